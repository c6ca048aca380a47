"""Appearance of each virtual sensor: illumination, camera, ink; read from workflow/rig/sensors.toml."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_toml
from gelforge.flow.schema import Number, ParameterTable, Place, Rule, Within, parse, plain
from gelforge.reading.markers import markers_in

COLOURS = ("red", "green", "blue")
WIDTH, HEIGHT = 320, 240
DEGREE = 4
TERMS = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
FIFTEEN = Rule(lambda numbers: len(numbers) == len(TERMS), f"{len(TERMS)} of them")

# Kinds of values of a unit, for the tables of one (`sensors.toml`) and for the ranges of many (`units.toml`).
Share = Annotated[Number, Within(-1, 1)]
Fraction = Annotated[Number, Within(0, 1)]
Angle = Annotated[Number, Within(-360, 360, "degrees")]
Position = Annotated[Number, Within(-1000, 1000, "px")]
Pixels = Annotated[Number, Within(0, 100, "px")]
Contrast = Annotated[Number, Within(0.001, 100)]
Brightening = Annotated[Number, Within(0, 10)]
Gain = Annotated[Number, Within(0.001, 10)]
CameraMm = Annotated[Number, Within(5, 10000, "mm")]
Levels = Annotated[Number, Within(0, 255)]
Diameter = Annotated[Number, Within(0.1, 1000, "px")]
Shadow = Annotated[Number, Within(0, 1000, "px")]
Flecks = Annotated[Number, Within(0, 10)]
Motion = Annotated[Number, Within(0, 2)]
Coefficient = Annotated[Number, Within(-1e4, 1e4)]
N = TypeVar("N")
Pair = tuple[N, N]
Colours = tuple[N, N, N]  # of red, green and blue


class FileTable(ParameterTable):
    """A table of workflow/rig/sensors.toml."""

    example = "workflow/rig/sensors.toml"


class BackgroundTable(FileTable):
    """Coefficients of the unloaded gel's levels (`Appearance.background`)."""

    red: Annotated[tuple[Coefficient, ...], FIFTEEN]
    green: Annotated[tuple[Coefficient, ...], FIFTEEN]
    blue: Annotated[tuple[Coefficient, ...], FIFTEEN]


class LightTable(FileTable):
    """The three lights."""

    azimuth_deg: Colours[Angle]
    slope_gain: Colours[Contrast]
    slope_limit: Contrast
    brightening: Colours[Brightening] = (1.0, 1.0, 1.0)
    tilt: Colours[Pair[Share]] = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))


class CameraTable(FileTable):
    """The camera."""

    height_mm: CameraMm
    gain: Gain
    white_balance: Colours[Gain]
    vignette: Fraction
    blur_px: Pixels
    noise: Colours[Levels]
    noise_blur_px: Pixels


class PrintTable(FileTable):
    """The printed markers; missing: numbers of those that are rubbed off, row by row."""

    rows: Annotated[int, Within(2, 100)]
    cols: Annotated[int, Within(2, 100)]
    pitch_px: Pair[Diameter]
    spread: Pair[Share]
    centre_px: Pair[Position]
    rotation_deg: Angle
    jitter_px: Pixels
    diameter_px: Diameter
    raggedness: Fraction
    ink: Colours[Fraction]
    flecks: Colours[Flecks]
    shadow_depth: Fraction
    shadow_length_px: Colours[Shadow]
    seed: Annotated[int, Within(0, 2**32)]
    missing: tuple[Annotated[int, Within(0, 10**4)], ...] = ()
    normal_motion: Motion = 1.0

    def fault(self) -> str | None:
        """Refuse missing markers that are not on the grid."""
        if any(number >= self.rows * self.cols for number in self.missing):
            return f"missing: there are {self.rows * self.cols} markers, counted from 0"
        return None


class AppearanceTable(FileTable):
    """All of one unit."""

    background: BackgroundTable
    light: LightTable
    camera: CameraTable
    markers: PrintTable


