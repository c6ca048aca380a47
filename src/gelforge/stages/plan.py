"""Stage 00: which shards a dataset has, and each stage's parameters as its own file.

Written at parse time of make, so that `make -n` knows all of it. Files change only when their
content does.
"""

import hashlib
import re
from argparse import Namespace
from collections.abc import Mapping
from hashlib import blake2b
from pathlib import Path
from stat import S_ISREG
from types import MappingProxyType

from gelforge.errors import BadInput
from gelforge.flow import params as config
from gelforge.flow.files import read_csv, read_json, write_if_changed, write_text
from gelforge.flow.main import command, option
from gelforge.records.log import csv_text, read_log, shard_text
from gelforge.records.press import RawRow

SHARD_DIGITS = 4
LARGEST_PICTURE = 64 * 2**20  # bytes; stage 10 refuses what is larger
BRANCHES = ("calibrate", "pareto")  # that may be part of a report


def assign_shards(
    ids: list[str], known: dict[str, int], size: int, press_of: dict[str, str] | None = None
) -> dict[str, int]:
    """Return the shard of each id: what `known` says, new ones filling the last shard.

    A sample keeps its shard for ever, so appending to a log leaves every full shard as it is. Samples of one press
    (`press_of`, by id) are solved together: they go to its first one's shard, however full.
    """
    shards: dict[str, int] = {}
    counts: dict[int, int] = {}
    press_of = press_of or {}
    homes = {press_of[name]: shard for name, shard in reversed(known.items()) if press_of.get(name)}
    for shard in known.values():
        counts[shard] = counts.get(shard, 0) + 1
    last = max(counts, default=0)
    for name in ids:
        if name in shards:
            continue
        if name in known:
            shards[name] = known[name]
            continue
        press = press_of.get(name)
        if press in homes:
            shards[name] = homes[press]
        else:
            last += counts.get(last, 0) >= size
            shards[name] = last
        if press:
            homes.setdefault(press, shards[name])
        counts[shards[name]] = counts.get(shards[name], 0) + 1
    return shards


def planned_shards(folder: Path) -> list[str]:
    """Names of the shards that are planned today, in order, from the folder 00_plan/shards."""
    return sorted(path.stem for path in folder.glob("*.csv"))


def write_shards(log: Path, out: Path, size: int, tables: Mapping[str, dict] = MappingProxyType({})) -> list[str]:
    """Write one CSV of raw rows per shard, what it uses of the catalogues, and the assignment; return the shards' names.

    Only what sharding needs is checked here; stage 10 judges the rows.
    """
    rows = read_log(log)
    table = out / "shards.csv"
    known = {row["sample_id"]: int(row["shard"]) for row in read_csv(table)} if table.exists() else {}
    ids = [row.cells["sample_id"] for row in rows]
    press_of = {row.cells["sample_id"]: row.cells["press_id"] for row in rows if row.cells.get("press_id")}
    shards = assign_shards(ids, known, size, press_of)
    by_shard: dict[int, list[RawRow]] = {}
    for row, name in zip(rows, ids, strict=True):
        by_shard.setdefault(shards[name], []).append(row)
    pictures = image_digests(log.parent, named(rows, "image"), out / "pictures.json")
    names = []
    for shard, members in sorted(by_shard.items()):
        names.append(f"{shard:0{SHARD_DIGITS}d}")
        write_if_changed(out / "shards" / f"{names[-1]}.csv", shard_text(members))
        # an entry that only other shards use may change without a rerun of this one
        entries = {kind: used(table, named(members, COLUMN_OF[kind])) for kind, table in tables.items()}
        entries["images"] = {name: pictures[name] for name in sorted(named(members, "image")) if name in pictures}
        write_if_changed(out / "shards" / f"{names[-1]}.json", config.canonical(entries))
    for gone in set(planned_shards(out / "shards")) - set(names):
        # the log lost its rows: no stage may read them again
        for suffix in (".csv", ".json"):
            (out / "shards" / f"{gone}{suffix}").unlink(missing_ok=True)
    lines = [{"sample_id": name, "shard": shard} for name, shard in shards.items()]
    write_if_changed(table, csv_text(["sample_id", "shard"], lines))
    return names


