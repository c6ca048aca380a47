"""Stage 00: the shards of a dataset, and the parameters of each stage in a file of their own.

The plan is a makefile that make includes: if one of its prerequisites is newer, make runs this stage and reads its
rules again, so that `make -n` knows the new plan. Files are written only if their content changes.
"""

import json
import math
import os
import re
import stat
from argparse import Namespace
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from types import MappingProxyType

from gelforge.errors import BadInput, nearest, printable
from gelforge.evidence.settings import check_dataset
from gelforge.flow import params as config
from gelforge.flow.calibration import FROZEN, calibration_of, read_values, refuse_twice
from gelforge.flow.cli import stage
from gelforge.flow.files import (
    State,
    canonical,
    csv_text,
    listed,
    record_of,
    states_of,
    write_if_changed,
    write_text,
)
from gelforge.flow.layout import LOGGED, PLAN, STAGES, TABLES, Layout, metrics_of, shard_name
from gelforge.flow.params import Params, stl_files, with_content
from gelforge.flow.tables import ENOUGH_PRESSES, IN_PROCESS, SHIPPED
from gelforge.records.log import read_log, shard_text
from gelforge.records.press import MOMENT, RawRow, parse_number, repeats
from gelforge.records.table import letters, read_table

FIRST_SHARDS, LATER = 32, 8  # the first shards are small, to fill the cores; later ones hold this many times as much
# Units: fewest turns or moments that show one; steps of turns in radians, how far rounded ones are off, and steps of a whole turn;
# least force, N, and largest lever, m, of a moment.
FEWEST, RADIANS, ROUNDED, FULL, FIRM_N, LEVER_M = 3, math.pi / 36, 0.007, 72.1, 1.0, 0.25


def room(shard: int, size: int) -> int:
    """How many samples a shard may hold."""
    return size if shard < FIRST_SHARDS else LATER * size


def assign_shards(
    ids: list[str], known: dict[str, int], size: int, press_of: dict[str, str] | None = None
) -> dict[str, int]:
    """Return the shard of each id: that of `known`, or for new ids the last shard until it is full (`room`).

    A sample keeps its shard, so appending to a log leaves every full shard as it is. Samples of one press (`press_of`,
    by id) are solved together: all go to the shard of the first one, however full, even if they had other shards when
    the log did not yet name them as one press.
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
            last += counts.get(last, 0) >= room(last, size)
            shards[name] = last
        if press:
            homes.setdefault(press, shards[name])
        counts[shards[name]] = counts.get(shards[name], 0) + 1
    return shards


def logged_rows(log: Path, sensor: str | None) -> list[RawRow]:
    """Raw rows of a log; rows that name no sensor get the dataset's `sensor`, if there is one."""
    rows = read_log(log)
    if sensor is None:
        return rows
    named_one = (row.cells.get("sensor_id", "").strip() for row in rows)
    return [
        row if name else replace(row, cells={**row.cells, "sensor_id": sensor})
        for row, name in zip(rows, named_one, strict=True)
    ]


def refuse_other_log(params: Params, rows: list[RawRow], dataset_toml: Path, calibration: Path | None) -> None:
    """Refuse settings that were made for another log: of mountings that it lacks, or from none of its presses; BadInput.

    calibration: the one that labels follow, None for none.
    """
    logged, settings = named(rows, "mounting") - {""}, [(dataset_toml, vars(params.poses))]
    if calibration is not None and calibration.name == FROZEN:
        found, ids = read_values(calibration), named(rows, "sample_id")
        home = found.name.rpartition("-")[0]
        if home != calibration.parent.name:
            print(
                f"note: {calibration}: was found in dataset {printable(home)[:60]!r}, and labels follow it: true where gel and bench are the same"
            )
        lost = [name for name in found.presses if name not in ids]
        if 2 * len(lost) > len(found.presses):
            raise BadInput(
                f"{calibration}: {len(lost)} of its {len(found.presses)} presses are not in the log, the first {printable(lost[0])[:60]!r}: it was"
                f" found for another gel or bench; remove it, or run make freeze DATASET={calibration.parent.name}"
            )
        settings.append((calibration, found.params.get("poses", {})))
    for path, poses in settings:
        for key in ("mounting_tilt_deg", "mounting_touch_offset_mm"):
            for name in poses.get(key, {}):
                if name not in logged:
                    meant = nearest(name, logged) if logged else "; the log names none, add a column mounting to it"
                    raise BadInput(f"{path}: [params.poses] {key}: no row of the log is of {name!r}{meant}")


