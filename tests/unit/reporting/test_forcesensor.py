"""Labels against a force sensor: what presses share, and which press differs from the others."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.flow.schema import altered
from gelforge.flow.tables import MaterialTable
from gelforge.reporting.forcesensor import (
    EXPECTED,
    NAMED,
    POWER,
    Spreads,
    common_sentences,
    compare_forces,
    expected_rows,
    force_sentences,
    spreads,
)
from tests.support.calibration_law import PARAMS, law_session, true_values

OF = Spreads(c10=0.02, low=0.95, high=1.06, indenter=0.015, noise=0.05, tare=0.03, scatter=0.003, zero=0.02,
             compliance=0.001, seating=0.1, tilt={"block": 0.03})  # fmt: skip
ALONE = replace(OF, c10=0.0, indenter=0.0, tare=0.0, zero=0.0, compliance=0.0, seating=0.0, tilt={})


def drawn(rng, count=40, of=OF):
    """Presses of two mountings and three indenters, whose readings are drawn from the very spreads that the page assumes."""
    names, mountings = (
        np.array(["ball", "block", "bar"])[np.arange(count) % 3],
        np.array(["", "b"])[np.arange(count) % 2],
    )
    label, depth = rng.uniform(1.0, 30.0, count), rng.uniform(0.3, 1.2, count)
    own = np.linalg.norm([of.noise / label, np.full(count, 0.005), POWER * of.scatter / depth], axis=0)
    away = own * rng.standard_normal(count) + of.c10 * rng.standard_normal() + of.tare / label * rng.standard_normal()
    for name in ("ball", "block", "bar"):
        away[names == name] += of.indenter * rng.standard_normal()
    for name in ("", "b"):
        mine = mountings == name
        tilt = np.array([of.tilt.get(each, 0.0) for each in names[mine]])
        away[mine] += of.seating * rng.standard_normal() + POWER * of.zero / depth[mine] * rng.standard_normal()
        away[mine] += tilt * rng.standard_normal()
    away -= of.compliance * POWER * label / depth * rng.standard_normal()
    return [{"id": f"s{i}", "indenter": names[i], "mounting": mountings[i], "z0_mm": 0.0, "dz_mm": -depth[i], "label_fz": -label[i],
             "measured_fz": -label[i] * (1.0 + away[i]), "outside_fz": 0.0, "error_n": 0.01 * label[i]} for i in range(count)]  # fmt: skip


def test_deviations_have_an_rms_of_one_and_a_fifth_too_much_in_one_press_is_named():
    """However far all presses, those of a mounting or of an indenter are from their labels together."""
    found = np.concatenate(
        [[p.deviations for p in compare_forces(drawn(np.random.default_rng(k)), OF, set())] for k in range(20)]
    )
    assert 0.9 < np.sqrt(np.mean(found**2)) < 1.1 and np.mean(np.abs(found) > NAMED) < 0.01
    for at in range(40):
        rows = drawn(np.random.default_rng(at))
        rows[at]["measured_fz"] *= 1.2
        first, *_ = (
            said for said in force_sentences(compare_forces(rows, OF, set())) if "standard deviations" in said
        )
        assert first.startswith(f"s{at} (")


def test_what_a_press_does_not_share_is_noise_mesh_and_scatter_by_hand():
    """A press alone is judged by them: nothing else is left where nothing is shared."""
    (row,) = drawn(np.random.default_rng(0), 1)
    row |= {"label_fz": -9.5, "outside_fz": -0.7, "measured_fz": -10.0, "dz_mm": -0.5, "error_n": 0.2}
    unread = [row | {"measured_fz": None}, row | {"label_fz": np.nan}, {"id": "row 3"}]
    (found,) = compare_forces([row, *unread], ALONE, {"s0"})
    own = np.linalg.norm([0.05 / 10.2, 0.1 / 10.2, POWER * 0.003 / 0.5])
    assert found.label == pytest.approx(-10.2) and found.used and found.own == pytest.approx(own)
    assert found.deviations == pytest.approx((10.0 / 10.2 - 1.0) / own) and found.expected == found.label
    assert [found.low, found.high] == pytest.approx([-10.2 * 1.06, -10.2 * 0.95])
    assert [each[0] for each in expected_rows([found], [row], ALONE)] == ["press"]


def test_every_expected_cause_has_its_size_and_one_sentence():
    rows = drawn(np.random.default_rng(1))
    for row in rows:
        row |= {"friction_error_n": 0.1, "label_fx": 0.5}
    table = {name: float(size) for name, _, size, _ in expected_rows(compare_forces(rows, OF, set()), rows, OF)}
    assert table.keys() == EXPECTED.keys() and table["material"] == 2.0 and table["seating"] == 10.0
    block = np.mean([row["indenter"] == "block" for row in rows])
    assert table["tilt"] == pytest.approx(3.0 * block**0.5, abs=0.06)


# A bench with one cause that labels do not follow, and the first words of the first sentence.
COMMON = {
    "c10": ({"c10": 0.09}, "C10 (MPa)"),
    "gain": ({"gain": 0.82}, "C10 (MPa)"),
    "touch too late": ({"offset": 0.09}, "touch offset (mm)"),
    "touch too early": ({"offset": -0.06}, "touch offset (mm)"),
    "friction": ({"mu": 0.3}, "friction coefficient"),
    "tare": ({"tare": 1.0}, "constant force along z (N)"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMON)
def test_what_all_presses_share_is_named_first_and_no_press_for_it(name):
    from gelforge.calibration.summary import parameter_table
    from gelforge.stages.calibrate import calibrate

    fault, said = COMMON[name]
    gain, tare = fault.get("gain", 1.0), fault.get("tare", 0.0)
    truth = {"c10": 0.0725, "compliance": 0.002, "offset": 0.0, "mu": 0.73} | fault
    session, emulator = law_session(1, **{key: truth[key] for key in ("c10", "compliance", "offset", "mu")})
    session = replace(session, force=gain * session.force - [0.0, 0.0, tare])
    assumed = {
        "c10": 0.0725,
        "offset": 0.0,
        "compliance": 0.0,
        "mu": 0.73,
        "tilt_x": 0.0,
        "tilt_y": 0.0,
        "tare_z": 0.0,
    }
    values = {
        **true_values(**{key: assumed[key] for key in ("c10", "offset", "compliance", "mu")}),
        "indenter": np.zeros((1, 3)),
    }
    label = emulator.forces(session.depth, values)[0][0]
    done, _ = calibrate(session, emulator, altered(PARAMS, autocorrelation_times=10), "coulomb", session, 0.0725)
    table = parameter_table(done.chain, done.posterior.model)
    summary = {"c10": table.pop("c10"), "parameters": table}
    rows = [{"id": str(i), "indenter": session.indenters[i], "z0_mm": 0.0, "dz_mm": -session.depth[i], "outside_fz": 0.0, "error_n": 0.02 * abs(label[i, 2]),
             "label_fz": label[i, 2], "measured_fz": session.force[i, 2]} for i in range(len(label))]  # fmt: skip
    of = spreads(MaterialTable(0.475, 0.0725), summary, PARAMS, follows=False)
    presses = compare_forces(rows, of, set())
    first, *others = common_sentences(rows, presses, summary, assumed)
    assert first.startswith(f"{said}: labels assume") and ("Tare" if tare else '"calibrated"') in first
    assert not any(said in other for other in others)
    assert not any("standard deviations" in sentence for sentence in force_sentences(presses))
