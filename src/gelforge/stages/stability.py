"""Branch stability: where each solver converges, where it fails and why, and where a converged result drifts.

`row` solves the cases of one factor, `map` joins the rows.
"""

import time
from argparse import Namespace
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gelforge.errors import BadInput
from gelforge.flow.cli import group, stage
from gelforge.flow.files import digest_of_value, publish, read_json, write_csv, write_json
from gelforge.flow.layout import Layout, beside
from gelforge.flow.params import StageParameters, read_parameters
from gelforge.mechanics.ccx.program import need_ccx
from gelforge.mechanics.solve import settings_of
from gelforge.records.status import VALID
from gelforge.sweeps.cases import FINEST, ROWS, SERIES, Case, factor_of, row_cases
from gelforge.sweeps.deviation import total_error
from gelforge.sweeps.methods import Method, hex_settings, method_of, prepare
from gelforge.sweeps.trial import kept, solve_isolated

VERSION = 5
NOT_RUN = "NOT_RUN"
# Method of cases without an element size of their own, by solver.
LABEL = {"hex": method_of("label"), "ccx": method_of("ccx"), FINEST: method_of("fine")}
COLUMNS = ("row", "level", "solver", "kind", "shape", "depth", "shear", "place", "nu", "friction", "size", "steps", "status",
           "verdict", "error", "against", "fx_n", "fy_n", "fz_n", "cpu_seconds", "reason")  # fmt: skip


def case_key(case: Case, params: StageParameters) -> str:
    """Digest of everything that a case's result depends on."""
    parts = [case.describe(), params.version]
    if case.solver in ("hex", FINEST):
        parts.append(asdict(hex_settings(case_method(case, params))))
    else:
        parts += settings_of("ccx", params.fea, case.scene.gel)
    return digest_of_value(parts)


def case_method(case: Case, params: StageParameters) -> Method:
    """The method by which a case is solved."""
    if not case.size:
        return LABEL[case.solver]
    layers = params.stability.layers.get(str(case.size), 6)
    return Method("case", case.solver, case.size, layers, case.steps)


def case_file(case: Case, params: StageParameters, folder: Path) -> tuple[Path, str]:
    """Path of a case's record, and its key."""
    key = case_key(case, params)
    return folder / f"{key[:24]}.json", key


def solve_case(case: Case, params: StageParameters, folder: Path) -> dict:
    """Record of one case, stored or newly solved."""
    path, key = case_file(case, params, folder)
    limit = params.stability.limit_s
    record = kept(path, key, limit)
    if record is None:
        method = case_method(case, params)
        make = partial(prepare, method, case.scene, params)
        found = solve_isolated(make, None, limit, folder)
        record = {"key": key, "case": case.describe()} | found
        write_json(path, record)
        print(f"{case}: {record['status']} {record.get('total')} {record.get('reason')}", flush=True)
    return record


def solve_row(row: str, params: StageParameters, folder: Path) -> list[dict]:
    """Records of a row; cases that its time limit left out are marked NOT_RUN, and a rerun resumes at them."""
    end = time.monotonic() + 60.0 * params.stability.minutes
    records = []
    for case in tqdm(row_cases(params.stability, row), f"stability {row}"):
        if time.monotonic() > end and kept(*case_file(case, params, folder), params.stability.limit_s) is None:
            reason = f"the row's time was over; delete rows/{row}.json and run make again, it resumes here"
            records.append({"case": case.describe(), "status": NOT_RUN, "reason": reason})
        else:
            records.append(solve_case(case, params, folder))
    return records


