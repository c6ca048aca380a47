"""Stages 30 to 50 in process: every press has hexahedra of its own and no mesh file."""

import re
import shutil

import numpy as np
import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, read_toml, write_csv, write_text
from gelforge.flow.layout import Layout
from gelforge.geometry.gel import GELS, Gel
from gelforge.geometry.indenters import build
from gelforge.mechanics.material import Material
from gelforge.mechanics.mesh.names import load_mesh
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solve import Solvers
from gelforge.records import forcefile, labelfile
from gelforge.records.forcefile import ForceFile
from gelforge.records.labelfile import read_labels
from gelforge.records.press import Press
from gelforge.stages import fea, forces, labels
from tests.support.parameters import parameters, write_stage, write_used

SENSOR = "gelsight_mini"
BALL = {"kind": "sphere", "diameter": 15, "height": 10}
COLUMNS = ("sample_id", "sensor_id", "indenter", "x0_mm", "y0_mm", "z0_mm", "dx_mm", "dy_mm", "dz_mm", "rot_deg")
# Two that share their hexahedra, one elsewhere, which a second sensor saw, too, one above the gel, one through the gel.
PRESSES = {
    "one": (SENSOR, "ball", 0, 0, 0, 0.1, 0, -0.6, 0), "same": (SENSOR, "ball", 0, 0, 0, 0.1, 0.01, -0.6, 0),
    "aside": (SENSOR, "ball", 3, -4, -0.2, 0, 0, -0.5, 0), "seen": ("mini_a", "ball", 3, -4, -0.2, 0, 0, -0.5, 0),
    "above": (SENSOR, "ball", 0, 0, 2, 0, 0, -0.5, 0), "through": (SENSOR, "ball", 0, 0, 0, 0, 0, -4.5, 0),
}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A shard solved at quality demo, with its forces and labels."""
    of = Layout(tmp_path_factory.mktemp("hex") / "results/lab")
    rows = [dict(zip(COLUMNS, (name, *press), strict=True)) for name, press in PRESSES.items()]
    write_csv(of.poses("0000"), COLUMNS, rows)
    write_text(of.shard("0000"), "")
    write_stage(of.params, "fea", fea={"method": "draft"}, interface={"law": "no_slip"})
    write_stage(of.params, "forces")
    write_stage(of.params, "labels")
    write_used(of, sensors=read_toml("workflow/sensors.toml"), indenters={"ball": BALL})
    for module, words in ((fea, ["0000"]), (forces, ["0000"]), (labels, ["24x32", "0000"])):
        assert module.main([str(of.root), *words]) == 0
    return of.root


def test_every_press_names_its_bricks(made):
    rows = {row["sample_id"]: row for row in read_csv(made / "30_fea" / "0000.csv")}
    statuses = {name: row["status"] for name, row in rows.items()}
    assert statuses.pop("through") == "OUT_OF_RANGE" and "below the gel's base" in rows["through"]["reason"]
    assert statuses == {"one": "OK", "same": "OK", "aside": "OK", "seen": "OK", "above": "NO_CONTACT"}
    assert rows["aside"]["mesh"] == rows["seen"]["mesh"] != rows["one"]["mesh"]
    assert all(len(load_mesh(row["mesh"]).nodes) > 100 for row in rows.values())


def test_a_press_that_two_sensors_saw_is_solved_once(made):
    """Both rows have its key, and a second run finds it in the store."""
    keys = {row["sample_id"]: row["key"] for row in read_csv(made / "30_fea" / "0000.csv")}
    assert keys["seen"] == keys["aside"] and len(set(keys.values())) == len(keys) - 1
    files = sorted((made.parent / "solves").glob("*.*"))
    assert len(files) == 2 * 5 - 1  # a press that is out of range has no arrays
    before = [path.stat().st_mtime_ns for path in files]
    assert fea.main([str(made), "0000"]) == 0
    assert [path.stat().st_mtime_ns for path in files] == before


def test_force_is_kept_from_solve_to_label(made):
    solved = {row["sample_id"]: [float(row[f"f{c}_n"]) for c in "xyz"] for row in read_csv(made / "30_fea/0000.csv")}
    found = read_labels(made / "50_labels/24x32/0000.npz")
    with ForceFile(made / "40_forces/0000.npz") as forced:
        for at, name in enumerate(forced.sample_id):
            label, outside = found.label[at].astype(float), found.outside[at]
            if name == "through":
                assert np.isnan(label).all()
                continue
            got = label.sum(axis=(1, 2)) + outside  # cells are float32
            size = np.linalg.norm(forced.total[at])
            assert np.abs(got - forced.total[at]).max() <= 1e-6 * size
            # the table is rounded to six digits
            np.testing.assert_allclose(forced.total[at], solved[str(name)], atol=1e-5 * max(size, 1e-9))


UNIT = re.compile(r"\b(N mm|N|kPa|MPa|mm\^2|mm)\b")


def units_of(module):
    """Unit of each array by the table of a format; None: of what has none."""
    rows = [line.strip("| ").split(" | ") for line in module.__doc__.splitlines() if line.startswith("| ")]
    for names, _, meaning in (row for row in rows if row[0][:3] not in ("arr", "---")):
        names, units = names.split(", "), UNIT.findall(meaning) or [None]
        yield from zip(names, units if len(units) == len(names) else units[:1] * len(names), strict=True)


def test_twice_the_stiffness_doubles_all_that_is_a_force_a_moment_or_a_pressure_and_nothing_else(made, tmp_path):
    """By the formats' own tables of units; arrays of indices and names have none."""
    found = []
    for c10 in (0.08, 0.16):
        of = Layout(shutil.copytree(made, tmp_path / str(c10) / "results/lab"))
        shutil.copytree(made.parent / "solves", of.solves)
        rows = read_csv(of.fea("0000"))
        for at, row in enumerate(rows):  # as if some slipped
            row["friction_error_n"] = str(0.01 * at)
        write_csv(of.fea("0000"), list(rows[0]), rows)
        intervals = {"c10_interval68": [0.9 * c10, 1.1 * c10], "c10_interval95": [0.8 * c10, 1.2 * c10]}
        write_stage(of.params, "forces", material={"c10": c10, **intervals})
        write_stage(
            of.params, "labels", labels={"channels": ["force", "traction", "traction_deformed", "displacement"]}
        )
        sensors = read_toml("workflow/sensors.toml")
        sensors[SENSOR]["projection"][0][2] += 130.0  # the image ends within a contact
        write_used(of, sensors=sensors)
        for module, words in ((forces, ["0000"]), (labels, ["24x32", "0000"])):
            assert module.main([str(of.root), *words]) == 0
        found.append([dict(np.load(path)) for path in (of.forces("0000"), of.labels("24x32", "0000"))])
    for module, once, twice in zip((forcefile, labelfile), *found, strict=True):
        units = dict(units_of(module))
        assert once.keys() == twice.keys() <= units.keys()
        for name, array in once.items():
            scales = units[name] in ("N", "N mm", "kPa", "MPa") and array.dtype.kind == "f"
            if array.dtype.kind != "f":
                np.testing.assert_array_equal(twice[name], array, name)
            else:
                assert np.nan_to_num(array).any(), name
                np.testing.assert_allclose(twice[name], (2 if scales else 1) * array, rtol=1e-6, err_msg=name)


