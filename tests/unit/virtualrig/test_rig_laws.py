"""Laws of the virtual rig: growing appends, and pictures show what the gel does."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build
from gelforge.labelling.sensor import load_sensors
from gelforge.records.press import Press
from gelforge.virtualrig.appearance import TERMS, Appearance, read_appearances
from gelforge.virtualrig.fields import STEP, body_of, unloaded
from gelforge.virtualrig.render import RIPPLE_MM, Pressed, Renderer
from gelforge.virtualrig.rigplan import kind_of, orders, read_plan
from tests.support.likeness import gel_points, inside_image

ROOT = Path(__file__).parents[3]
PLAN = ROOT / "workflow" / "rig" / "train.toml"
UNITS = ("mini_a", "mini_b", "mini_c", "mini_d", "mini_e")


@cache
def camera(name: str) -> Renderer:
    sensors, appearances = (
        load_sensors(ROOT / "workflow" / "sensors.toml"),
        read_appearances(ROOT / "workflow/rig/sensors.toml"),
    )
    return Renderer(appearances[name], sensors[name].projection, Gel())


@given(short=st.integers(1, 60), more=st.integers(0, 60))
@settings(max_examples=8)
def test_growing_a_plan_appends(short, more):
    plan = read_plan(PLAN)
    few = orders(replace(plan, presses=short))
    assert orders(replace(plan, presses=short + more))[: len(few)] == few


@given(weights=st.lists(st.floats(0.1, 10.0), min_size=1, max_size=5), presses=st.integers(1, 300))
@settings(max_examples=50)
def test_kinds_get_their_share_at_every_length(weights, presses):
    plan = read_plan(PLAN)
    plan = replace(plan, kinds=tuple(replace(plan.kinds[0], weight=w) for w in weights))
    count = np.bincount(kind_of(plan, presses)[0], minlength=len(weights))
    expected = presses * np.array(weights) / sum(weights)
    # the kind furthest behind is served next, so none is ahead by a whole press
    assert (count - expected < 1.0).all()
    assert count.sum() == presses


def linear_field(shift, stretch, turn_deg):
    """A homogeneous displacement of the whole surface and its map on points (n, 2)."""
    field = unloaded(Gel())
    y, x = np.mgrid[: field.values.shape[0], : field.values.shape[1]]
    xy = np.stack([field.x0 + STEP * x, field.y0 + STEP * y], axis=-1)
    angle = np.deg2rad(turn_deg)
    matrix = stretch * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) - np.eye(2)
    field.values[..., :2] = xy @ matrix.T + shift
    return field, lambda points: points @ matrix.T + shift


def marker_centres(image: np.ndarray) -> np.ndarray:
    """Centres (n, 2) px of dark spots of 40 to 500 pixels, weighted by the darkness of all colours together.

    Good to 0.05 px on a sharp picture. What readers find markers with leaves a marker's shadow out, which moves with the light.
    """
    grey = image.astype(np.float32).mean(axis=2)
    around = cv2.GaussianBlur(cv2.medianBlur(np.rint(grey).astype(np.uint8), 61).astype(np.float32), (0, 0), 8)
    ratio = cv2.GaussianBlur(grey / np.maximum(around, 1.0), (0, 0), 0.8)
    _, label, stats, _ = cv2.connectedComponentsWithStats((ratio < 0.72).astype(np.uint8), connectivity=4)
    v, u = np.mgrid[: grey.shape[0], : grey.shape[1]] + 0.5
    centres = []
    for spot, (_, _, width, height, area) in enumerate(stats[1:], 1):
        if 40 <= area <= 500 and max(width, height) <= 2.2 * min(width, height):
            near = cv2.dilate((label == spot).astype(np.uint8), np.ones((3, 3)))
            weight = np.clip(1.0 - ratio, 0.0, None) * near
            centres.append([(weight * u).sum() / weight.sum(), (weight * v).sum() / weight.sum()])
    return np.array(centres)


@given(
    name=st.sampled_from(UNITS),
    shift=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    stretch=st.floats(0.95, 1.05),
    turn=st.floats(-2.0, 2.0),
)
@example(name="mini_c", shift=(0.5, 0.0), stretch=1.0, turn=0.0)
@settings(max_examples=8)
def test_markers_go_where_the_gel_goes(name, shift, stretch, turn):
    eye = camera(name)
    field, moves = linear_field(np.array(shift), stretch, turn)
    points = gel_points(eye, eye.appearance.markers)
    expected = eye.seen(points, np.column_stack([moves(points), np.zeros(len(points))]))
    before, after = marker_centres(eye.image()), marker_centres(eye.image(field))
    seen = inside_image(expected, 1.5 * eye.appearance.diameter) & inside_image(
        eye.appearance.markers, 1.5 * eye.appearance.diameter
    )
    off = []
    for marker, there in zip(eye.appearance.markers[seen], expected[seen], strict=True):
        a = before[np.linalg.norm(before - marker, axis=1).argmin()]
        b = after[np.linalg.norm(after - there, axis=1).argmin()]
        off.append(np.linalg.norm((b - a) - (there - marker)))
    # pictures are free of noise here; what is left are 8 bit, and of a single marker its ragged rim, its flecks and its shadow
    assert np.median(off) < 0.1 and max(off) < eye.appearance.diameter / 20


def clean_appearance(name: str, markers: np.ndarray) -> Appearance:
    """A unit's camera under even light, with round markers that have neither flecks nor shadows."""
    even = np.zeros((len(TERMS), 3))
    even[0] = 240.0
    appearance = read_appearances(ROOT / "workflow/rig/sensors.toml")[name]
    return replace(
        appearance, markers=markers, background=even, tilt=np.zeros((3, 2)), white_balance=np.ones(3), gain=1.0, vignette=0.0,
        raggedness=0.0, flecks=np.zeros(3), shadow_depth=0.0,
    )  # fmt: skip