@dataclass(frozen=True)
class Drift:
    """How a unit's light, focus and wear differ between images; each range is drawn uniformly.

    gain: relative, and offset: grey levels, of each colour; field: relative change towards the image's sides. relit:
    fraction of images that are also taken under light from another direction, with a relative change from the image's
    centre to its sides, common to all colours (gradient) and of each (colour_gradient), and a darkening of the
    corners (vignette). refocus: px of blur in addition to the unit's. worn: fraction of images in which further
    markers are worn off, their number (worn_markers), and the fraction of ink that is left (worn_ink).
    """

    gain: tuple[float, float]
    offset: tuple[float, float]
    field: tuple[float, float]
    relit: float = 0.0
    gradient: tuple[float, float] = (0.0, 0.0)
    colour_gradient: tuple[float, float] = (0.0, 0.0)
    vignette: tuple[float, float] = (0.0, 0.0)
    refocus: tuple[float, float] = (0.0, 0.0)
    worn: float = 0.0
    worn_markers: tuple[float, float] = (0, 0)
    worn_ink: tuple[float, float] = (0.0, 0.0)

    def draw(self, markers: np.ndarray, rng: np.random.Generator) -> "Circumstances":
        """Circumstances of one image, the first draws of its `rng`; markers: (n, 2) px, those of the unit."""
        worn: list[tuple[np.ndarray, float]] = []
        if rng.random() < self.worn:
            least, most = map(int, self.worn_markers)
            count = rng.integers(least, most, endpoint=True)
            worn = [(centre, rng.uniform(*self.worn_ink)) for centre in rng.permutation(markers)[:count]]
        gain, offset, field = (
            rng.uniform(*bounds, shape) for bounds, shape in ((self.gain, 3), (self.offset, 3), (self.field, (5, 3)))
        )
        relit = None
        if rng.random() < self.relit:
            gradient = rng.uniform(*self.gradient, (2, 1)) + rng.uniform(*self.colour_gradient, (2, 3))
            relit = gradient, rng.uniform(*self.vignette)
        return Circumstances(worn, gain, offset, field, relit, rng.uniform(*self.refocus))


@dataclass(frozen=True)
class Circumstances:
    """Circumstances under which one image is taken, drawn by a `Drift`.

    worn: centre (2,) px and remaining fraction of ink of each further worn marker. gain, offset: (3,); field: (5, 3),
    coefficients of s, t, s t, s^2 and t^2. relit: for light from another direction the gradients (2, 3) along s and t
    and the darkening of the corners; else None. blur: px.
    """

    worn: list[tuple[np.ndarray, float]]
    gain: np.ndarray
    offset: np.ndarray
    field: np.ndarray
    relit: tuple[np.ndarray, float] | None
    blur: float


@dataclass(frozen=True)
class Appearance:
    """Appearance of one sensor; lengths in px unless named mm, colours in the order red, green, blue.

    background: (15, 3) coefficients of s^i t^j in the order of TERMS, grey levels, where s and t run from -1 to 1
    across the image. tilt: (3, 2) relative change of the light along s and t. light: (3, 2) unit vectors in the
    image plane towards each light. slope_gain: (3,) relative brightening per unit of surface slope towards the light,
    which saturates beyond slope_limit. brightening: (3,) factor on it for steep flanks that face the light; gentle
    slopes and flanks that face away have factor 1. markers: (n, 2) centres, measured from the image's corner like
    projections. ink: (3,) fraction of light that a marker reflects; flecks: (3,) how much brighter its bare spots
    are. shadow_depth and shadow_length: the coloured penumbra beside each marker. noise: (3,) standard deviation in
    grey levels. camera_mm: distance of the pinhole below the gel's apex, which sets how much larger a pressed part
    looks. specks: number of dust grains and scratches. drift: changes of light, focus and wear between images. shade:
    (3,) relative change of each colour's light per mm of mean indentation of the gel. jpeg: quality of a camera that
    compresses, 0 for one that does not. normal_motion: factor on the surface's in-plane motion due to the way down,
    below 1 for a coat stiffer than its gel; motion due to sideways travel is not scaled.
    """

    name: str
    background: np.ndarray
    tilt: np.ndarray
    white_balance: np.ndarray
    gain: float
    vignette: float
    light: np.ndarray
    slope_gain: np.ndarray
    slope_limit: float
    brightening: np.ndarray
    camera_mm: float
    blur: float
    noise: np.ndarray
    noise_blur: float
    markers: np.ndarray
    diameter: float
    raggedness: float
    ink: np.ndarray
    flecks: np.ndarray
    shadow_depth: float
    shadow_length: np.ndarray
    seed: int
    specks: int = 0
    drift: Drift | None = None
    shade: np.ndarray | None = None
    jpeg: int = 0
    normal_motion: float = 1.0

    def light_field(self) -> np.ndarray:
        """Image of the evenly lit, marker-free, unloaded gel, (240, 320, 3) float32 grey levels."""
        s, t = normalised_pixels()
        powers = np.stack([s**i * t**j for i, j in TERMS], axis=-1)
        field = powers @ self.background
        field *= 1.0 + s[..., None] * self.tilt[:, 0] + t[..., None] * self.tilt[:, 1]
        field *= self.gain * self.white_balance * (1.0 - self.vignette * (s**2 + t**2))[..., None]
        return np.clip(field, 0.0, 255.0).astype(np.float32)


