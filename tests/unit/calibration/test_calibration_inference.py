"""The inference on a smooth force law: exact inversions, recovery, resuming, scores."""

import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import multivariate_t

from gelforge.calibration import sampling, scores, summary
from gelforge.calibration.emulator import curve_table, friction_table, sheared_table
from gelforge.calibration.floor import least_error
from gelforge.calibration.friction import friction_of
from gelforge.calibration.kernel import sideways_left
from gelforge.calibration.moves import TAIL, independent_draws
from gelforge.calibration.parameters import FrictionPrior, Model, Prior
from gelforge.calibration.posterior import LeaveOneOut
from gelforge.calibration.readings import bisection_order, choose_presses
from gelforge.calibration.sampling import Rules, sample, split_rhat
from gelforge.mechanics.material import REFERENCE_C10
from tests.support.calibration_law import (
    TOP,
    law_curve,
    law_emulator,
    law_posterior,
    make_readings,
    normal_force,
    true_values,
)

RULES = Rules(walkers=32, seed=5, taus=50, acceptance=(0.15, 0.6), rhat=1.01, max_steps=40000)
DEPTH = np.linspace(0.4, 2.0, 10)


def test_table_follows_the_curve_between_its_points():
    grid = np.linspace(0.0, TOP, 161)
    error = np.abs(curve_table(law_curve(0.4), TOP)[:, 2] - normal_force(grid, 0.4))
    assert error.max() < 3e-3 * np.abs(normal_force(TOP, 0.4))  # monotone cubic through 14 points


def test_compliance_is_inverted_exactly():
    """Effective depth plus what the frame gives way is the commanded depth plus the offset."""
    values = true_values(compliance=0.02)
    forces, slopes, depth = law_emulator().forces([1.5], values)
    assert depth[0, 0] == pytest.approx(1.5 + 0.03 - 0.02 * abs(forces[0, 0, 2]), abs=1e-12)
    ahead = law_emulator().forces([1.5 + 1e-5], values)[0]
    assert slopes[0, 0, 2] == pytest.approx((ahead - forces)[0, 0, 2] / 1e-5, rel=1e-6)


def test_force_is_proportional_to_c10_without_compliance():
    one = law_emulator().forces([1.0], true_values(c10=REFERENCE_C10, compliance=0.0))[0]
    two = law_emulator().forces([1.0], true_values(c10=2 * REFERENCE_C10, compliance=0.0))[0]
    np.testing.assert_allclose(two, 2 * one, rtol=1e-12)


def test_poisson_s_ratio_is_interpolated_between_its_nodes():
    one = law_emulator()
    three = replace(
        one, table=np.concatenate([one.table, 1.2 * one.table, 1.4 * one.table], 1), nu=np.array([0.45, 0.47, 0.49])
    )
    for nu, factor in ((0.45, 1.0), (0.465, 1.15), (0.48, 1.3), (0.49, 1.4)):
        values = true_values(nu=nu, compliance=0.0)
        np.testing.assert_allclose(three.forces([1.0], values)[0], factor * one.forces([1.0], values)[0], rtol=1e-9)


def dragged(travel: float, mu: float) -> float:
    """Sideways over normal force of a made-up contact that obeys Coulomb's law: proportional when both are scaled."""
    return mu * np.tanh(1.5 * travel / mu)


@pytest.mark.parametrize("mu", [0.4, 0.8, 3.0])
def test_a_frame_that_yields_sideways_takes_its_part_of_the_travel(mu):
    """The force is that of the travel which is left, found from friction alone; at 0 nothing changes."""
    travel, compliance = 0.3, 0.01
    nodes = friction_of(np.linspace(0.0, 1.0, 33)[1:-1])
    curves = [law_curve(0.0, ratio=dragged(travel, one)) for one in nodes]
    table = friction_table(nodes, [curve_table(curve, TOP) for curve in curves])[None, None]
    emulator = replace(law_emulator(), table=table, travel=np.array([travel]))
    values = {"c10": REFERENCE_C10, "offset": 0.0, "compliance": 0.0, "mu": mu}
    whole = emulator.forces([1.6], true_values(**values))[0][0, 0]
    found = emulator.forces([1.6], true_values(**values, shear_compliance=compliance))[0][0, 0]
    left = brentq(lambda way: way + compliance * abs(whole[2]) * dragged(way, mu) - travel, 0.0, travel)
    assert found[2] == whole[2]
    assert found[0] / found[2] == pytest.approx(dragged(left, mu), rel=0.004)
    assert abs(found[0]) < abs(whole[0])


