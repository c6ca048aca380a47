"""[fea] verify: presses are solved by a second method, too, and differences are reported with what they show."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import read_json, read_toml, write_text
from gelforge.flow.layout import Layout
from gelforge.geometry.gel import GELS
from gelforge.geometry.indenters import build
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Interface, Scene
from gelforge.records.press import Press
from gelforge.stages import fea
from gelforge.stages.report import verified_section
from gelforge.sweeps import verification
from gelforge.sweeps.verification import Verified
from tests.support.meshed import place_mesh
from tests.support.parameters import parameters, write_stage, write_used

HEADER = "sample_id,sensor_id,gel_id,indenter,x0_mm,y0_mm,z0_mm,dx_mm,dy_mm,dz_mm,rot_deg\n"


@pytest.fixture
def folder(root, tmp_path):
    """Inputs of stage 30: one press of a ball."""
    of = Layout(tmp_path / "results/lab")
    sensor = read_toml(root / "workflow" / "sensors.toml")["gelsight_mini"]
    ball = {"kind": "sphere", "diameter": 15, "height": 10}
    write_used(of, sensors={"gelsight_mini": sensor}, indenters={"ball": ball})
    place_mesh(of)
    write_text(of.poses("0000"), HEADER + "s0,gelsight_mini,g,ball,0,0,0,0,0,-0.4,0\n")
    return of.root


def solve(folder, verify: float, **fea_table) -> list[Verified]:
    table = {"method": "auto", "tolerance": 0.05, "verify": verify, **fea_table}
    write_stage(folder / "00_plan/params", "fea", fea=table)
    assert fea.main([str(folder), "0000"]) == 0
    return verification.read_verified([folder / "30_fea" / "0000"])


def kept(folder) -> dict[str, int]:
    """When each file of the store was written."""
    return {path.name: path.stat().st_mtime_ns for path in Layout(folder).solves.iterdir()}


def test_a_verified_press_has_a_difference_and_limits(folder, ccx):
    """Nothing is solved twice, and another fraction leaves the press's own solve alone."""
    (found,) = solve(folder, 1.0)
    assert (found.sample_id, found.method, found.second, found.reason) == ("s0", "draft", "ccx", "")
    # edges shrink under a narrow contact, so even coarse tetrahedra are within what both solves state
    assert 0 < found.total < 0.05 and found.total < found.cells < 0.2 and not found.beyond
    records = [read_json(path) for path in Layout(folder).solves.glob("*.json")]
    own, twin = sorted(records, key=lambda record: record["method"], reverse=True)
    assert (own["method"], twin["method"]) == ("draft", "ccx") and twin["deck"]
    right = np.array(twin["total"])
    stated = own["evidence"]["error_n"] + twin["evidence"]["error_n"]
    assert found.limit_total == pytest.approx(stated / np.linalg.norm(right))
    assert found.total == pytest.approx(np.linalg.norm(right - own["total"]) / np.linalg.norm(right), rel=1e-3)
    times = kept(folder)
    assert solve(folder, 0.9999) == [found] and kept(folder) == times
    assert solve(folder, 0.0) == [] and kept(folder) == times


def test_calculix_own_contact_checks_ccx_without_friction():
    """At the end of the path alone, with a hard penalty; how near both are: tests/physics/test_calculix_contact.py."""
    press = Press(0.0, 0.0, 0.0, 0.3, 0.0, -0.4)
    ball = build("ball", {"kind": "sphere", "diameter": 15, "height": 10})
    frames = [
        Scene(GELS["gelsight_mini"], Material(), ball, end, Interface("coulomb", 0.5)) for end in (press, press)
    ]
    check = verification.check_of("ccx", frames, parameters().fea)
    (end,) = check.scenes
    assert end.interface.law == "frictionless" and end.press.x0 + end.press.dx == pytest.approx(0.3)
    assert (check.first.method, check.second.method) == ("ccx", "ccx-contact")
    assert check.second.contact_stiffness == verification.HARD
    other = verification.check_of("label", frames, parameters().fea)
    assert other.scenes == frames and other.first is None and other.second.method == "ccx"


def made(name: str, total: float, cells: float) -> Verified:
    forces = np.array([0.0, 0.0, -1.0]), np.zeros((3, 1, 1))
    found = forces[0] * (1 + total), np.full((3, 1, 1), cells / np.sqrt(3))
    return verification.compare(("k", name, "label", "ccx"), [(0.01, 0.08), (0.03, 0.12)], found, forces)


def test_a_difference_beyond_both_errors_is_named_and_more_than_one_in_twenty_are_refused():
    fine, odd = [made(f"s{i}", 0.03, 0.19) for i in range(19)], made("odd", 0.03, 0.21)
    assert not any(one.beyond for one in fine) and odd.beyond and made("heavy", 0.05, 0.0).beyond
    failed = replace(odd, reason="no equilibrium", total=None, cells=None)
    verification.refuse_beyond([*fine, odd, failed])  # one in twenty; what was not solved is none of them
    reported = [item["text"] for item in verified_section([*fine, odd, failed]).items if item["kind"] == "text"]
    assert any("odd: label and ccx differ by 3.0% of total force" in text for text in reported)
    assert any("not verified: no equilibrium" in text for text in reported)
    for unsolved in ([], [failed] * 30):  # which excuse none of the others
        with pytest.raises(BadInput, match='2 of 20 verified presses differ .* odd.* method = "ccx"'):
            verification.refuse_beyond([*fine[1:], odd, replace(odd, sample_id="second"), *unsolved])


def test_the_choice_of_presses_is_a_fraction_and_grows_with_it():
    names = [f"lab-{i:06d}" for i in range(4000)]
    few, more = ({n for n in names if verification.chosen(n, f)} for f in (0.05, 0.1))
    assert few < more and 0.04 < len(few) / len(names) < 0.06
    assert not any(verification.chosen(n, 0.0) for n in names) and all(verification.chosen(n, 1.0) for n in names)
