"""Images of the demo with one trouble at a time: each is named by its cause, and the demo as it is by nothing."""

import csv
import functools
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelforge.evidence.images import Shapes, findings
from gelforge.evidence.imprints import Seen, Window, displaced, imprint
from gelforge.evidence.logimages import LogPairs, rim_of
from gelforge.geometry.indenters import build, load_catalogue, read_catalogue
from gelforge.labelling.sensor import load_sensors
from gelforge.reading.faults import Asked, nocontact_fault, pair_fault
from gelforge.reading.markers import markers_in
from gelforge.reading.measures import FLIPS
from gelforge.reading.picture import likeness
from gelforge.reading.wear import painted_over
from gelforge.records.image import read_image
from gelforge.records.press import POSE, Press

DEMO = Path("tests/data/presses")
MIDDLE = np.array([160.0, 120.0])


@dataclass(frozen=True)
class Log:
    """What a log of images consists of; a trouble replaces one part."""

    rows: dict  # of its numbers
    images: dict  # of the numbers of the demo's rows, also of those that it lacks
    nocontact: dict
    sensors: dict
    bodies: dict


@pytest.fixture(scope="module")
def demo() -> Log:
    with (DEMO / "log.csv").open() as file:
        rows = dict(enumerate(csv.DictReader(file)))
    nocontact = {path.stem: read_image(path) for path in sorted((DEMO / "nocontact").glob("*.png"))}
    images = {at: read_image(DEMO / row["image"]) for at, row in rows.items()}
    return Log(
        rows, images, nocontact, load_sensors("workflow/sensors.toml"), load_catalogue("workflow/indenters.toml")
    )


def part(log: Log, *numbers: int) -> Log:
    return replace(log, rows={at: log.rows[at] for at in numbers})


def of_sensor(log: Log, name: str) -> list[int]:
    return [at for at, row in log.rows.items() if row["sensor_id"] == name]


# All presses; the first of mini_a, three of each of six indenters at least; and the eight of mini_b.
PARTS = {
    "all": lambda demo: demo,
    "some": lambda demo: part(demo, *(at for at in of_sensor(demo, "mini_a") if at < 32)),
    "fewer": lambda demo: part(demo, *of_sensor(demo, "mini_b")),
}


def press_of(row: dict) -> Press:
    return Press(*(float(row[name]) for name in POSE))


KNOWN: dict = {}


def once(make, *parts):
    """make(*parts), made once for the same parts: a trouble leaves most of a log as it is."""
    key = make, *(id(part) for part in parts)
    if key not in KNOWN:
        KNOWN[key] = make(*parts), parts  # which are kept, so that no other has their identity
    return KNOWN[key][0]


def look(image: np.ndarray, nocontact: np.ndarray) -> tuple[np.ndarray, str, np.ndarray]:
    compare = once(LogPairs, nocontact)
    pair = compare(image)
    logged = compare.as_logged(image, pair)
    return imprint(logged), pair_fault(pair, Asked.LOG), rim_of(logged)


def expect(row: dict, sensor, body) -> np.ndarray:
    return once(Window, sensor).expected(body, press_of(row))


def judged(log: Log) -> list[str]:
    """What is said of a log: of its no-contact images, of its images one by one, and of all together."""
    faults = {
        name: nocontact_fault(once(LogPairs, picture).judged, Asked.LOG) for name, picture in log.nocontact.items()
    }
    said = [f"{name}: {fault}" for name, fault in faults.items() if fault]
    seen = []
    for number, row in log.rows.items():
        sensor = log.sensors[row["sensor_id"]]
        measured, fault, rim = once(look, log.images[number], log.nocontact[row["sensor_id"]])
        if fault:
            said.append(f"row {number + 2}: {fault}")
        expected, window = once(expect, row, sensor, log.bodies[row["indenter"]]), once(Window, sensor)
        centre = window.place(press_of(row))
        seen.append(
            Seen(
                number + 2,
                row["sample_id"],
                row["sensor_id"],
                row["indenter"],
                fault,
                measured,
                expected,
                centre,
                window.mm,
                rim,
            )
        )

    def shape(one: Seen, name: str) -> np.ndarray:
        return once(expect, log.rows[one.row - 2], log.sensors[one.sensor], log.bodies[name])

    def turned(one: Seen, turn) -> np.ndarray:
        row = log.rows[one.row - 2]
        return expect(
            row | {"rot_deg": str(turn(float(row["rot_deg"])))}, log.sensors[one.sensor], log.bodies[one.indenter]
        )

    return said + [one.text for one in findings(seen, Shapes(list(log.bodies), shape, turned))]


