"""What a chain is summed up to, against the same numbers by numpy, emcee and arviz."""

from dataclasses import replace
from types import SimpleNamespace

import emcee
import numpy as np
import pytest
from arviz_stats.base import array_stats

from gelforge.calibration import summary
from gelforge.calibration.sampling import Chain, Figures, judge
from gelforge.calibration.solves import make_plan
from gelforge.geometry.gel import USUAL_GEL
from tests.support.calibration_law import law_posterior, make_readings

DEPTH = np.linspace(0.4, 2.0, 6)


def autoregressive(steps: int, walkers: int, memory: float, start: float, rng) -> np.ndarray:
    """A chain (steps, walkers, 2) of deviation 1 that begins at `start` and forgets by a factor e in `memory` steps."""
    keep = np.exp(-1.0 / memory)
    found = np.empty((steps, walkers, 2))
    at = np.full((walkers, 2), start)
    for step in range(steps):
        at = keep * at + np.sqrt(1.0 - keep**2) * rng.standard_normal((walkers, 2))
        found[step] = at
    return found


def judged(chain: np.ndarray) -> Figures:
    """Figures of a sampler that holds a chain."""
    held = SimpleNamespace(
        iteration=len(chain), acceptance_fraction=np.full(chain.shape[1], 0.4),
        get_autocorr_time=lambda tol: emcee.autocorr.integrated_time(chain, tol=tol), get_chain=lambda discard=0: chain[discard:],
    )  # fmt: skip
    return judge(held, ("a", "b"))


def test_where_a_chain_began_is_forgotten_in_its_draws():
    """A hundred deviations off at first: one autocorrelation time leaves tens of them, ten times leave none."""
    rng = np.random.default_rng(1)
    chain = autoregressive(4000, 40, 10.0, 100.0, rng)
    figures = judged(chain)
    assert 0 < figures.burn < 2000
    first = Chain(chain, figures).flat()[:40].mean(axis=0)
    assert np.abs(first).max() < 5.0 / np.sqrt(40)  # five standard errors of 40 walkers
    # a chain too short for that gives up half of it, never all
    assert judged(autoregressive(60, 40, 10.0, 100.0, rng)).burn == 30


def test_figures_of_a_chain_are_those_of_emcee_and_arviz():
    rng = np.random.default_rng(2)
    chain = autoregressive(1500, 12, 4.0, 0.0, rng)
    chain[:, 5, 1] += 0.7  # one walker keeps to itself along the second parameter
    figures = judged(chain)
    times = emcee.autocorr.integrated_time(chain, tol=0)
    assert figures.tau == pytest.approx(times.max())
    kept = chain[figures.burn :]
    assert figures.taus == pytest.approx(len(kept) / times.max())
    expected = array_stats.rhat(kept.transpose(2, 1, 0))  # by parameter; walkers are chains
    assert (
        figures.worst == "b" and figures.rhat == pytest.approx(expected.max()) and expected.max() > 1.02 > expected[0]
    )


@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_walker_that_never_moves_is_no_converged_chain():
    still = np.zeros((200, 4, 2))
    figures = judged(still)
    assert figures.rhat == np.inf and figures.taus == 0.0 and len(Chain(still, figures).flat()) == 0


@pytest.fixture(scope="module")
def known():
    """A posterior of six presses, and a chain whose draws are known: half as wide as the priors, after a burn-in."""
    posterior = law_posterior(np.random.default_rng(3), DEPTH, law="no_slip")
    size, rng = len(posterior.model.free), np.random.default_rng(4)
    burnt, draws = np.full((50, 4, size), 7.0), 0.5 * rng.standard_normal((1000, 4, size))
    draws[..., 1] = 0.8 * draws[..., 0] + 0.6 * draws[..., 1]
    return posterior, Chain(np.concatenate([burnt, draws]), Figures(1050, 50, 1.0, 1000.0, 0.4, 1.0, "c10"))