def refuse_near_names(rows: list[RawRow], log: Path) -> None:
    """Refuse names in one column that differ in case or punctuation alone: as a rule one thing, written in two ways."""
    for column in ("mounting", "gel_id", "sensor_id", "press_id"):
        seen: dict[str, str] = {}
        for name in sorted(named(rows, column)):
            # presses may be numbered 1-11 and 11-1
            plain = letters(name) if column == "press_id" else letters(name).replace("_", "")
            if plain and seen.setdefault(plain, name) != name:
                raise BadInput(
                    f"{log}: column {column} has {printable(seen[plain])[:60]!r} and {printable(name)[:60]!r}, which differ in case or"
                    " punctuation alone: write one name for one thing, and names that differ in letters or digits for two"
                )


def refuse_other_units(rows: list[RawRow], log: Path) -> None:
    """Refuse a column whose numbers show another unit: turns in radians, moments in N mm; BadInput."""
    cells = {name: [parse_number(row.cells.get(name, "")) for row in rows] for name in ("rot_deg", "fz_n", *MOMENT)}
    turns = {value for value in cells["rot_deg"] if value}
    steps = [value / RADIANS for value in turns]
    if len(turns) >= FEWEST and all(abs(one - round(one)) < ROUNDED and abs(one) < FULL for one in steps):
        raise BadInput(
            f"{log}: column rot_deg holds only multiples of 5 degrees in radians, such as {max(turns, key=abs):g}: write degrees, 57.29578 times as many"
        )
    levers = [
        max(map(abs, of)) / abs(force)
        for force, *each in zip(*(cells[name] for name in ("fz_n", *MOMENT)), strict=True)
        if (of := [one for one in each if one]) and force and abs(force) >= FIRM_N
    ]
    if len(levers) >= FEWEST and median(levers) > LEVER_M:
        raise BadInput(
            f"{log}: columns mx_nm, my_nm, mz_nm: moments over forces are {median(levers):.2g} m, longer than any such bench: most likely they are in N mm;"
            " write N m, a thousandth of it"
        )


def known_shards(table: Path) -> dict[str, int]:
    """Shard of each sample in the previous plan, empty if there was none; a corrupt table raises BadInput."""
    hint = "restore it from a copy, or remove it: samples that come into another shard then are solved again"
    rows = read_table(table, hint, ("sample_id", "shard")) if table.exists() else []
    # a row of the log without a sample_id has a shard, too, in which stage 10 rejects it
    if not all(row["shard"].isdecimal() for row in rows):
        raise BadInput(f"{table}: does not name the shard of every sample; {hint}")
    return {row["sample_id"]: int(row["shard"]) for row in rows}