COLUMN_OF = {"sensors": "sensor_id", "indenters": "indenter"}  # of the log, by catalogue


def named(rows: list[RawRow], column: str) -> set[str]:
    """What rows of the log name in a column."""
    return {row.cells.get(column, "").strip() for row in rows}


def image_digests(data: Path, names: set[str], kept: Path) -> dict[str, str]:
    """Digest of each picture that rows name: one that was replaced is another picture, one that was touched is not.

    kept: a JSON file of digests by name, time and size, so that a picture is read once.
    """
    known = read_json(kept) if kept.exists() else {}
    told, found = {}, {}
    for name in sorted(names):
        path = Path(name)
        if not name or path.is_absolute() or ".." in path.parts:
            continue
        try:
            state = (data / path).stat()
            if not S_ISREG(state.st_mode) or state.st_size > LARGEST_PICTURE:
                continue
            old = known.get(name, [None] * 3)
            same = old[:2] == [state.st_mtime_ns, state.st_size]
            digest = old[2] if same else blake2b((data / path).read_bytes(), digest_size=8).hexdigest()
        except (OSError, ValueError):
            continue
        told[name], found[name] = [state.st_mtime_ns, state.st_size, digest], digest
    write_if_changed(kept, config.canonical(told))
    return found


def write_slices(params: dict, workflow: Path, out: Path, tables: dict[str, dict], scenes: dict) -> None:
    """Write every stage's slice, and the catalogues' entries that this dataset uses, without their comments."""
    source = Path(__file__).parent
    for stage in config.SLICES:
        version = config.stage_version(source, stage)
        write_if_changed(out / "params" / f"{stage}.json", config.canonical(config.cut_slice(params, stage, version)))
    for name, entries in tables.items():
        write_if_changed(out / "params" / f"{name}.json", config.canonical(entries))
    # One file per network, so that a new network retrains no other.
    for name, table in config.read_toml(workflow / "models.toml").items():
        write_if_changed(out / "params" / "models" / f"{name}.json", config.canonical({name: table}))
    for name, table in scenes.items():
        write_if_changed(out / "params" / "scenes" / f"{name}.json", config.canonical(table))


def used(catalogue: dict, names: set[str]) -> dict:
    """The entries of a catalogue that a dataset names: another one that is added or edited changes nothing."""
    return {name: table for name, table in catalogue.items() if name in names}