@pytest.mark.parametrize("exponent", [0.0, 0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("yielded", [0.0, 0.01, 0.3, 0.9, 5.0])
def test_what_is_left_of_a_sideways_force_meets_its_equation(yielded, exponent):
    """Way of the frame and way that is left make up the travel; a force that takes all of it is cut, never wrong."""
    left = sideways_left(yielded, exponent)
    assert 0.0 < left <= 1.0
    if yielded < 0.5 or (yielded < 1.0 and exponent >= 0.5):
        way = left ** (1.0 / exponent) if exponent > 0 else 1.0 - yielded
        assert way + yielded * left == pytest.approx(1.0, abs=0.01)


def test_no_force_above_the_gel():
    assert not law_emulator().forces([0.01], true_values(offset=-0.02))[0].any()


@pytest.mark.parametrize("exponent", [0.0, -1.0])
def test_shear_between_solved_depths_is_exact_in_both_limits(exponent):
    """Full slip (shear over normal force constant) and full stick of a punch (falls as 1 / depth)."""
    press = curve_table(law_curve(0.4), TOP)
    grid = np.linspace(0.0, TOP, len(press))
    solved = np.array([2.2, 1.2])
    normal = np.interp(solved, grid, press[:, 2])
    table = sheared_table(
        press, TOP, solved, np.stack([-0.3 * solved**exponent * normal, 0 * solved, normal], axis=1)
    )
    inside = (grid > 1.21) & (grid < 2.19)
    np.testing.assert_allclose(table[inside, 0], -0.3 * grid[inside] ** exponent * press[inside, 2], rtol=1e-10)


def test_truth_is_recovered_where_data_are_rich():
    posterior = law_posterior(
        np.random.default_rng(2), np.tile(DEPTH, 4), stiffness=list(np.repeat([2.0, 4, 8, 20], 10))
    )
    chain = sample(posterior, RULES)
    c10 = posterior.model.values(chain.flat())["c10"]
    assert abs(c10.mean() - 0.085) < 3 * c10.std()
    assert c10.std() < 0.1 * 0.3 * 0.08 * 2  # a small part of the prior's width


def test_independent_draws_have_the_density_they_are_accepted_by():
    """The ratio is the multivariate t's of scipy, and draws have the spread of the past, 5 / 3 in variance."""
    rng = np.random.default_rng(8)
    past = rng.standard_normal((400, 32, 3)) @ np.array([[1.0, 0.8, 0.0], [0.0, 0.5, 0.2], [0.0, 0.0, 2.0]]) + 3.0
    propose = independent_draws(past)
    old = past[0]
    new, ratio = propose(old, np.random.RandomState(1))
    flat = past.reshape(-1, 3)
    law = multivariate_t(flat.mean(axis=0), np.cov(flat, rowvar=False), df=TAIL)
    np.testing.assert_allclose(ratio, law.logpdf(old) - law.logpdf(new), rtol=1e-6, atol=1e-8)
    many, _ = propose(np.zeros((200_000, 3)), np.random.RandomState(2))
    # the sixth moment of t5 does not exist, so its sample covariance settles slowly: 5 %
    np.testing.assert_allclose(np.cov(many, rowvar=False), 5 / 3 * np.cov(flat, rowvar=False), rtol=0.05, atol=0.05)


@dataclass(frozen=True)
class Skewed:
    """Log-probability of independent exponential laws: no moves fitted to it can have its shape."""

    model: Model

    @property
    def identity(self):
        return ["skewed"]

    def __call__(self, x):
        return np.where((x > 0).all(axis=1), -x.sum(axis=1), -np.inf)


def test_chain_has_the_moments_of_a_law_that_its_moves_do_not_fit():
    """Mean, deviation and 95 % quantile of an exponential law, within three of their standard errors or so."""
    start = Prior("uniform", 0.0, 3.0)
    model = Model("no_slip", {"c10": start, "offset": start}, {})
    draws = sample(Skewed(model), replace(RULES, taus=400)).flat()
    # at least 400 times 32 independent draws: the mean's standard error is 0.009, the quantile's 0.04
    np.testing.assert_allclose(draws.mean(axis=0), 1.0, atol=0.03)
    np.testing.assert_allclose(draws.std(axis=0), 1.0, atol=0.05)
    np.testing.assert_allclose(np.quantile(draws, 0.95, axis=0), np.log(20.0), atol=0.12)


def test_least_error_is_zero_without_noise_and_that_of_the_kink_with_one():
    exact = law_posterior(np.random.default_rng(0), DEPTH, noise=0.0)
    found = least_error(exact)
    assert found.error < 2e-3  # on forces up to 13 N; a simplex in four dimensions gets no nearer
    assert found.values["c10"] == pytest.approx(0.085, rel=0.05)
    four = law_posterior(np.random.default_rng(0), [0.5, 1.0, 1.5, 2.0], law="no_slip", noise=0.0, mu=np.inf)
    kinked = four.observed.copy()
    kinked[1, 2] += 0.5  # three parameters meet three of four readings, and missing this one costs the least
    floor = least_error(replace(four, observed=kinked))
    np.testing.assert_allclose(floor.residual, [0.0, -0.5, 0.0, 0.0], atol=1e-3)
    assert floor.error == pytest.approx(0.125, abs=1e-3)


def test_own_touch_explains_a_press_off_in_depth():
    """A press commanded 8 um deeper than it went: the mean of its own touch is nearer than that of a press repeated."""
    posterior = law_posterior(np.random.default_rng(3), DEPTH, noise=0.002)
    slope = np.abs(posterior.emulator.forces(DEPTH, true_values())[1][0, 6, 2])
    observed = posterior.observed.copy()
    observed[6, 2] -= 0.008 * slope
    posterior = replace(posterior, observed=observed)
    chain = sample(posterior, RULES)
    mean, _ = summary.predictions(chain, posterior)
    own = summary.own_forces(chain, posterior)
    away, left = (abs(m[6, 2] - observed[6, 2]) for m in (mean, own))
    assert away > 0.002 * slope and left < 0.6 * away


def test_resumed_chain_is_the_uninterrupted_one(tmp_path):
    posterior = law_posterior(np.random.default_rng(3), DEPTH)
    whole = sample(posterior, RULES, tmp_path / "whole.npz")
    lengths = []

    def stop(figures):
        lengths.append(figures.steps)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sample(posterior, RULES, tmp_path / "part.npz", stop)
    resumed = sample(posterior, RULES, tmp_path / "part.npz")
    assert lengths[0] < whole.figures.steps
    np.testing.assert_array_equal(resumed.coordinates, whole.coordinates)


def test_chain_of_another_problem_or_corrupt_is_not_resumed(tmp_path):
    path = tmp_path / "chain.npz"
    posterior = law_posterior(np.random.default_rng(3), DEPTH)
    sample(posterior, RULES, path)
    problem = sampling.problem_of(posterior, RULES)
    assert sampling.load_checkpoint(path, problem) is not None
    other = replace(posterior, tail=5.0)
    assert sampling.load_checkpoint(path, sampling.problem_of(other, RULES)) is None
    shutil.copy(path, tmp_path / "cut.npz")
    with open(tmp_path / "cut.npz", "r+b") as file:
        file.truncate(1000)
    assert sampling.load_checkpoint(tmp_path / "cut.npz", problem) is None


def test_a_chain_whatever_happened_to_its_bytes_is_read_or_begun_anew(tmp_path):
    """A bit of its table of contents makes it a compressed or an encrypted one, which numpy says in errors of its own."""
    path = tmp_path / "chain.npz"
    state = np.random.RandomState(1).get_state()
    sampling.save_checkpoint(path, "this", np.zeros((3, 2, 1)), np.zeros((3, 2)), np.zeros(2), state)
    whole = path.read_bytes()
    for at in range(len(whole) - 500, len(whole)):
        for bit in range(8):
            corrupt = bytearray(whole)
            corrupt[at] ^= 1 << bit
            path.write_bytes(corrupt)
            sampling.load_checkpoint(path, "this")
    np.save(tmp_path / "chain.npy", np.zeros(3))
    (tmp_path / "chain.npy").replace(path)
    assert sampling.load_checkpoint(path, "this") is None


def test_split_rhat_sees_a_shifted_walker():
    rng = np.random.default_rng(4)
    chains = rng.standard_normal((2000, 8, 2))
    assert split_rhat(chains).max() < 1.01
    chains[:, 0, 1] += 1.0
    assert split_rhat(chains)[1] > 1.03


def conjugate(rng, n=12):
    """Draws and exact leave-one-out densities of a normal mean with known deviation 1 and prior deviation 10."""
    y = rng.standard_normal(n)
    exact = []
    for i in range(n):
        rest = np.delete(y, i)
        variance = 1 / (len(rest) + 0.01)
        mean, spread = variance * rest.sum(), np.sqrt(variance + 1)
        exact.append(-0.5 * ((y[i] - mean) / spread) ** 2 - np.log(spread * np.sqrt(2 * np.pi)))
    variance = 1 / (n + 0.01)
    draws = variance * y.sum() + np.sqrt(variance) * rng.standard_normal(20000)
    return y, draws, np.sum(exact)


def test_psis_loo_matches_a_conjugate_model():
    y, draws, exact = conjugate(np.random.default_rng(6))
    pointwise = -0.5 * (y - draws[:, None]) ** 2 - 0.5 * np.log(2 * np.pi)
    score = scores.loo(pointwise)
    assert score.reliable
    assert score.elpd == pytest.approx(exact, abs=0.02)  # Monte Carlo error of 20 000 draws


def test_mixture_loo_matches_psis_on_the_law():
    posterior = law_posterior(np.random.default_rng(7), np.tile(DEPTH, 2), stiffness=[4.0] * 10 + [20.0] * 10)
    plain = scores.loo(posterior.pointwise(sample(posterior, RULES).flat(8000)))
    mixture = LeaveOneOut(posterior.emulator, posterior.model, posterior.depth, posterior.observed, posterior.tail)
    robust = scores.loo_from_mixture(posterior.pointwise(sample(mixture, RULES).flat(16000)))
    assert robust.elpd == pytest.approx(plain.elpd, abs=0.5)  # both estimate the same sum; Monte Carlo error of each


def test_pareto_fit_finds_the_shape():
    rng = np.random.default_rng(8)
    for shape in (-0.3, 0.3, 0.8):
        x = np.sort(((1 - rng.random(4000)) ** -shape - 1) / shape)
        assert scores.fit_pareto(x)[0] == pytest.approx(shape, abs=3.5 * (1 + shape) / 4000**0.5)


@pytest.mark.parametrize("times", [2, 3])
def test_draws_that_a_chain_repeats_leave_the_shape_of_the_weights(times):
    """A rejected step repeats a draw. One that stood on both sides of the tail's cut once made any weights look safe."""
    ratio = 0.9 * np.random.default_rng(0).exponential(size=2000)  # weights of a Pareto law, whose shape is 0.9
    _, once = scores.smooth_weights(ratio)
    _, repeated = scores.smooth_weights(np.repeat(ratio, times))
    assert once > 0.7  # so that importance sampling is not relied on
    assert repeated == pytest.approx(once, abs=0.3)  # the tails hold 134 draws, 95 and 77 different ones


def test_priors_draw_what_their_density_says():
    rng = np.random.default_rng(9)
    for prior in (
        Prior("normal", 1.0, 2.0),
        Prior("lognormal", 0.5, 0.4),
        Prior("halfnormal", 0, 0.3),
        Prior("uniform", 1, 3),
    ):
        draws = prior.draw(rng, 20000)
        assert np.isfinite(prior.log_density(draws)).all()
        assert prior.value(np.median(draws)) == pytest.approx(float(prior.value(prior.quantile(0.5))), rel=0.03)
    assert Prior("halfnormal", 0, 0.3).log_density(-1e-9) == -np.inf


@pytest.mark.parametrize(
    ("kind", "a", "b"), [("lognormal", 0.6, 0.6), ("uniform", 0.1, 2.0), ("halfnormal", 0.0, 0.5)]
)
def test_friction_prior_keeps_its_density_on_its_axis(kind, a, b):
    """Its density integrates, over any interval, to what its quantiles say."""
    prior = FrictionPrior(kind, a, b)
    x = np.linspace(1e-6, 1 - 1e-6, 200001)
    density = np.exp(prior.log_density(x))
    total = np.cumsum(density) / density.sum()
    for u in (0.1, 0.5, 0.9):
        assert np.interp(prior.quantile(u), x, total) == pytest.approx(u, abs=2e-3)  # rectangles


def test_chosen_presses_span_indenters_and_depths():
    readings = make_readings(np.linspace(0.1, 2.0, 20), -np.linspace(1, 20, 20))
    readings.indenters[10:] = "cuboid_10"
    chosen = choose_presses(readings, 6)
    assert {0, 9, 10, 19} <= set(chosen.tolist())
    assert sorted(bisection_order(9)) == list(range(9))
    assert len(choose_presses(readings, 99)) == 20


def test_model_values_hold_fixed_ones():
    model = Model("coulomb", {"c10": Prior("lognormal", 0.08, 0.3)}, {"mu": 0.4})
    values = model.values(np.log([[0.07], [0.09]]))
    np.testing.assert_allclose(values["c10"], [0.07, 0.09])
    np.testing.assert_allclose(values["mu"], [0.4, 0.4])
