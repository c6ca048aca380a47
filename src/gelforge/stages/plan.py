"""Stage 00: which shards a dataset has, and each stage's parameters as its own file.

Written at parse time of make, so that `make -n` knows all of it. Files change only when their
content does.
"""

import os
import re
import subprocess
from argparse import Namespace
from collections.abc import Iterable, Mapping
from dataclasses import replace
from hashlib import blake2b, sha256
from pathlib import Path
from types import MappingProxyType

from gelforge.errors import BadInput, printable
from gelforge.flow import params as config
from gelforge.flow.catalogue import with_content
from gelforge.flow.files import csv_text, write_if_changed, write_text
from gelforge.flow.kept import Kept
from gelforge.flow.layout import LOGGED, planned_shards, shard_name
from gelforge.flow.main import command, option
from gelforge.flow.params import DatasetFile, Params
from gelforge.flow.params.tables import IN_PROCESS, SHIPPED, SHIPPED_IMAGE
from gelforge.records.log import read_log, shard_text
from gelforge.records.press import SENSOR_TABLES, RawRow
from gelforge.records.regular import bytes_or_fault
from gelforge.records.repeats import repeats
from gelforge.records.table import read_table


def assign_shards(
    ids: list[str], known: dict[str, int], size: int, press_of: dict[str, str] | None = None
) -> dict[str, int]:
    """Return the shard of each id: what `known` says, new ones filling the last shard.

    A sample keeps its shard, so appending to a log leaves every full shard as it is. Samples of one press (`press_of`,
    by id) are solved together: they go to its first one's shard, however full, also where they were given as one
    press after they had shards.
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
        press = press_of.get(name, "")
        if name in known and homes.get(press, known[name]) == known[name]:
            shards[name] = known[name]
            continue
        if press in homes:
            shards[name] = homes[press]
        else:
            last += counts.get(last, 0) >= size
            shards[name] = last
        if press:
            homes.setdefault(press, shards[name])
        counts[shards[name]] = counts.get(shards[name], 0) + 1
    return shards


def logged_rows(log: Path, sensor: str | None) -> list[RawRow]:
    """Raw rows of a log; those that name no sensor are of the dataset's, where it names one."""
    rows = read_log(log)
    if sensor is None:
        return rows
    named_one = (row.cells.get("sensor_id", "").strip() for row in rows)
    return [
        row if name else replace(row, cells={**row.cells, "sensor_id": sensor})
        for row, name in zip(rows, named_one, strict=True)
    ]


def known_shards(table: Path) -> dict[str, int]:
    """Shard of each sample in the plan before, none where there was none; a corrupt table raises BadInput."""
    hint = "bring it back from a copy, or remove it: samples that come into another shard then are solved again"
    rows = read_table(table, hint) if table.exists() else []
    # a row of the log without a sample_id has a shard, too: stage 10 rejects it there
    if not all("sample_id" in row and row.get("shard", "").isdecimal() for row in rows):
        raise BadInput(f"{table}: does not name the shard of every sample; {hint}")
    return {row["sample_id"]: int(row["shard"]) for row in rows}


def write_shards(
    data: Path, rows: list[RawRow], out: Path, size: int, tables: Mapping[str, dict] = MappingProxyType({})
) -> list[str]:
    """Write one CSV of raw rows per shard, what it uses of the catalogues, and the assignment; return the shards' names.

    data: folder that the rows' pictures are named from. Only what sharding needs is checked here; stage 10 judges the
    rows.
    """
    table = out / "shards.csv"
    known = known_shards(table)
    ids = [row.cells["sample_id"] for row in rows]
    press_of = {row.cells["sample_id"]: row.press_id for row in rows if row.press_id}
    shards = assign_shards(ids, known, size, press_of)
    by_shard: dict[int, list[RawRow]] = {}
    for row, name in zip(rows, ids, strict=True):
        by_shard.setdefault(shards[name], []).append(row)
    pictures = image_digests(data, named(rows, "image"), out / "pictures.json")
    repeated = repeated_rows(rows, pictures)
    names = []
    for shard, members in sorted(by_shard.items()):
        names.append(shard_name(shard))
        write_if_changed(out / "shards" / f"{names[-1]}.csv", shard_text(members))
        # an entry that only other shards use may change without a rerun of this one
        entries = {kind: used(table, named(members, COLUMN_OF[kind])) for kind, table in tables.items()}
        entries["gels"] = own_shapes(entries.get("sensors", {}))
        if found := {str(row.row): repeated[row.row] for row in members if row.row in repeated}:
            entries["repeated"] = found
        entries["images"] = {name: pictures[name] for name in sorted(named(members, "image")) if name in pictures}
        write_if_changed(out / "shards" / f"{names[-1]}.json", config.canonical(entries))
    for gone in set(planned_shards(out / "shards")) - set(names):
        # the log lost its rows: no stage may read them again
        for suffix in (".csv", ".json"):
            (out / "shards" / f"{gone}{suffix}").unlink(missing_ok=True)
    # samples that the log has lost keep their shard, and so their solves, should they come back
    kept = {name: shard for name, shard in known.items() if name not in shards}
    lines = [{"sample_id": n, "shard": shard, LOGGED: int(n in shards)} for n, shard in (shards | kept).items()]
    write_if_changed(table, csv_text(["sample_id", "shard", LOGGED], lines))
    return names


