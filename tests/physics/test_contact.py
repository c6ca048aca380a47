"""Contact at Gauss points: the rule integrates the surface, tractions have a potential, friction is bounded."""

from typing import get_args

import numpy as np
import pytest

from gelforge.flow.tables import Law
from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build
from gelforge.mechanics.contact.facerule import dunavant12
from gelforge.mechanics.contact.law import LAWS, contact_law
from gelforge.mechanics.contact.penalty import (
    STICK,
    FacePlaces,
    Penalty,
    contact_points,
    curved,
    penalty_tractions,
    positions,
)
from gelforge.mechanics.linear.pattern import build_pattern, symmetric_product
from gelforge.mechanics.mesh.hexmesh import (
    FineBox,
    build_mesh,
    graded_lines,
    layer_heights,
    round_corners,
    surface_lines,
    thinner_layers,
)
from gelforge.mechanics.pose import Pose, on_surface, touch_fraction
from tests.support.blocks import symmetric_block
from tests.support.flat_pad import FlatPad
from tests.support.surface_values import interpolate_surface

NO_SLIP = Penalty(50.0, 5.0, contact_law("no_slip"))
# Every law, with several numbers where it has one.
EVERY = [
    contact_law(name, number)
    for name, law in LAWS.items()
    for number in ((0.0, 0.1, 0.8) if law.has_coefficient else (0.0,))
]


def named(law):
    return f"{law.name}-{law.coefficient:g}"


HERE = Pose(np.eye(3), np.zeros(3))


class Floor:
    """Half space above z = 0, tilted: a body with one flat face."""

    name = "floor"
    normal = np.array([0.2, -0.1, -1.0]) / np.linalg.norm([0.2, -0.1, -1.0])

    def distance(self, points):
        return points @ self.normal, np.tile(self.normal, (len(points), 1))


class Ball:
    """A ball that all of the gel's top lies in."""

    name = "ball"

    def distance(self, points):
        v = points - [0.0, 0.0, 8.0]
        length = np.linalg.norm(v, axis=1)
        return length - 40.0, v / length[:, None]


@pytest.fixture(scope="module")
def mesh():
    return build_mesh(Gel(), FineBox(-3, 3, -2, 2, 1.0), 3)


@pytest.fixture(scope="module", params=["hexahedra", "tetrahedra"])
def either(request, mesh):
    """A mesh of each kind of face."""
    pad = FlatPad(name="pad", width=7.0, length=7.0, corner_radius=0.0, height=4.0)
    return mesh if request.param == "hexahedra" else symmetric_block(pad, 1.75, 2)


def test_face_rule_is_exact_to_degree_six():
    bary, weights = dunavant12()
    # integral of l1^2 l2^2 l3^2 over a triangle of area one: 2 (2! 2! 2!) / 8!
    assert weights @ np.prod(bary**2, axis=1) == pytest.approx(2 * 8 / 40320, rel=1e-12)


def test_rule_covers_the_surface(mesh):
    corners = mesh.nodes[mesh.faces]
    flat = 0.5 * np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    for order in (1, 2, 3, 4):
        state = contact_points(mesh, order)
        # a warped quad is larger than its projection by the square of its slopes, below 1e-2 in all but the rim
        assert state.weights.sum() == pytest.approx(np.linalg.norm(flat, axis=1).sum(), rel=5e-3)
        assert np.allclose(state.shape.sum(axis=1), 1.0)


def test_the_configuration_names_laws_that_there_are():
    assert set(get_args(Law)) <= LAWS.keys()


def test_free_points_feel_the_normal_only(mesh):
    state = contact_points(mesh, 2)
    x = state.reference + [0, 0, 0.3]
    tractions = penalty_tractions(state, x, HERE, Floor(), NO_SLIP, np.arange(len(x)))
    assert len(tractions.point)
    assert np.abs(np.cross(tractions.traction, Floor.normal)).max() < 1e-12 * np.abs(tractions.traction).max()


