"""Stage 00: which shards a dataset has, and each stage's parameters as its own file.

Written at parse time of make, so that `make -n` knows all of it. Files change only when their
content does.
"""

from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow import params as config
from gelforge.flow.files import read_csv, write_if_changed, write_text
from gelforge.flow.main import command, option
from gelforge.records.log import csv_text, read_log, shard_text
from gelforge.records.press import RawRow

SHARD_DIGITS = 4


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


def write_shards(log: Path, out: Path, size: int) -> list[str]:
    """Write one CSV of raw rows per shard and the assignment; return the shards' names in order.

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
    names = []
    for shard, members in sorted(by_shard.items()):
        names.append(f"{shard:0{SHARD_DIGITS}d}")
        write_if_changed(out / "shards" / f"{names[-1]}.csv", shard_text(members))
    for gone in set(planned_shards(out / "shards")) - set(names):
        (out / "shards" / f"{gone}.csv").unlink()  # the log lost its rows: no stage may read them again
    lines = [{"sample_id": name, "shard": shard} for name, shard in shards.items()]
    write_if_changed(table, csv_text(["sample_id", "shard"], lines))
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


def reported_model(params: dict, models: dict) -> list[str]:
    """The network that the report shows, as a list of one or none; BadInput for a name that is none."""
    name = params["report"]["model"]
    if name and name not in {*models, "shipped"}:
        raise BadInput(
            f"[report] model = {name!r}: choose shipped, nothing, or one of {', '.join(models)} (models.toml)"
        )
    return [name] if name else []


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
    lists["REPORT_MODEL"] = reported_model(params, config.read_toml(args.workflow / "models.toml"))
    write_text(args.out, "".join(f"{name} := {' '.join(values)}\n" for name, values in lists.items()))


if __name__ == "__main__":
    main.exit()
