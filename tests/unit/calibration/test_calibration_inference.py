"""The inference on a smooth force law: exact inversions, recovery, resuming, scores."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import brentq

from gelforge.calibration import summary
from gelforge.calibration.emulator import (
    Curve,
    curve_table,
    friction_axis,
    friction_of,
    friction_table,
    sheared_table,
    sticking,
    stuck_share,
)
from gelforge.calibration.kernel import sideways_left
from gelforge.calibration.parameters import BenchModel, FrictionPrior, Prior, make_model, prior_of
from gelforge.calibration.posterior import ERROR, SIDEWAYS_ERROR, SIDEWAYS_ERROR_OF_NORMAL, Posterior, tare_of
from gelforge.calibration.readings import bisection_order, choose_presses, read_readings, slides
from gelforge.calibration.sampling import TAIL, Chain, Figures, Rules, independent_draws, sample
from gelforge.flow.files import read_json
from gelforge.flow.params import read_dataset_file
from gelforge.flow.schema import Place, parse
from gelforge.flow.tables import PRIOR_KEYS, PriorTable
from gelforge.mechanics.material import REFERENCE_C10
from tests.support.calibration_law import (
    PARAMS,
    TOP,
    law_curve,
    law_emulator,
    law_posterior,
    law_session,
    make_readings,
    normal_force,
    true_values,
)

RULES = Rules(taus=50, max_steps=40000, seed=5)
DEPTH = np.linspace(0.4, 2.0, 10)


def test_table_follows_a_power_of_depth_from_the_first_touch_on():
    """One point alone is continued as a ball's."""
    touch = 0.1
    for points, power in ((1, 1.0), (1, 1.5), (2, 1.0), (4, 1.5), (4, 1.9)):
        depth = np.linspace(touch, TOP, points + 1)[1:]
        force = np.zeros((points + 1, 3))
        force[1:, 2] = -4.0 * (depth - touch) ** power
        table = curve_table(Curve(np.append(touch, depth), force), TOP)[:, 2]
        grid = np.linspace(0.0, TOP, len(table))
        assert not table[grid <= touch].any()
        if points > 1 or power == 1.5:
            np.testing.assert_allclose(table[grid > touch], -4.0 * (grid[grid > touch] - touch) ** power, rtol=1e-9)


def test_table_follows_a_thin_layer_between_four_points():
    """A ball on a layer, whose exponent grows with depth; at light presses too, where C10 and touch offset trade off."""
    grid = np.linspace(0.0, TOP, 161)
    curve = law_curve(0.4)
    table = curve_table(Curve(curve.depth[1::4], curve.force[1::4]), TOP)[:, 2]
    light = grid > 0.1 * TOP
    np.testing.assert_allclose(table[light], normal_force(grid[light], 0.4), rtol=0.03)


def test_compliance_is_inverted_exactly():
    """Effective depth plus what the frame gives way is the commanded depth plus the offset; the force is that of this depth."""
    values = true_values(compliance=0.02)
    forces, slopes, depth = law_emulator().forces([1.5], values)
    assert depth[0, 0] == pytest.approx(1.5 + 0.03 - 0.02 * abs(forces[0, 0, 2]), abs=1e-12)
    stiff = law_emulator().forces(depth[0], true_values(compliance=0.0, offset=0.0))[0]
    np.testing.assert_allclose(forces, stiff, rtol=1e-12)
    ahead = law_emulator().forces([1.5 + 1e-5], values)[0]
    assert slopes[0, 0, 2] == pytest.approx((ahead - forces)[0, 0, 2] / 1e-5, rel=1e-6)


def test_force_is_proportional_to_c10_without_compliance():
    one = law_emulator().forces([1.0], true_values(c10=REFERENCE_C10, compliance=0.0))[0]
    two = law_emulator().forces([1.0], true_values(c10=2 * REFERENCE_C10, compliance=0.0))[0]
    np.testing.assert_allclose(two, 2 * one, rtol=1e-12)


