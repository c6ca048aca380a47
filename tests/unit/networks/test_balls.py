"""A ball as a force sensor: the table of solves, the imprint's circle, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gelforge
from gelforge.commands import predict, sensor
from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.networks.balls.ballpresses import px_per_mm_of, read_presses
from gelforge.networks.balls.balltable import ball_table
from gelforge.networks.balls.imprint import Circle, fit_circle
from gelforge.networks.inference.sensorprofile import REACH, fit_gain, of_balls, read_profile
from gelforge.records.image import read_image, write_png
from gelforge.records.press import Press
from tests.benchmarks.ball_table import contact_radius
from tests.benchmarks.balls import DRAWN, draw_balls, slope_gain, true_force
from tests.support.refused import refused

GEL, BALL_MM = Gel(), 6.0


@pytest.fixture(scope="module")
def ball():
    return build("ball", {"kind": "sphere", "diameter": BALL_MM, "height": BALL_MM}, "test")


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A folder in gs_sdk's layout: presses of a 6 mm ball that the virtual rig drew, and no marked circle."""
    return draw_balls(tmp_path_factory.mktemp("balls") / "drawn", "mini_a", BALL_MM, DRAWN[:5])


def put(folder: Path, number: int, picture: np.ndarray, size: str = "6.000") -> Path:
    path = folder / f"{size}mm" / str(number) / "gelsight.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, picture)
    return path


def test_the_table_holds_what_was_measured_of_a_5_mm_ball():
    """Solves of the same solver, at these radii in mm and forces in N, whose radii were read by another person."""
    radius = (1.24, 1.45, 1.53, 1.65, 1.73, 1.81, 1.98)
    curve = ball_table().curve(5.0)
    for depth, force in zip(radius, (0.57, 1.00, 1.27, 1.56, 1.88, 2.24, 3.51), strict=True):
        at = np.interp(np.log(force), np.log(curve.force), np.log(curve.radius))
        assert np.exp(at) == pytest.approx(depth, rel=0.03)


@pytest.mark.slow
def test_a_row_of_the_table_is_what_a_solve_gives(ball):
    """At a coarser setting: of another thickness, ball or stiffness it would be 5 % and more beside it."""
    result = HexSolver(quality("draft")).solve(
        Scene(GEL, Material(), ball, Press(0.0, 0.0, 0.0, 0.0, 0.0, -0.8, 0.0))
    )
    curve = ball_table().curve(BALL_MM)
    assert contact_radius(result, BALL_MM, 0.8) == pytest.approx(curve.radius[2], rel=0.03)
    assert -result.total[2] == pytest.approx(curve.force[2], rel=0.03)


@given(st.floats(4.0, 12.0), st.floats(3.6, 4.4))
@settings(max_examples=50)
def test_between_the_rows_force_grows_with_radius_ball_and_thinness(diameter, thickness):
    table = ball_table()
    curve = table.curve(diameter, thickness)
    assert (np.diff(curve.radius) > 0).all() and (np.diff(curve.force) > 0).all() and (curve.rim > curve.radius).all()
    assert (curve.force <= table.curve(diameter, 3.6).force + 1e-9).all()
    assert (curve.force >= table.curve(4.0, thickness).force - 1e-9).all()
    radius = float(np.sqrt(curve.radius[1] * curve.radius[2]))
    assert curve.force[1] < curve.force_at(radius) < curve.force[2]
    assert np.isnan(curve.force_at(0.5 * curve.radius[0])) and np.isnan(curve.radius_at(2 * curve.rim[-1]))