def sticking(mesh, seed=0):
    state, rng = contact_points(mesh, 1), np.random.default_rng(seed)
    state.status[:] = STICK
    state.stick_point = state.reference + rng.normal(0, 0.2, state.reference.shape)
    state.normal = np.tile(Floor.normal, (len(state.status), 1))
    return state, state.reference + [0, 0, 2.0]


@pytest.mark.parametrize("law", EVERY, ids=named)
def test_stiffness_is_the_derivative_of_the_traction(mesh, law):
    """On a flat face, where the indenter's curvature (left out of the stiffness) is zero."""
    (state, x), penalty = sticking(mesh), Penalty(50.0, 5.0, law)
    none = np.empty(0, int)
    tractions = penalty_tractions(state, x, HERE, Floor(), penalty, none)
    step = np.random.default_rng(1).normal(size=x.shape)
    h = 1e-6
    ahead = penalty_tractions(state, x + h * step, HERE, Floor(), penalty, none).traction
    behind = penalty_tractions(state, x - h * step, HERE, Floor(), penalty, none).traction
    predicted = -np.einsum("pij,pj->pi", tractions.stiffness, step[tractions.point])
    slip = tractions.slip
    predicted[np.searchsorted(tractions.point, slip.point)] -= np.einsum("pij,pj->pi", slip.block, step[slip.point])
    # central differences of a smooth law; a point within h of the cone would be off, none is for this seed
    assert np.abs((ahead - behind) / (2 * h) - predicted).max() < 1e-5 * penalty.normal
    assert np.allclose(tractions.stiffness, tractions.stiffness.transpose(0, 2, 1))
    assert (len(slip.point) > 0) == law.slips


@pytest.mark.parametrize("law", [law for law in EVERY if law.slips], ids=named)
def test_tangential_traction_stays_within_the_limit_and_opposes_slip(mesh, law):
    state, x = sticking(mesh)
    tractions = penalty_tractions(state, x, HERE, Floor(), Penalty(50.0, 5.0, law), np.empty(0, int))
    pressure = tractions.traction @ Floor.normal
    tangential = tractions.traction - pressure[:, None] * Floor.normal
    size, limit = np.linalg.norm(tangential, axis=1), law.coefficient * pressure
    rounding = 1e-12 * NO_SLIP.normal * 10
    assert np.all(size <= limit + rounding)
    slips = np.searchsorted(tractions.point, tractions.slip.point)
    np.testing.assert_allclose(size[slips], limit[slips], atol=rounding)
    back = state.stick_point[tractions.point] - x[tractions.point]
    assert np.all(np.einsum("pi,pi->p", tangential, back) >= -1e-12)


def test_stored_stiffness_is_the_derivative_of_the_nodal_forces(either):
    (state, _), mesh = sticking(either), either
    pattern, nodes = (
        build_pattern(mesh.elements, len(mesh.nodes), mesh.base),
        np.ascontiguousarray(mesh.faces[state.face]),
    )
    faces, values = FacePlaces(mesh, pattern), np.zeros(len(pattern.indices))

    def forces(u):
        x = positions(state.shape, nodes, mesh.nodes + u)
        tractions, found = penalty_tractions(state, x, HERE, Floor(), NO_SLIP, np.empty(0, int)), np.zeros_like(u)
        faces.add_forces(state, tractions, found)
        return tractions, found

    free = pattern.first_row >= 0
    way = np.random.default_rng(3).normal(size=mesh.nodes.shape) * free[:, None]
    tractions, before = forces(np.zeros_like(way))
    faces.add_stiffness(state, tractions, values)
    # springs of points that all stick are linear
    change = (forces(way)[1] - before)[free].ravel()
    assert np.allclose(
        symmetric_product(pattern, values, way[free].ravel()), change, atol=1e-10 * np.abs(change).max()
    )


