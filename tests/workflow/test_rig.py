"""A tiny plan through the real bench: resume, growth, repetition, another plan in the same folder."""

import re
import shutil

import cv2
import numpy as np
import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, read_json
from gelforge.records.frames import check_frames, presses_of
from gelforge.records.log import read_log, read_presses
from gelforge.records.press import parse
from gelforge.stages import rig
from gelforge.stages.rig import main, run
from gelforge.virtualrig.rigplan import orders, read_plan
from gelforge.virtualrig.writer import Dataset
from tests.support.sandbox import ROOT

DEMO = ROOT / "workflow" / "rig" / "demo.toml"


def plan_of(folder, presses: int, *changes):
    """The demo plan, shallow and short, of one mounting and indenter, which slips freely: it is solved in a quarter of the time."""
    text = DEMO.read_text(encoding="utf-8").replace("presses = 23", f"presses = {presses}")
    text = text.replace("depth_mm = [0.3, 1.5]", "depth_mm = [0.2, 0.4]").replace("friction = 0.7", "friction = 0.0")
    text = re.sub("(?m)^indenters = .*$", 'indenters = ["sphere_10"]', text)
    text = re.sub(r"(?s)\[(film|mountings)\].*?\n\n", "", text)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "plan.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    """A dataset of two presses, which tests copy and leave as it is."""
    folder = tmp_path_factory.mktemp("rig")
    return run(plan_of(folder, 2), folder / "data", ROOT / "workflow")


@pytest.fixture
def two(pressed, tmp_path):
    """A dataset of two presses."""
    return shutil.copytree(pressed, tmp_path / "two" / pressed.name)


BOTH = 'sensors = ["mini_a"]', 'sensors = ["mini_a", "mini_e"]\nseen_by = 2'


@pytest.fixture(scope="module")
def seen_by_both(tmp_path_factory):
    """The folder of a plan and of its dataset: one press that two sensors see. Tests leave it as it is."""
    folder = tmp_path_factory.mktemp("both")
    run(plan_of(folder, 1, BOTH), folder / "data", ROOT / "workflow")
    return folder


def test_log_and_images_are_what_the_importer_expects(two):
    rows = read_log(two / "log.csv")
    for row in rows:
        sample, wrong = parse(row, "log.csv")
        assert not wrong
        image = cv2.imread(str(two / sample.image))
        assert image.shape == (240, 320, 3)
        assert sample.fz_n < 0 > sample.dz_mm
    assert (two / "dataset.toml").is_file()
    assert {path.stem for path in (two / "nocontact").iterdir()} == {"mini_a", "mini_b", "mini_e"}


def test_one_press_seen_by_two_sensors_is_carried_out_once(seen_by_both):
    data = seen_by_both / "data/demo"
    one, other = read_csv(data / "log.csv")
    assert [one.pop("sensor_id"), other.pop("sensor_id")] == ["mini_a", "mini_e"]
    pictures = [cv2.imread(str(data / row.pop("image"))) for row in (one, other)]
    assert np.abs(pictures[0].astype(int) - pictures[1]).mean() > 5
    assert one.pop("sample_id") != other.pop("sample_id")
    assert one == other
    assert len(list((data / "truth" / "surfaces").iterdir())) == 1


def test_a_flat_press_on_a_tilted_mounting_pushes_beside_its_tip(tmp_path):
    """Two mountings that lean otherwise: the log names them, and its moments show on which side each touches."""
    table = "[mountings]\npresses = 1\ntilt_deg = [2, 3]\ntouch_offset_mm = [-0.1, -0.05]\n\n[truth]"
    plan = plan_of(tmp_path, 2, ("[truth]", table), ('"sphere_10"', '"cuboid_10"'), ("[0.0, 0.4]", "[0.0, 0.0]"))
    data = run(plan, tmp_path / "data", ROOT / "workflow")
    log, truth = read_presses(data / "log.csv"), read_csv(data / "truth" / "presses.csv")
    assert [press.mounting for press in log] == ["mounting_01", "mounting_02"]
    drawn = read_json(data / "truth" / "truth.json")["mountings"]
    for press, true in zip(log, truth, strict=True):
        tilt = np.array([float(true["tilt_x_deg"]), float(true["tilt_y_deg"])])
        np.testing.assert_allclose(tilt, drawn[press.mounting]["tilt_deg"], atol=1e-4)
        assert press.tilt == (0.0, 0.0)  # the log does not know it
        pushed = np.array([-press.my_nm, press.mx_nm]) / press.fz_n * 1e3 - [press.x0_mm, press.y0_mm]
        lower = np.array([tilt[1], -tilt[0]])  # about y, the side at +x sinks; about x, the side at -y
        assert pushed @ lower / np.hypot(*lower) > 0.1


@pytest.mark.parametrize("friction", [0.0, pytest.param(0.7, marks=pytest.mark.slow)])
def test_the_moments_of_a_press_are_frames_of_one_path_at_little_more_than_its_price(two, tmp_path, friction):
    """Four frames: rows that belong together, forces that grow, each with its own picture; the last is the press alone."""
    slips = "friction = 0.0", f"friction = {friction}"
    alone = run(plan_of(tmp_path, 1, slips), tmp_path / "alone", ROOT / "workflow") if friction else two
    plan = plan_of(tmp_path, 1, slips, ('dataset = "demo"', 'dataset = "demo"\nframes = 4'))
    data = run(plan, tmp_path / "data", ROOT / "workflow")
    film = read_presses(data / "log.csv")
    assert check_frames(film, "log.csv") == [] and [len(press) for press in presses_of(film)] == [4]
    assert len({(data / press.image).read_bytes() for press in film}) == 4
    single, truth = read_presses(alone / "log.csv")[0], read_csv(data / "truth" / "presses.csv")
    assert np.linalg.norm(film[-1].force - single.force) < 0.02 * np.linalg.norm(single.force) + 0.05
    assert all(later.fz_n < before.fz_n + 0.2 for before, later in zip(film, film[1:], strict=False))
    assert film[0].fz_n > 0.6 * film[-1].fz_n
    if friction:
        # counted along one path, from its touch to each frame; each ends in a tight equilibrium of its own
        counted = [int(row["newton_iterations"]) for row in truth]
        assert min(counted[2:]) > max(counted[:2])
    lost = data / film[2].image
    kept = lost.read_bytes()
    lost.unlink()
    run(plan, tmp_path / "data", ROOT / "workflow")
    assert lost.read_bytes() == kept


def test_log_hides_what_the_truth_knows(two):
    log, truth = read_csv(two / "log.csv"), read_csv(two / "truth" / "presses.csv")
    hidden = read_json(two / "truth" / "truth.json")["truth"]
    for seen, real in zip(log, truth, strict=True):
        given_way = float(real["dz_mm"]) - float(seen["dz_mm"])
        # the frame gives way by compliance times force; the CNC is good to a quarter of a micrometre
        assert abs(given_way + hidden["compliance_mm_per_n"] * float(real["fz_n"])) < 0.5e-3
        assert abs(float(real["z0_mm"]) - hidden["touch_offset_mm"]) < 5 * hidden["touch_scatter_mm"] + 0.5e-3
        assert abs(float(seen["fz_n"]) - float(real["fz_n"])) < 0.3
    assert "truth" not in (two / "log.csv").read_text()


def assert_same_rows(rows: list[dict], others: list[dict]) -> None:
    """Equal but for rounding in the last digit written: several threads add in another order each time."""
    assert len(rows) == len(others)
    for row, other in zip(rows, others, strict=True):
        assert row.keys() == other.keys()
        for name, text in row.items():
            if name.endswith(("_mm", "_n", "_nm", "_deg")):
                assert float(text) == pytest.approx(float(other[name]), abs=2e-4), name
            else:
                assert text == other[name], name


def test_growth_appends_and_repeats_nothing_and_equals_a_fresh_run(two, tmp_path):
    """The second press is carried out by another process."""
    grown = run(plan_of(tmp_path, 1), tmp_path / "grown", ROOT / "workflow")
    before, kept = (grown / "log.csv").read_text(), grown / "images" / "demo-000000.png"
    stamp, plan = kept.stat().st_mtime_ns, plan_of(tmp_path, 2)
    words = ["--plan", str(plan), "--data", str(grown.parent), "--workflow", str(ROOT / "workflow"), "--jobs", "2"]
    assert main(words) == 0
    after = (grown / "log.csv").read_text()
    assert after.startswith(before) and len(after.splitlines()) == 3
    assert kept.stat().st_mtime_ns == stamp
    run(plan, grown.parent, ROOT / "workflow")
    assert (grown / "log.csv").read_text() == after
    assert_same_rows(read_csv(two / "log.csv"), read_csv(grown / "log.csv"))
    for fresh in (two / "images").iterdir():
        drawn = cv2.imread(str(grown / "images" / fresh.name)).astype(int)
        assert np.abs(drawn - cv2.imread(str(fresh))).max() <= 1


def test_a_lost_picture_is_drawn_again_from_the_kept_surface(two, tmp_path, capsys):
    log = (two / "log.csv").read_bytes()
    lost = two / "images" / "demo-000000.png"
    image = lost.read_bytes()
    lost.unlink()
    run(plan_of(tmp_path, 2), two.parent, ROOT / "workflow")
    assert "0 new, 1 with images drawn again" in capsys.readouterr().out
    assert lost.read_bytes() == image
    assert (two / "log.csv").read_bytes() == log


def test_a_camera_that_is_made_anew_takes_the_same_picture(seen_by_both, tmp_path, monkeypatch):
    """A process keeps few of a plan's cameras; which of them does not show."""
    folder = shutil.copytree(seen_by_both, tmp_path / "both")
    pictures = {path: path.read_bytes() for path in (folder / "data/demo/images").iterdir()}
    monkeypatch.setattr(rig, "CAMERAS", 1)
    for path in pictures:
        path.unlink()
    run(folder / "plan.toml", folder / "data", ROOT / "workflow")
    assert len(pictures) == 2 and all(path.read_bytes() == picture for path, picture in pictures.items())