def all_images(log: Log, change) -> Log:
    return replace(log, images={at: np.ascontiguousarray(change(log.images[at])) for at in log.rows})


def all_nocontact(log: Log, change) -> Log:
    return replace(log, nocontact={name: np.ascontiguousarray(change(one)) for name, one in log.nocontact.items()})


def in_order(log: Log, order) -> Log:
    """Images of other rows, by the place of each among the rows of the log."""
    numbers = list(log.rows)
    return replace(log, images={at: log.images[numbers[other]] for at, other in zip(numbers, order, strict=True)})


def grey(image: np.ndarray) -> np.ndarray:
    return np.repeat(image.mean(axis=2, keepdims=True).astype(np.uint8), 3, axis=2)


def with_images(log: Log, images: dict[int, np.ndarray]) -> Log:
    return replace(log, images=log.images | images)


def exchanged(log: Log, one: int, other: int) -> Log:
    return with_images(log, {one: log.images[other], other: log.images[one]})


def faint(log: Log, rows, strength: float) -> Log:
    """Some images with a fraction of their change against the no-contact image."""
    images = {}
    for at in rows:
        rest = log.nocontact[log.rows[at]["sensor_id"]].astype(float)
        images[at] = np.rint(rest + strength * (log.images[at] - rest)).astype(np.uint8)
    return with_images(log, images)


def reprinted(log: Log, rows, shift: int) -> Log:
    """Some images with markers printed elsewhere, as of another unit under the same light."""
    images = {}
    for at in rows:
        rest = log.nocontact[log.rows[at]["sensor_id"]]
        bare = [
            painted_over(one, markers_in(one).points - 0.5, markers_in(one).diameter)
            for one in (rest, log.images[at])
        ]
        ink = np.clip((rest + 1.0) / (bare[0] + 1.0), 0.0, 1.0)
        images[at] = np.rint(bare[1] * np.roll(ink, (shift, shift), (0, 1))).astype(np.uint8)
    return with_images(log, images)


def frozen(log: Log, count: int) -> Log:
    """As many images that are the one of the row before."""
    own = list(log.rows)[5 : 6 + count]
    return with_images(log, dict.fromkeys(own[1:], log.images[own[0]]))


def with_nocontact(log: Log, **pictures) -> Log:
    return replace(log, nocontact=log.nocontact | pictures)


def projected(log: Log, degrees=0.0, scale=1.0, shift=(0.0, 0.0)) -> Log:
    turn = np.radians(degrees)
    linear = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    about = np.eye(3)
    about[:2, :2], about[:2, 2] = linear, MIDDLE - linear @ MIDDLE + shift
    return replace(
        log, sensors={name: replace(one, projection=about @ one.projection) for name, one in log.sensors.items()}
    )


def with_cell(log: Log, name: str, change) -> Log:
    return replace(log, rows={at: row | {name: str(change(float(row[name])))} for at, row in log.rows.items()})


def renamed(log: Log, name: str, other: str) -> Log:
    return replace(
        log,
        rows={
            at: row | {"indenter": other if (its := row["indenter"]) == name else its} for at, row in log.rows.items()
        },
    )


def resized(log: Log, name: str, factor: float) -> Log:
    table = dict(read_catalogue("workflow/indenters.toml")[name])
    for key in {"diameter", "size", "side"} & table.keys():
        table[key] = np.multiply(table[key], factor).tolist()
    return replace(log, bodies=log.bodies | {name: build(name, table)})


def test_nothing_is_said_of_the_demo(demo):
    assert judged(demo) == []