def with_content(indenters: dict, folder: Path) -> tuple[dict, list[Path]]:
    """Tables of indenters with a digest of each STL file they name, and these files.

    A file that changes under its name is another shape: all that follows depends on what is in it.
    """
    found, files = {}, []
    for name, table in indenters.items():
        file = table.get("file") if isinstance(table, dict) and table.get("kind") == "stl" else None
        path = folder / file if isinstance(file, str) else None
        if path is not None and path.is_file():
            files.append(path)
            table = {**table, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        found[name] = table
    return found, files


# What make takes as one word without reading anything into it.
_WORD = re.compile(r"[A-Za-z0-9_@+][A-Za-z0-9_.@+/-]*")
MOST_SHARDS = 20_000


def make_list(name: str, values: list[str]) -> str:
    """A line of make that lists words; one that make would not take as it stands raises BadInput."""
    for value in values:
        if not isinstance(value, str) or not _WORD.fullmatch(value):
            raise BadInput(
                f"{value!r} cannot be a name in {name}: make reads meaning into such characters; use letters, digits,"
                " _ - . + @ and / only"
            )
    return f"{name} := {' '.join(values)}\n"


def state_of(paths: list[Path]) -> str:
    """Name, time and size of files as `stat -c %n:%.9Y:%s` prints them, to see later whether one was replaced."""
    told = []
    for path in paths:
        if path.exists():
            found = path.stat()
            seconds, rest = divmod(found.st_mtime_ns, 10**9)
            told.append(f"{path}:{seconds}.{rest:09d}:{found.st_size}")
    return " ".join(told)


def reported_model(params: dict, models: dict) -> list[str]:
    """The network that the report shows, as a list of one or none; BadInput for a name that is none."""
    name = params["report"]["model"]
    if name and name not in {*models, "shipped"}:
        raise BadInput(
            f"[report] model = {name!r}: choose shipped, nothing, or one of {', '.join(models)} (models.toml)"
        )
    return [name] if name else []


def branches(params: dict) -> list[str]:
    """Branches that the report shows; BadInput for a name that is none."""
    asked = params["report"]["branches"]
    if not isinstance(asked, list) or not set(map(str, asked)) <= set(BRANCHES):
        raise BadInput(f"[report] branches = {asked!r}: give a list of some of {', '.join(BRANCHES)}, or []")
    return asked


def chart_lists(params: dict, scenes: dict) -> dict[str, list[str]]:
    """Names that the rules of the branches pareto and stability need."""
    from gelforge.sweeps.references import all_meshes

    quick = params["pareto"]["quick"]["scenes"]
    return {"PARETO_SCENES": list(scenes), "PARETO_QUICK": quick, "PARETO_MESHES": all_meshes(params, scenes)}


def read_catalogues(data: Path, workflow: Path, params: dict) -> tuple[dict[str, dict], list[Path]]:
    """What of the sensors and indenters a dataset and its charts use, by slice, and the files that this depends on."""
    catalogue = workflow / config.read_toml(data / "dataset.toml").get("catalogue", "indenters.toml")
    rows = read_log(data / "log.csv")
    sensors = named(rows, "sensor_id") | {params["pareto"]["sensor"]}
    indenters = used(config.read_toml(catalogue), named(rows, "indenter"))
    indenters, shapes = with_content(indenters, workflow)
    tables = {"sensors": used(config.read_toml(workflow / "sensors.toml"), sensors), "indenters": indenters}
    return tables, [catalogue, *shapes]


def check_count(shards: list[str], size: int) -> None:
    """Refuse more shards than make can hold."""
    if len(shards) > MOST_SHARDS:
        raise BadInput(
            f"{len(shards)} shards of up to {size} samples are more make targets than the {MOST_SHARDS} that work;"
            f" delete results/DATASET/00_plan and set [params.plan] shard_size = {size * len(shards) // 2000} or more"
        )


@command(
    option("--data", type=Path, help="data/DATASET"),
    option("--workflow", type=Path, default=Path("workflow")),
    option("--ccx", default="none", help="CalculiX' program, or `none`"),
    option(
        "--inputs", type=Path, nargs="*", default=[], help="files whose state the plan keeps, beside those it reads"
    ),
    option("--out", type=Path, help="results/DATASET/00_plan/plan.mk"),
)
def main(args: Namespace) -> None:
    out = args.out.parent
    dataset_toml = args.data / "dataset.toml"
    before = state_of(args.inputs)  # told before they are read: a change in between is seen next time
    params = config.load_params(args.workflow, dataset_toml)
    if args.ccx == "none" and params["fea"]["fidelity"] != "hex":
        print(
            f"CalculiX (ccx) was not found: fidelity hex is used instead of {params['fea']['fidelity']}.", flush=True
        )
        params["fea"]["fidelity"] = "hex"
    from gelforge.mechanics.family import required_meshes
    from gelforge.sweeps.scenes import read_tables

    scenes = read_tables(args.workflow)
    tables, read = read_catalogues(args.data, args.workflow, params)
    meshes = required_meshes(params["fea"], params["meshes"])
    lists = {"MESHES": meshes, "BRANCHES": branches(params)} | chart_lists(params, scenes)
    lists["REPORT_MODEL"] = reported_model(params, config.read_toml(args.workflow / "models.toml"))
    lists["PLAN_READS"] = [str(path) for path in read]
    text = "".join(make_list(name, values) for name, values in lists.items())
    write_slices(params, args.workflow, out, tables, scenes)
    shards = write_shards(args.data / "log.csv", out, params["plan"]["shard_size"], tables)
    check_count(shards, params["plan"]["shard_size"])
    state = " ".join(filter(None, [before, state_of(read)]))
    write_text(args.out, f"{make_list('SHARDS', shards)}{text}PLAN_STATE := {state}\n")


if __name__ == "__main__":
    main.exit()