def normalised_pixels() -> tuple[np.ndarray, np.ndarray]:
    """Pixel coordinates scaled to -1..1 across the image, two arrays (240, 320)."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    return (u - (WIDTH - 1) / 2) / (WIDTH / 2), (v - (HEIGHT - 1) / 2) / (HEIGHT / 2)


def read_appearances(path) -> dict[str, Appearance]:
    """Read every sensor's appearance; a table may name another as `base` and give only what differs.

    Raises BadInput for a table that is incomplete, or has an unknown key or a value that is not allowed.
    """
    path = Path(path)
    tables = read_toml(path)
    if loose := [name for name, table in tables.items() if not isinstance(table, dict)]:
        raise BadInput(f"{path}: {loose[0]} is outside any table; compare it with [mini_a]")
    return {
        name: _appearance(name, parse(AppearanceTable, _merged(name, tables, path), Place(str(path), (name,))))
        for name in tables
    }


def _merged(name: str, tables: dict, path) -> dict:
    table = tables[name]
    base = table.get("base")
    if base is None:
        return table
    if not isinstance(base, str) or base not in tables or "base" in tables[base]:
        raise BadInput(f"{path}: [{name}] has base = {base!r}, which must be a table without a base of its own")
    merged = dict(tables[base])
    for part, values in table.items():
        if part != "base":
            both = isinstance(merged.get(part), dict) and isinstance(values, dict)
            merged[part] = merged[part] | values if both else values
    return merged


def _appearance(name: str, table: AppearanceTable) -> Appearance:
    parts = plain(table)
    values = {
        key.removesuffix("_px"): value
        for part in ("light", "camera", "markers")
        for key, value in parts[part].items()
    }
    own: dict[str, Any] = {
        key: np.array(values[key], float) if isinstance(values[key], list) else float(values[key])
        for key in Appearance.__annotations__
        if key in values
    }
    return Appearance(**own | {
        "name": name,
        "background": np.array([parts["background"][colour] for colour in COLOURS], float).T,
        "light": towards(np.array(values["azimuth_deg"], float)),
        "camera_mm": float(values["height_mm"]),
        "markers": marker_centres(parts["markers"]),
        "seed": values["seed"],
    })  # fmt: skip


def towards(azimuth_deg: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 2) in the image plane towards lights at angles (n,) in degrees, counter-clockwise from the right."""
    angle = np.deg2rad(azimuth_deg)
    return np.stack([np.cos(angle), -np.sin(angle)], axis=1)


def marker_centres(markers: dict) -> np.ndarray:
    """Centres of the printed markers, (n, 2) px: a rotated grid with seeded misprints, without the missing ones.

    markers: the keys of `PrintTable` that say where they are.
    """
    rows, cols, missing = markers["rows"], markers["cols"], np.array(markers["missing"], int)
    row, col = np.divmod(np.arange(rows * cols), cols)
    half = np.array([cols - 1, rows - 1]) / 2
    place = np.stack([col, row], axis=1) - half
    # the lens and the apex spread the outer markers; the mean pitch stays
    place = place * (1.0 + np.array(markers["spread"], float) * ((place / half) ** 2 - 1.0))
    grid = place * np.array(markers["pitch_px"], float)
    angle = np.deg2rad(markers["rotation_deg"])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    jitter = np.random.default_rng(markers["seed"]).normal(scale=markers["jitter_px"], size=grid.shape)
    centres = grid @ turn.T + jitter + np.array(markers["centre_px"], float)
    return np.delete(centres, missing, axis=0)


def marker_free(centres: np.ndarray, radius: float) -> np.ndarray:
    """Mask (240, 320) of the pixels farther than `radius` px from every centre."""
    v, u = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    mask = np.ones((HEIGHT, WIDTH), bool)
    for cu, cv_ in centres:
        mask &= np.hypot(u - cu, v - cv_) > radius
    return mask


def fit_background(image: np.ndarray) -> np.ndarray:
    """Coefficients (15, 3) of Appearance.background by least squares over the marker-free pixels of an RGB image.

    Raises BadInput for an image that is not 320 x 240 RGB or shows no markers.
    """
    if image.shape != (HEIGHT, WIDTH, 3):
        raise BadInput(
            f"an image of shape {image.shape} was given; an appearance is fitted to {WIDTH} x {HEIGHT} RGB"
        )
    markers = markers_in(image)
    if not len(markers.points):
        raise BadInput("no dark spots were found; give a picture of a gel with markers without contact")
    mask = marker_free(markers.points, 1.1 * markers.diameter)
    s, t = normalised_pixels()
    powers = np.stack([s[mask] ** i * t[mask] ** j for i, j in TERMS], axis=1)
    return np.linalg.lstsq(powers, image[mask].astype(float), rcond=None)[0]
