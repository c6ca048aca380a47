"""Sensors: where a point of the gel appears in the image."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_json, read_toml
from gelforge.geometry.gel import Gel, load_gel
from gelforge.records.press import SENSOR_TABLES

NOMINAL = Gel()
SHAPE = 0.01  # tolerance of an image's aspect ratio, relative to the sensor's
LEAST_SHOWN, MOST_SHOWN = 0.05, 5.0  # width of an image as a multiple of the gel's length
FEWEST_DOTS, MOST_DOTS = 2, 100  # in a row or a column of the marker grid


@dataclass(frozen=True)
class Sensor:
    """One sensor unit.

    Args:
        name: of the unit.
        image: (width, height) in pixels.
        projection: (3, 3), homography from gel mm (x, y, 1) to pixel (u, v, 1), u right and v down from the image's
            corner, so that the first pixel's centre is (0.5, 0.5) and label cells start at 0.
        gel: name of its gel.
        markers: what is known of the printed markers, see sensors.toml.
    """

    name: str
    image: tuple[int, int]
    projection: np.ndarray
    gel: str = "gelsight_mini"
    markers: dict = field(default_factory=dict)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) of gel points (..., 2 or more) in mm; only x and y are used."""
        return transform(self.projection, points)

    def unproject(self, pixels: np.ndarray) -> np.ndarray:
        """Gel points (x, y) in mm, (..., 2), of pixels (..., 2)."""
        return transform(np.linalg.inv(self.projection), pixels)

    def sized(self, image: np.ndarray, where: str) -> np.ndarray:
        """An image (h, w, 3) resized to the sensor's; BadInput for another aspect ratio. where: names the images."""
        import cv2

        (high, wide), (width, height) = image.shape[:2], self.image
        if abs(wide * height / (high * width) - 1.0) > SHAPE:
            raise BadInput(
                f"{where} are {wide} x {high}; their aspect ratio differs from the {width} x {height} of sensor {self.name}: name another"
                " sensor, or describe this one in workflow/sensors.toml"
            )
        return (
            image
            if (wide, high) == (width, height)
            else cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        )


def gelsight_mini() -> Sensor:
    """A GelSight Mini with the image of its maker's driver: 15.77 px/mm, 320 x 240 (workflow/sensors.toml)."""
    projection = np.array([[0.0, -15.77, 160.0], [-15.77, 0.0, 120.0], [0.0, 0.0, 1.0]])
    return Sensor("gelsight_mini", (320, 240), projection)


