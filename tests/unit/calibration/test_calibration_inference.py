"""The inference on a smooth force law: exact inversions, recovery, resuming, scores."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import brentq

from gelforge.calibration import summary
from gelforge.calibration.emulator import curve_table, friction_axis, friction_of, friction_table, sheared_table
from gelforge.calibration.kernel import sideways_left
from gelforge.calibration.parameters import FrictionPrior, Model, Prior, prior_of
from gelforge.calibration.readings import bisection_order, choose_presses
from gelforge.calibration.sampling import TAIL, Rules, independent_draws, sample
from gelforge.flow.params.schema import Place, parse
from gelforge.flow.params.tables import PRIOR_KEYS, PriorTable
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

RULES = Rules(taus=50, max_steps=40000, seed=5)
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


def dragged(travel: float, mu: float) -> float:
    """Sideways over normal force of a made-up contact that obeys Coulomb's law: proportional when both are scaled."""
    return mu * np.tanh(1.5 * travel / mu)


@pytest.mark.parametrize("mu", [0.4, 0.8, 3.0])
def test_a_frame_that_yields_sideways_takes_its_part_of_the_travel(mu):
    """The force is that of the travel which is left, found from friction alone; at 0 nothing changes."""
    travel, compliance = 0.3, 0.01
    nodes = friction_of(np.linspace(0.0, 1.0, 33)[1:-1])
    curves = [law_curve(0.0, ratio=dragged(travel, one)) for one in nodes]
    table = friction_table(nodes, [curve_table(curve, TOP) for curve in curves])[None]
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
def test_shear_between_solved_depths_is_exact_where_nothing_slips(exponent):
    """Whether sideways over normal force is constant, or falls as 1 / depth as under a punch."""
    alone = friction_table([np.inf], [curve_table(law_curve(np.inf), TOP)])
    grid, solved = np.linspace(0.0, TOP, alone.shape[1]), np.array([TOP, 1.2])
    press = alone[-1, :, 2]
    normal = np.interp(solved, grid, press)
    stuck = np.stack([-0.3 * solved**exponent * normal, 0.1 * normal, 0.9 * normal], axis=1)
    table = sheared_table(alone, TOP, [np.inf], stuck[:1], solved, stuck)[-1]
    inside = (grid > 1.21) & (grid < TOP - 0.01)
    np.testing.assert_allclose(table[inside, 0], -0.3 * grid[inside] ** exponent * press[inside], rtol=1e-10)
    np.testing.assert_allclose(table[inside, 1:], press[inside, None] * [0.1, 0.9], rtol=1e-10)


def test_shear_of_a_contact_that_slips_follows_from_one_depth():
    """Of a contact that obeys Coulomb's law, between friction nodes and at depths that were solved without slip alone."""
    nodes, travel = np.array([0.0, 0.2, 0.5, np.inf]), 0.3
    alone = friction_table(nodes, [curve_table(law_curve(mu), TOP) for mu in nodes])
    grid, solved = np.linspace(0.0, TOP, alone.shape[1]), np.array([TOP, 1.2])

    def dragged(mu, depth):
        return 1.5 * travel / depth if np.isinf(mu) else mu * np.tanh(1.5 * travel / depth / max(mu, 1e-9))

    def after(mu, depth):
        return normal_force(depth, mu) * np.array([-dragged(mu, depth), 0.0, 1.0])

    table = sheared_table(
        alone, TOP, nodes, [after(mu, TOP) for mu in nodes], solved, [after(np.inf, depth) for depth in solved]
    )
    for mu in (0.3, 0.5, 1.0, 2.0):
        of_mu = np.stack(
            [np.interp(friction_axis(mu), np.linspace(0, 1, 33), one) for one in table.reshape(33, -1).T]
        )
        for depth in (1.3, 1.6, 2.0):
            found = of_mu.reshape(-1, 3)[np.argmin(np.abs(grid - depth))]
            # a hundredth of the normal force, as between the nodes of a cubic
            assert found[0] / found[2] == pytest.approx(-dragged(mu, depth), rel=0.025)


@pytest.mark.slow
@pytest.mark.parametrize("tare", [0.0, -1.5])
def test_truth_is_recovered_where_data_are_rich(tare):
    """A sensor that was not tared hides nothing: C10 is as narrow as with a tared one."""
    rng, stiffness = np.random.default_rng(2), list(np.repeat([2.0, 4, 8, 20], 10))
    posterior = law_posterior(rng, np.tile(DEPTH, 4), stiffness=stiffness, tare_z=tare)
    values = posterior.model.values(sample(posterior, RULES).flat())
    for name, truth in (("c10", 0.085), ("tare_z", tare), ("offset", 0.03), ("compliance", 0.006)):
        assert abs(values[name].mean() - truth) < 3 * values[name].std()
    assert values["c10"].std() < 0.1 * 0.3 * 0.08 * 2  # a small part of the prior's width
    assert values["tare_z"].std() < 0.02