def write_shards(
    of: Layout,
    rows: list[RawRow],
    size: int,
    pictures: Mapping[str, str],
    tables: Mapping[str, dict] = MappingProxyType({}),
    every: Mapping[str, dict] = MappingProxyType({}),
) -> list[str]:
    """Write each shard's raw rows, catalogue entries and digests of images, and the shard table; return shard names.

    pictures: digests by the name that rows give them. every: whole catalogues, whose names are kept for a shard that
    names another, so that stage 10 can tell the nearest. Only what sharding needs is checked here, the rest by stage 10.
    """
    known = known_shards(of.shard_table)
    ids = [row.cells["sample_id"] for row in rows]
    press_of = {row.cells["sample_id"]: row.press_id for row in rows if row.press_id}
    shards = assign_shards(ids, known, size, press_of)
    by_shard: dict[int, list[RawRow]] = {}
    for row, name in zip(rows, ids, strict=True):
        by_shard.setdefault(shards[name], []).append(row)
    repeated = repeated_rows(rows, pictures)
    # the folder as text: for thousands of files, making a Path would take longer than writing
    folder, names = str(of.shards), []
    for shard, members in sorted(by_shard.items()):
        names.append(shard_name(shard))
        # only the entries that this shard uses, so that a change of others does not rerun it
        entries = {kind: used(table, named(members, COLUMN_OF[kind])) for kind, table in tables.items()}
        entries["gels"] = own_shapes(gels_of(entries.get("sensors", {})))
        if any(named(members, COLUMN_OF[kind]) - table.keys() for kind, table in every.items()):
            entries["known"] = {kind: sorted(table) for kind, table in every.items()}
        seen = {
            "images": {name: pictures[name] for name in sorted(named(members, "image")) if name in pictures},
            "repeated": {str(row.row): repeated[row.row] for row in members if row.row in repeated},
        }
        write_if_changed(f"{folder}/{names[-1]}.csv", shard_text(members))
        # json writes one line several times faster than indented text
        write_if_changed(f"{folder}/{names[-1]}.json", json.dumps(entries, sort_keys=True, ensure_ascii=False) + "\n")
        write_if_changed(
            f"{folder}/{names[-1]}.pictures.json", json.dumps(seen, sort_keys=True, ensure_ascii=False) + "\n"
        )
    for gone in set(of.names()) - set(names):
        # the log no longer has these rows: no stage may read them again
        for path in (of.shard(gone), of.used(gone), of.pictures(gone)):
            path.unlink(missing_ok=True)
    # samples that the log no longer has keep their shard, and so their solves, in case they come back
    kept = {name: shard for name, shard in known.items() if name not in shards}
    lines = [{"sample_id": n, "shard": shard, LOGGED: int(n in shards)} for n, shard in (shards | kept).items()]
    write_if_changed(of.shard_table, csv_text(["sample_id", "shard", LOGGED], lines))
    return names


def own_shapes(names: Iterable[object]) -> dict[str, dict]:
    """Kind and dimensions of the gels that the code does not define itself, because results depend on them."""
    from gelforge.geometry.gel import gel_shape, own_gels

    return {name: gel_shape(gel) for name, gel in own_gels(names).items()}


def meshable(names: Iterable[object]) -> list[str]:
    """The names that are gels, sorted; a row with another one is rejected later."""
    from gelforge.geometry.gel import is_gel

    return sorted({name for name in names if is_gel(name)})


def gels_of(tables: Mapping[str, object]) -> list[object]:
    """The gels that tables of sensors or scenes name."""
    return [table.get("gel") for table in tables.values() if isinstance(table, dict)]


def repeated_rows(rows: list[RawRow], pictures: Mapping[str, str]) -> dict[int, str]:
    """For each row whose image is also that of another press, by line number: the first other row with that image.

    pictures: digests by name, so that copies of a file count as equal.
    """
    found: dict[int, str] = {}
    for members in repeats(rows, [pictures.get(row.cells.get("image", "")) for row in rows]):
        first, second = (f"row {rows[at].row}, {printable(rows[at].cells['sample_id'])[:100]}," for at in members[:2])
        found |= {rows[at].row: second if at == members[0] else first for at in members}
    return found


COLUMN_OF = {"sensors": "sensor_id", "indenters": "indenter"}  # of the log, by catalogue


def named(rows: list[RawRow], column: str) -> set[str]:
    """The values that rows of the log have in a column."""
    return {row.cells.get(column, "") for row in rows}


def inside(data: Path, names: Iterable[str]) -> dict[str, str]:
    """Paths of the images that rows name, by name, without those outside the dataset's folder (stage 10 rejects)."""
    from gelforge.records.image import stays_inside

    folders: dict[str, list[str]] = {}
    for name in sorted(filter(None, names)):
        folder, slash, _ = name.rpartition("/")
        folders.setdefault(folder or slash or ".", []).append(name)
    found: dict[str, str] = {}
    for folder, members in folders.items():
        if stays_inside(data, folder):
            links = links_in(data / folder)
            kept = (name for name in members if name.rpartition("/")[2] not in links or stays_inside(data, name))
            found |= {name: f"{data}/{name}" for name in kept}
    return found


def links_in(folder: Path) -> set[str]:
    """Names of the links in a folder; none where there is no folder."""
    try:
        with os.scandir(folder) as entries:
            return {entry.name for entry in entries if entry.is_symlink()}
    except (OSError, ValueError):
        return set()