def test_every_parameter_is_summed_up_as_numpy_sorts_its_draws(known):
    posterior, chain = known
    flat = chain.coordinates[50:].reshape(-1, chain.coordinates.shape[-1])
    table = summary.parameter_table(chain, posterior.model)
    for at, (name, prior) in enumerate(posterior.model.free.items()):
        values = np.sort(prior.value(flat[:, at]))
        found = table[name]
        assert found["median"] == pytest.approx(values[len(values) // 2], rel=2e-3, abs=1e-4)
        for key, share in (("interval68", 0.16), ("interval95", 0.025)):
            low, high = (values[int(part * len(values))] for part in (share, 1.0 - share))
            assert found[key] == pytest.approx([low, high], rel=5e-3, abs=1e-3)
        # 4000 draws know a quantile to 2 %; 0.16 and 0.84 lie 0.994 deviations out
        assert found["width_over_prior"] == pytest.approx(0.5 * 0.994, rel=0.06)
        draws = prior.value(np.random.default_rng(5).standard_normal(200_000))
        assert found["prior_interval95"] == pytest.approx(np.quantile(draws, [0.025, 0.975]), rel=0.03, abs=0.01)
    matrix = np.array(summary.correlations(chain, posterior.model)["matrix"])
    np.testing.assert_allclose(matrix, np.corrcoef(flat.T), atol=1e-4)
    assert matrix[0, 1] == pytest.approx(0.8, abs=0.05)


def test_a_repeated_press_is_spread_as_draws_of_it_are(known):
    """What draws of the parameters and then of a reading scatter by; either alone would say less."""
    posterior, wide = known
    chain = replace(wide, coordinates=0.2 * wide.coordinates)
    mean, spread = summary.predictions(chain, posterior)
    forces, scale = posterior.predict(chain.flat())
    rng = np.random.default_rng(6)
    repeated = np.concatenate([forces + scale * rng.standard_normal(forces.shape) for _ in range(30)])[..., 2]
    np.testing.assert_allclose(mean[:, 2], repeated.mean(axis=0), rtol=0.02)
    np.testing.assert_allclose(spread[:, 2], repeated.std(axis=0), rtol=0.03)
    alone = np.sqrt((scale[..., 2] ** 2).mean(axis=0)), forces[..., 2].std(axis=0)
    assert (spread[:, 2] > 1.02 * np.maximum(*alone)).all()


def test_a_reading_is_an_outlier_on_either_side():
    """Too strong or too weak by more than the threshold, the worst first; what is not read is none."""
    readings, mean, scale = make_readings(DEPTH, np.zeros(6)), np.zeros((6, 3)), np.full((6, 3), 0.5)
    observed = np.full((6, 3), np.nan)
    observed[:, 2] = [0.1, -3.0, 2.5, 1.4, -1.4, 0.0]  # 0.2, -6, 5, 2.8, -2.8, 0 scales
    observed[3, 0] = -4.0
    found = summary.find_outliers(readings, mean, scale, observed, 3.0)
    assert [(one["sample_id"], one["component"], one["scales_away"]) for one in found] == [
        ("p003", "x", -8.0), ("p001", "z", -6.0), ("p002", "z", 5.0),
    ]  # fmt: skip
    assert [one["measured_n"] for one in found] == [-4.0, -3.0, 2.5] and {one["predicted_n"] for one in found} == {
        0.0
    }
    assert len(summary.find_outliers(readings, mean, scale, observed, 2.0)) == 5
    assert summary.predictive_error(mean, observed) == pytest.approx({"fx": 4.0, "fz": 8.4 / 6})


def test_presses_share_a_curve_where_the_gel_meets_them_alike():
    """One place, height, turn, tilt, indenter and gel; another one of these has a curve of its own."""
    readings = make_readings([0.5, 1.0, 0.7, 0.8, 0.9, 0.6, 0.4, 0.3], np.full(8, -1.0))
    readings.pose[2, 2] = -0.15  # begins lower
    readings.pose[3, 6] = 30.0  # is turned
    readings.pose[4, 2] = 4e-5  # within the play of an axis
    readings.pose[7, 8] = 2.0  # is tilted
    gels, bodies = (
        [USUAL_GEL] * 5 + [f"{USUAL_GEL}-3.6mm"] + [USUAL_GEL] * 2,
        ["sphere_15"] * 6 + ["sphere_10", "sphere_15"],
    )
    readings = replace(readings, gels=np.array(gels), indenters=np.array(bodies))
    plan = make_plan(readings, 0.1, "no_slip", [0.5], 0.475)
    assert plan.leader.tolist() == [1, 1, 2, 3, 1, 5, 6, 7]
    np.testing.assert_allclose(plan.top, [1.1, 1.1, 0.8, 0.9, 1.1, 0.7, 0.5, 0.4])


def test_a_press_slides_whichever_way_it_is_dragged():
    readings = make_readings([0.5, 0.5, 0.5, 0.5], np.full(4, -1.0))
    readings.pose[:, 3:5] = [[0.8, 0.0], [0.0, -0.8], [0.4, 0.4], [0.3, 0.3]]
    np.testing.assert_allclose(readings.travel, [0.8, 0.8, np.hypot(0.4, 0.4), np.hypot(0.3, 0.3)])
    plan = make_plan(readings, 0.1, "coulomb", [0.25, 0.6], 0.475)
    assert [len(nodes) for nodes in plan.nodes] == [3, 3, 3, 2] and plan.slides.tolist() == [True, True, True, False]