def own_shapes(sensors: Mapping[str, object]) -> dict[str, dict]:
    """Kind and numbers of the gels of workflow/gels.toml that sensors carry: what is pressed there depends on them."""
    from gelforge.geometry.gel import GELS, gel_shape, is_gel, load_gel

    names = {table.get("gel") for table in sensors.values() if isinstance(table, dict)}
    return {name: gel_shape(load_gel(name)) for name in sorted(filter(is_gel, names - GELS.keys()))}


def repeated_rows(rows: list[RawRow], pictures: dict[str, str]) -> dict[int, str]:
    """For each row whose picture another press shows, too, by its line: the first such row but itself.

    pictures: digests by name, so that copies of a file count.
    """
    found: dict[int, str] = {}
    for members in repeats(rows, [pictures.get(row.cells.get("image", "")) for row in rows]):
        first, second = (f"row {rows[at].row}, {printable(rows[at].cells['sample_id'])[:100]}," for at in members[:2])
        found |= {rows[at].row: second if at == members[0] else first for at in members}
    return found


COLUMN_OF = {"sensors": "sensor_id", "indenters": "indenter"}  # of the log, by catalogue


def named(rows: list[RawRow], column: str) -> set[str]:
    """What rows of the log name in a column."""
    return {row.cells.get(column, "").strip() for row in rows}


def picture_folders(data: Path, rows: list[RawRow]) -> list[str]:
    """Folders right below the dataset's with pictures that rows name, in which make looks for others.

    The dataset's own where pictures lie in it, or where make cannot name the folder.
    """
    inside = (Path(name).parts for name in named(rows, "image") if name and not Path(name).is_absolute())
    folders = {str(data / parts[0]) if len(parts) > 1 else str(data) for parts in inside if ".." not in parts}
    found = {folder if _WORD.fullmatch(folder) else str(data) for folder in folders}
    return [str(data)] if str(data) in found else sorted(found)


def picture_state(folders: list[str]) -> str:
    """Digest of the names, sizes and times of all files below folders, as rules/00_plan.mk has it from the same programs."""
    listing = ["find", "-L", *folders, "-type", "f", "-printf", r"%p %s %C@\n"]
    found = subprocess.run(listing, capture_output=True, env={**os.environ, "LC_ALL": "C"}, check=False).stdout
    lines = sorted(found.split(b"\n")[:-1])
    return sha256(b"".join(line + b"\n" for line in lines)).hexdigest()[:32]


def image_digests(data: Path, names: set[str], kept: Path) -> dict[str, str]:
    """Digest of each picture that rows name: one that was replaced is another picture, one that was touched is not.

    One that stage 10 refuses for its place, outside the dataset's folder, has none: a copy of it inside is another.
    kept: a JSON file of digests, so that a picture is read once.
    """
    from gelforge.records.image import MOST_BYTES, stays_inside

    def read(path: Path) -> str | None:
        content, fault = bytes_or_fault(path, MOST_BYTES)
        return None if fault else blake2b(content, digest_size=8).hexdigest()  # stage 10 refuses what has a fault

    pictures = Kept(kept)
    found = {name: pictures.of(data / name, read) for name in sorted(names) if name and stays_inside(data, name)}
    pictures.keep()
    return {name: digest for name, digest in found.items() if digest}