def digests(states: Mapping[str, State | None], files: Mapping[str, Path | str]) -> dict[str, str]:
    """Digest of each readable file, by name; it changes with the content of a file, not with its time stamp."""
    found = {name: states[str(path)] for name, path in files.items()}
    return {name: state[0][:16] for name, state in found.items() if state}


def files_beside(data: Path) -> dict[str, Path]:
    """Files beside a log that belong to its dataset, by path there: no-contact images, splits, truth, labels."""
    found = [*listed(data / "nocontact", "*"), *listed(data / "labels", "*.npz")]
    found += [data / "splits.csv", data / "truth" / "presses.csv"]
    return {str(path.relative_to(data)): path for path in found if path.is_file()}


def write_beside(of: Layout, found: Mapping[str, str]) -> None:
    """Write the digests of the files beside the log, one file per kind, for the stages that read them."""
    # the list of imported labels counts at every resolution: a dataset with any of them solves nothing
    imported = {"labels": [name for name in found if name.startswith("labels/")]}
    kinds: dict[str, dict] = {"nocontact": {}, "rows": imported}
    for name, digest in found.items():
        folder, stem = name.split("/")[0], Path(name).stem
        kinds.setdefault("nocontact" if folder == "nocontact" else stem if folder == "labels" else "rows", {})[
            name
        ] = digest
    for kind, digests_of_kind in kinds.items():
        write_if_changed(of.beside(kind), canonical(digests_of_kind))


def write_parameters(
    params: Params, workflow: Path, out: Path, tables: dict[str, dict], scenes: dict, calibration: str = ""
) -> None:
    """Write the parameters of every stage, and the catalogue entries that this dataset uses, without comments.

    Tables of single networks and of the chart's scenes are written where their folder exists: a rule of make makes the
    folder for the goals that need them. calibration: path of the one that labels follow, "" for none.
    """
    source = Path(__file__).parent
    for name in STAGES:
        made = config.written_for(params, name, config.stage_version(source, name), calibration)
        write_if_changed(out / "params" / f"{name}.json", canonical(made))
    for name, entries in tables.items():
        write_if_changed(out / "params" / f"{name}.json", canonical(entries))
    write_if_changed(out / "params" / "networks.json", canonical(charted(networks(workflow))))
    write_if_changed(out / "params" / "scenes.json", canonical([*scenes]))
    # One file for each, so that a new network retrains no other.
    for kind, every in (
        ("models", {name: {name: table} for name, table in networks(workflow).items()}),
        ("scenes", scenes),
    ):
        if (folder := out / "params" / kind).is_dir():
            for name, table in every.items():
                write_if_changed(folder / f"{name}.json", canonical(table))


def spare(catalogue: dict, bodies: dict) -> dict:
    """Indenters of the catalogue that no row names: a row with a wrong name may mean one of them (stage 15).

    STL files are left out, because measuring them takes long.
    """
    return {
        name: table
        for name, table in catalogue.items()
        if name not in bodies and isinstance(table, dict) and table.get("kind") != "stl"
    }


def used(catalogue: dict, names: set[str]) -> dict:
    """The entries of a catalogue that a dataset names, so that adding or editing others changes nothing."""
    return {name: table for name, table in catalogue.items() if name in names}


# A word without characters that make interprets.
_WORD = re.compile(r"[A-Za-z0-9_@+][A-Za-z0-9_.@+/-]*")
NETWORK_NAME = re.compile(r"[a-z0-9_]+")
MOST_SHARDS = 20_000


def make_list(name: str, values: list[str]) -> str:
    """A line of make that lists words; a word with characters that make interprets raises BadInput."""
    for value in values:
        if not isinstance(value, str) or not _WORD.fullmatch(value):
            raise BadInput(
                f"{value!r} cannot be a name in {name}: make reads meaning into such characters; use letters, digits,"
                " _ - . + @ and / only"
            )
    return f"{name} := {' '.join(values)}\n"


def networks(workflow: Path) -> dict[str, dict]:
    """Tables of workflow/models.toml by name; BadInput for a name that cannot stand in make's rules."""
    path = workflow / "models.toml"
    found = config.read_toml(path)
    if odd := [name for name in found if not NETWORK_NAME.fullmatch(name)]:
        raise BadInput(f"{path}: [{odd[0]}]: name a network by small letters, digits and underscores alone")
    return found


