"""Troubles of force sensors put into a session of presses: each gets its own sentence, a clean session none."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gelforge.calibration.posterior import Posterior
from gelforge.calibration.sampling import Chain, Figures, NotConverged
from gelforge.evidence.forces import Fitted, LogForces, drift, mean_forces, of_log, of_readings, sideways
from gelforge.evidence.labels import of_labels
from gelforge.flow.schema import altered
from gelforge.stages.calibrate import Calibration, calibrate, evidence_of, model_of, served, usual_forces
from tests.support.calibration_law import PARAMS, law_session, true_values

USUAL = 0.0725  # MPa
AXES = {
    "turned by +90 degrees": lambda force, turn: force * 1j,
    "turned by -45 degrees": lambda force, turn: force * np.exp(-0.25j * np.pi),
    "turned by +30 degrees": lambda force, turn: force * np.exp(1j * np.pi / 6),
    "opposite sign": lambda force, turn: -force,
    "turns with the indenter's rot_deg": lambda force, turn: force * turn,
    "turns against the indenter's rot_deg": lambda force, turn: force / turn,
    "x and y are exchanged, which": lambda force, turn: 1j * force.conj(),
    "exchanged, and their signs flipped": lambda force, turn: -1j * force.conj(),
    "the sign of x is flipped": lambda force, turn: -force.conj(),
    "the sign of y is flipped": lambda force, turn: force.conj(),
    "no exchange of axes explains them": lambda force, turn: np.roll(force, 5),
}
# What is done to forces (n, 3) N of n presses, and what is said of it.
TROUBLES = {
    "pounds-force": (lambda f: f / 4.44822, "in pounds-force"),
    "ounces-force": (lambda f: f / 0.278014, "in ounces-force"),
    "kilograms-force": (lambda f: f / 9.80665, "in kilograms-force"),
    "grams-force": (lambda f: f / 9.80665e-3, "in grams-force"),
    "next row": (lambda f: np.roll(f, -1, axis=0), "fit the preceding row"),
    "previous row": (lambda f: np.roll(f, 1, axis=0), "fit the following row"),
    "drift": (
        lambda f: f + 0.25 * np.arange(len(f))[:, None] * [0, 0, 1],
        "drifts: what it reads along z .* by [+]0.2",
    ),
    "small drift": (
        lambda f: f - 0.06 * np.arange(len(f))[:, None] * [0, 0, 1],
        "drifts: what it reads along z .* by -0.0",
    ),
    "drift sideways": (lambda f: f + 0.1 * np.arange(len(f))[:, None] * [1, 0, 0], "drifts: what it reads along x"),
    "tare": (lambda f: f + [0.8, 0.0, -1.5], r"[+]0.\d+ N along x and -1.\d+ N along z: tare"),
    "tare along y": (lambda f: f + [0.0, -0.5, 0.0], r"constant force of -0.\d+ N along y: tare"),
    "tare upwards": (lambda f: f + [0.0, 0.0, 2.0], r"constant force of [+][12].\d+ N along z: tare"),
    "end of the range": (
        lambda f: np.maximum(f, [-np.inf, -np.inf, np.quantile(f[:, 2], 0.3)]),
        r"the end of (its|the sensor's) range",
    ),
    "noise": (lambda f: f + 0.6 * np.random.default_rng(5).standard_normal(f.shape), "scatter by 0.[4-9]"),
}


def log_of(session) -> LogForces:
    return LogForces(session.pose[:, 3:5], session.depth, session.pose[:, 6], session.force)


def with_force(session, force):
    return replace(session, force=force)


@pytest.mark.parametrize("seed", range(2))
def test_forces_along_the_path_say_nothing_and_axes_that_are_not_the_gel_s_are_named(seed):
    session, _ = law_session(seed)
    assert sideways(log_of(session)) is None
    turn = np.exp(1j * np.deg2rad(session.pose[:, 6]))
    for said, change in AXES.items():
        seen = change(session.force[:, 0] + 1j * session.force[:, 1], turn)
        trend = 0.05 * np.arange(len(seen))  # a constant force and a drift do not hide it
        force = np.column_stack([seen.real + 0.7 + trend, seen.imag, session.force[:, 2]])
        assert said in sideways(log_of(with_force(session, force)))


def test_a_few_presses_and_small_sideways_forces_say_nothing():
    session, _ = law_session()
    few = session.take(np.arange(5))
    assert sideways(log_of(with_force(few, -few.force))) is None
    assert sideways(log_of(with_force(session, session.force * [-0.01, 0.01, 1.0]))) is None
    unread = with_force(session, session.force * [np.nan, np.nan, 1.0])
    assert sideways(log_of(unread)) is None


def test_an_axis_that_the_sensor_lacks_is_named():
    session, label, names = labelled(0)
    for kept, said in (
        ([0.0, 0.0, 1.0], "fx_n and fy_n never change in"),
        ([1.0, 0.0, 1.0], "fy_n never changes in"),
    ):
        single = log_of(with_force(session, session.force * kept))
        assert said in sideways(single)
        assert [said in line for line in of_labels(single, label, names)] == [True]


def test_presses_without_a_path_whose_sideways_forces_are_a_drag_s_are_named():
    session, label, names = labelled(0)
    straight = replace(log_of(session), path=np.zeros((len(session.force), 2)))
    free = label * [0.0, 0.0, 1.0]
    assert ["dx_mm and dy_mm are 0 in all presses" in line for line in of_labels(straight, free, names)] == [True]
    for share in (0.02, -0.05):  # a body's sides, a tilt of the force sensor
        still = session.force[:, 2:] * [share, -share, 1.0]
        assert of_labels(replace(straight, force=still), free, names) == []
    assert of_labels(replace(straight, force=straight.force * [0.0, 0.0, 1.0]), free, names) == []


def test_readings_that_stay_as_they_were_or_end_at_a_limit_are_named():
    session, label, names = labelled(0)
    stale, most = np.repeat(session.force[::2], 2, axis=0)[: len(label)], 0.5 * np.abs(session.force).max()
    for force, said in (
        (stale, "exactly the reading of the previous press"),
        (session.force.clip(-most), "the sensor is at the end of its range"),
    ):
        assert [said in line for line in of_labels(log_of(with_force(session, force)), label, names)] == [True]


def test_readings_of_the_previous_press_are_named_if_its_label_differs_by_a_fifth():
    """By a tenth, two presses may have one reading."""
    still, depth, force = np.zeros((12, 2)), np.linspace(0.5, 1.1, 12), np.repeat(np.linspace(3.0, 9.0, 6), 2)
    read = LogForces(still, depth, np.zeros(12), np.column_stack([still, -force]))
    for larger, named in ((1.2, True), (1.1, False)):
        label = read.force * np.where(np.arange(12) % 2, larger, 1.0)[:, None]
        said = of_labels(read, label, ["ball"] * 12)
        assert any("6 presses have exactly the reading of the previous press" in line for line in said) == named


def test_a_constant_force_shows_in_presses_without_shear():
    noise = 0.05 * np.random.default_rng(0).standard_normal((12, 2))
    (value, error) = mean_forces(noise + [0.8, 0.0])["x"]
    assert value == pytest.approx(0.8, abs=4 * error) and error < 0.03
    assert mean_forces(noise[:5]) == {} == mean_forces(noise * np.nan)


def test_a_drift_is_one_along_the_log_and_no_chance():
    rng = np.random.default_rng(1)
    rows = np.sort(rng.choice(48, 16, replace=False))
    alone = np.stack([np.full(16, np.nan), np.full(16, np.nan), 0.1 * rng.standard_normal(16)], axis=1)
    assert drift(alone, rows) is None
    assert "+0.050 N a row" in drift(alone * [1, 1, 0] + 0.05 * rows[:, None], rows)
    assert drift(alone + 0.002 * rows[:, None], rows) is None  # a tenth of a newton in all


def fitted(session, emulator) -> list[str]:
    """What a calibration says of a session, of which it uses three quarters."""
    used = np.flatnonzero(np.arange(len(session)) % 4 != 1)
    params = altered(PARAMS, autocorrelation_times=10)
    return calibrate(session.take(used), emulator.take(used), params, "coulomb", session, USUAL)[1]


@pytest.mark.slow
def test_a_chain_that_does_not_converge_says_what_the_readings_say():
    """A drift of six newtons, which no parameter explains, leaves a posterior of many modes."""
    session, emulator = law_session(3)
    change, said = TROUBLES["drift"]
    drifts = with_force(session, change(session.force))
    with pytest.raises(NotConverged, match=f"(?s){said}.*The chain did not converge"):
        calibrate(drifts, emulator, altered(PARAMS, max_steps=1200), "coulomb", drifts, USUAL)


def test_a_cause_hides_what_follows_from_it():
    session, _ = law_session()
    usual = -session.force[:, 2]
    plain = Fitted(np.arange(24), usual, np.zeros((24, 3)), {}, 0.03, 0.24)
    noisy = replace(plain, noise=0.5)
    tare = replace(noisy, constant={"z": (-1.5, 0.05), "x": (0.1, 0.01)})
    assert of_log(log_of(session), plain) == []
    assert ["scatter by 0.50 N" in line for line in of_log(log_of(session), noisy)] == [True]
    assert ["-1.50 N along z: tare" in line for line in of_log(log_of(session), tare)] == [True]
    turned = with_force(session, session.force * [-1.0, 1.0, 1.0])
    assert ["sign of x" in line for line in of_log(log_of(turned), tare)] == [True]
    weighed = with_force(session, session.force / 9.80665)
    assert ["kilograms" in line for line in of_log(log_of(weighed), tare)] == [True]


def test_a_friction_that_is_held_says_the_same_of_unit_and_rows():
    """Of `priors.mu free = false`: usual forces are those at the value at which it is held."""
    session, emulator = law_session(3)
    held = replace(PARAMS.priors.mu, free=False, fixed=0.7)
    model = model_of(session, replace(PARAMS, priors=replace(PARAMS.priors, mu=held)), "coulomb")
    chain = Chain(model.draw(np.random.default_rng(0), 200)[:, None], Figures(200, 0, 1.0, 200.0, 0.5, 1.0, "c10"))
    for name in ("pounds-force", "next row"):
        change, said = TROUBLES[name]
        readings = with_force(session, change(session.force))
        posterior = Posterior(emulator, model, readings.depth, served(readings), 4.0)
        np.testing.assert_allclose(usual_forces(posterior, USUAL), on_rigid_bench(emulator, session.depth), rtol=1e-9)
        (line,) = evidence_of(Calibration(readings, posterior, chain), readings, USUAL)
        assert re.search(said, line)


def on_rigid_bench(emulator, depth):
    """Forces (n, 3) N of presses on a usual gel, where touch is exact and nothing else yields."""
    exact = {**true_values(c10=USUAL, offset=0.0, compliance=0.0), "indenter": np.zeros((1, 3))}
    return emulator.forces(depth, exact)[0][0]


def beside_labels(seed, presses, deeper=0.0, **bench):
    """A log that says `deeper` mm more than was pressed, its labels on a bench that does not yield, and its indenters."""
    session, emulator = law_session(seed, presses, **bench)
    depth = session.depth + deeper
    return replace(log_of(session), depth=depth), on_rigid_bench(emulator, depth), session.indenters


@pytest.mark.parametrize("seed", range(2))
def test_a_frame_that_yields_as_usual_is_not_taken_for_a_thicker_gel(seed):
    """By 0.02 mm/N, with readings that scatter by 0.2 N and indenters that differ by 3 %."""
    log, label, names = beside_labels(seed, 48, compliance=0.02, noise=0.2)
    own = np.exp(0.03 * np.random.default_rng(seed).standard_normal(3))
    label *= own[np.unique(names, return_inverse=True)[1], None]
    assert of_labels(log, label, names) == []


@pytest.mark.parametrize("deeper, said", [(0.3, r"0\.[23]\d mm less deep"), (-0.3, r"0\.[23]\d mm deeper")])
def test_a_touch_that_was_missed_is_named_and_not_another_gel(deeper, said):
    for seed in range(3):
        (line,) = of_labels(*beside_labels(seed, 30, deeper))
        assert re.search(said, line)


def labelled(seed):
    """A session, and labels of a gel three tenths softer whose bench neither yields nor touches late, as before any calibration."""
    session, _ = law_session(seed)
    noise = 0.01 * np.random.default_rng(seed).standard_normal(session.force.shape)
    bent = (
        0.75 * (1.0 - 0.05 / session.depth[:, None]) * (1.0 + 0.005 * session.force[:, 2:] / session.depth[:, None])
    )
    names = np.array(["ball", "bar", "cube"])[np.arange(len(session)) % 3]
    return session, session.force * (bent + noise), names


@pytest.mark.parametrize("seed", range(2))
def test_labels_name_the_trouble_and_of_a_clean_session_nothing(seed):
    session, label, names = labelled(seed)
    assert of_labels(log_of(session), label, names) == []
    turn = np.exp(1j * np.deg2rad(session.pose[:, 6]))
    for said, change in AXES.items():
        seen = change(session.force[:, 0] + 1j * session.force[:, 1], turn)
        force = np.column_stack([seen.real, seen.imag, session.force[:, 2]])
        (line,) = of_labels(log_of(with_force(session, force)), label, names)
        assert said in line
    for name in TROUBLES.keys() - {"noise"}:
        change, said = TROUBLES[name]
        (line,) = of_labels(log_of(with_force(session, change(session.force))), label, names)
        assert re.search(said, line), name
    for name, factor in (("ball", 1.3), ("bar", 0.8)):
        wrong = session.force * np.where(names == name, factor, 1.0)[:, None]
        (line,) = of_labels(log_of(with_force(session, wrong)), label, names)
        assert f"For {name}, the ratio of forces to labels is" in line


@pytest.mark.parametrize(
    "power, said", [(0.15, "the gel is thinner than its table says"), (-0.2, "the gel is thicker")]
)
def test_forces_that_grow_otherwise_with_the_contact_name_the_gel_s_thickness(power, said):
    session, label, names = labelled(1)
    wide = np.array([{"ball": 1.0, "bar": 4.0, "cube": 2.0}[name] for name in names])[:, None]
    assert of_labels(log_of(with_force(session, session.force * wide)), label * wide, names) == []
    size = np.abs(session.force[:, 2:] * wide) ** power
    (line,) = of_labels(log_of(with_force(session, session.force * wide * size)), label * wide, names)
    assert said in line


# What is done to forces (n, 3) N of n presses and found beside labels only, and what is said of it.
BESIDE_LABELS = {
    "x and z exchanged": (lambda f: f[:, [2, 1, 0]], "fx_n follows the normal force .* fz_n does not"),
    "y and z exchanged": (lambda f: f[:, [0, 2, 1]], "fy_n follows the normal force .* fz_n does not"),
    "half of the press before": (lambda f: (f + np.vstack([f[:1], f[:-1]])) / 2, r"Readings contain [3-6]\d % of the previous press' force"),
    "a stiffer gel halfway": (lambda f: f * np.where(np.arange(len(f)) < len(f) // 2, 1.0, 1.25)[:, None], r"From press 13 .* is 1.2\d times"),
    "weight of a tool": (lambda f: f - [0.0, 0.0, 20.0], r"Forces are offset by [+](19|2\d).\d N from the usual"),
    "weight that lifts": (lambda f: f + [0.0, 0.0, 30.0], r"Forces are offset by -[23]\d.\d N from the usual"),
    "small tare": (lambda f: f - [0.0, 0.0, 0.4], r"constant force of -0.\d+ N along z"),
}  # fmt: skip


def test_labels_name_what_a_model_of_forces_would_take_for_another_cause():
    session, label, names = labelled(4)
    for change, said in BESIDE_LABELS.values():
        (line,) = of_labels(log_of(with_force(session, change(session.force))), label, names)
        assert re.search(said, line)


def test_labels_need_readings_and_enough_presses():
    session, label, names = labelled(0)
    unread = with_force(session, session.force * np.nan)
    assert of_labels(log_of(unread), label, names) == []
    normal_alone = with_force(session, session.force * [np.nan, np.nan, 1.0] - [0.0, 0.0, 1.5])
    assert ["along z: tare" in line for line in of_labels(log_of(normal_alone), label, names)] == [True]
    few = session.take(np.arange(5))
    assert of_labels(log_of(with_force(few, few.force - [0.0, 0.0, 1.5])), label[:5], names[:5]) == []


def test_presses_of_one_depth_or_one_force_stop_nothing():
    """Depth of touch and compliance then follow from stiffness, and a constant force from either: no fit tells them apart."""
    rng, one, still = np.random.default_rng(0), np.full(16, 0.8), np.zeros((16, 2))
    for depth, normal in (
        (one, rng.uniform(2.0, 9.0, 16)),
        (one, np.full(16, 5.0)),
        (rng.uniform(0.3, 1.2, 16), np.full(16, 5.0)),
    ):
        label = np.column_stack([still, -normal])
        read = LogForces(still, depth, np.zeros(16), 1.02 * label + 0.05 * rng.standard_normal((16, 3)))
        assert of_labels(read, label, ["ball"] * 16) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_calibration_of_a_clean_session_says_nothing(seed):
    assert fitted(*law_session(seed)) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "trouble", ["kilograms-force", "next row", "small drift", "tare along y", "end of the range", "noise"]
)
def test_a_calibration_names_the_trouble_and_nothing_else(trouble):
    session, emulator = law_session(3)
    change, said = TROUBLES[trouble]
    (line,) = fitted(with_force(session, change(session.force)), emulator)
    assert re.search(said, line)


@pytest.mark.parametrize("seed", range(3))
def test_readings_of_a_scale_say_nothing_or_name_unit_offset_and_drift(seed):
    """Readings that are a fifth larger than what the network reads, and scattered by a twentieth."""
    rng = np.random.default_rng(seed)
    read = rng.uniform(2.0, 20.0, 12)
    measured = 1.2 * read * np.exp(0.05 * rng.standard_normal(12))
    assert of_readings(measured, read) == []
    for name, newtons in (("pounds", 4.44822), ("ounces", 0.278014), ("kilograms", 9.80665), ("grams", 9.80665e-3)):
        (line,) = of_readings(measured / newtons, read)
        assert f"in {name}-force" in line
    for offset, way in ((2.0, "falls"), (4.0, "falls"), (-1.5, "rises")):
        (line,) = of_readings(measured + offset, read)
        assert f"ratio {way} with force: tare" in line and line.startswith(
            f"Readings have an offset of {np.sign(offset):+.0f}"[:-1]
        )
    (line,) = of_readings(measured + 1.5 * np.arange(12), read)
    assert "drift by +" in line
