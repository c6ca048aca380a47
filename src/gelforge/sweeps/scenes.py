"""The named scenes of workflow/scenes.toml."""

from dataclasses import dataclass
from pathlib import Path

from gelforge.errors import BadInput, nearest
from gelforge.flow.files import read_toml
from gelforge.geometry.gel import gel_shape, load_gel, own_gels
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Interface, Scene
from gelforge.records.press import TILT, Press

SOURCE = "workflow/scenes.toml"
_NUMBERS = {"x0": 0.0, "y0": 0.0, "z0": 0.0, "dx": 0.0, "dy": 0.0, "rot_deg": 0.0}
_KEYS = {"indenter", "depth", "gel", *_NUMBERS, *TILT}


@dataclass(frozen=True)
class NamedScene:
    """A scene with its name and its resolved table."""

    name: str
    scene: Scene
    table: dict


def resolve(name: str, table: dict, catalogue: dict) -> dict:
    """The table with its indenter's own table, where `indenter` is a name of the catalogue (raw tables)."""
    unknown = sorted(set(table) - _KEYS)
    missing = sorted({"indenter", "depth"} - set(table))
    if unknown or missing:
        raise BadInput(f"{SOURCE}: [{name}]: unknown keys {unknown}, missing keys {missing}; correct the table")
    indenter = table["indenter"]
    if isinstance(indenter, dict):
        return table
    if not isinstance(indenter, str) or indenter not in catalogue:
        known = nearest(str(indenter), catalogue)
        raise BadInput(f"{SOURCE}: [{name}] indenter = {indenter!r} is not in the catalogue{known}")
    return table | {"indenter": catalogue[indenter]}


def read_tables(workflow) -> dict[str, dict]:
    """Resolved tables of workflow/scenes.toml by name."""
    catalogue = read_toml(Path(workflow) / "indenters.toml")
    scenes = read_toml(Path(workflow) / "scenes.toml")
    return {name: with_gel(resolve(name, table, catalogue)) for name, table in scenes.items()}


def with_gel(table: dict) -> dict:
    """A scene's table with the numbers of its gel if that is from the catalogue, because they may change."""
    try:
        shapes = [gel_shape(gel) for gel in own_gels([table.get("gel")]).values()]
    except BadInput:
        return table  # the chart of this scene raises it; other datasets must not fail
    return table | {"gel_shape": shapes[0]} if shapes else table


def parse_scene(name: str, table: dict, nu: float) -> NamedScene:
    """Build one scene from its resolved table."""
    from gelforge.geometry.indenters import build

    depth = table["depth"]
    if isinstance(depth, bool) or not isinstance(depth, int | float) or not 0 < depth < 4:
        raise BadInput(f"{SOURCE}: [{name}] depth = {depth!r}; give mm below the plane z0, above 0 and below 4")
    at = {key: table.get(key, usual) for key, usual in _NUMBERS.items()}
    tilt = {key: table.get(key, 0.0) for key in TILT}
    for key, value in (at | tilt).items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise BadInput(f"{SOURCE}: [{name}] {key} = {value!r}; give a number in mm or degrees")
    body = build(name, table["indenter"], SOURCE)
    gel = load_gel(str(table.get("gel", "gelsight_mini")))
    scene = Scene(gel, Material(nu=nu), body, Press(**at, **tilt, dz=-depth), Interface())
    return NamedScene(name, scene, table | at)