@given(name=st.sampled_from(UNITS), shift=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)))
@settings(max_examples=5)
def test_a_dot_stands_where_labels_have_its_point_of_the_gel(name, shift):
    sensor = load_sensors(ROOT / "workflow/sensors.toml")[name]
    gel = np.array([[-4.3, -6.2], [-1.1, 0.4], [3.7, 5.1], [4.2, -4.0]])
    eye = Renderer(clean_appearance(name, sensor.project(gel)), sensor.projection, Gel())
    field = unloaded(Gel())
    field.values[..., :2] = shift
    scale = float(
        np.hypot(*(sensor.project(gel[:1] + [0.0, 0.5]) - sensor.project(gel[:1] - [0.0, 0.5]))[0])
    )  # px/mm
    v, u = np.mgrid[:240, :320] + 0.5  # label cells count from the image's corner
    for image, places in ((eye.image(), sensor.project(gel)), (eye.image(field), sensor.project(gel + shift))):
        darkness = np.clip(np.median(image) - image.mean(axis=2), 0.0, None)
        for at in places:
            ink = darkness * (np.hypot(u - at[0], v - at[1]) < eye.appearance.diameter)
            centroid = np.array([(ink * u).sum(), (ink * v).sum()]) / ink.sum()
            # a press is followed to 0.0014 mm of the gel by nine rounds of a fixed point iteration, which a sensor that
            # magnifies shows larger, and 8 bits leave 0.005 px
            assert np.abs(centroid - at).max() < 0.0014 * scale + 0.005


@given(name=st.sampled_from(UNITS), seed=st.integers(0, 1000))
@settings(max_examples=4)
def test_a_nocontact_field_is_the_nocontact_image(name, seed):
    eye = camera(name)
    plain = eye.image(rng=np.random.default_rng(seed)).astype(int)
    through = eye.image(unloaded(Gel()), rng=np.random.default_rng(seed)).astype(int)
    assert np.abs(plain - through).max() <= 1  # interpolation of nothing may round one grey level