def test_independent_draws_have_the_density_they_are_accepted_by():
    """The ratio is the multivariate t's of scipy, and draws have the spread of the past, 5 / 3 in variance."""
    rng = np.random.default_rng(8)
    past = rng.standard_normal((12800, 3)) @ np.array([[1.0, 0.8, 0.0], [0.0, 0.5, 0.2], [0.0, 0.0, 2.0]]) + 3.0
    propose = independent_draws(past)
    old = past[:32]
    new, ratio = propose(old, np.random.RandomState(1))
    law = stats.multivariate_t(past.mean(axis=0), np.cov(past, rowvar=False), df=TAIL)
    np.testing.assert_allclose(ratio, law.logpdf(old) - law.logpdf(new), rtol=1e-6, atol=1e-8)
    many, _ = propose(np.zeros((200_000, 3)), np.random.RandomState(2))
    # the sixth moment of t5 does not exist, so its sample covariance settles slowly: 5 %
    np.testing.assert_allclose(np.cov(many, rowvar=False), 5 / 3 * np.cov(past, rowvar=False), rtol=0.05, atol=0.05)


@dataclass(frozen=True)
class Skewed:
    """Log-probability of independent exponential laws: no moves fitted to it can have its shape."""

    model: Model

    def __call__(self, x):
        outside = np.abs(np.minimum(x, 0.0)).sum(axis=1)  # uphill back to where the law is
        return np.where(outside == 0.0, -x.sum(axis=1), -1e9 * (1.0 + outside))


@pytest.mark.slow
def test_chain_has_the_moments_of_a_law_that_its_moves_do_not_fit():
    """Mean, deviation and 95 % quantile of an exponential law, within four of their standard errors."""
    start = Prior("normal", stats.norm())
    model = Model("no_slip", dict.fromkeys("ab", start), {})
    draws = sample(Skewed(model), replace(RULES, taus=400)).flat()
    # at least 400 independent draws of each of 6 walkers: the standard errors are 0.02, 0.03 and 0.09
    np.testing.assert_allclose(draws.mean(axis=0), 1.0, atol=0.08)
    np.testing.assert_allclose(draws.std(axis=0), 1.0, atol=0.12)
    np.testing.assert_allclose(np.quantile(draws, 0.95, axis=0), np.log(20.0), atol=0.36)


@pytest.mark.slow
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


@pytest.mark.slow
def test_laws_are_compared_by_what_they_predict_of_readings_left_out():
    """Without sideways forces no law is ruled out; a law whose forces are a tenth off at one indenter is."""
    posterior = law_posterior(np.random.default_rng(7), np.tile(DEPTH, 4), stiffness=[4.0] * 20 + [20.0] * 20)
    chain = sample(posterior, RULES)
    table = posterior.emulator.table * np.where(np.arange(40) < 20, 1.0, 1.1)[:, None, None, None]
    wrong = replace(posterior, emulator=replace(posterior.emulator, table=table))
    entries = summary.compare([(wrong, sample(wrong, RULES)), (posterior, chain), (posterior, chain)])
    assert [entry["indistinguishable"] for entry in entries] == [True, True, False]
    assert entries[0]["behind"] == entries[1]["behind"] == 0.0 and entries[2]["behind"] > 0.0
    terms, _ = summary.score(posterior, chain)
    # what is left out costs: each reading has less density than at the parameters that suit it best, a few units in all per parameter
    at_best = posterior.pointwise(chain.flat(4000)).max(axis=0).sum()
    assert at_best - 6 * len(posterior.model.free) < terms.sum() < at_best


@pytest.mark.slow
def test_a_chain_is_the_same_again():
    posterior = law_posterior(np.random.default_rng(3), DEPTH, law="no_slip")
    one, two = (sample(posterior, replace(RULES, taus=5)).coordinates for _ in range(2))
    np.testing.assert_array_equal(one, two)


NUMBERS = {"mean": 1.0, "median": 0.5, "spread": 0.4, "low": 1.0, "high": 3.0}


@pytest.mark.parametrize("kind", PRIOR_KEYS)
def test_coordinates_of_a_prior_are_standard_normal(kind):
    """And those of a friction coefficient have the density, over the friction axis, that its quantiles say."""
    table = parse(PriorTable, {"kind": kind} | {key: NUMBERS[key] for key in PRIOR_KEYS[kind]}, Place("a test"))
    prior = prior_of(table)
    z = np.linspace(-4.0, 4.0, 81)
    np.testing.assert_allclose(prior.law.cdf(prior.value(z)), stats.norm.cdf(z), atol=1e-6)
    draws = prior.value(prior.quantile(np.random.default_rng(9).random(20000)))
    assert stats.kstest(draws, prior.law.cdf).pvalue > 1e-3
    if kind in ("normal", "cauchy"):  # no priors of what is above 0
        return
    friction = prior_of(table, FrictionPrior)
    x = np.linspace(1e-4, 1 - 1e-4, 20001)
    density = np.exp(friction.log_density(x))
    total = np.cumsum(density) / density.sum()
    for u in (0.1, 0.5, 0.9):
        assert friction.law.cdf(friction_of(np.interp(u, total, x))) == pytest.approx(u, abs=2e-3)  # rectangles
    draws = friction.value(friction.quantile(np.random.default_rng(9).random(20000)))
    assert stats.kstest(draws, prior.law.cdf).pvalue > 1e-3


def test_chosen_presses_span_indenters_and_depths():
    readings = make_readings(np.linspace(0.1, 2.0, 20), -np.linspace(1, 20, 20))
    readings.indenters[10:] = "cuboid_10"
    chosen = choose_presses(readings, 6)
    assert {0, 9, 10, 19} <= set(chosen.tolist())
    assert sorted(bisection_order(9)) == list(range(9))
    assert len(choose_presses(readings, 99)) == 20