def transform(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 2 or more) mapped by a homography (3, 3) to (..., 2); only the first two numbers are used."""
    points = np.asarray(points, float)[..., :2]
    mapped = points @ homography[:, :2].T + homography[:, 2]
    return mapped[..., :2] / mapped[..., 2:]


def check_projection(homography: np.ndarray, where: str, gel: Gel = NOMINAL) -> None:
    """Raise BadInput unless the homography is finite and neither folds nor flips the sensor's gel.

    The camera looks at the gel from below with v down, so the map from (x, y) to (u, v) has a negative
    Jacobian everywhere; a positive one is a mirrored image. It folds where the line that maps to
    infinity crosses the gel (Hartley and Zisserman, Multiple View Geometry, section 2.3).
    """
    homography = np.asarray(homography, float)
    if homography.shape != (3, 3) or not np.isfinite(homography).all():
        raise BadInput(f"{where}: the projection must be 3 x 3 finite numbers, it is {homography.tolist()}")
    half = np.array([gel.width, gel.length]) / 2
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    scale = corners @ homography[2, :2] + homography[2, 2]
    if scale.min() * scale.max() <= 0:
        raise BadInput(
            f"{where}: the projection folds the gel (its line to infinity crosses the"
            f" {gel.width:g} x {gel.length:g} mm outline); check the correspondences and run make projection"
        )
    jacobian = np.linalg.det(homography) / scale**3  # of the map at each corner, section 2.4
    size = np.abs(homography[:2]).max() / np.abs(scale).max()
    if (np.abs(jacobian) <= 1e-9 * size**2).any():
        raise BadInput(
            f"{where}: the projection is singular, it maps the gel onto a line; give points that span an area"
        )
    if (jacobian > 0).any():
        raise BadInput(
            f"{where}: the projection flips the gel (positive Jacobian: the image would be mirrored);"
            " exchange u or v, or x and y, in the correspondences, or mirror the image back"
        )


def check_scale(homography: np.ndarray, image: tuple[int, int], where: str, gel: Gel = NOMINAL) -> None:
    """Raise BadInput if an image (width, height) px shows far more or far less than a gel, as with a wrong unit."""
    middle = np.array(image) / 2
    across = transform(np.linalg.inv(homography), middle + np.array([[-middle[0], 0.0], [middle[0], 0.0]]))
    shown = float(np.hypot(*(across[1] - across[0])))
    if not LEAST_SHOWN <= shown / gel.length <= MOST_SHOWN:
        raise BadInput(
            f"{where}: the image of {image[0]} px would be {shown:.3g} mm wide on a gel of {gel.width:g} x {gel.length:g} mm, {image[0] / shown:.3g}"
            " px/mm; give it from gel mm to pixels (make projection), for images of this size"
        )


def load_sensors(path) -> dict[str, Sensor]:
    """Read sensors.toml (or stage parameters, .json) into {name: Sensor}; BadInput names a bad entry and its field."""
    try:
        tables = read_json(path) if Path(path).suffix == ".json" else read_toml(path)
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: cannot be read as sensors ({error}); correct it") from error
    return sensors_of(tables, str(path))


def sensors_of(tables: dict, where: str) -> dict[str, Sensor]:
    """Sensors of tables by name; BadInput names a bad entry of file `where` and its field."""
    return {name: sensor_of(where, name, table) for name, table in tables.items()}


def find_sensor(sensors: Mapping, name: str, where: str, tables: str = SENSOR_TABLES) -> Sensor:
    """The sensor called `name`; an unknown one raises BadInput with the known names. tables: the file of sensors."""
    if name not in sensors:
        raise BadInput(
            f"{where}: sensor {name!r} is not in {tables}, which has {', '.join(sorted(sensors))}; add it there, or name"
            " one of these"
        )
    return sensors[name]


def sensor_of(path: str, name: str, table: dict) -> Sensor:
    """The sensor of a table in the file `path`; BadInput names the wrong field."""
    where = f"{path}: [{name}]"
    if not isinstance(table, dict) or not {"image", "projection", "gel"} <= set(table):
        raise BadInput(
            f"{where}: needs gel = the name of the gel it carries, image = [width, height] and projection = three rows"
            " of three numbers"
        )
    image = table["image"]
    if not (isinstance(image, list) and len(image) == 2 and all(type(n) is int and 0 < n <= 10_000 for n in image)):
        raise BadInput(f"{where}: image is {image!r}; write [width, height] in pixels, two positive whole numbers")
    try:
        projection = np.array(table["projection"], float)
    except (TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"{where}: projection {table['projection']!r} is not three rows of three numbers") from error
    try:
        gel = load_gel(str(table["gel"]))
    except BadInput as error:
        raise BadInput(f"{where}: gel: {error}") from error
    check_projection(projection, f"{where} projection", gel)
    check_scale(projection, (image[0], image[1]), f"{where} projection", gel)
    markers = table.get("markers", {})
    check_markers(markers, f"{where} markers")
    return Sensor(name, tuple(image), projection, table["gel"], markers)


def check_markers(markers: Any, where: str) -> None:
    """Raise BadInput for impossible values in the description of printed markers; any key may be missing."""
    if not isinstance(markers, dict):
        raise BadInput(f"{where}: is {markers!r}; write a table, such as {{ rows = 7, cols = 9 }}")
    for key in ("rows", "cols"):
        count = markers.get(key, FEWEST_DOTS)
        if type(count) is not int or not FEWEST_DOTS <= count <= MOST_DOTS:
            raise BadInput(f"{where}: {key} is {count!r}; write a whole number from {FEWEST_DOTS} to {MOST_DOTS}")
    for key in ("pitch_px", "centre_px"):
        pair = markers.get(key, [0, 0])
        if not (
            isinstance(pair, list) and len(pair) == 2 and all(type(n) in (int, float) and abs(n) < 1e4 for n in pair)
        ):
            raise BadInput(f"{where}: {key} is {pair!r}; write [u, v] in pixels")
