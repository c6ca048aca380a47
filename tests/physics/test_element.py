"""Every element against closed forms of the Neo-Hookean solid."""

import numpy as np
import pytest

from gelforge.mechanics.elements.element import ELEMENTS
from gelforge.mechanics.elements.kernels import batched
from gelforge.mechanics.linear.factorisation import SuperLU, symmetric_solver
from gelforge.mechanics.linear.pattern import block_places, build_pattern, symmetric_product
from gelforge.mechanics.material import Material
from gelforge.mechanics.mesh.stepped import Cells
from gelforge.mechanics.mesh.tetmesh import second_order
from tests.support.blocks import kuhn_grid

EXACT = 1e-10  # relative; homogeneous fields lie in the element's space, so only rounding is left


@pytest.fixture(params=ELEMENTS.values(), ids=ELEMENTS)
def element(request):
    return request.param


def distorted_block(element, n=3, amount=0.25, seed=1):
    """Unit cube of n^3 hexahedra, or six times as many tetrahedra, inner nodes moved at random: nodes, cells, boundary."""
    grid = np.linspace(0, 1, n + 1)
    if element.nodes == 8:
        z, y, x = np.meshgrid(grid, grid, grid, indexing="ij")
        nodes = np.stack([x, y, z], axis=-1).reshape(-1, 3)
        index = np.arange((n + 1) ** 3).reshape(n + 1, n + 1, n + 1)
        lower = [index[:-1, :-1, :-1], index[:-1, :-1, 1:], index[:-1, 1:, 1:], index[:-1, 1:, :-1]]
        upper = [index[1:, :-1, :-1], index[1:, :-1, 1:], index[1:, 1:, 1:], index[1:, 1:, :-1]]
        cells = np.stack([a.ravel() for a in lower + upper], axis=1).astype(np.int32)
    else:
        (nodes, cells), amount = kuhn_grid((grid, grid, grid)), amount / 2  # sharp corners bear less
    inner = np.all((nodes > 1e-9) & (nodes < 1 - 1e-9), axis=1)
    nodes[inner] += np.random.default_rng(seed).uniform(-amount, amount, (inner.sum(), 3)) / n
    if element.nodes == 10:
        nodes, cells, _ = second_order(nodes, cells)
    return nodes, cells.astype(np.int32), ~np.all((nodes > 1e-9) & (nodes < 1 - 1e-9), axis=1)


def forces_of(element, nodes, cells, u, material):
    """Nodal forces dE/du (n, 3)."""
    out = np.zeros_like(u)
    body = element.on(nodes, Cells.plain(cells))
    assert body.internal_forces(u, material.shear_modulus, material.bulk_modulus, out) > 0
    return out


def matrix_of(element, nodes, cells, u, material, fixed=np.empty(0, int)):
    """Upper-triangle values and pattern of the tangent."""
    body, pattern = element.on(nodes, Cells.plain(cells)), build_pattern(cells, len(nodes), fixed)
    values = np.zeros(len(pattern.indices), np.float32)
    body.tangent(u, material.shear_modulus, material.bulk_modulus, 1.0, *block_places(pattern, cells), values)
    return values, pattern


def dense(values, pattern):
    import scipy.sparse as sp

    n = len(pattern.indptr) - 1
    upper = sp.csr_matrix((values, pattern.indices, pattern.indptr), (n, n)).toarray()
    return upper + np.triu(upper, 1).T


def first_piola(f, material):
    """P = dW/dF of W = C10 (I1bar - 3) + (J - 1)^2 / D1."""
    j, inverse = np.linalg.det(f), np.linalg.inv(f).T
    isochoric = material.shear_modulus * j ** (-2 / 3) * (f - np.sum(f * f) / 3 * inverse)
    return isochoric + material.bulk_modulus * (j - 1) * j * inverse


@pytest.mark.parametrize("nu", [0.3, 0.475, 0.49])
def test_a_bar_that_is_drawn_a_little_narrows_by_poissons_ratio(nu):
    """Its sides are free of stress, and Young's modulus is 2 G (1 + nu)."""
    material, strain = Material(nu), 1e-6
    stress = first_piola(np.diag(1.0 + strain * np.array([1.0, -nu, -nu])), material)
    young = 2.0 * material.shear_modulus * (1.0 + nu)
    np.testing.assert_allclose(stress, np.diag([young * strain, 0.0, 0.0]), atol=1e-4 * young * strain)