def dragged(travel: float, mu: float) -> float:
    """Sideways over normal force of a made-up contact that obeys Coulomb's law: proportional when both are scaled."""
    return mu * np.tanh(1.5 * travel / mu)


def test_a_frame_that_yields_sideways_takes_its_part_of_the_travel():
    """The force is that of the travel which is left, found from friction alone; at 0 nothing changes."""
    travel, compliance = 0.3, 0.01
    nodes = friction_of(np.linspace(0.0, 1.0, 33)[1:-1])
    curves = [law_curve(0.0, ratio=dragged(travel, one)) for one in nodes]
    table = friction_table(nodes, [curve_table(curve, TOP) for curve in curves])[None]
    emulator = replace(law_emulator(), table=table, travel=np.array([travel]))
    for mu in (0.4, 0.8, 3.0):
        values = {"c10": REFERENCE_C10, "offset": 0.0, "compliance": 0.0, "mu": mu}
        whole = emulator.forces([1.6], true_values(**values))[0][0, 0]
        found = emulator.forces([1.6], true_values(**values, shear_compliance=compliance))[0][0, 0]

        def over(way, mu=mu, pressing=abs(whole[2])):
            return way + compliance * pressing * dragged(way, mu) - travel

        assert found[2] == whole[2] and abs(found[0]) < abs(whole[0])
        assert found[0] / found[2] == pytest.approx(dragged(brentq(over, 0.0, travel), mu), rel=0.004)


def test_what_is_left_of_a_sideways_force_meets_its_equation():
    """Way of the frame and way that is left make up the travel; a force that takes all of it is cut, never wrong."""
    for yielded, exponent in product((0.0, 0.01, 0.3, 0.9, 5.0), (0.0, 0.1, 0.5, 0.9, 1.0)):
        left = sideways_left(yielded, exponent)
        assert 0.0 < left <= 1.0
        if yielded < 0.5 or (yielded < 1.0 and exponent >= 0.5):
            way = left ** (1.0 / exponent) if exponent > 0 else 1.0 - yielded
            assert way + yielded * left == pytest.approx(1.0, abs=0.01), (yielded, exponent)


def test_no_force_above_the_gel():
    assert not law_emulator().forces([0.01], true_values(offset=-0.02))[0].any()


def dragged_at(travel: float, mu: float, depth: float) -> float:
    """Sideways over normal force of a ball that is dragged: Cattaneo's law, whose ratio without slip goes as 1 / depth."""
    stuck = 1.5 * travel / depth
    return stuck * float(stuck_share(mu, stuck))


@pytest.mark.parametrize("travel", [0.1, 0.3, 1.5])
def test_shear_between_friction_nodes_and_depths_is_that_of_a_ball(travel):
    """Where it sticks, where it slips in part, and where it slides as a whole; solved at one depth and two friction coefficients."""
    nodes = np.array([0.25, np.inf])
    alone = friction_table(nodes, [curve_table(law_curve(mu), TOP) for mu in nodes])
    grid = np.linspace(0.0, TOP, alone.shape[1])

    def after(mu, depth):
        return normal_force(depth, mu) * np.array([-dragged_at(travel, mu, depth), 0.0, 1.0])

    table = sheared_table(alone, TOP, nodes, [after(mu, TOP) for mu in nodes])
    for mu in (0.3, 0.5, 1.0, 2.0):
        at = np.array(
            [
                [np.interp(friction_axis(mu), np.linspace(0, 1, 33), one) for one in of.T]
                for of in table.swapaxes(0, 1)
            ]
        )
        for depth in (0.6, 1.3, 2.0):
            found = at[np.argmin(np.abs(grid - depth))]
            # the table is linear in friction between its 33 coefficients
            assert found[0] / found[2] == pytest.approx(-dragged_at(travel, mu, depth), rel=0.02)
    sticks = sticking(table)
    assert np.all(sticks[-1] == 1.0) and (travel < 1.0 or np.all(sticks[:17, 40:] < 0.01))