def charted(models: dict[str, dict]) -> list[str]:
    """Sorted names of the networks of the chart of networks: all but those fine-tuned from the shipped one."""
    lists = network_lists(models)
    return sorted({*lists["MODELS"]} - {*lists["TUNED"]})


def network_lists(models: dict[str, dict]) -> dict[str, list[str]]:
    """Names of all networks, of those fine-tuned from the shipped one, and of those that read a no-contact image."""
    tables = {name: table for name, table in models.items() if isinstance(table, dict)}
    tuned = [name for name, table in tables.items() if "start" in table]
    beside = [name for name, table in tables.items() if table.get("kind") == "grid"]
    return {"MODELS": list(tables), "TUNED": tuned, "NEED_NOCONTACT": beside}


def reported_model(file: Path, params: Params, models: dict, presses: int) -> list[str]:
    """The network that the report shows, as a list of one or none; BadInput for an unknown name. file: dataset.toml.

    presses: number of presses with images. With few of them, the shipped network is better than one trained on them.
    """
    name = params.report.model
    if not name and presses < ENOUGH_PRESSES and (file.parent / "nocontact").is_dir():
        return [SHIPPED]
    if name and name not in {*models, SHIPPED}:
        raise BadInput(
            f"{file}: [params.report] model = {name!r}: choose {SHIPPED}, nothing, or one of {', '.join(models)} (models.toml)"
        )
    return [name] if name else []


def pressed(rows: list[RawRow]) -> int:
    """Number of presses with an image in a log; frames of one press count once."""
    return len({row.press_id or f"row {row.row}" for row in rows if row.cells.get("image")})


def followed(paths: Sequence[str], log: Path) -> list[str]:
    """Those of the files that others name, such as images, which make can watch: that exist, by names without blanks.

    Says which others it cannot watch.
    """
    there = [path for path in dict.fromkeys(paths) if is_there(path)]
    lost = [path for path in there if not _WORD.fullmatch(path)]
    if lost:
        more = f" and {len(lost) - 1} more" if len(lost) > 1 else ""
        print(
            f"note: {printable(lost[0])[:200]}{more}: make watches no file of such a name; touch {log} after it changed"
        )
    watched = [path for path in there if _WORD.fullmatch(path)]
    folders = {os.path.dirname(path) for path in paths}  # whose date tells of a file that was absent
    return [*watched, *sorted(each for each in folders if _WORD.fullmatch(each) and os.access(each, os.F_OK))]


def is_there(path: str) -> bool:
    """Whether a path is that of something other than a folder."""
    try:
        return not stat.S_ISDIR(os.stat(path).st_mode)
    except (OSError, ValueError):
        return False


def gel_files(workflow: Path) -> list[Path]:
    """STL files that workflow/gels.toml names."""
    path = workflow / "gels.toml"
    tables = config.read_toml(path).values() if path.exists() else ()
    named = (table.get("file") for table in tables if isinstance(table, dict))
    return [workflow / file for file in named if isinstance(file, str)]


def check_count(shards: list[str], size: int) -> None:
    """Refuse more shards than make can hold."""
    if len(shards) > MOST_SHARDS:
        raise BadInput(
            f"{len(shards)} shards of up to {size} samples are more make targets than the {MOST_SHARDS} that work;"
            f" delete results/DATASET/00_plan and set [params.plan] shard_size = {size * len(shards) // 2000} or more"
        )


def without_ccx(params: config.Params, dataset_toml: Path) -> config.Params:
    """Parameters for a machine without CalculiX: presses are solved in process instead.

    A dataset that itself asks for CalculiX raises BadInput, because it would get other numbers than it asks for.
    """
    method = params.fea.method
    if method in IN_PROCESS:
        return params
    if "method" in config.read_dataset_file(dataset_toml).params.get("fea", {}) and method != "auto":
        raise BadInput(
            f"{dataset_toml}: [params.fea] method = {method!r} needs CalculiX (ccx), which was not found; install it"
            ' and run `rm .venv/ccx.path` and `make setup`, or write method = "label"'
        )
    print(f"CalculiX (ccx) was not found: method label is used instead of {method}.", flush=True)
    return replace(params, fea=replace(params.fea, method="label"))


