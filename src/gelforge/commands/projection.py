"""Fit a sensor's projection from point correspondences, or from the markers in a no-contact image."""

from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.cli import command, option
from gelforge.flow.files import write_json
from gelforge.labelling.homography import Fit, fit_homography
from gelforge.labelling.sensor import Sensor, check_projection, find_sensor, load_sensors, transform
from gelforge.reading.markers import MarkerGrid, markers_in
from gelforge.records.image import read_image, write_png
from gelforge.records.press import check_id
from gelforge.records.regular import refuse_to_replace
from gelforge.records.table import TableRows

POINT_COLUMNS = ["x_mm", "y_mm", "u_px", "v_px"]
EXACT = 4  # points that determine the eight parameters of a projection exactly
LEAST_SPAN = 1.0  # least extent of the points on the gel, mm
SQUARE = 0.02  # relative difference of the scales along gel x and y above which a doubt is printed
ZOOM = 3  # enlargement of the drawn image, so that lines are thinner than pixels
COLOURS = {"gel": (255, 255, 255), "points": (0, 255, 255), "markers": (0, 220, 0), "missing": (0, 0, 255)}  # BGR


@dataclass(frozen=True)
class FittedProjection:
    """The fit for a sensor: gel points (n, 2) mm and pixels (n, 2); markers is None where they were not used."""

    sensor: str
    image: tuple[int, int]
    gel: str
    fit: Fit
    points: np.ndarray
    pixels: np.ndarray
    markers: MarkerGrid | None


def read_points(path) -> tuple[np.ndarray, np.ndarray]:
    """Gel points (n, 2) mm and pixels (n, 2) of a CSV with columns x_mm, y_mm, u_px, v_px; # starts a comment."""
    hint = f"give a CSV with columns {', '.join(POINT_COLUMNS)} and decimals with a point"
    table = TableRows.read(path, hint, POINT_COLUMNS, "points")
    values = np.column_stack([table.numbers(name) for name in POINT_COLUMNS])
    return values[:, :2], values[:, 2:]


def read_picture(path, size: tuple[int, int]) -> np.ndarray:
    """An image file, or the gs_img of one of FEATS' .npy samples, as RGB (h, w, 3); another size raises BadInput."""
    from gelforge.formats.featsfile import read_npy

    if Path(path).suffix == ".npy":
        found = read_npy(path)
        image = found.get("gs_img") if isinstance(found, dict) else found
        if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3:
            raise BadInput(f"{path}: holds no uint8 image gs_img; give an image without contact")
    else:
        return read_image(path, size, "give a PNG, or a .npy sample")
    if (image.shape[1], image.shape[0]) != tuple(size):
        raise BadInput(
            f"{path}: image is {image.shape[1]} x {image.shape[0]} pixels, the sensor has {size[0]} x {size[1]};"
            " resize it, or correct `image` in workflow/sensors.toml"
        )
    return image


def grid_pixels(markers: dict, index: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) of the markers at (row, col) (n, 2) of the regular grid that a sensor's `markers` describes."""
    angle = np.deg2rad(markers.get("rotation_deg", 0.0))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = np.array([markers["cols"] - 1, markers["rows"] - 1]) / 2
    return (index[:, ::-1] - middle) * np.array(markers["pitch_px"]) @ turn.T + np.array(markers["centre_px"])


def fit_projection(name: str, like: Sensor, points=None, image=None, where: str = "") -> FittedProjection:
    """Fit the projection of the sensor `name`.

    points: (gel points (n, 2) mm, pixels (n, 2)). Without them, the markers in `image` (h, w, 3) RGB are assumed to
    lie where `like`, a sensor with the same marker grid, has them on its gel. With both, the points give the
    projection. Raises BadInput where neither determines it.
    """
    markers = None
    if image is not None:
        needed = {"rows", "cols", "pitch_px", "centre_px"}
        if not needed <= set(like.markers):
            raise BadInput(
                f"sensor {like.name}: `markers` lacks {', '.join(sorted(needed - set(like.markers)))}, which an"
                " image needs; add it to workflow/sensors.toml, or name another sensor as LIKE"
            )
        markers = markers_in(image).grid(like.markers["rows"], like.markers["cols"], where)
        span = np.ptp(markers.index, axis=0) + 1
        if tuple(span) != (markers.rows, markers.cols):
            # some rows or columns lie outside the image, on an unknown side
            if points is None:
                raise BadInput(
                    f"{where}: its markers span {span[0]} x {span[1]} of the {markers.rows} x {markers.cols} markers of sensor "
                    f"{like.name}, so it is unknown which ones are visible: give POINTS=points.csv, or set LIKE to a sensor "
                    "whose images show as many"
                )
            markers = None
    if points is None:
        if markers is None:
            raise BadInput(
                "give POINTS=points.csv, or IMAGE=nocontact.png, or both: make projection SENSOR=name POINTS=…"
            )
        points = like.unproject(grid_pixels(like.markers, markers.index)), markers.points
    on_gel, pixels = points
    fit = fit_homography(on_gel, pixels, where=where or "correspondences")
    check_projection(fit.homography, where or "correspondences")
    return FittedProjection(name, like.image, like.gel, fit, on_gel, pixels, markers)


