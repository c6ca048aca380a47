"""Readings and chains that must be refused, each by name."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gelforge.calibration import summary
from gelforge.calibration.parameters import Model, Prior, compared_models, make_model
from gelforge.calibration.readings import check_enough, check_readings, read_readings
from gelforge.calibration.sampling import LEARN, Chain, NotConverged, Rules, complaint, find_modes, judge, sample
from gelforge.calibration.solves import refuse_no_contact
from gelforge.errors import BadInput
from gelforge.flow.params.schema import Place, parse
from gelforge.flow.params.tables import PriorTable
from gelforge.geometry.gel import USUAL_GEL
from gelforge.records.press import COLUMNS
from gelforge.stages.calibrate import load_rejected, poisson_nodes, refuse_beyond
from tests.support.calibration_law import PARAMS, law_posterior, make_readings
from tests.support.press_records import log_line, write_lines

DEPTH = np.array([0.5, 1.0, 1.5, 2.0])
FORCE = -np.array([1.65, 5.96, 13.5, 23.3])
RULES = Rules(walkers=32, seed=3, taus=50, acceptance=(0.15, 0.6), rhat=1.01, max_steps=3000)


def test_good_readings_pass():
    check_readings(make_readings(DEPTH, FORCE))


def test_a_press_that_two_sensors_saw_is_one_reading(tmp_path):
    path = tmp_path / "log.csv"
    cells = "{},t,{},ball,0,0,0,0,0,-1.0,0,0,0,-5.0"
    header = "sample_id,time_utc,sensor_id,indenter,x0_mm,y0_mm,z0_mm,dx_mm,dy_mm,dz_mm,rot_deg,fx_n,fy_n,fz_n"
    path.write_text("\n".join([header, cells.format("a1", "left"), cells.format("a2", "right")]) + "\n")
    assert list(read_readings(path).ids) == ["a1"]
    # the same sensor twice is a copied row
    path.write_text("\n".join([header, cells.format("a1", "left"), cells.format("a2", "left")]) + "\n")
    with pytest.raises(BadInput, match="a2"):
        check_readings(read_readings(path))


def test_of_the_frames_of_a_press_the_last_serves(tmp_path):
    """They share one error of touch: as six readings they would make it look six times smaller."""
    lines = [log_line((*COLUMNS, "press_id"), sample_id=f"f{k}", press_id="film" if k < 4 else "", dz_mm=-0.3 - 0.1 * k,
                      fz_n=-1.0 - k) for k in range(5)]  # fmt: skip
    path = write_lines(tmp_path / "log.csv", *lines, columns=(*COLUMNS, "press_id"))
    assert read_readings(path).ids.tolist() == ["f3", "f4"]


def test_wrong_sign_convention_is_named():
    with pytest.raises(BadInput, match=r"fz_n is positive in 3 of 3 .* row 3 .* opposite sign convention"):
        check_readings(make_readings(DEPTH, -FORCE))


def test_one_pulling_reading_is_no_sign_error():
    force = FORCE.copy()
    force[2] = 5.0
    check_readings(make_readings(DEPTH, force))


def test_no_depth_is_named():
    with pytest.raises(BadInput, match=r"row 4 \(p002\).*no depth and no contact"):
        check_readings(make_readings([0.5, 1.0, 0.0, 2.0], FORCE))


def test_duplicated_rows_are_named():
    with pytest.raises(BadInput, match=r"row 4 \(p002\): pose and force repeat an earlier row"):
        check_readings(make_readings([0.5, 1.0, 1.0, 2.0], [-1.65, -5.96, -5.96, -23.3]))


def test_repeated_press_with_its_own_reading_is_no_copy():
    check_readings(make_readings([0.5, 1.0, 1.0, 2.0], [-1.65, -5.96, -5.99, -23.3]))


@pytest.mark.parametrize("value", [-3.2, 0.0])
def test_constant_sensor_is_named(value):
    with pytest.raises(BadInput, match=r"in all 4 rows though the presses differ"):
        check_readings(make_readings(DEPTH, np.full(4, value)))


def test_depth_without_contact_is_named():
    readings = make_readings(DEPTH, FORCE)
    table = np.full((4, 1, 3, 5, 3), -1.0)
    table[3] = 0.0
    with pytest.raises(BadInput, match=r"row 5 \(p003\): depth without contact"):
        refuse_no_contact(readings, table)


def test_posterior_deeper_than_the_solves_is_named():
    posterior = law_posterior(np.random.default_rng(1), DEPTH)
    free = posterior.model.free
    deep = np.zeros((50, 32, len(free)))
    for column, name in enumerate(free):
        deep[..., column] = 0.7 if name == "offset" else free[name].quantile(0.5)
    with pytest.raises(BadInput, match=r"25 % of the posterior presses deeper .* raise \[calibrate\] reach_mm"):
        refuse_beyond(posterior, Chain(deep, np.zeros((50, 32)), None))


def test_fewer_readings_than_vague_parameters():
    model = make_model(PARAMS, "coulomb")
    check_enough(2, model)  # every prior is informative
    with pytest.raises(BadInput, match="log two presses or more"):
        check_enough(1, model)
    flat = {name: Prior("uniform", 0.0, 1.0) for name in ("c10", "offset", "mu")}
    with pytest.raises(BadInput, match=r"2 force readings cannot determine 3 parameters with flat priors \(c10"):
        check_enough(2, replace(model, free={**model.free, **flat}))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("few", [3, 16])
def test_walkers_stuck_in_two_modes_are_named(seed, few):
    """Walkers that stay 40 deviations apart in one parameter, laid out here because a sampler may cross by chance."""
    rng, wide = np.random.default_rng(seed), Prior("uniform", -2.0, 2.0)
    chain = 0.05 * rng.standard_normal((LEARN + 400, 32, 2))
    chain[:, :, 0] += np.where(np.arange(32) < few, -1.0, 1.0)
    model, figures = Model("coulomb", {"offset": wide, "nu": wide}, {}), judge(chain, 0.3)
    assert not figures.meets(RULES)
    names = rf"stuck in two modes: {few} walkers near offset = -\d.* and {32 - few} walkers near offset = \d"
    assert re.search(names, complaint(model, chain, figures, RULES))


def test_one_broad_mode_is_not_two():
    rng = np.random.default_rng(0)
    slow = rng.standard_normal((1, 32, 3)) + 0.5 * rng.standard_normal((400, 32, 3))
    assert find_modes(slow) == []


def test_too_short_a_chain_fails_with_figures_and_hint():
    posterior = law_posterior(np.random.default_rng(1), DEPTH)
    with pytest.raises(NotConverged, match=r"in 500 steps: \d+ autocorrelation .* acceptance 0\.\d+ .* max_steps"):
        sample(posterior, replace(RULES, max_steps=500))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sample_id,indenter\na,s\n", "column x0_mm is missing"),
        ("{h}\na,s,0,0,0,0,0,-1,0,,,,\n", "no row has a normal force"),
        ("{h}\na,s,0,0,0,0,0,-1,0,,,x,\n", r"row 2, column fz_n: 'x': not a finite number"),
        ("{h}\na,s,0,0,0,0,0,nan,0,,,-1,\n", r"row 2, column dz_mm: 'nan': not a finite number"),
    ],
)
def test_unreadable_logs(tmp_path, text, message):
    header = "sample_id,indenter,x0_mm,y0_mm,z0_mm,dx_mm,dy_mm,dz_mm,rot_deg,fx_n,fy_n,fz_n,image"
    (tmp_path / "log.csv").write_text(text.replace("{h}", header))
    with pytest.raises(BadInput, match=message):
        read_readings(tmp_path / "log.csv")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"kind": "gauss"}, "kind = 'gauss': give"),
        ({"kind": "normal", "mean": 0.0}, "spread is missing: a prior of kind"),
        ({"kind": "normal", "mean": 0.0, "spread": 0.0}, "has no width"),
        ({"kind": "uniform", "low": 1.0, "high": 1.0}, "has no width"),
        ({"kind": "lognormal", "median": -1.0, "spread": 1.0}, "needs a positive one"),
    ],
)
def test_unusable_priors(table, message):
    with pytest.raises(BadInput, match=message):
        parse(PriorTable, table, Place("a test", ("calibrate", "priors", "c10")))


def test_too_few_walkers():
    posterior = law_posterior(np.random.default_rng(1), DEPTH)
    with pytest.raises(BadInput, match="walkers is 8; 7 parameters"):
        sample(posterior, replace(RULES, walkers=8))


def test_rows_rejected_by_stage_10_do_not_serve(tmp_path):
    (tmp_path / "0000.rejected.csv").write_text(
        "file,row,sample_id,column,value,reason,hint\n"
        "log.csv,3,b,dz_mm,x,no number,mend\nlog.csv,4,c,image,,none,add\n"
    )
    # of a longer log: no shard of today's
    (tmp_path / "0001.rejected.csv").write_text(
        "file,row,sample_id,column,value,reason,hint\nlog.csv,2,z,dz_mm,x,,\n"
    )
    lines = [f"{name},sphere_15,0,0,0,0,0,-1,0,,,-{k}" for k, name in enumerate("abc", 1)]
    header = "sample_id,indenter,x0_mm,y0_mm,z0_mm,dx_mm,dy_mm,dz_mm,rot_deg,fx_n,fy_n,fz_n"
    (tmp_path / "log.csv").write_text("\n".join([header, *lines]) + "\n")
    readings = read_readings(tmp_path / "log.csv", load_rejected(tmp_path, ["0000"]))
    assert readings.ids.tolist() == ["a", "c"]  # a missing image is no reason to drop a force
    with pytest.raises(BadInput, match="all 3 rows with a normal force .* were rejected"):
        read_readings(tmp_path / "log.csv", {2, 3, 4})


def test_a_parameter_that_is_held_is_held_alike_in_every_model_that_is_compared():
    held = replace(PARAMS.priors.offset, free=False, fixed=0.02)
    params = replace(PARAMS, priors=replace(PARAMS.priors, offset=held))
    models = compared_models(params)
    assert {model.fixed["offset"] for model in models} == {0.02}
    assert len({model.name for model in models}) == len(models) == 6  # three laws, with and without a soft bench


def test_a_bench_that_yields_only_sideways_is_compared_with_a_rigid_one():
    held = replace(PARAMS.priors.compliance, free=False, fixed=0.006)
    models = compared_models(replace(PARAMS, priors=replace(PARAMS.priors, compliance=held)))
    free = [(model.law, "offset" in model.free, "shear_compliance" in model.free) for model in models]
    assert len(set(free)) == len(models) == 12  # three laws, with and without a touch offset, and a soft bench
    assert "coulomb+offset+shear_compliance" in {model.name for model in models}


def test_a_reading_is_of_the_gel_on_which_its_sensor_sits(tmp_path):
    sensors = ("thin", "", "other")
    rows = [log_line(sample_id=f"s{k}", sensor_id=name, fz_n=-1.0 - k) for k, name in enumerate(sensors)]
    log = write_lines(tmp_path / "log.csv", *rows)
    thin = f"{USUAL_GEL}-3.6mm"
    assert read_readings(log, (), {"thin": thin, "": thin}).gels.tolist() == [thin, thin, USUAL_GEL]
    assert read_readings(log).take([2, 0]).gels.tolist() == [USUAL_GEL] * 2


def test_what_an_axis_moved_by_less_than_its_error_is_no_way_sideways(tmp_path):
    rows = [
        log_line(sample_id=f"s{k}", dx_mm=aside, dy_mm=0.0, fz_n=-1.0 - k) for k, aside in enumerate((0.001, 0.2))
    ]
    readings = read_readings(write_lines(tmp_path / "log.csv", *rows))
    assert readings.sheared.tolist() == [False, True] and readings.travel[0] == 0.0


@pytest.mark.parametrize(
    ("prior", "nodes"),
    [
        ({"free": False}, [0.475]),
        # [calibrate.priors.nu] fixed says another one than [material] nu: the solves are at what the model is held at
        ({"free": False, "fixed": 0.45}, [0.45]),
        ({"free": True, "kind": "uniform", "low": 0.45, "high": 0.49}, [0.4504, 0.47, 0.4896]),
        # walkers move in its logarithm, which is below 0
        ({"free": True, "kind": "lognormal", "median": 0.47, "spread": 0.01}, [0.4592, 0.47, 0.4811]),
        # between two of the same value nothing can be interpolated
        ({"free": True, "mean": 0.4995, "spread": 0.0002}, [0.49903, 0.4995]),
        ({"free": True, "kind": "uniform", "low": 0.4996, "high": 0.4999}, [0.4995]),
    ],
)
def test_solves_are_at_poisson_s_ratios_of_the_prior(prior, nodes):
    table = parse(PriorTable, {"kind": "normal", "mean": 0.475, "spread": 0.005, **prior}, Place("a test"))
    params = replace(PARAMS, priors=replace(PARAMS.priors, nu=table))
    assert poisson_nodes(params, 0.475) == pytest.approx(nodes, abs=1e-4)


@pytest.mark.parametrize(
    ("c10", "usual", "says"),
    [
        (0.0725 / 9.80665, 0.0725, "1/9.81 of the usual 0.0725 MPa.*in kilogram-force.*fz_n"),
        (0.0081, 0.0725, "in kilogram-force"),
        (0.0725 / 4.448, 0.0725, "in pound-force"),
        (0.0725 * 102, 0.0725, "102 times the usual.*in gram-force"),
        (0.15 * 1000, 0.15, "1e[+]03 times the usual 0.15 MPa.*in millinewtons"),
        (
            0.0725 * 30,
            0.0725,
            "30 times the usual 0.0725 MPa: most likely forces are not in newtons, or lengths not in mm",
        ),
    ],
)
def test_a_stiffness_that_no_gel_has_is_reported_with_units_as_the_likely_cause(c10, usual, says):
    (said,) = summary.units_sentence(c10, usual)
    assert re.search(says, said)


@pytest.mark.parametrize("ratio", [0.4, 0.9, 1.0, 2.5])
def test_a_softer_or_harder_gel_is_no_matter_of_units(ratio):
    assert summary.units_sentence(0.0725 * ratio, 0.0725) == []