def test_contacts_lie_where_the_poses_put_them(demo):
    """The least likeness of 48 presses of six indenters, and their mean distance, which a place of the map is 0.5 mm of."""
    fits, moves = [], []
    for at, row in demo.rows.items():
        sensor = demo.sensors[row["sensor_id"]]
        measured, *_ = once(look, demo.images[at], demo.nocontact[row["sensor_id"]])
        expected = once(expect, row, sensor, demo.bodies[row["indenter"]])
        fits.append(likeness(measured, expected))
        moves.append(np.hypot(*displaced(measured, expected)[1]) * once(Window, sensor).mm)
    assert min(fits) > 0.75
    assert np.median(moves) < 0.25


def test_a_displaced_map_is_found_to_a_tenth_of_a_place():
    rows, cols = np.mgrid[0:30, 0:40]

    def bump(row, col):
        return np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / 18.0)

    for across, along in ((0.0, 0.0), (3.4, -5.3), (-6.7, 2.25)):
        fit, move = displaced(bump(14 + across, 20 + along), bump(14, 20))
        assert fit > 0.95  # half a place beside a whole one it is less alike
        assert move == pytest.approx([along, across], abs=0.1)


def overexposed(image: np.ndarray) -> np.ndarray:
    return np.clip(2.0 * image.astype(float), 0.0, 255.0).astype(np.uint8)