def test_matrix_product_with_slip_is_that_of_the_blocks(either):
    """The part of the matrix that is not symmetric, applied without being stored."""
    (state, x), mesh = sticking(either), either
    pattern = build_pattern(mesh.elements, len(mesh.nodes), mesh.base)
    slip = penalty_tractions(
        state, x, HERE, Floor(), Penalty(50.0, 5.0, contact_law("coulomb", 0.05)), np.empty(0, int)
    ).slip
    rng = np.random.default_rng(2)
    v = rng.normal(size=(len(mesh.nodes), 3))
    v[mesh.base] = 0.0
    free = pattern.first_row >= 0
    y = np.zeros(3 * free.sum())
    FacePlaces(mesh, pattern).skew_product(state, slip)(v[free].ravel(), y)
    expected = np.zeros_like(v)
    nodes = mesh.faces[state.face[slip.point]]
    moved = np.einsum("pa,pai->pi", state.shape[slip.point], v[nodes])
    force = np.einsum("pij,pj->pi", slip.block, moved) * state.weights[slip.point, None]
    np.add.at(expected, nodes, state.shape[slip.point][:, :, None] * force[:, None, :])
    assert len(slip.point) and np.allclose(y, expected[free].ravel(), atol=1e-12 * np.abs(y).max())


def test_curved_stiffness_is_exact_where_the_face_is_not_flat(mesh):
    state, x = sticking(mesh)
    ball, penalty, none = Ball(), Penalty(50.0, 5.0, contact_law("coulomb", 0.3)), np.empty(0, int)
    tractions = penalty_tractions(state, x, HERE, ball, penalty, none)
    rest = curved(tractions, state, x, HERE, ball, penalty, none)
    step, h = np.random.default_rng(1).normal(size=x.shape), 1e-6
    ahead = penalty_tractions(state, x + h * step, HERE, ball, penalty, none).traction
    behind = penalty_tractions(state, x - h * step, HERE, ball, penalty, none).traction
    predicted = -np.einsum("pij,pj->pi", tractions.stiffness, step[tractions.point])
    predicted[np.searchsorted(tractions.point, rest.point)] -= np.einsum("pij,pj->pi", rest.block, step[rest.point])
    # one-sided differences over 1e-6 mm within `curved`: 1e-4 of slopes that grow as the pressure does
    assert np.abs((ahead - behind) / (2 * h) - predicted).max() < 1e-3 * NO_SLIP.normal


def test_released_points_fade():
    mesh = build_mesh(Gel(), FineBox(-3, 3, -2, 2, 1.0), 2)
    state, x = sticking(mesh)
    state.release(np.array([0, 5]), np.ones((2, 3)))
    state.go(0.25)
    tractions = penalty_tractions(state, x - [0, 0, 10], HERE, Floor(), NO_SLIP, np.empty(0, int))
    for point in (0, 5):
        assert np.allclose(tractions.traction[tractions.point == point].sum(axis=0), 0.75)


# ---- meshes


def test_lines_are_fine_inside_and_end_at_the_rim():
    lines = graded_lines(-10, 12, -2, 3, 0.5)
    steps = np.diff(lines)
    assert lines[0] == -10 and lines[-1] == 12 and np.all(steps > 0)
    inside = (lines[:-1] >= -2 - 1e-9) & (lines[1:] <= 3 + 1e-9)
    assert np.allclose(steps[inside], 0.5)
    assert np.all(steps[1:] / steps[:-1] < 2.0) and np.all(steps[:-1] / steps[1:] < 2.0)


def test_layers_grow_downwards():
    heights = layer_heights(5, 3.0)
    steps = np.diff(heights)
    assert heights[0] == 0 and heights[-1] == 1 and steps[0] / steps[-1] == pytest.approx(3.0)


def test_layers_under_a_small_contact_are_thin_and_grow_slowly():
    assert thinner_layers(5, 2.0, 4.0, 0.6, 1.6) == (5, 2.0)  # thin enough as they are
    for thickest, growth in ((0.45, 1.6), (0.24, 1.6), (0.1, 1.6), (0.48, 2.56), (0.01, 2.0)):
        layers, ratio = thinner_layers(5, 2.0, 4.0, thickest, growth)
        steps = 4.0 * np.diff(layer_heights(layers, ratio))
        assert steps[-1] == pytest.approx(thickest, rel=1e-3)
        assert np.all(steps[:-1] <= growth * 1.001 * steps[1:])
        assert layers == 5 or thickest * (growth ** (layers - 1) - 1) / (growth - 1) < 4.0  # one fewer would not do