def judge_row(row: str, records: list[dict], params: StageParameters) -> list[dict]:
    """Rows of the table: each case with its verdict "good", "drifts", "failed" or "not run", and its error.

    The error is the difference in total force from the finest solve of the same press: by the same solver in the rows
    of element sizes and load steps, on the finest hexahedra in the others.
    """
    limit = params.stability.drift
    cases = [Case(**record["case"]) for record in records]
    judged = []
    for case, record in zip(cases, records, strict=True):
        against, other = _yardstick(row, case, cases, records)
        error = None
        if other is not None and record["status"] == other["status"] == "OK" and np.linalg.norm(other["total"]) > 0:
            error = total_error(record["total"], other["total"])
        verdict = "not run" if record["status"] == NOT_RUN else "failed" if record["status"] not in VALID else "good"
        if verdict == "good" and error is not None and error > limit:
            verdict = "drifts"
        fx, fy, fz = record.get("total") or (None, None, None)
        judged.append({"row": row, "level": getattr(case, factor_of(row))} | record["case"] | {
            "status": record["status"], "verdict": verdict, "error": error, "against": against,
            "fx_n": fx, "fy_n": fy, "fz_n": fz, "cpu_seconds": record.get("cpu_seconds"),
            "reason": record.get("reason", ""),
        })  # fmt: skip
    return judged


def _yardstick(row, case, cases, records):
    """What a case is compared with: description and record, (None, None) if there is nothing."""
    if row in SERIES:
        same = [i for i, c in enumerate(cases) if (c.solver, c.press) == (case.solver, case.press)]
        finest = min(same, key=lambda i: (cases[i].size, -cases[i].steps))
        return f"{row} {getattr(cases[finest], row):g}", records[finest]
    if case.solver != FINEST:
        for c, record in zip(cases, records, strict=True):
            if c.solver == FINEST and c.press == case.press:
                return FINEST, record
    return None, None


def reading(table: list[dict]) -> list[str]:
    """The results of the map in sentences."""
    said = []
    for solver in dict.fromkeys(line["solver"] for line in table):
        own = [line for line in table if line["solver"] == solver]
        count = {v: sum(line["verdict"] == v for line in own) for v in ("good", "drifts", "failed", "not run")}
        run = len(own) - count["not run"]
        said.append(f"{solver}: {run - count['failed']} of {run} solves converged, {count['drifts']} of them drift,"
                    f" {count['failed']} failed, {count['not run']} were not run.")  # fmt: skip
        for row in dict.fromkeys(line["row"] for line in own):
            drifting = [line for line in own if line["row"] == row and line["verdict"] == "drifts"]
            if drifting:
                named = ", ".join(f"{_place(line)} ({line['error']:.0%})" for line in drifting[:8])
                said.append(f"  {solver}, {row}: {named}{' and more' if len(drifting) > 8 else ''}.")
        said += [f"  {solver}, {line['row']}: {_place(line)}: {line['status']}, {line['reason']}"
                 for line in own if line["verdict"] == "failed"]  # fmt: skip
    return said


def _place(line: dict) -> str:
    return f"{line['kind']} {factor_of(line['row'])} {line['level']}"


@stage(Layout.stability_row)
def solve(args: Namespace) -> None:
    """Solve the cases of one row; a rerun resumes."""
    of = args.of
    if args.row not in ROWS:
        raise BadInput(f"no row {args.row!r} of cases; there are {', '.join(ROWS)}")
    params = read_parameters(of.parameters("stability"))
    need_ccx()
    records = solve_row(args.row, params, args.out.parents[1] / "cases")
    judged = judge_row(args.row, records, params)
    write_json(args.out, {"row": args.row, "judged": judged, "evidence": [r.get("evidence", {}) for r in records]})
    left = sum(r["status"] == NOT_RUN for r in records)
    if left:
        print(
            f"{left} of {len(records)} cases were not run: the row's time was over; delete its file and run make again"
        )


@stage(Layout.stability_map)
def draw(args: Namespace) -> None:
    """Join the rows: picture, CSV and JSON."""
    from gelforge.reporting.charts import stability_map

    table = [line for row in ROWS for line in read_json(args.of.stability_row(row))["judged"]]
    write_csv(beside(args.out, ".csv"), COLUMNS, table)
    with publish(beside(args.out, ".png")) as part:
        part.write_bytes(stability_map(table))
    said = reading(table)
    write_json(args.out, {"reading": said, "table": table})
    print("\n".join(said))


main = group(row=solve, map=draw)


if __name__ == "__main__":
    main.exit()
