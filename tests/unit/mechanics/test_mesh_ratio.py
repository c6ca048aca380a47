"""How forces of two meshes differ: the factors give the finer ones back, and there is none where no force was solved."""

import numpy as np
import pytest

from gelforge.mechanics.mesh.meshratio import LEAST_ASIDE, mesh_ratios


def pressed(count: int) -> np.ndarray:
    """Forces (count, 3) N of presses that are dragged in any direction."""
    rng = np.random.default_rng(count)
    return np.column_stack([rng.uniform(-3, 3, (count, 2)), -rng.uniform(1, 20, count)])


def test_the_factors_give_normal_and_sideways_force_of_the_finer_mesh():
    fine, coarse = pressed(50), pressed(51)[:50]
    reported = mesh_ratios(fine, coarse) * coarse
    assert reported[:, 2] == pytest.approx(fine[:, 2])
    assert np.hypot(*reported[:, :2].T) == pytest.approx(np.hypot(*fine[:, :2].T))


def test_hardly_any_sideways_force_takes_the_factor_of_the_normal_one():
    coarse = np.array([[0.5 * LEAST_ASIDE, 0.0, -1.0]])
    assert mesh_ratios(np.array([[1.0, 0.0, -2.0]]), coarse).tolist() == [[2.0, 2.0, 2.0]]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("coarse", [(0.0, 0.0, 0.0), (np.nan, np.nan, np.nan), (0.0, 0.0, 0.1)])
def test_what_presses_on_nothing_gives_no_factor(coarse):
    assert np.isnan(mesh_ratios(np.array([[0.0, 0.0, -2.0]]), np.array([coarse]))).all()
