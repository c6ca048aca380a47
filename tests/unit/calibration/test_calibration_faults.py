"""Readings and chains that must be refused, each by name."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from gelforge.calibration import summary
from gelforge.calibration.emulator import DEPTHS, FRICTIONS, Emulator
from gelforge.calibration.parameters import CHECK, label_of, make_model, prior_of
from gelforge.calibration.posterior import Posterior
from gelforge.calibration.readings import check_enough, check_readings, read_readings
from gelforge.calibration.sampling import Chain, Figures, NotConverged, Rules, complaint, sample, start_points
from gelforge.calibration.solves import make_plan, refuse_no_contact
from gelforge.errors import BadInput
from gelforge.flow.files import read_toml, write_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import read_parameters
from gelforge.flow.schema import Place, parse
from gelforge.flow.tables import Law, PriorTable
from gelforge.geometry.gel import USUAL_GEL
from gelforge.records.press import COLUMNS
from gelforge.stages.calibrate import logged_readings, refuse_beyond
from gelforge.stages.poses import Bodies
from tests.support.calibration_law import PARAMS, law_posterior, make_readings
from tests.support.parameters import place_workflow, write_stage
from tests.support.press_records import log_line, write_lines
from tests.support.refused import refused

DEPTH = np.array([0.5, 1.0, 1.5, 2.0])
FORCE = -np.array([1.65, 5.96, 13.5, 23.3])
RULES = Rules(taus=50, max_steps=3000, seed=3)


def test_good_readings_pass():
    """And a repeated press that has its own reading; one that pulls is no sign error."""
    check_readings(make_readings(DEPTH, FORCE))
    check_readings(make_readings(DEPTH, np.where(DEPTH == 1.5, 5.0, FORCE)))
    check_readings(make_readings([0.5, 1.0, 1.0, 2.0], [-1.65, -5.96, -5.99, -23.3]))


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


def test_forces_that_pull_are_turned_round_or_of_a_sensor_that_was_not_tared():
    for force in (-FORCE, 0.1 - FORCE, 5.0 - FORCE):
        with pytest.raises(BadInput, match=r"fz_n is positive in [34] of the [34] .* opposite sign convention"):
            check_readings(make_readings(DEPTH, force))
    light = FORCE / 10
    for bias in (2.0, 1.9, 5.0):
        with pytest.raises(BadInput, match=r"but falls with depth.* constant force along z without contact: tare it"):
            check_readings(make_readings(DEPTH, light + bias))


def test_rows_without_depth_and_copied_rows_are_named():
    for depth, force, said in (
        ([0.5, 1.0, 0.0, 2.0], FORCE, r"row 4 \(p002\).*no depth and no contact"),
        ([0.5, 1.0, 1.0, 2.0], [-1.65, -5.96, -5.96, -23.3], r"row 4 \(p002\): pose and force repeat an earlier row"),
    ):
        refused(said, check_readings, make_readings(depth, force))


def test_constant_sensor_is_named():
    for value in (-3.2, 0.0):
        refused("in all 4 rows though the presses differ", check_readings, make_readings(DEPTH, np.full(4, value)))


def test_depth_without_contact_is_named():
    readings = make_readings(DEPTH, FORCE)
    table = np.full((4, 3, 5, 3), -1.0)
    table[3] = 0.0
    with pytest.raises(BadInput, match=r"row 5 \(p003\): depth without contact"):
        refuse_no_contact(readings, table)


def test_posterior_deeper_than_the_solves_is_named():
    posterior = law_posterior(np.random.default_rng(1), DEPTH + 0.3)
    middle = posterior.model.draw(np.random.default_rng(0), 1000).mean(axis=0)
    middle[posterior.model.names.index("offset")] = 2.0
    figures = Figures(50, 0, 1.0, 50.0, 0.5, 1.0, "offset")
    chain = Chain(np.tile(middle, (10, 8, 1)), figures)
    for seen, said in (
        ([], r"raise \[calibrate\] reach_mm"),
        (["Readings are in grams-force."], "Readings are in grams-force"),
    ):
        with pytest.raises(
            BadInput, match=f"25 % of the posterior's depths are beyond .* 0.1 mm below the commanded ones; {said}"
        ):
            refuse_beyond(posterior, chain, 0.1, seen)


def test_a_press_that_slides_may_lie_beyond_its_solves_as_far_as_others_are_solved():
    """It is solved to a third of the reach; the forces of this table are 0, so that each depth is the offset deeper."""
    readings = make_readings([0.1, 0.2, 0.25], [-0.1, -0.3, -0.4], sheared=True)
    top = make_plan(readings, 0.15, "coulomb", [0.25, 0.6], 0.475).top
    assert top == pytest.approx(readings.depth + 0.05)
    emulator = Emulator(np.zeros((3, FRICTIONS, DEPTHS, 3)), top, np.zeros(3, int), readings.travel)
    model = make_model(PARAMS, "coulomb", sideways=True)
    posterior = Posterior(emulator, model, readings.depth, readings.force, PARAMS.tail)
    at, offset = model.draw(np.random.default_rng(0), 1000).mean(axis=0), model.free["offset"]
    figures = Figures(50, 0, 1.0, 50.0, 0.5, 1.0, "offset")
    for deeper, beyond in ((0.04, False), (0.14, False), (0.16, True)):
        at[model.names.index("offset")] = offset.quantile(offset.law.cdf(deeper))
        chain = Chain(np.tile(at, (10, 8, 1)), figures)
        assert posterior.emulator.forces(readings.depth, model.values(chain.flat()))[2][0] == pytest.approx(
            readings.depth + deeper, abs=1e-3
        )
        if not beyond:
            refuse_beyond(posterior, chain, 0.15)
            continue
        with pytest.raises(BadInput, match=r"100 % of the posterior's depths .* 0.15 mm below the commanded ones"):
            refuse_beyond(posterior, chain, 0.15)


def test_a_parameter_outside_of_its_prior_is_said_with_what_to_check():
    """Of a chain that converged, too: each parameter in turn, and nothing of draws from the priors."""
    model = make_model(PARAMS, "coulomb", ("ball", "cube"))
    usual, figures = model.draw(np.random.default_rng(0), 2000), Figures(10, 0, 1.0, 10.0, 0.5, 1.0, "offset")

    def said(draws):
        chain = Chain(draws[:, None], figures)
        told = summary.sentences(summary.parameter_table(chain, model), summary.correlations(chain, model), model)
        return [line for line in told if "outside of what its prior expects" in line]

    assert said(usual) == []
    for at, (name, prior) in enumerate(model.free.items()):
        key = "indenter" if name.startswith("scale of ") else name
        beyond = usual.copy()
        beyond[:, at] = prior.quantile(1.0 - 1e-3 * np.random.default_rng(1).random(len(usual)))
        told = [f"The {label_of(name)} is" in line and CHECK[key] in line for line in said(beyond)]
        assert told == ([True] if key in CHECK else [])


def test_a_single_reading_is_refused():
    check_enough(2)
    with pytest.raises(BadInput, match="log two presses or more"):
        check_enough(1)


def test_a_chain_that_is_too_short_or_whose_walkers_differ_is_refused_with_figures_and_hint():
    posterior = law_posterior(np.random.default_rng(1), DEPTH)
    with pytest.raises(NotConverged, match=r"in 20 steps: \d+ autocorrelation .* acceptance 0\.\d+.* max_steps"):
        sample(posterior, replace(RULES, max_steps=20))
    apart = Figures(3000, 500, 20.0, 125.0, 0.3, 1.4, "offset")
    assert not apart.meets(RULES)
    assert "Walkers disagree on offset, as if it had two modes" in complaint(apart, RULES, [])
    with pytest.raises(
        NotConverged,
        match=r"The touch offset \(mm\) is .*, outside of what its prior expects .* check how touch was found",
    ):
        far = law_posterior(np.random.default_rng(1), np.tile(DEPTH, 5), offset=0.3)
        sample(far, replace(RULES, max_steps=200))


def test_draws_whose_forces_are_no_numbers_matter_only_where_too_few_others_are_left():
    """A stiffness whose prior reaches beyond the largest number, in a few draws of a thousand or in half of them."""
    posterior, prior = law_posterior(np.random.default_rng(1), DEPTH), {"kind": "lognormal", "median": 0.08}
    with np.errstate(all="ignore"):
        for spread in (200.0, 2000.0):
            wide = prior_of(parse(PriorTable, {**prior, "spread": spread}, Place("a test")))
            one = replace(posterior, model=replace(posterior.model, free={**posterior.model.free, "c10": wide}))
            starts = start_points(one, 30, np.random.default_rng(5))
            assert len(np.unique(starts, axis=0)) == 30 and np.isfinite(one(starts)).all()
            assert np.isneginf(one(one.model.draw(np.random.default_rng(0), 6000))).any()
        table = np.full_like(posterior.emulator.table, np.nan)
        model = posterior.model  # with touch held, so that every draw presses
        free = {name: prior for name, prior in model.free.items() if name != "offset"}
        held = replace(model, free=free, fixed={**model.fixed, "offset": 0.0})
        mute = replace(posterior, model=held, emulator=replace(posterior.emulator, table=table))
        with pytest.raises(BadInput, match=r"only 0 of 6000 draws .* 30 are needed .* units of the log"):
            start_points(mute, 30, np.random.default_rng(5))


def test_unreadable_logs(tmp_path):
    header = "sample_id,indenter,x0_mm,y0_mm,z0_mm,dx_mm,dy_mm,dz_mm,rot_deg,fx_n,fy_n,fz_n,image"
    for text, said in (
        ("sample_id,indenter\na,s\n", "column x0_mm is missing"),
        (f"{header}\na,s,0,0,0,0,0,-1,0,,,,\n", "no row has a normal force"),
        (f"{header}\na,s,0,0,0,0,0,-1,0,,,x,\n", r"row 2, column fz_n: 'x': not a finite number"),
        (f"{header}\na,s,0,0,0,0,0,nan,0,,,-1,\n", r"row 2, column dz_mm: 'nan': not a finite number"),
    ):
        (tmp_path / "log.csv").write_text(text)
        refused(said, read_readings, tmp_path / "log.csv")


def test_unusable_priors():
    for table, said in (
        ({"kind": "gauss"}, "kind = 'gauss': give"),
        ({"kind": "normal", "mean": 0.0}, "spread is missing: a prior of kind"),
        ({"kind": "normal", "mean": 0.0, "spread": 0.0}, "has no width"),
        ({"kind": "lognormal", "median": -1.0, "spread": 1.0}, "needs a positive one"),
    ):
        refused(said, parse, PriorTable, table, Place("a test", ("calibrate", "priors", "c10")))


def planned(tmp_path, *rows, columns=COLUMNS, **poses):
    """The layout of a dataset with these rows in one shard, and the parameters of calibrate."""
    of = Layout(place_workflow(tmp_path) / "results/lab")
    of.shards.mkdir(parents=True)
    write_lines(of.shard("0000"), *rows, columns=columns)
    write_json(of.parameters("sensors"), read_toml(tmp_path / "workflow/sensors.toml"))
    indenters = read_toml(tmp_path / "workflow/indenters.toml")
    write_stage(of.params, "calibrate", poses=poses)
    return of, read_parameters(of.parameters("calibrate")), Bodies(indenters, tmp_path / "workflow")


def test_rows_serve_that_stage_10_would_take_by_their_commanded_path(tmp_path):
    """Neither 10_poses nor an image is read: calibration comes before both."""
    presses = (("a", "sphere_15", -1), ("b", "sphere_15", "deep"), ("c", "sphere_15", -1.2), ("d", "sphere_99", -1),
               ("e", "sphere_15", -2.5))  # fmt: skip
    rows = [log_line(sample_id=name, sensor_id="mini_a", indenter=body, z0_mm=0, dz_mm=dz, fz_n=-k, image="")
            for k, (name, body, dz) in enumerate(presses, 1)]  # fmt: skip
    assert logged_readings(*planned(tmp_path / "usual", *rows)).ids.tolist() == ["a", "c", "e"]
    assert logged_readings(*planned(tmp_path / "shallow", *rows, deepest_share=0.4)).ids.tolist() == ["a", "c"]
    tilted = logged_readings(*planned(tmp_path / "tilted", *rows[:1], tilt_deg=[0.5, -1.0])).pose[:, -2:]
    assert tilted.tolist() == [[0.5, -1.0]]
    columns = (*COLUMNS, "mounting")
    again = log_line(
        columns, sample_id="a", sensor_id="mini_a", indenter="sphere_15", dz_mm=-1, fz_n=-1, mounting="m2"
    )
    bench = {"tilt_deg": [0.5, -1.0], "mounting_tilt_deg": {"m2": [2.0, 0.0]}}
    mounted = planned(tmp_path / "mounted", f"{rows[2]},", again, columns=columns, **bench)
    assert logged_readings(*mounted).pose[:, -2:].tolist() == [[0.5, -1.0], [2.0, 0.0]]
    bad = planned(tmp_path / "bad", rows[1], rows[3])
    refused(r"every row with a normal force \(fz_n\) is rejected, the first: .*deep", logged_readings, *bad)
    assert not (tmp_path / "usual/results/lab/10_poses").exists()


def test_parameters_are_held_where_the_table_says_so_or_nothing_determines_them():
    held = replace(PARAMS.priors.offset, free=False, fixed=0.02)
    params = replace(PARAMS, priors=replace(PARAMS.priors, offset=held))
    for law in get_args(Law):
        model = make_model(params, law, ("ball", "cube"))
        assert model.fixed["offset"] == 0.02 and ("mu" in model.free) == (law == "coulomb")
        assert {"tare_x", "tare_z", "shear_compliance", "scale of ball", "scale of cube"} <= set(model.free)
        straight = make_model(params, law, ("ball",), sideways=False)
        assert straight.fixed["shear_compliance"] == straight.fixed["tare_x"] == 0.0
        assert "tare_z" in straight.free and "scale of ball" not in straight.free


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