def check_marks(on_gel: np.ndarray, pixels: np.ndarray, image: tuple[int, int], where: str) -> None:
    """BadInput for pixels (n, 2) outside an image (width, height), and for gel points (n, 2) that cannot be in mm."""
    beyond = np.flatnonzero((pixels < 0.0).any(axis=1) | (pixels > image).any(axis=1))
    if len(beyond):
        u, v = pixels[beyond[0]]
        raise BadInput(
            f"{where}: point {beyond[0] + 1}, ({u:g}, {v:g}), lies outside an image of {image[0]} x {image[1]} pixels; mark"
            " points in an image of that size"
        )
    span = np.ptp(on_gel, axis=0)
    if span.max() < LEAST_SPAN:
        raise BadInput(
            f"{where}: its points lie within {span.max():g} mm of the gel; check the unit, x_mm and y_mm are mm"
        )


def describe(found: FittedProjection) -> dict:
    """The fit as a dict of plain numbers, for the JSON file."""
    worst = int(found.fit.residual.argmax())
    about = {
        "sensor": found.sensor,
        "image": list(found.image),
        "gel": found.gel,
        "points": len(found.points),
        "projection": np.round(found.fit.homography, 8).tolist(),
        "residual_px": {
            "rms": round(found.fit.rms, 4),
            "largest": round(float(found.fit.residual[worst]), 4),
            "at_mm": np.round(found.points[worst], 3).tolist(),
        },
        "px_per_mm": np.round(_scale(found.fit.homography), 4).tolist(),
    }
    if found.markers is not None:
        grid = found.markers
        about["markers"] = {
            "rows": grid.rows,
            "cols": grid.cols,
            "count": grid.count,
            "missing": grid.missing.tolist(),
            "pitch_px": np.round(grid.pitch, 3).tolist(),
            "rotation_deg": round(grid.rotation, 3),
            "centre_px": np.round(grid.centre, 2).tolist(),
            "diameter_px": round(grid.diameter, 2),
            "uneven_px": round(grid.residual, 3),
        }
    return about


def _scale(homography) -> list[float]:
    """Pixels per mm along gel x and y at the apex."""
    step = 1e-3
    here, along_x, along_y = transform(homography, np.array([[0, 0], [step, 0], [0, step]]))
    return [float(np.hypot(*(to - here)) / step) for to in (along_x, along_y)]


def toml_table(about: dict) -> str:
    """The table to paste into workflow/sensors.toml."""
    rows = ", ".join(str([float(f"{value:.8g}") + 0.0 for value in row]) for row in about["projection"])
    lines = [f"[{about['sensor']}]", f'gel = "{about["gel"]}"', f"image = {about['image']}", f"projection = [{rows}]"]
    if "markers" in about:
        kept = ("rows", "cols", "pitch_px", "centre_px", "rotation_deg", "diameter_px")
        lines.append("markers = { " + ", ".join(f"{name} = {about['markers'][name]}" for name in kept) + " }")
    return "\n".join(lines) + "\n"


def draw(found: FittedProjection, image) -> np.ndarray:
    """Picture (BGR) of the fit: 5 mm grid lines of the gel, points used, markers found, markers missing."""
    import cv2

    width, height = found.image
    base = np.full((height, width, 3), 60, np.uint8) if image is None else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    picture = cv2.resize(base, (width * ZOOM, height * ZOOM), interpolation=cv2.INTER_CUBIC)

    def pixel(points):
        return np.rint(np.asarray(points).reshape(-1, 2) * ZOOM).astype(int)

    for at in range(-10, 11, 5):
        for line in ([(at, -12.5), (at, 12.5)], [(-10, at), (10, at)]):
            a, b = pixel(transform(found.fit.homography, np.array(line, float)))
            cv2.line(picture, a.tolist(), b.tolist(), COLOURS["gel"], 2 if at == 0 else 1, cv2.LINE_AA)
    for axis, end in (("x", (8, 0)), ("y", (0, 8))):
        at = pixel(transform(found.fit.homography, np.array([end], float)))[0]
        cv2.putText(picture, axis, (at + 8).tolist(), cv2.FONT_HERSHEY_SIMPLEX, 0.8, COLOURS["gel"], 2, cv2.LINE_AA)
    if found.markers is not None:
        for at in pixel(found.markers.points):
            cv2.circle(
                picture, at.tolist(), round(ZOOM * found.markers.diameter / 2), COLOURS["markers"], 2, cv2.LINE_AA
            )
        for at in pixel(_expected(found.markers)):
            cv2.drawMarker(picture, at.tolist(), COLOURS["missing"], cv2.MARKER_TILTED_CROSS, 20, 2)
    for at in pixel(found.pixels):
        cv2.drawMarker(picture, at.tolist(), COLOURS["points"], cv2.MARKER_CROSS, 12, 1)
    return picture