@pytest.mark.slow
def test_truth_is_recovered_where_data_are_rich():
    """A sensor that was not tared hides nothing: C10 is as narrow as with a tared one."""
    tare, rng, stiffness = -1.5, np.random.default_rng(2), list(np.repeat([2.0, 4, 8, 20], 10))
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

    model: BenchModel

    def __call__(self, x):
        outside = np.abs(np.minimum(x, 0.0)).sum(axis=1)  # uphill back to where the law is
        return np.where(outside == 0.0, -x.sum(axis=1), -1e9 * (1.0 + outside))


@pytest.mark.slow
def test_chain_has_the_moments_of_a_law_that_its_moves_do_not_fit():
    """Mean, deviation and 95 % quantile of an exponential law, within four of their standard errors."""
    start = Prior("normal", stats.norm())
    model = BenchModel("no_slip", dict.fromkeys("ab", start), {})
    draws = sample(Skewed(model), replace(RULES, taus=400)).flat()
    # at least 400 independent draws of each of 6 walkers: the standard errors are 0.02, 0.03 and 0.09
    np.testing.assert_allclose(draws.mean(axis=0), 1.0, atol=0.08)
    np.testing.assert_allclose(draws.std(axis=0), 1.0, atol=0.12)
    np.testing.assert_allclose(np.quantile(draws, 0.95, axis=0), np.log(20.0), atol=0.36)


def test_the_components_of_a_press_share_its_errors():
    """A multivariate t whose scale is noise and what touch and emulator do to all components; scipy's, for 1 to 3 of them."""
    readings, emulator = law_session(presses=3)
    model = make_model(PARAMS, "coulomb", np.unique(readings.indenters).tolist())
    observed = readings.force.copy()
    observed[1, 0], observed[2, :2] = np.nan, np.nan
    posterior = Posterior(emulator, model, readings.depth, observed, 4.0)
    at = model.draw(np.random.default_rng(0), 2)
    values, found = model.values(at), posterior.by_press(at)
    forces, slopes, _ = emulator.forces(readings.depth, values)
    for w in range(2):
        for p in range(3):
            used = np.isfinite(observed[p])
            f, s = forces[w, p], values["scatter"][w] * slopes[w, p]
            aside = SIDEWAYS_ERROR * f * [1, 1, 0]
            shape = (
                np.outer(s, s)
                + ERROR**2 * np.outer(f, f)
                + np.outer(aside, aside)
                + values["noise"][w] ** 2 * np.eye(3)
            )
            shape += np.diag([1.0, 1.0, 0.0]) * (SIDEWAYS_ERROR_OF_NORMAL * f[2]) ** 2
            law = stats.multivariate_t((f + tare_of(values)[w])[used], shape[np.ix_(used, used)], df=4.0)
            assert found[w, p] == pytest.approx(law.logpdf(observed[p, used]), rel=1e-9)
            # and a reading is predicted with the same middle and, of each component, the same scale
            expected, scale = (part[w, p] for part in posterior.predict(at))
            np.testing.assert_allclose(expected, f + tare_of(values)[w], rtol=1e-12)
            np.testing.assert_allclose(scale, np.sqrt(np.diag(shape)), rtol=1e-12)


def test_the_likelihood_has_the_errors_that_emulated_forces_were_measured_to_have(root):
    """Not less than measured, and at most half more (make benchmark-calibration)."""
    figures = read_json(root / "results/benchmarks/calibration.json")["figures"]
    measured = {figure["name"]: figure["value"] / 100 for figure in figures}
    for name, error in (
        ("normal forces, error from press to press", ERROR),
        ("sideways forces, the same", SIDEWAYS_ERROR),
    ):
        assert measured[f"emulated {name}"] <= error <= 1.5 * measured[f"emulated {name}"]