def solve_inner(element, nodes, cells, u, fixed, material):
    """Newton on the nodes that are not fixed; returns u and the residual norms."""
    free = np.setdiff1d(np.arange(len(nodes)), fixed)
    norms = []
    for _ in range(12):
        residual = forces_of(element, nodes, cells, u, material)[free]
        norms.append(np.linalg.norm(residual))
        if norms[-1] < 1e-14:
            break
        values, pattern = matrix_of(element, nodes, cells, u, material, fixed)
        solver = SuperLU(pattern.indptr, pattern.indices)
        solver.factorise(values)
        u = u.copy()
        u[free] -= solver.solve(residual.ravel()).reshape(-1, 3)
    return u, norms


def test_products_are_those_of_the_whole_matrix(element):
    nodes, cells, boundary = distorted_block(element)
    rng = np.random.default_rng(0)
    values, pattern = matrix_of(
        element, nodes, cells, 0.01 * rng.normal(size=nodes.shape), Material(), np.flatnonzero(boundary)[:9]
    )
    x = rng.normal(size=len(pattern.indptr) - 1)
    np.testing.assert_allclose(symmetric_product(pattern, values, x), dense(values, pattern) @ x, rtol=0, atol=1e-12)


def test_elements_are_the_same_in_any_company(element):
    """They are worked on in batches, of which the last is not full."""
    nodes, cells, _ = distorted_block(element, 5)
    assert len(cells) % element.kernels.width
    u, material = 0.01 * np.random.default_rng(0).normal(size=nodes.shape), Material()
    alone = [forces_of(element, nodes, cells[e : e + 1], u, material) for e in range(len(cells))]
    together = forces_of(element, nodes, cells, u, material)
    np.testing.assert_allclose(together, np.sum(alone, axis=0), rtol=0, atol=1e-12)
    ratios = element.on(nodes, Cells.plain(cells)).smallest_ratios(u)
    single = [element.on(nodes, Cells.plain(cells[e : e + 1])).smallest_ratios(u)[0] for e in range(len(cells))]
    np.testing.assert_allclose(ratios, single, rtol=1e-12)
    whole, turned = (dense(*matrix_of(element, nodes, some, u, material)) for some in (cells, cells[::-1]))
    np.testing.assert_allclose(whole, turned, rtol=0, atol=1e-6 * np.abs(whole).max())


DEFORMATIONS = {
    "uniaxial": np.diag([1.25, 0.9, 0.9]),
    "simple shear": np.array([[1, 0.4, 0], [0, 1, 0], [0, 0, 1.0]]),
    "confined compression": np.diag([1, 1, 0.9]),
    "mixed": np.array([[1.1, 0.1, -0.05], [0.02, 0.95, 0.08], [0.0, 0.1, 0.97]]),
}


@pytest.mark.parametrize("nu", [0.3, 0.475, 0.499])
@pytest.mark.parametrize("name", DEFORMATIONS)
def test_patch_and_closed_forms(element, name, nu):
    """Inner nodes of a distorted block find the homogeneous state; boundary forces are P N."""
    nodes, cells, boundary = distorted_block(element)
    material, f = Material(nu=nu), DEFORMATIONS[name]
    exact = nodes @ (f - np.eye(3)).T
    start = np.where(boundary[:, None], exact, exact + 0.01 * (nodes > 2))
    start[~boundary] *= 0.97
    u, _ = solve_inner(element, nodes, cells, start, np.flatnonzero(boundary), material)
    assert np.abs(u - exact).max() < 1e-9  # Newton stops at rounding of forces, which stiff nu magnifies
    forces = forces_of(element, nodes, cells, u, material)
    stress = first_piola(f, material)
    for axis in range(3):  # the resultant over a face of unit area is a column of P
        # an edge node shares its force between faces, so the first moment is compared: sum f x^T = V P
        moment = forces.T @ nodes[:, axis]
        assert np.abs(moment - stress[:, axis]).max() < EXACT * np.abs(stress).max() * 100


def test_closed_forms_by_hand():
    """P of the law itself against textbook results, so that the comparison above is no circle."""
    m = Material(nu=0.475)
    mu, kappa = m.shear_modulus, m.bulk_modulus
    shear = first_piola(DEFORMATIONS["simple shear"], m)
    assert shear[0, 1] == pytest.approx(mu * 0.4, rel=1e-12)  # tau = mu gamma
    lam = 0.9
    confined = first_piola(np.diag([1, 1, lam]), m)[2, 2]
    hand = mu * lam ** (-2 / 3) * (lam - (2 + lam**2) / (3 * lam)) + kappa * (lam - 1)
    assert confined == pytest.approx(hand, rel=1e-12)
    small = first_piola(np.diag([1 + 1e-6, 1, 1]), m)[0, 0] / 1e-6
    assert small == pytest.approx(kappa + 4 * mu / 3, rel=1e-5)  # oedometric modulus, to first order in the strain