def write_parameters(params: Params, workflow: Path, out: Path, tables: dict[str, dict], scenes: dict) -> None:
    """Write the parameters of every stage, and the catalogues' entries that this dataset uses, without their comments."""
    source = Path(__file__).parent
    for name, of in config.SOURCES.items():
        made = config.parameters_of(params, of.kind, config.stage_version(source, of))
        write_if_changed(out / "params" / f"{name}.json", config.canonical(config.plain(made)))
    for name, entries in tables.items():
        write_if_changed(out / "params" / f"{name}.json", config.canonical(entries))
    # One file per network, so that a new network retrains no other.
    for name, table in networks(workflow).items():
        write_if_changed(out / "params" / "models" / f"{name}.json", config.canonical({name: table}))
    for name, table in scenes.items():
        write_if_changed(out / "params" / "scenes" / f"{name}.json", config.canonical(table))


def used(catalogue: dict, names: set[str]) -> dict:
    """The entries of a catalogue that a dataset names: another one that is added or edited changes nothing."""
    return {name: table for name, table in catalogue.items() if name in names}


# What make takes as one word without reading anything into it.
_WORD = re.compile(r"[A-Za-z0-9_@+][A-Za-z0-9_.@+/-]*")
NETWORK_NAME = re.compile(r"[a-z0-9_]+")
MOST_SHARDS = 20_000
GELS_FILE = "gels.toml"


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
    states = []
    for path in paths:
        if path.exists():
            found = path.stat()
            seconds, rest = divmod(found.st_mtime_ns, 10**9)
            states.append(f"{path}:{seconds}.{rest:09d}:{found.st_size}")
    return " ".join(states)


def networks(workflow: Path) -> dict[str, dict]:
    """Tables of workflow/models.toml by name; BadInput for a name that make, which makes them words of its rules, would miss."""
    path = workflow / "models.toml"
    found = config.read_toml(path)
    if odd := [name for name in found if not NETWORK_NAME.fullmatch(name)]:
        raise BadInput(f"{path}: [{odd[0]}]: name a network by small letters, digits and underscores alone")
    return found


def network_lists(models: dict[str, dict]) -> dict[str, list[str]]:
    """Names of all networks, of those that start from the network that ships, and of those that read a no-contact image."""
    tables = {name: table for name, table in models.items() if isinstance(table, dict)}
    tuned = [name for name, table in tables.items() if "start" in table]
    beside = [name for name, table in tables.items() if table.get("reads", "image") != "image"]
    return {"MODELS": list(tables), "TUNED": tuned, "NEED_NOCONTACT": beside}


def shape_files(workflow: Path) -> list[str]:
    """Files of shapes that the project's own catalogue names."""
    files = with_content(config.read_toml(workflow / "indenters.toml"), workflow)[1]
    return [str(path) for path in files if _WORD.fullmatch(str(path))]


def reported_model(file: Path, params: Params, models: dict) -> list[str]:
    """The network that the report shows, as a list of one or none; BadInput for a name that is none. file: dataset.toml."""
    name = params.report.model
    if name and name not in {*models, SHIPPED}:
        raise BadInput(
            f"{file}: [params.report] model = {name!r}: choose {SHIPPED}, nothing, or one of {', '.join(models)} (models.toml)"
        )
    return [name] if name else []


def check_names(setting: str, names: Iterable[str], known: Mapping[str, object]) -> None:
    """Refuse a name that is none of those known: misspelt, it would do nothing."""
    for name in names:
        if name not in known:
            raise BadInput(f"{setting}: {name!r} is unknown{config.nearest(name, known)}")


def chart_lists(params: Params, scenes: dict) -> dict[str, list[str]]:
    """Names that the rules of the branches pareto and stability need."""
    from gelforge.sweeps.references import all_meshes

    quick = list(params.pareto.quick.scenes)
    check_names("[pareto.quick] scenes", quick, scenes)
    check_names("[pareto] halved", params.pareto.halved, scenes)
    return {"PARETO_SCENES": list(scenes), "PARETO_QUICK": quick, "PARETO_MESHES": all_meshes(params, scenes)}