AT_RIM = Press(1.3, -9.7, -0.3, 0, 0, -0.7, 30)


@pytest.mark.parametrize(
    ("method", "press"),
    [("draft", Press(0, 0, 0, 0.1, 0, -0.6)), ("draft", AT_RIM), pytest.param("ccx", AT_RIM, marks=pytest.mark.slow)],
)
def test_the_mesh_of_a_name_is_the_one_that_was_solved(tmp_path, ccx, press, method):
    solvers = Solvers(tmp_path, parameters(fea={"method": "draft"}).fea)
    result = solvers.solve(Scene(GELS[SENSOR], Material(), build("ball", BALL), press), method)
    again = load_mesh(result.evidence["mesh"])
    assert result.status.valid
    for part in ("nodes", "elements", "faces", "base"):
        assert np.array_equal(getattr(again, part), getattr(result.mesh, part)), part


def test_a_gel_or_quality_that_no_name_can_hold_is_refused(tmp_path):
    solvers = Solvers(tmp_path, parameters(fea={"method": "draft"}).fea)
    scene = Scene(Gel(height=5.0), Material(), build("ball", BALL), Press(0, 0, 0, 0, 0, -0.5))
    with pytest.raises(BadInput, match="gelsight_mini"):
        solvers.solve(scene, "draft")
    with pytest.raises(BadInput, match="draft, label, fine"):
        solvers.solve(scene, "best")