def test_a_broken_surface_is_named(two, tmp_path):
    lost, surface = two / "images" / "demo-000000.png", two / "truth" / "surfaces" / "demo-000000.npz"
    image, kept = lost.read_bytes(), surface.read_bytes()
    lost.unlink()
    surface.write_bytes(kept[:100])
    with pytest.raises(BadInput, match="demo-000000.npz: not a surface of a press"):
        run(plan_of(tmp_path, 2), two.parent, ROOT / "workflow")
    surface.write_bytes(kept)
    lost.write_bytes(image)


def test_a_film_rests_presses_to_the_end_of_a_path_and_releases(two, tmp_path):
    """On the way up the gel is as on the way down; a film that is there is kept, and a plan may ask for one at any time."""
    plan = plan_of(tmp_path, 2)
    plan.write_text(plan.read_text() + '\n[film]\nsensor = "mini_a"\npresses = [0]\nframes = 2\n')
    log = (two / "log.csv").read_bytes()
    film = run(plan, two.parent, ROOT / "workflow") / rig.FILM
    capture = cv2.VideoCapture(str(film))
    images = np.array([image for _, image in iter(capture.read, (False, None))], float)
    assert len(images) == rig.RATE + 3 + rig.RATE // 5 and capture.get(cv2.CAP_PROP_FPS) == rig.RATE
    rest, pressed = (cv2.imread(str(two / name)) for name in ("nocontact/mini_a.png", "images/demo-000000.png"))
    nearer = [np.abs(image - rest).mean() < np.abs(image - pressed).mean() for image in images]
    assert nearer == [True] * rig.RATE + [nearer[rig.RATE], False, nearer[rig.RATE]] + [True] * (rig.RATE // 5)
    down, deepest, up = (
        cv2.blur(image - rest, (15, 15)) for image in images[rig.RATE : rig.RATE + 3]
    )  # without noise
    assert np.abs(down - up).mean() < 0.5 * np.abs(deepest).mean()
    before = film.stat().st_mtime_ns
    run(plan, two.parent, ROOT / "workflow")
    assert film.stat().st_mtime_ns == before and (two / "log.csv").read_bytes() == log


def test_another_plan_does_not_mix_in(two, tmp_path):
    before = (two / "log.csv").read_text()
    with pytest.raises(BadInput, match="was written by another plan"):
        run(plan_of(tmp_path, 2, ("friction = 0.0", "friction = 0.5")), two.parent, ROOT / "workflow")
    assert (two / "log.csv").read_text() == before


def test_a_log_from_elsewhere_is_left_alone(tmp_path):
    (tmp_path / "data" / "demo").mkdir(parents=True)
    log = tmp_path / "data" / "demo" / "log.csv"
    log.write_text("sample_id\nmine\n")
    with pytest.raises(BadInput, match="was not written by the virtual rig"):
        run(plan_of(tmp_path, 1), tmp_path / "data", ROOT / "workflow")
    assert log.read_text() == "sample_id\nmine\n"


def test_parameters_of_a_plan_that_were_changed_since_are_reported(two, tmp_path, capsys):
    """dataset.toml may hold a user's own values: it stays, and is not silently something else than the plan says."""
    (two / "dataset.toml").write_text(
        (two / "dataset.toml").read_text() + "\n[params.labels]\nlargest_outside_share = 0.5\n"
    )
    shutil.copytree(two, tmp_path / "data" / two.name)
    capsys.readouterr()
    run(plan_of(tmp_path, 2), tmp_path / "data", ROOT / "workflow")
    assert "dataset.toml differs from what the plan would write and is kept" in capsys.readouterr().out
    assert "largest_outside_share" in (tmp_path / "data" / two.name / "dataset.toml").read_text()


@pytest.fixture
def workshop(tmp_path):
    """A copy of workflow/, to be changed."""
    return shutil.copytree(ROOT / "workflow", tmp_path / "workflow")


def test_a_shape_that_changed_under_its_name_does_not_mix_in(two, tmp_path, workshop):
    catalogue = workshop / "indenters.toml"
    text = catalogue.read_text(encoding="utf-8")
    assert "[sphere_10]" in text
    head, tail = text.split("[sphere_10]")
    catalogue.write_text(f"{head}[sphere_10]{tail.replace('diameter = 10', 'diameter = 11', 1)}", encoding="utf-8")
    before = read_csv(two / "log.csv")
    with pytest.raises(BadInput, match="indenter sphere_10 had another shape"):
        run(plan_of(tmp_path, 3), two.parent, workshop)
    assert read_csv(two / "log.csv") == before


def test_a_sensor_that_looks_otherwise_needs_its_pictures_drawn_anew(two, tmp_path, workshop, capsys):
    sensors = workshop / "rig" / "sensors.toml"
    text = sensors.read_text(encoding="utf-8")
    changed = re.sub(r"^gain = .*$", "gain = 0.9", text, count=1, flags=re.MULTILINE)
    assert changed != text
    sensors.write_text(changed, encoding="utf-8")
    with pytest.raises(BadInput, match="remove images/ and nocontact/"):
        run(plan_of(tmp_path, 2), two.parent, workshop)
    shutil.rmtree(two / "images")
    shutil.rmtree(two / "nocontact")
    run(plan_of(tmp_path, 2), two.parent, workshop)
    assert "with images drawn again" in capsys.readouterr().out


def test_a_bench_none_of_whose_presses_succeeded_goes_on(two, tmp_path):
    plan = read_plan(plan_of(tmp_path, 2))
    empty = Dataset(tmp_path / "empty", plan)
    empty.begin({}, {})
    empty.add([(orders(plan)[0], None, next(iter(Dataset(two, plan).truth.values())) | {"status": "DIVERGED"})])
    empty.publish()
    assert not (tmp_path / "empty" / "log.csv").exists()
    assert len(Dataset(tmp_path / "empty", plan).missing(orders(plan))) == 1