# Result of a branch that the report shows, relative to results/DATASET.
SHOWN_OF = {"calibrate": "calibrate/summary.json"}


@stage(Layout.plan)
def main(args: Namespace) -> None:
    from gelforge.geometry.gel import USUAL_GEL
    from gelforge.sweeps.scenes import read_tables

    of = args.of
    data, workflow = of.data, of.workflow
    dataset_toml = data / "dataset.toml"
    dataset = config.read_dataset_file(dataset_toml)
    known = (record_of(metrics_of(of.plan())) or {}).get("inputs", {})
    params = config.load_params(workflow, dataset_toml)
    if not of.ccx.exists() or of.ccx.read_text(encoding="utf-8").strip() == "none":
        params = without_ccx(params, dataset_toml)
    found = calibration_of(params, dataset_toml, of.calibration())
    refuse_twice(dataset.params, dataset_toml, found)
    calibration = [] if found is None else [str(found.relative_to(of.base))]
    rows = logged_rows(of.log, dataset.sensor)
    sensors = config.read_sensor_tables(workflow, data)
    indenters = config.read_indenter_tables(workflow, data, dataset.catalogue)
    shapes = list(stl_files(config.read_toml(workflow / "indenters.toml"), workflow).values())
    scenes, models = read_tables(workflow), networks(workflow)
    pictures = inside(data, named(rows, "image"))
    bodies = used(indenters, named(rows, "indenter"))
    read: list[Path | str] = [*stl_files(bodies, workflow).values(), *shapes, *gel_files(workflow)]
    read += [f"{data}/{name}" for name in sorted(named(rows, "image")) if name]
    beside = files_beside(data)
    states = states_of([*read, *beside.values()], known)
    check_dataset(dataset_toml, dataset, params, used(sensors, named(rows, "sensor_id")), sensors, indenters, models)
    refuse_near_names(rows, of.log)
    refuse_other_units(rows, of.log)
    refuse_other_log(params, rows, dataset_toml, found)
    seen_by = used(sensors, named(rows, "sensor_id"))
    tables = {
        "sensors": seen_by,
        "indenters": with_content(bodies, workflow),
        "spare": spare(indenters, bodies),
        "gels": own_shapes(gels_of(seen_by)),
        "chart": used(sensors, {params.pareto.sensor}),
    }
    logged_gels = meshable(gels_of(seen_by))
    lists: dict[str, list[str]] = {
        "BRANCHES": [SHOWN_OF[name] for name in params.report.branches],
        "PARETO_SCENES": [*scenes],
        **network_lists(models),
        "LEARNER": ["pair_24_mirrored" if (data / "nocontact").is_dir() else "unet"],
        "CALIBRATION": calibration,
        "REPORT_MODEL": reported_model(dataset_toml, params, models, pressed(rows)),
        "LEARN_ALSO": [*params.train.also],
        "GELS": logged_gels,
        # gels whose meshes stage 30 needs, and those of the charts
        "MESHED_GELS": [] if params.fea.method in IN_PROCESS else logged_gels,
        "CHARTED_GELS": meshable({USUAL_GEL, *gels_of({**tables["chart"], **scenes})}),
        "IMAGES": ["yes"] if pictures and params.poses.images else [],
        "PARAMETERS": [*STAGES, *TABLES],  # files that the report shows
        "PLANNED_FROM": followed([*map(str, read)], of.log),
    }
    text = "".join(make_list(name, values) for name, values in lists.items())
    follows = str(of.followed().relative_to(of.base)) if found else ""
    write_parameters(params, workflow, of.folder(PLAN), tables, scenes, follows)
    write_beside(of, digests(states, beside))
    kinds, every = {kind: tables[kind] for kind in COLUMN_OF}, {"sensors": sensors, "indenters": indenters}
    shards = write_shards(of, rows, params.plan.shard_size, digests(states, pictures), kinds, every)
    check_count(shards, params.plan.shard_size)
    write_text(args.out, f"{make_list('SHARDS', shards)}{text}")
    print(json.dumps({"rows": len(rows), "shards": len(shards)}))


if __name__ == "__main__":
    main.exit()