def test_rigid_rotation_gives_no_force(element):
    nodes, cells, _ = distorted_block(element)
    a, b = np.deg2rad(70), np.deg2rad(-40)
    rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    rz = np.array([[np.cos(b), -np.sin(b), 0], [np.sin(b), np.cos(b), 0], [0, 0, 1]])
    u = nodes @ (rx @ rz - np.eye(3)).T + [0.3, -2.0, 1.0]
    material = Material(nu=0.499)
    # the stiffest modulus times area sets the size of rounding
    assert np.abs(forces_of(element, nodes, cells, u, material)).max() < 1e-12 * material.bulk_modulus


def test_tangent_is_the_derivative_of_the_forces(element):
    nodes, cells, _ = distorted_block(element, 2)
    material, rng = Material(nu=0.49), np.random.default_rng(4)
    u = (0.05 if element.nodes == 8 else 0.02) * rng.normal(size=nodes.shape)
    direction = rng.normal(size=nodes.shape)
    k = dense(*matrix_of(element, nodes, cells, u, material)) @ direction.ravel()
    h = 1e-5
    ahead, behind = (forces_of(element, nodes, cells, u + s * h * direction, material).ravel() for s in (1, -1))
    # central differences: error h^2 times the third derivative, far below 1e-6 of the stiffness
    assert np.abs(k - (ahead - behind) / (2 * h)).max() < 1e-6 * np.abs(k).max()


def test_newton_converges_quadratically(element):
    nodes, cells, boundary = distorted_block(element)
    f = DEFORMATIONS["mixed"]
    start = nodes @ (f - np.eye(3)).T
    start[~boundary] *= 0.7
    _, norms = solve_inner(element, nodes, cells, start, np.flatnonzero(boundary), Material(nu=0.475))
    orders = [np.log(c / b) / np.log(b / a) for a, b, c in zip(norms, norms[1:], norms[2:]) if c > 1e-13]
    assert max(orders) > 1.8  # 2 in theory; rounding spoils the last pair


def test_no_locking_near_incompressibility():
    """A bonded block pressed flat: its force hardly knows nu, a locking hexahedron answers with the bulk modulus."""
    element = ELEMENTS["hex8"]
    nodes, cells, _ = distorted_block(element, 4, amount=0.0)
    fixed = np.flatnonzero((nodes[:, 2] < 1e-9) | (nodes[:, 2] > 1 - 1e-9))
    answers = []
    for nu in (0.475, 0.499):
        u, _ = solve_inner(element, nodes, cells, nodes * [0, 0, -0.01], fixed, Material(nu=nu))
        answers.append(forces_of(element, nodes, cells, u, Material(nu=nu))[nodes[:, 2] > 1 - 1e-9, 2].sum())
    # a bonded unit cube is stiffened by incompressibility by a few per cent only (its sides are free)
    assert answers[1] / answers[0] == pytest.approx(1.0, abs=0.12)


def test_both_factorisations_agree(element):
    nodes, cells, _ = distorted_block(element, 3)
    material, fixed = Material(nu=0.475), np.flatnonzero(nodes[:, 2] < 1e-9)
    values, pattern = matrix_of(element, nodes, cells, np.zeros_like(nodes), material, fixed)
    b = np.random.default_rng(0).normal(size=len(pattern.indptr) - 1)
    answers = []
    for solver in (symmetric_solver(pattern.indptr, pattern.indices), SuperLU(pattern.indptr, pattern.indices)):
        solver.factorise(values)
        answers.append(solver.solve(b))
    # PARDISO's factors are single precision: 1e-7 times a condition number of about 1e3
    assert np.linalg.norm(answers[0] - answers[1]) < 1e-4 * np.linalg.norm(answers[1])


def test_a_batch_holds_elements_side_by_side_and_is_filled_up_with_the_last():
    for count in (1, 3, 4, 5, 8):
        values = np.arange(count * 6).reshape(count, 2, 3)
        found = batched(values, 4)
        assert found.shape == (-(-count // 4), 2, 3, 4)
        for place in range(found.shape[0] * 4):
            np.testing.assert_array_equal(found[place // 4, ..., place % 4], values[min(place, count - 1)])
