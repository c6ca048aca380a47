"""Checks that a dataset's settings name existing sensors and indenters, one gel, one image size, and fit its log."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path

from gelforge.errors import BadInput, nearest
from gelforge.flow.files import listed
from gelforge.flow.params import DatasetFile, Params
from gelforge.flow.tables import SHIPPED, SHIPPED_IMAGE
from gelforge.records.press import SENSOR_TABLES

# Extensions of files that may be meant as no-contact images.
PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"}


def check_dataset(
    file: Path, of: DatasetFile, params: Params, logged: dict, sensors: dict, indenters: dict, models: dict
) -> None:
    """Refuse settings that name a sensor, an indenter or a gel that does not exist, or that does not fit the log.

    file: dataset.toml. logged: tables of the sensors that rows name, among all `sensors`. models: of workflow/models.toml.
    """
    where = f"{file}: [params.dataset]"
    check_names(f"{where} unseen_indenters", params.dataset.unseen_indenters, indenters)
    check_names(f"{where} unseen_sensors", params.dataset.unseen_sensors, sensors)
    check_names(f"{file}: sensor", [of.sensor] if of.sensor is not None else [], sensors)
    check_gel(file, of, logged)
    if params.poses.images:
        check_nocontact(file.parent, logged, sensors)
    check_pictures(file, params, logged, models)
    if file.parent.name in params.train.also:
        raise BadInput(
            f"{file}: [params.train] also names the dataset itself, {file.parent.name}; name others, or none"
        )


def check_names(setting: str, names: Iterable[str], known: Mapping[str, object]) -> None:
    """Refuse an unknown name: a misspelt one would have no effect."""
    for name in names:
        if name not in known:
            raise BadInput(f"{setting}: {name!r} is unknown{nearest(name, known)}")


def check_nocontact(data: Path, logged: Iterable[str], known: Iterable[str]) -> None:
    """Refuse a no-contact image that no stage would read, because of its name.

    logged: sensors of the log; known: all sensors of the catalogue, whose images may lie there, too.
    """
    found = listed(data / "nocontact", "*")
    for path in found:
        picture = path.suffix.lower() in PICTURES and path.suffix != ".png"
        if picture and not path.with_suffix(".png").exists():
            raise BadInput(f"{path}: no-contact images are read as PNG; save it as {path.with_suffix('.png').name}")
    without = [name for name in sorted(logged) if not (data / "nocontact" / f"{name}.png").exists()]
    for path in found:
        stray = path.is_dir() or (path.suffix == ".png" and path.stem not in known)
        if without and stray:
            near = get_close_matches(path.stem.lower(), [name.lower() for name in without], 1)
            meant = next((name for name in without if name.lower() in near), without[0])
            raise BadInput(
                f"{path}: {'is a folder' if path.is_dir() else 'is named after no sensor'}, and {', '.join(without)} of the log"
                f" {'has' if len(without) == 1 else 'have'} no no-contact image; save one as {data / 'nocontact' / meant}.png,"
                " or move this elsewhere"
            )


def check_gel(file: Path, of: DatasetFile, sensors: dict[str, dict]) -> None:
    """Refuse a dataset with several gels: in its file, and on the sensors of its log.

    Sensors may state thicknesses of their own. sensors: tables of those that the log names. An invalid gel is left to
    stage 10, which rejects its rows.
    """
    from gelforge.geometry.gel import is_gel, load_gel, without_thickness
    from gelforge.geometry.gelcatalogue import refuse_taken

    if of.gel is not None:
        try:
            load_gel(of.gel)
        except BadInput as error:
            raise BadInput(f"{file}: {error}") from None
        refuse_taken(of.gel)
    meant, where = of.gel, f"{file}: gel"
    for name, table in sorted(sensors.items()):
        gel = table.get("gel") if isinstance(table, dict) else None
        if not is_gel(gel):
            continue
        refuse_taken(gel)
        if meant is None:
            meant, where = gel, f"sensor {name!r}"
        elif without_thickness(gel) != without_thickness(meant):
            raise BadInput(
                f"{file}: sensor {name!r} of the log has gel {gel!r} ({SENSOR_TABLES}), but {where} has {meant!r}: keep presses on"
                " different gels in datasets of their own; sensors of one may state thicknesses, as gelsight_mini-3.6mm"
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
    """Refuse images of several sizes, which no dataset can hold, and of a size that the report's network cannot read.

    Without this check both would fail only after all presses are solved. sensors: tables of those that the log names.
    models: of workflow/models.toml.
    """
    sizes = picture_sizes(sensors) if params.poses.images else {}
    seen = ", ".join(f"{name} {width} x {height}" for (width, height), name in sizes.items())
    if len(sizes) > 1:
        raise BadInput(
            f"{file}: sensors of the log take pictures of several sizes ({seen}): make one dataset for each size, or set"
            " [params.poses] images = false, so that the flow ends at labels and calibrate"
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
