"""Stage 00: which shards a dataset has, and each stage's parameters as its own file.

Written at parse time of make, so that `make -n` knows all of it. Files change only when their
content does.
"""

import csv
import io
from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow import params as config
from gelforge.flow.files import read_csv, write_if_changed, write_text
from gelforge.flow.main import command, option

SHARD_DIGITS = 4


def assign_shards(ids: list[str], known: dict[str, int], size: int) -> dict[str, int]:
    """Return the shard of each id: what `known` says, new ones filling the last shard.

    A sample keeps its shard for ever, so appending to a log leaves every full shard as it is.
    """
    shards = {}
    counts: dict[int, int] = {}
    for shard in known.values():
        counts[shard] = counts.get(shard, 0) + 1
    last = max(counts, default=0)
    for name in ids:
        if name in shards:
            continue
        if name in known:
            shards[name] = known[name]
            continue
        if counts.get(last, 0) >= size:
            last += 1
        counts[last] = counts.get(last, 0) + 1
        shards[name] = last
    return shards


def read_log_rows(path: Path) -> tuple[list[str], list[dict]]:
    """Return the header and the rows of a raw log, each row with its line number as `row`.

    Only what sharding needs is checked here; stage 10 judges the rows.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise BadInput(f"{path}: not found; a dataset needs a raw log there (README.md, your own data)") from error
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: not UTF-8 text ({error}); save it as CSV in UTF-8") from error
    reader = csv.DictReader(io.StringIO(text), restkey="extra_columns", restval="")
    header = reader.fieldnames or []
    if "sample_id" not in header:
        raise BadInput(f"{path}: column sample_id is missing; seen: {', '.join(header) or 'no header'}")
    rows = []
    for row in reader:
        # kept, because an unquoted 0,5 shifts every cell behind it: stage 10 refuses such a row
        if "extra_columns" in row:
            row["extra_columns"] = " ".join(row["extra_columns"])
        rows.append({"row": reader.line_num, **row})
    if not rows:
        raise BadInput(f"{path}: has a header and no rows; log at least one press")
    return header, rows


def to_csv(columns: list[str], rows: list[dict]) -> str:
    """Rows as CSV text."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def planned_shards(folder: Path) -> list[str]:
    """Names of the shards that are planned today, in order, from the folder 00_plan/shards."""
    return sorted(path.stem for path in folder.glob("*.csv"))


def write_shards(log: Path, out: Path, size: int) -> list[str]:
    """Write one CSV of raw rows per shard and the assignment; return the shards' names in order."""
    header, rows = read_log_rows(log)
    table = out / "shards.csv"
    known = {row["sample_id"]: int(row["shard"]) for row in read_csv(table)} if table.exists() else {}
    shards = assign_shards([row["sample_id"] for row in rows], known, size)
    by_shard: dict[int, list[dict]] = {}
    for row in rows:
        by_shard.setdefault(shards[row["sample_id"]], []).append(row)
    names = []
    for shard, members in sorted(by_shard.items()):
        names.append(f"{shard:0{SHARD_DIGITS}d}")
        columns = ["row", *header, *["extra_columns"] * any("extra_columns" in row for row in members)]
        write_if_changed(out / "shards" / f"{names[-1]}.csv", to_csv(columns, members))
    for gone in set(planned_shards(out / "shards")) - set(names):
        (out / "shards" / f"{gone}.csv").unlink()  # the log lost its rows: no stage may read them again
    write_if_changed(table, to_csv(["sample_id", "shard"], [{"sample_id": k, "shard": v} for k, v in shards.items()]))
    return names


def write_slices(params: dict, workflow: Path, out: Path, catalogue: str, scenes: dict) -> None:
    """Write every stage's slice, and the catalogues without their comments."""
    source = Path(__file__).parent
    for stage in config.SLICES:
        version = config.stage_version(source, stage)
        write_if_changed(out / "params" / f"{stage}.json", config.canonical(config.cut_slice(params, stage, version)))
    for name, path in (("sensors", "sensors.toml"), ("indenters", catalogue)):
        write_if_changed(out / "params" / f"{name}.json", config.canonical(config.read_toml(workflow / path)))
    # One file per network, so that a new network retrains no other.
    for name, table in config.read_toml(workflow / "models.toml").items():
        write_if_changed(out / "params" / "models" / f"{name}.json", config.canonical({name: table}))
    for name, table in scenes.items():
        write_if_changed(out / "params" / "scenes" / f"{name}.json", config.canonical(table))


def chart_lists(params: dict, scenes: dict) -> dict[str, list[str]]:
    """Names that the rules of the branches pareto and stability need."""
    from gelforge.sweeps.references import all_meshes

    quick = params["pareto"]["quick"]["scenes"]
    return {"PARETO_SCENES": list(scenes), "PARETO_QUICK": quick, "PARETO_MESHES": all_meshes(params, scenes)}


@command(
    option("--data", type=Path, help="data/DATASET"),
    option("--workflow", type=Path, default=Path("workflow")),
    option("--ccx", default="none", help="CalculiX' program, or `none`"),
    option("--out", type=Path, help="results/DATASET/00_plan/plan.mk"),
)
def main(args: Namespace) -> None:
    out = args.out.parent
    dataset_toml = args.data / "dataset.toml"
    params = config.load_params(args.workflow, dataset_toml)
    if args.ccx == "none" and params["fea"]["fidelity"] != "hex":
        print(
            f"CalculiX (ccx) was not found: fidelity hex is used instead of {params['fea']['fidelity']}.", flush=True
        )
        params["fea"]["fidelity"] = "hex"
    from gelforge.sweeps.scenes import read_tables

    scenes = read_tables(args.workflow)
    write_slices(
        params, args.workflow, out, config.read_toml(dataset_toml).get("catalogue", "indenters.toml"), scenes
    )
    shards = write_shards(args.data / "log.csv", out, params["plan"]["shard_size"])
    from gelforge.mechanics.family import required_meshes

    meshes = required_meshes(params["fea"], params["meshes"])
    lists = {"SHARDS": shards, "MESHES": meshes, "BRANCHES": params["report"]["branches"]}
    lists |= chart_lists(params, scenes)
    write_text(args.out, "".join(f"{name} := {' '.join(values)}\n" for name, values in lists.items()))


if __name__ == "__main__":
    main.exit()