def defocused(image: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(image, (0, 0), 4.0)


NOCONTACT = {
    "another unit's": (lambda log: with_nocontact(log, mini_a=log.nocontact["mini_e"]), "different sensors"),
    "pressed by a sphere": (lambda log: with_nocontact(log, mini_a=log.images[0]), "to touch the gel in the no-contact image"),
    "pressed by a triangle": (lambda log: with_nocontact(log, mini_a=log.images[16]), "something touched the gel"),
    "pressed under strong light": (lambda log: with_nocontact(log, mini_e=log.images[3]), "touch the gel"),
    "monochrome": (lambda log: with_nocontact(log, mini_a=grey(log.nocontact["mini_a"])), "mini_a: the no-contact image is monochrome"),
    "dark": (lambda log: with_nocontact(log, mini_a=log.nocontact["mini_a"] // 40), "shows no gel"),
}  # fmt: skip
ALIKE = {
    **{how: (functools.partial(all_images, change=flip), how) for how, flip in FLIPS.items()},
    "all monochrome": (lambda log: all_images(log, grey), "the image is monochrome"),
    "all in the order BGR": (lambda log: all_images(log, lambda image: image[..., ::-1]),
                             "mini_b: 8 of 8 images have the same fault, the image is in the other colour order (red and blue exchanged)"),
    "all out of focus": (lambda log: all_images(log, defocused), "images have the same fault, the image is blurred"),
    "all overexposed": (lambda log: all_images(log, overexposed), "the image is overexposed"),
    "no-contact images at half the light": (
        lambda log: all_nocontact(log, lambda one: one // 2), "have the same fault, the image is more than 1.8 times brighter"),
}  # fmt: skip
AXES = {
    **{f"sensor {how}": (
        lambda log, flip=flip: all_nocontact(all_images(log, flip), flip), f"once these are {how}") for how, flip in FLIPS.items()},
    "projection turned by 90 degrees": (lambda log: projected(log, 90.0), "once these are turned by 90 degrees"),
    "x0 with the other sign": (lambda log: with_cell(log, "x0_mm", np.negative), "once these are mirrored top to bottom"),
}  # fmt: skip
ROWS = {
    "shifted down": (lambda log: in_order(log, [*range(1, len(log.rows)), 0]), "pose of the next row"),
    "in the order of unpadded names": (
        lambda log: in_order(log, sorted(range(len(log.rows)), key=str)), "do not show the contacts that their rows describe"),
    "shifted back from the middle on": (
        lambda log: in_order(log, [*range(12), *range(11, len(log.rows) - 1)]), "on suit the pose of the previous row"),
    "two exchanged": (lambda log: exchanged(log, 10, 16), "row 12 (demo-000010)"),
    "one of another unit": (lambda log: with_images(log, {5: log.images[3]}), "row 7: the image and the no-contact image are of different"),
    "one black": (lambda log: with_images(log, {5: np.zeros_like(log.images[5])}), "row 7: the image shows nothing"),
    "one of noise": (lambda log: with_images(log, {5: np.random.default_rng(1).integers(0, 255, log.images[5].shape).astype(np.uint8)}),
                     "row 7: the image shows nothing"),
    "one out of focus": (lambda log: with_images(log, {7: defocused(log.images[7])}), "row 9: the image is blurred"),
    "one overexposed": (lambda log: with_images(log, {7: overexposed(log.images[7])}), "row 9: the image is overexposed"),
    "three of a frozen camera": (lambda log: frozen(log, 3), "identical to that of the previous row"),
    "two of another print": (lambda log: reprinted(log, (6, 21), 12), "the markers at the rim of its image are not"),
    "one of a gel that moved": (lambda log: with_images(log, {6: np.roll(log.images[6], 9, 1)}), "the markers at the rim of its image are not"),
}  # fmt: skip
SHAPES = {
    "projection turned": (lambda log: projected(log, 6.0), "turned by -6."),
    "projection too large": (lambda log: projected(log, scale=1.2), "the scale of `projection`"),
    "projection too small": (lambda log: projected(log, scale=0.83), "the scale of `projection`"),
    "projection moved along both axes": (lambda log: projected(log, shift=(14.0, -16.0)), "moved by 1."),
    "sphere too small": (lambda log: resized(log, "sphere_15", 0.75), "imprints of sphere_15 are 1.1"),
    "cuboid too large": (lambda log: resized(log, "cuboid_10", 1.2), "imprints of cuboid_10 are 0.8"),
    "origin beside the apex": (lambda log: with_cell(log, "x0_mm", lambda x0: x0 + 5.0),
                               "mini_a: compared with the poses and the projection, the contacts are moved by 4."),
    "rot_deg in radians": (lambda log: with_cell(log, "rot_deg", np.radians), "as if rot_deg were in radians"),
    "rot_deg of the other sign": (lambda log: with_cell(log, "rot_deg", np.negative), "as if rot_deg were of the other sign"),
    "rot_deg off by 30 degrees": (lambda log: with_cell(log, "rot_deg", lambda turn: turn - 30.0), "as if rot_deg were off by 30 degrees"),
    "sphere upside down": (lambda log: replace(log, bodies=log.bodies | {name: build(
        name, {"kind": "cylinder", "diameter": 15, "height": 10, "fillet": 0.3}) for name in ("sphere_10", "sphere_15")}), "images of sphere_15 show the shape of sphere_20"),
    "triangle called cylinder": (lambda log: renamed(log, "triangle_10", "cylinder_8"), "of cylinder_8 show the shape of triangle_10"),
}  # fmt: skip
IMPRINTS = {
    "none in most": (lambda log: faint(log, list(log.rows)[:-6], 0.0), "images show no imprint"),
    "none in three": (lambda log: faint(log, (2, 18, 24), 0.0), "row 20 (demo-000018): its image shows"),
    "a third in two": (lambda log: faint(log, (18, 24), 0.33), "row 20 (demo-000018): its image shows"),
    "two exchanged beside a moved projection": (lambda log: projected(exchanged(log, 10, 16), shift=(20.0, 0.0)), "row 12 (demo-000010)"),
    "none in three beside a moved projection": (
        lambda log: projected(faint(log, (2, 18, 24), 0.0), shift=(14.0, -16.0)), "row 20 (demo-000018): its image shows"),
    "two exchanged beside a projection too large": (lambda log: projected(exchanged(log, 10, 16), scale=1.2), "row 12 (demo-000010)"),
}  # fmt: skip


@pytest.mark.parametrize(
    "log, troubles",
    [
        ("some", NOCONTACT),
        ("fewer", ALIKE),
        pytest.param("all", AXES, marks=pytest.mark.slow),
        ("some", ROWS),
        pytest.param("some", SHAPES, marks=pytest.mark.slow),
        ("some", IMPRINTS),
    ],
    ids=["nocontact", "alike", "axes", "rows", "shapes", "imprints"],
)
def test_a_trouble_is_named(demo, log, troubles):
    good, missed = PARTS[log](demo), {}
    for name, (trouble, cause) in troubles.items():
        said = judged(trouble(good))
        if not any(cause in one for one in said):
            missed[name] = said
    assert not missed


def test_few_images_or_centred_presses_say_nothing_together(demo):
    turn = FLIPS["turned by 180 degrees"]
    assert judged(all_nocontact(all_images(part(demo, *range(5)), turn), turn)) == []