def _expected(grid: MarkerGrid) -> np.ndarray:
    """Pixels (m, 2) of the missing markers on a regular grid."""
    even = {
        "rows": grid.rows,
        "cols": grid.cols,
        "pitch_px": grid.pitch,
        "centre_px": grid.centre,
        "rotation_deg": grid.rotation,
    }
    return grid_pixels(even, grid.missing)


def report(about: dict, old: Sensor | None, like: str | None) -> None:
    """Print residual, markers, the change from sensors.toml, and the table to paste.

    like: name of the sensor whose marker grid was assumed; None where points were given.
    """
    residual = about["residual_px"]
    if like is not None:
        print(f"the marker grid is assumed to be that of {like}")
    elif about["points"] == EXACT:
        print(f"{EXACT} points determine the projection exactly: mark two more to see their error")
    print(
        f"projection of {about['sensor']} from {about['points']} points: residual {residual['rms']:.3f} px rms,"
        f" {residual['largest']:.3f} px at most (at x, y = {residual['at_mm']} mm)"
    )
    along_x, along_y = about["px_per_mm"]
    print(f"scale at the apex: {along_x:.2f} px/mm along gel x, {along_y:.2f} along gel y")
    if max(along_x / along_y, along_y / along_x) > 1.0 + SQUARE:
        print(
            f"doubt: the scales differ by {abs(along_x / along_y - 1.0):.1%}, but pixels are square: check the mm and px of the"
            " points along both axes"
        )
    if "markers" in about:
        markers = about["markers"]
        print(
            f"markers: {markers['count']} of {markers['rows'] * markers['cols']}, pitch {markers['pitch_px'][0]:.2f} x"
            f" {markers['pitch_px'][1]:.2f} px, turned {markers['rotation_deg']:.2f} degrees about {markers['centre_px']},"
            f" {markers['uneven_px']:.2f} px rms deviation from a regular grid"
        )
        # u runs along gel y, so the first pitch is divided by the scale of gel y
        apart = np.array(markers["pitch_px"]) / about["px_per_mm"][::-1]
        print(f"this gives a marker spacing of {apart[0]:.2f} x {apart[1]:.2f} mm; known GelSight Minis have 2.0")
    if old is not None:
        half = np.array([[-9.5, -11], [9.5, -11], [9.5, 11], [-9.5, 11]])
        moved = np.hypot(*(transform(np.array(about["projection"]), half) - old.project(half)).T).max()
        print(f"compared with workflow/sensors.toml, the corners of the view move by up to {moved:.2f} px")
    print("for workflow/sensors.toml, or data/DATASET/sensors.toml:\n" + toml_table(about))


@command(
    option("--sensor", default="", help="name of the sensor in sensors.toml"),
    option("--points", type=Path, help="CSV: x_mm, y_mm, u_px, v_px", default=None),
    option("--image", type=Path, help="no-contact image, .png or FEATS' .npy", default=None),
    option("--like", default="gelsight_mini", help="sensor with the same image size, gel and markers"),
    option("--sensors", type=Path, default=Path("workflow/sensors.toml")),
    option(
        "--out",
        type=Path,
        help="JSON; a picture goes beside it (default results/projection/SENSOR.json)",
        default=None,
    ),
)
def main(args: Namespace) -> None:
    if not args.sensor:
        raise BadInput("no sensor named; say make projection SENSOR=name POINTS=points.csv (or IMAGE=nocontact.png)")
    check_id(args.sensor, "SENSOR")
    out = args.out or Path("results/projection") / f"{args.sensor}.json"
    refuse_to_replace(f"--out {out}", [out, out.with_suffix(".png")], [args.points, args.image, args.sensors])
    if out.suffix == ".png":
        raise BadInput(f"--out {out}: its picture would have this name; give one that ends in .json")
    sensors = load_sensors(args.sensors)
    like = find_sensor(sensors, args.like, "LIKE", str(args.sensors))
    points = read_points(args.points) if args.points else None
    if points is not None:
        check_marks(*points, like.image, str(args.points))
    image = read_picture(args.image, like.image) if args.image else None
    found = fit_projection(args.sensor, like, points, image, str(args.points or args.image or ""))
    about = describe(found)
    write_json(out, about)
    write_png(out.with_suffix(".png"), draw(found, image)[..., ::-1])
    report(about, sensors.get(args.sensor), None if points else like.name)


if __name__ == "__main__":
    main.exit()