@given(st.floats(50, 250), st.floats(50, 200), st.floats(10, 60), st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_a_circle_is_fitted_though_a_fifth_of_its_points_lie_elsewhere(u, v, radius, seed):
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    off = np.where(np.arange(72) % 5 == 0, rng.uniform(1.2, 2.0, 72), 1.0) * radius + rng.normal(0, 0.2, 72)
    circle, deviation = fit_circle(np.stack([u + off * np.cos(angle), v + off * np.sin(angle)], axis=1))
    assert np.hypot(circle.u - u, circle.v - v) < 0.5 and abs(circle.radius - radius) < 0.5 and deviation < 0.6


def test_forces_of_drawn_presses_are_those_of_their_depths(drawn):
    """Circles found by themselves. Rendered rims lie 3 % farther out than the table's, which is a tenth of force."""
    found = read_presses(drawn, read_image(drawn / "background.png"))
    truth = np.array([true_force(BALL_MM, depth) for *_, depth in DRAWN[:5]])
    force = np.array([press.force for press in found.presses])
    assert not found.left_out and found.px_per_mm == pytest.approx(15.77, rel=0.02)
    assert 0.9 < np.median(force / truth) < 1.25
    assert np.corrcoef(force, truth)[0, 1] > 0.96


def test_a_profile_is_made_from_balls_alone(drawn, tmp_path, capsys):
    words = ["--name", "mine", "--balls", str(drawn), "--out", str(tmp_path / "mine.toml")]
    assert sensor.main([*words, "--diameter", "6"]) == 0
    gain = read_profile(tmp_path / "mine.toml").gain
    reported = capsys.readouterr().out
    assert (
        gain.readings == 5
        and "px per mm" in reported
        and "C10 0.0725 MPa assumed, which balls cannot measure" in reported
    )
    profile = read_profile(tmp_path / "mine.toml")
    assert (profile.nocontact == read_image(drawn / "background.png")).all()
    assert profile.table is None  # five presses are too few
    picture = drawn / "6.000mm/1/gelsight.png"
    (tmp_path / "r.csv").write_text(f"image,force_n\n{picture},5\n")
    assert sensor.main([*words, "--readings", str(tmp_path / "r.csv")]) == 0
    both = read_profile(tmp_path / "mine.toml").gain
    assert both.readings == 6 and both.high / both.low < gain.high / gain.low


def test_balls_leave_their_level_open():
    """However many presses: a quarter in nine of ten cases, as no press shows it."""
    read = np.linspace(1.0, 5.0, 200)
    many = of_balls(fit_gain(1.3 * read, read))
    assert many.value == pytest.approx(1.3, rel=0.01)
    assert np.log(many.high / many.value) == pytest.approx(0.14 * REACH, rel=0.1)
    weighed = fit_gain(1.1 * read, read, many)
    assert weighed.value == pytest.approx(1.1, rel=0.02) and weighed.readings == 400


def test_presses_that_cannot_count_say_why(drawn, tmp_path):
    rest = read_image(drawn / "background.png")
    write_png(tmp_path / "background.png", rest)
    pictures = [read_image(drawn / f"6.000mm/{number}/gelsight.png") for number in range(5)]
    for number, picture in enumerate(pictures[:3]):
        put(tmp_path, number, picture)
    put(tmp_path, 3, rest)
    cut = draw_balls(tmp_path / "cut", "mini_a", BALL_MM, [(-6.8, 0.0, 1.0)])
    put(tmp_path, 4, read_image(cut / "6.000mm/0/gelsight.png"))
    square = rest.copy()
    square[60:140, 80:220] = np.uint8(0.6 * square[60:140, 80:220])
    put(tmp_path, 5, square)
    mark = put(tmp_path, 6, pictures[4]).with_name("label.npz")
    np.savez(mark, center=np.array([60.0, 60.0]), radius=28)
    why = read_presses(tmp_path, rest).left_out
    assert {name: text.split(",")[0] for name, text in why.items()} == {
        "6.000mm/3": "nothing touches in it",
        "6.000mm/4": "its imprint is cut by the picture's edge",
        "6.000mm/5": "its imprint is no circle",
        "6.000mm/6": "its mark lies beside its imprint",
    }


def test_sizes_options_and_folders_that_say_nothing_are_refused(drawn, tmp_path):
    rest, picture = read_image(drawn / "background.png"), read_image(drawn / "6.000mm/0/gelsight.png")
    refused(r"a ball of 3 mm: the table of solves covers 4 to 12 mm.*\[flow\]", ball_table().curve, 3.0)
    refused("a gel of 5 mm", ball_table().curve, 5.0, 5.0)
    for more, said in (
        (["--diameter", "5"], "--diameter and --thickness say what --balls FOLDER shows"),
        (["--balls", "x", "--opposite", "l.toml", "--grasps", "g.csv"], "either --balls or --grasps"),
        (["--balls", str(drawn / "6.000mm")], "holds no background.png; give a folder with background.png and DIAM"),
    ):
        refused(said, sensor.main, ["--name", "mine", "--out", str(tmp_path / "mine.toml"), *more])
    assert not list(tmp_path.iterdir())
    refused("shows no markers", px_per_mm_of, np.full_like(rest, 100))
    refused("holds no press of a ball; give a folder with background.png", read_presses, tmp_path, rest)
    for number in (0, 1):
        put(tmp_path, number, picture)
    refused("pressed in one place only .2 presses", read_presses, tmp_path, rest)
    refused("a ball of 20 mm", read_presses, tmp_path, rest, 20.0)
    for number in (0, 1):
        put(tmp_path, number, rest)
    refused("none of 2 presses counts; 6.000mm/0: nothing touches in it", read_presses, tmp_path, rest)
    put(tmp_path, 0, picture, "8.000")
    refused("holds balls of 6.000, 8.000 mm; leave --diameter out", read_presses, tmp_path, rest, 6.0)


def test_circles_of_a_real_sensor_are_found_where_they_were_marked(reference):
    """Over the presses of a real ball: circles marked by hand, in whole px."""
    folder = reference / "balls/unit_a"
    rest = read_image(folder / "background.png")
    pairs = []
    for press in read_presses(folder, rest, marks=False).presses:
        with np.load(folder / press.name / "label.npz") as mark:
            pairs.append((press.circle, Circle(*mark["center"].tolist(), float(mark["radius"]))))
    pairs = [(one, other) for one, other in pairs if other.inside(rest.shape)]
    ratio = np.array([one.radius / other.radius for one, other in pairs])
    assert len(pairs) >= 40
    assert abs(np.median(ratio) - 1) < 0.05 and np.quantile(ratio, 0.1) > 0.9 and np.quantile(ratio, 0.9) < 1.12
    assert np.median([np.hypot(one.u - other.u, one.v - other.v) for one, other in pairs]) < 3.0


def test_a_real_sensor_learns_its_table_of_slopes(reference, tmp_path, capsys):
    folder, out = reference / "balls/unit_a", tmp_path / "a.toml"
    assert sensor.main(["--name", "a", "--balls", str(folder), "--out", str(out)]) == 0
    profile, presses = read_profile(out), read_presses(folder, read_image(folder / "background.png"))
    assert profile.gain.readings > 40
    for press in presses.presses[::8]:
        assert slope_gain(profile.table, press, profile.nocontact) == pytest.approx(1.0, abs=0.3)
    deepest = max(presses.presses, key=lambda press: press.force)
    words = [str(folder / deepest.name / "gelsight.png"), "--height", "--out", str(tmp_path / "found")]
    alone = [*words, "--nocontact", str(folder / "background.png")]
    refused("--height: no table of the sensor's slopes", predict.main, alone)
    assert not (tmp_path / "found").exists()
    assert predict.main([*words, "--profile", str(out)]) == 0
    height = np.load(tmp_path / "found/gelsight_height.npy")
    lowest = np.unravel_index(height.argmin(), height.shape)
    beside = np.hypot(2 * lowest[1] + 1 - deepest.circle.u, 2 * lowest[0] + 1 - deepest.circle.v)
    found = gelforge.Reader(profile=out).height(read_image(Path(words[0])))
    assert np.allclose(found, height, atol=1e-6)
    assert height.shape == (120, 160) and -2.5 < height.min() < -0.3 and beside < deepest.circle.radius