def test_a_press_that_is_left_out_is_predicted_as_if_none_of_its_axes_had_been_read():
    """Of one free parameter the posterior is known without sampling. Each axis of a press that is a third too strong says so."""
    readings, emulator = law_session(1, presses=3)
    observed = readings.force * np.array([1.0, 1.0, 1.3])[:, None]
    model = make_model(PARAMS, "coulomb", np.unique(readings.indenters).tolist())
    truth = true_values(noise=0.3, scatter=0.05)
    held = {name: float(truth[name][0]) for name in model.free if name in truth}
    model = replace(model, free={"c10": model.free["c10"]}, fixed=model.fixed | held)

    def known(observed):
        posterior = Posterior(emulator, model, readings.depth, observed, 4.0)
        z = np.linspace(-4.0, 4.0, 4001)
        logged = posterior(z[:, None])
        below = np.cumsum(np.exp(logged - logged.max()))
        draws = np.interp((np.arange(2000) + 0.5) / 2000, below / below[-1], z)
        return Chain(draws[:, None, None], Figures(2000, 0, 1.0, 2000.0, 0.5, 1.0, "c10")), posterior

    without, shape = summary.left_out(*known(observed))
    assert np.isfinite(shape)
    unread, _ = summary.predictions(*known(np.where([[False], [False], [True]], np.nan, observed)))
    np.testing.assert_allclose(without[2], unread[2], rtol=1e-3)


@pytest.mark.slow
def test_a_chain_is_the_same_again():
    posterior = law_posterior(np.random.default_rng(3), DEPTH[::3], law="no_slip")
    one, two = (sample(posterior, replace(RULES, taus=5)).coordinates for _ in range(2))
    np.testing.assert_array_equal(one, two)


NUMBERS = {"mean": 1.0, "median": 0.5, "spread": 0.4}


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


def test_chosen_presses_span_indenters_and_depths_and_slide_where_that_tells():
    readings = make_readings(np.linspace(0.1, 2.0, 20), -np.linspace(1, 20, 20))
    readings.indenters[10:] = "cuboid_10"
    chosen = choose_presses(readings, 6, "no_slip")
    assert {0, 9, 10, 19} <= set(chosen.tolist())
    assert sorted(bisection_order(9)) == list(range(9))
    assert len(choose_presses(readings, 99, "coulomb")) == 20
    readings.pose[4:10, 3] = 3.0
    assert sum(slides(readings.take(choose_presses(readings, 12, "coulomb")))) == 3
    assert sum(slides(readings.take(choose_presses(readings, 18, "coulomb")))) == 4
    assert not any(slides(readings.take(choose_presses(readings, 99, "no_slip"))))


def test_the_demo_has_presses_that_slide_and_a_calibration_of_it_chooses_some(root):
    """Without them its friction would be known no better than before: those that hardly slip fit any."""
    demo = root / "data/demo"
    assert read_dataset_file(demo / "dataset.toml").params["interface"]["law"] == "coulomb"
    readings = read_readings(demo / "log.csv")
    far = readings.travel > 2 * readings.depth
    assert far.sum() == 3 and (slides(readings) == far).all()
    chosen = choose_presses(readings, PARAMS.max_presses, "coulomb")
    for name, there in zip(*np.unique(readings.mountings[far], return_counts=True), strict=True):
        assert far[chosen][readings.mountings[chosen] == name].sum() == min(PARAMS.max_presses // 4, there)


def test_a_prior_far_from_the_readings_is_no_lack_of_data():
    """Of a C10 far above its prior it was said that the data say almost nothing."""
    law = stats.norm(0.05, 0.002)
    coordinate = summary.normal_coordinate(law, np.array([0.04, 0.05, 0.08]))
    assert np.isfinite(coordinate).all() and coordinate == pytest.approx([-5.0, 0.0, 15.0], abs=1e-6)
    row = {"width_over_prior": 0.95, "median": 0.05, "prior_interval95": [0.04, 0.06]}
    assert "almost nothing" in summary._unseen({"c10": row})[0]
    assert not summary._unseen({"c10": row | {"median": 0.08}})