def read_catalogues(
    rows: list[RawRow], catalogue: Path, workflow: Path, known: dict, bodies: dict, params: Params
) -> tuple[dict[str, dict], list[Path]]:
    """What of the `known` sensors and indenters, `bodies`, a dataset and its charts use, by stage, and files this depends on.

    catalogue: file of the indenters, beside the dataset's own.
    """
    from gelforge.geometry.gelcatalogue import files_of

    sensors = named(rows, "sensor_id") | {params.pareto.sensor}
    indenters, shapes = with_content(used(bodies, named(rows, "indenter")), workflow)
    tables = {"sensors": used(known, sensors), "indenters": indenters}
    # the charts' scenes name indenters of the project's own catalogue, whichever the dataset has
    return tables, list(
        dict.fromkeys([catalogue, workflow / "indenters.toml", *shapes, *files_of(workflow / GELS_FILE)])
    )


def check_gel(file: Path, of: DatasetFile, params: Params, sensors: dict[str, dict]) -> None:
    """Refuse a dataset whose gel is not one throughout: in its file, in [meshes], and on the sensors of its log.

    Where presses are solved on hexahedra, which are built for each press, sensors may state a thickness of their own.
    sensors: tables of those that the log names. A gel that is none is left to stage 10, which rejects its rows.
    """
    from gelforge.geometry.gel import is_gel, load_gel, states_thickness

    mesh_gel = params.meshes.gel
    try:
        load_gel(mesh_gel)
    except BadInput as error:
        raise BadInput(f"{file}: [params.meshes] {error}") from None
    if of.gel is not None and of.gel != mesh_gel:
        raise BadInput(
            f"{file}: gel = {of.gel!r}, but [meshes] gel = {mesh_gel!r}, on which presses are solved; name one gel"
        )
    hexahedra = params.fea.fidelity in IN_PROCESS
    for name, table in sorted(sensors.items()):
        gel = table.get("gel") if isinstance(table, dict) else None
        if is_gel(gel) and gel != mesh_gel and not (hexahedra and states_thickness(gel, mesh_gel)):
            raise BadInput(
                f"{file}: sensor {name!r} of the log has gel {gel!r} ({SENSOR_TABLES}), but"
                f" [meshes] gel = {mesh_gel!r}: set [params.meshes] gel, and keep presses on different gels in datasets of their own;"
                ' hexahedra ([params.fea] fidelity = "hex") follow the thickness that each sensor states'
            )


def picture_sizes(sensors: dict[str, dict]) -> dict[tuple[int, int], str]:
    """Sizes (width, height) of the pictures that sensors take, each with the first sensor of that size.

    A sensor whose table states none is left to stage 10, which rejects its rows.
    """
    sizes: dict[tuple[int, int], str] = {}
    for name, table in sorted(sensors.items()):
        match table:
            case {"image": [int(width), int(height)]}:
                sizes.setdefault((width, height), name)
    return sizes


def check_pictures(file: Path, params: Params, sensors: dict[str, dict], models: dict[str, dict]) -> None:
    """Refuse pictures of several sizes, which no dataset holds, and of one that the report's network does not read.

    Without this both would show when all presses are solved. sensors: tables of those that the log names. models: of
    workflow/models.toml.
    """
    sizes = picture_sizes(sensors) if params.poses.images else {}
    seen = ", ".join(f"{name} {width} x {height}" for (width, height), name in sizes.items())
    if len(sizes) > 1:
        raise BadInput(
            f"{file}: sensors of the log take pictures of several sizes ({seen}): make one dataset for each size, or set"
            " [params.poses] images = false, which goes as far as labels and calibrate"
        )
    model = params.report.model
    goes_on = model == SHIPPED or models.get(model, {}).get("start") == SHIPPED
    if goes_on and sizes and SHIPPED_IMAGE not in sizes:
        width, height = SHIPPED_IMAGE
        raise BadInput(
            f"{file}: [params.report] model = {model!r}: the shipped network reads pictures of {width} x {height}, the log's"
            f" sensors take others ({seen}); bring them to that size, also in {SENSOR_TABLES}, or name a network that learns"
            " from these alone (models.toml)"
        )