def test_mesh_fills_the_gel(mesh):
    from gelforge.mechanics.elements.element import ELEMENTS

    gel = Gel()
    volume = ELEMENTS["hex8"].on(mesh.nodes, mesh.cells).weights.sum()  # raises where a hexahedron is inverted
    x, y = np.meshgrid(np.linspace(-10.37, 10.37, 400), np.linspace(-12.62, 12.62, 400))
    inside = gel.edge_distance(x, y) <= 0
    exact = (gel.top(x, y) + gel.height)[inside].mean() * inside.mean() * gel.width * gel.length
    assert volume == pytest.approx(exact, rel=0.02)  # hexahedra of 2 mm cut the curved rim short
    assert np.allclose(mesh.nodes[mesh.base][:, 2], -gel.height)
    top = mesh.nodes[mesh.surface_nodes]
    assert np.allclose(top[:, 2], gel.top(top[:, 0], top[:, 1]))


def test_the_rim_of_a_rectangle_goes_onto_the_rounded_outline():
    gel = Gel()
    half, share = np.array([gel.width, gel.length]) / 2, np.linspace(-1.0, 1.0, 801)
    for rim in (np.column_stack([share, 0 * share + 1.0]), np.column_stack([0 * share - 1.0, share])):
        x, y = round_corners(*(rim * half).T, *half, gel.corner_radius)
        np.testing.assert_allclose(gel.edge_distance(x, y), 0.0, atol=1e-12)
    inner = share * (half.min() - gel.corner_radius)
    np.testing.assert_array_equal(round_corners(inner, inner, *half, gel.corner_radius), [inner, inner])


def test_surface_interpolation_reproduces_bilinear_fields(mesh):
    xs, ys, _ = surface_lines(mesh)
    assert np.allclose(xs, mesh.xs) and np.allclose(ys, mesh.ys)
    rng = np.random.default_rng(0)
    values = np.stack([mesh.nodes[:, 0] * 2 + mesh.nodes[:, 1], mesh.nodes[:, 1] - 1], axis=1)
    xy = rng.uniform([-8, -10], [8, 10], (200, 2))  # away from the rounded corners
    expected = np.stack([xy[:, 0] * 2 + xy[:, 1], xy[:, 1] - 1], axis=1)
    assert np.allclose(interpolate_surface(mesh, values, xy), expected)


def test_a_point_touches_where_its_gap_has_gone_evenly_to_zero():
    before, after = np.array([0.3, 0.3, 0.3, 0.0, -0.1, 0.3]), np.array([-0.1, -0.3, 0.1, -0.2, -0.2, 0.0])
    # one that stays open or just meets the surface, at the end; one that was inside already, at the start
    np.testing.assert_allclose(touch_fraction(before, after), [0.75, 0.5, 1.0, 0.0, 0.0, 1.0], atol=1e-15)


@pytest.mark.parametrize(
    "table",
    [{"kind": "sphere", "diameter": 8, "height": 10}, {"kind": "cuboid", "size": [5, 7], "fillet": 1, "height": 10}],
)
def test_what_is_held_lies_on_the_indenter(table):
    """Places a little beside its surface, either way, are moved onto it, along the normal that is returned."""
    body = build("body", table)
    places = np.random.default_rng(4).uniform([-4.0, -4.0, -0.3], [4.0, 4.0, 3.0], (2000, 3))
    places = places[np.abs(body.distance(places)[0]) < 0.3]
    there, normal = on_surface(body, places)
    assert len(places) > 200 and np.abs(body.distance(there)[0]).max() < 1e-9
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-12)
    away = places - there
    along = np.einsum("pi,pi->p", away, normal)[:, None] * normal
    np.testing.assert_allclose(along, away, atol=1e-6)