@given(depth=st.floats(0.2, 2.0))
@settings(max_examples=10)
def test_what_is_pressed_looks_larger(depth):
    eye = camera("mini_a")
    points = np.array([[-4.0, -4.0], [4.0, 4.0]])
    flat = eye.seen(points, np.zeros((2, 3)))
    near = eye.seen(points, np.array([[0.0, 0.0, -depth]] * 2))
    larger = np.linalg.norm(near[1] - near[0]) / np.linalg.norm(flat[1] - flat[0])
    assert np.isclose(larger, eye.appearance.camera_mm / (eye.appearance.camera_mm - depth))


@given(
    name=st.sampled_from(UNITS),
    x=st.floats(-5.0, 5.0),
    y=st.floats(-6.5, 6.5),
    down=st.floats(0.0, 0.8),
)
@example(name="mini_a", x=5.0, y=6.5, down=0.5)
@example(name="mini_e", x=2.0, y=6.5, down=0.75)
@settings(max_examples=6)
def test_a_body_shows_where_the_gel_that_it_presses_shows(name, x, y, down):
    """Off the apex, too, where the gel lies lower without having moved: there its label's cell is."""
    gel, eye, radius = Gel(), camera(name), 3.0
    field = unloaded(gel)
    field.values[..., 2] = -down
    body = body_of(build("ball", {"kind": "sphere", "diameter": 2 * radius, "height": 8}), 0.0, 0.6, 0.0)
    tip = float(gel.top(x, y)) - down - 0.2  # the contact is some 30 pixels wide
    low, high = (eye.height(field, Pressed(body, Press(x, y, 1.0, 0.0, 0.0, end - 1.0))) for end in (tip, 0.9))
    sunk = np.clip(high - low, 0.0, None)
    v, u = np.mgrid[:240, :320] + 0.5
    found = np.array([(sunk * u).sum(), (sunk * v).sum()]) / sunk.sum()
    at = np.stack(np.meshgrid(np.linspace(-1.5, 1.5, 301), np.linspace(-1.5, 1.5, 301)), axis=-1).reshape(-1, 2)
    ball = tip + radius - np.sqrt(radius**2 - (at**2).sum(axis=1))
    weight = np.clip(gel.top(x + at[:, 0], y + at[:, 1]) - down - ball, 0.0, None)
    seen = eye.seen(at + (x, y), np.column_stack([np.zeros((len(at), 2)), np.full(len(at), -down)]))
    # the surface is smoothed: contact nearer to the picture's edge than that reaches shows a part of itself
    assume(inside_image(seen[weight > 0.0], 2.0 * RIPPLE_MM * eye.scale).all())
    expected = (weight[:, None] * seen).sum(axis=0) / weight.sum()
    assert np.abs(found - expected).max() < 0.03


def test_a_dent_is_lit_from_the_three_sides():
    eye = camera("mini_a")
    field = unloaded(Gel())
    y, x = np.mgrid[: field.values.shape[0], : field.values.shape[1]]
    r2 = (field.x0 + STEP * x) ** 2 + (field.y0 + STEP * y) ** 2
    field.values[..., 2] = -np.exp(-r2 / (2 * 1.5**2))
    change = eye.image(field).astype(float) - eye.image().astype(float)
    above, below, right, left = (
        np.median(change[rows, cols], axis=(0, 1))
        for rows, cols in (
            (np.s_[92:102], np.s_[145:175]),
            (np.s_[138:148], np.s_[145:175]),
            (np.s_[105:135], np.s_[178:188]),
            (np.s_[105:135], np.s_[132:142]),
        )
    )
    # the gel bulges towards the camera: each light brightens the flank that faces it
    assert above[0] > 5 > -5 > below[0]
    assert right[1] > 5 > -5 > left[1]
    assert below[2] > 5 > -5 > above[2]