def check_dataset(
    file: Path,
    of: DatasetFile,
    params: Params,
    rows: list[RawRow],
    workflow: Path,
    sensors: dict,
    indenters: dict,
) -> None:
    """Refuse settings that name a sensor, an indenter or a gel that there is not, or that is not the log's."""
    where = f"{file}: [params.dataset]"
    check_names(f"{where} unseen_indenters", params.dataset.unseen_indenters, indenters)
    check_names(f"{where} unseen_sensors", params.dataset.unseen_sensors, sensors)
    check_names(f"{file}: sensor", [of.sensor] if of.sensor is not None else [], sensors)
    check_names("[pareto] sensor", [params.pareto.sensor], sensors)
    logged = used(sensors, named(rows, "sensor_id"))
    check_gel(file, of, params, logged)
    check_pictures(file, params, logged, networks(workflow))
    if file.parent.name in params.train.also:
        raise BadInput(
            f"{file}: [params.train] also names the dataset itself, {file.parent.name}; name others, or none"
        )


def check_count(shards: list[str], size: int) -> None:
    """Refuse more shards than make can hold."""
    if len(shards) > MOST_SHARDS:
        raise BadInput(
            f"{len(shards)} shards of up to {size} samples are more make targets than the {MOST_SHARDS} that work;"
            f" delete results/DATASET/00_plan and set [params.plan] shard_size = {size * len(shards) // 2000} or more"
        )


def without_ccx(params: config.Params, dataset_toml: Path) -> config.Params:
    """Parameters of a machine that has no CalculiX: its presses are solved in process, in place of what is usual.

    A dataset that names a fidelity of CalculiX itself raises BadInput, because it would get other numbers than it asks for.
    """
    fidelity = params.fea.fidelity
    if fidelity in IN_PROCESS:
        return params
    if "fidelity" in config.read_dataset_file(dataset_toml).params.get("fea", {}) and fidelity != "auto":
        raise BadInput(
            f"{dataset_toml}: [params.fea] fidelity = {fidelity!r} needs CalculiX (ccx), which was not found; install it"
            ' and run `rm .venv/ccx.path` and `make setup`, or write fidelity = "hex"'
        )
    print(f"CalculiX (ccx) was not found: fidelity hex is used instead of {fidelity}.", flush=True)
    return replace(params, fea=replace(params.fea, fidelity="hex"))


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
    before = state_of(args.inputs)  # taken before they are read: a change in between is seen next time
    params = config.load_params(args.workflow, dataset_toml)
    if args.ccx == "none":
        params = without_ccx(params, dataset_toml)
    from gelforge.mechanics.mesh.family import required_meshes
    from gelforge.sweeps.scenes import read_tables

    scenes = read_tables(args.workflow)
    of = config.read_dataset_file(dataset_toml)
    rows = logged_rows(args.data / "log.csv", of.sensor)
    sensors = config.read_sensor_tables(args.workflow, args.data)
    indenters = config.read_indenter_tables(args.workflow, args.data, of.catalogue)
    tables, read = read_catalogues(rows, args.workflow / of.catalogue, args.workflow, sensors, indenters, params)
    check_dataset(dataset_toml, of, params, rows, args.workflow, sensors, indenters)
    meshes = required_meshes(params.fea, params.meshes)
    lists: dict[str, list[str]] = {"MESHES": meshes, "BRANCHES": [*params.report.branches]}
    lists |= chart_lists(params, scenes)
    models = networks(args.workflow)
    lists |= network_lists(models)
    lists["SHAPES"] = shape_files(args.workflow)
    lists["NEEDS_CALIBRATION"] = ["yes"] if params.material.c10 == "calibrated" else []
    lists["REPORT_MODEL"] = reported_model(dataset_toml, params, models)
    lists["LEARN_ALSO"] = list(params.train.also)
    lists["PLAN_READS"] = [str(path) for path in read]
    lists["PICTURES"] = picture_folders(args.data, rows)
    lists["PICTURE_STATE"] = [picture_state(lists["PICTURES"])]  # taken before they are read, too
    text = "".join(make_list(name, values) for name, values in lists.items())
    write_parameters(params, args.workflow, out, tables, scenes)
    shards = write_shards(args.data, rows, out, params.plan.shard_size, tables)
    check_count(shards, params.plan.shard_size)
    state = " ".join(filter(None, [before, state_of(read)]))
    write_text(args.out, f"{make_list('SHARDS', shards)}{text}PLAN_STATE := {state}\n")


if __name__ == "__main__":
    main.exit()
