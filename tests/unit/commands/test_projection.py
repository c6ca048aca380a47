"""Sensors and their projection: fits, refusals with a reason, and the markers of real and drawn images."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelforge.commands import projection
from gelforge.formats.featsfile import read_npy
from gelforge.labelling.grid import Grid
from gelforge.labelling.homography import fit_homography
from gelforge.labelling.operator import assemble
from gelforge.labelling.sensor import check_projection, check_scale, find_sensor, load_sensors, transform
from gelforge.reading.markers import markers_in
from gelforge.virtualrig.units import read_ranges
from tests.support.patch import irregular_surface
from tests.support.refused import refused

SQUARE = np.array([[-5.0, 5], [5, 5], [-5, -5], [5, -5]])
GOOD = np.array([[0.0, -14, 160], [-14, 0, 120], [0, 0, 1]])


def test_resolutions_that_are_none():
    for text in ("24", "24x", "0x32", "-1x5", "24x32x3", "a x b", "1.5x2", "٣x٤", "99999x1", ""):
        refused("RES=24x32", Grid.parse, text)
    assert Grid.parse("24x32") == Grid(24, 32)


@given(st.lists(st.floats(-1, 1), min_size=8, max_size=8), st.integers(4, 30), st.integers(0, 99))
def test_exact_correspondences_give_the_homography_back(wiggle, count, seed):
    truth = GOOD + np.append(wiggle, 0).reshape(3, 3) * np.array([[2, 2, 20], [2, 2, 20], [1e-3, 1e-3, 0]])
    points = np.vstack([SQUARE, np.random.default_rng(seed).uniform(-9, 9, (count - 4, 2))])
    fit = fit_homography(points, transform(truth, points))
    # Points can come close to each other or to a line, which costs digits; pixels are what matters.
    assert fit.residual.max() < 1e-6
    assert np.abs(transform(fit.homography, SQUARE) - transform(truth, SQUARE)).max() < 1e-6


def test_noise_is_averaged_and_reported():
    rng = np.random.default_rng(0)
    points = rng.uniform(-9, 9, (400, 2))
    fit = fit_homography(points, transform(GOOD, points) + rng.normal(0, 0.5, (400, 2)))
    assert fit.rms == pytest.approx(0.5 * np.sqrt(2), rel=0.1)  # 800 draws scatter their deviation by 2.5 %
    assert np.abs(transform(fit.homography, SQUARE) - transform(GOOD, SQUARE)).max() < 0.3


def test_degenerate_sets_are_refused_with_the_reason():
    for points, reason in (
        (SQUARE[:3], "at least four"),
        (SQUARE[[0, 0, 1, 2]], "points 1 and 2 are the same"),
        (np.array([[0.0, 0], [1, 1], [2, 2], [3, 3], [4, 4]]), "all points lie on one line"),
        (np.array([[0.0, 0], [1, 1], [2, 2], [5, -3]]), "all points but one"),
        (np.array([[0.0, 0], [1, 0], [0, np.nan], [5, -3]]), "not a finite number"),
    ):
        refused(reason, fit_homography, points, transform(GOOD, points))
    line = np.array([[0.0, 0], [10, 10], [20, 20], [40, 40]])
    refused("in the image, all points lie on one line", fit_homography, SQUARE, line)


def test_a_scale_in_another_unit_is_refused_and_crops_are_not():
    """Pixels by metre, by inch and by micrometre, and a camera that sees a quarter or three times the gel."""
    for factor in (1e-3, 1 / 25.4, 1e3):
        refused("px/mm", check_scale, np.diag([factor, factor, 1.0]) @ GOOD, (320, 240), "unit")
    for factor in (0.4, 1.0, 4.0):
        check_scale(np.diag([factor, factor, 1.0]) @ GOOD, (320, 240), "unit")


def test_projections_that_fold_or_flip():
    for change, reason in (
        (np.diag([1.0, -1, 1]), "flips"),
        (np.diag([0.0, 1, 1]), "singular"),
        (np.array([[1.0, 0, 0], [0, 1, 0], [0.01, 0, 0]]), "folds"),
        (np.full((3, 3), np.nan), "finite"),
    ):
        refused(reason, check_projection, change @ GOOD, "unit")


def test_broken_sensor_tables_name_the_field(tmp_path):
    keep = {
        "gel": "gel = 'gelsight_mini'",
        "image": "image = [320, 240]",
        "projection": "projection = [[0, -14, 160], [-14, 0, 120], [0, 0, 1]]",
    }
    path = tmp_path / "sensors.toml"
    for line, reason in (
        ("image = [320]", "width, height"),
        ("image = [320, 0]", "width, height"),
        ("image = [", "TOML|sensors"),
        ("projection = 3", "projection"),
        ("projection = [[1, 2], [3, 4]]", "3 x 3"),
        (f"projection = [[{10**400}, 0, 0], [0, 1, 0], [0, 0, 1]]", "projection"),
        ("projection = [[0, -14, 160], [-14, 0, 120], [0.2, 0, 1]]", r"\[a\].*folds"),  # within the gel
        ("gel = 'jelly'", "jelly"),
        ("gel = 3", "gel"),
        ("markers = 5", "markers"),
        ("markers = { rows = 1, cols = 9 }", "rows is 1"),
        ("markers = { rows = '7', cols = 9 }", "rows is '7'"),
        ("markers = { pitch_px = 32.8 }", "pitch_px is 32.8"),
        ("markers = { centre_px = [nan, 3.0] }", "centre_px"),
    ):
        path.write_text("[a]\n" + "\n".join({**keep, line.split(" ")[0]: line}.values()))
        refused(reason, load_sensors, path)


def test_the_projects_sensors_are_usable(root):
    sensors = load_sensors(root / "workflow/sensors.toml")
    assert sensors["feats_mini"].project(np.array([5.0, -5.0])) == pytest.approx([230, 50])
    away = replace(
        sensors["gelsight_mini"], projection=sensors["feats_mini"].projection + [[0, 0, 2000.0], [0] * 3, [0] * 3]
    )
    mesh = irregular_surface("hex8", 2.0, np.random.default_rng(0))
    refused("gelsight_mini.*wholly outside", assemble, mesh, away, Grid(4, 4))
    for sensor in sensors.values():
        points = np.array([[1.0, 2], [-7, 9]])
        assert sensor.unproject(sensor.project(points)) == pytest.approx(points, abs=1e-9)
    refused("log row 3.*nobody", find_sensor, sensors, "nobody", "log row 3")


def test_gels_of_all_sensors_are_printed_alike(root):
    """A scale that is wrong shows: markers stand 2.0 mm apart on real gels. FEATS' own placement has them farther apart."""
    apart = {}
    every = load_sensors(root / "workflow/sensors.toml")
    for name, sensor in every.items():
        if not sensor.markers:  # nothing is known of them
            continue
        one_mm = sensor.project(np.array([[0.0, 0.5], [0.0, -0.5], [0.5, 0.0], [-0.5, 0.0]]))
        scale = np.mean([np.hypot(*(one_mm[k] - one_mm[k + 1])) for k in (0, 2)])
        apart[name] = float(np.mean(sensor.markers["pitch_px"]) / scale)
    assert apart.pop("feats_mini") > 2.2
    ranges = read_ranges(root / "workflow/rig/units.toml")
    apart["drawn units"] = float(np.mean(ranges.pitch_mm))
    assert all(2.0 <= pitch <= 2.1 for pitch in apart.values()), apart


def test_the_reference_correspondences(reference):
    points = projection.read_points(reference / "feats/point_correspondences.csv")
    fit = fit_homography(*points)
    assert fit.homography == pytest.approx(GOOD, abs=1e-9) and fit.rms < 1e-9


def test_points_are_read_and_broken_ones_named(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("# by hand\nx_mm , y_mm, u_px,\tv_px\n1, 2, 3, 4\n")
    on_gel, pixels = projection.read_points(path)
    assert on_gel.tolist() == [[1.0, 2.0]] and pixels.tolist() == [[3.0, 4.0]]
    head = "x_mm,y_mm,u_px,v_px\n"
    for text, reason in (
        ("x_mm,y_mm,u_px\n1,2,3\n", "v_px"),
        (f"{head}1,2,3,abc\n", "line 2: v_px is 'abc'"),
        ("", "x_mm"),
        (f"# by hand\n{head}1,2,3,\n", "line 3: its v_px is empty"),
        # decimal commas shift what follows: x would be 1, y 5, u 2 and v 5
        (f"{head}1,2,3,4\n1,5,2,5,160,120\n", "row 3 has another number of cells .* decimals with a point"),
    ):
        path.write_text(text)
        refused(reason, projection.read_points, path)


def test_points_of_another_picture_or_unit_are_refused():
    """They fit a projection exactly all the same, by which every label would be nothing."""
    square, seen = np.array([[-5.0, -5], [5, -5], [5, 5], [-5, 5]]), [[10.0, 10], [300, 10], [300, 200], [10, 200]]
    for on_gel, second, said in (
        (square, [478, 10], "478, 10.*320 x 240"),
        (square, [300, -3], "300, -3"),
        (1e-3 * square, seen[1], "check the unit"),
    ):
        pixels = np.array([seen[0], second, *seen[2:]], float)
        refused(said, projection.check_marks, on_gel, pixels, (320, 240), "points.csv")


def test_the_markers_of_reference_images(reference):
    found = markers_in(read_npy(reference / "feats/images/nocontact_train_sensor.npy")["gs_img"]).grid(7, 9)
    assert found.count == 63 and not len(found.missing)
    assert found.pitch == pytest.approx([32.9, 31.4], abs=0.3)
    assert found.diameter == pytest.approx(11.6, abs=1.0) and abs(found.rotation) < 0.5
    pressed = markers_in(cv2.imread(str(reference / "feats/images/cuboid_10-2-284.png"))[..., ::-1]).grid(7, 9)
    assert pressed.count == 63 and pressed.pitch == pytest.approx([33.6, 32.9], abs=0.5)


def draw_markers(pitch, turn_deg, centre, rows=7, cols=9, missing=(), specks=(), seed=0):
    """Image (240, 320, 3) of dark soft spots on uneven coloured light, and their true places by index."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:240, :320] + 0.5
    light = np.stack([90 + 0.15 * u, 120 - 0.2 * v + 0.1 * u, 80 + 0.2 * v], axis=-1)
    markers = {"rows": rows, "cols": cols, "pitch_px": pitch, "rotation_deg": turn_deg, "centre_px": centre}
    index = np.array([(r, c) for r in range(rows) for c in range(cols)])
    places, dark = projection.grid_pixels(markers, index), np.zeros((240, 320))
    for k, (x, y) in enumerate(places):
        if tuple(index[k]) not in missing:
            dark = np.maximum(dark, 1 / (1 + np.exp((np.hypot(u - x, v - y) - 5.8) / 0.6)))
    for x, y in specks:
        dark = np.maximum(dark, 1 / (1 + np.exp((np.hypot(u - x, v - y) - 5.0) / 0.6)))
    image = light * (1 - 0.7 * dark[..., None]) + rng.normal(0, 1.5, light.shape)
    return np.clip(image, 0, 255).astype(np.uint8), index, places


def test_drawn_markers_are_found():
    for pitch, turn, centre, missing, specks in (
        ((32.9, 31.4), 0.0, (160, 120), (), ()),
        ((32.0, 30.0), 3.0, (156, 123), (), ()),
        ((33.0, 31.0), -4.0, (163, 118), ((0, 0), (3, 4), (3, 5), (6, 8)), ()),
        ((32.9, 31.4), 1.0, (160, 120), ((1, 1), (2, 1)), ((177, 135), (45, 71))),
        ((32.9, 31.4), 0.5, (158, 121), tuple((r, 4) for r in range(7)), ()),
    ):
        image, index, places = draw_markers(pitch, turn, centre, missing=missing, specks=specks)
        found = markers_in(image).grid(7, 9)
        assert {tuple(i) for i in found.missing.tolist()} == set(missing)
        true = {tuple(i): p for i, p in zip(index.tolist(), places, strict=True)}
        off = [np.hypot(*(p - true[tuple(i)])) for i, p in zip(found.index.tolist(), found.points, strict=True)]
        assert max(off) < 0.5  # a tenth of the markers' radius, under noise and uneven light
        assert found.pitch == pytest.approx(pitch, abs=0.1) and found.rotation == pytest.approx(turn, abs=0.2)
        assert found.centre == pytest.approx(centre, abs=0.3)


def test_images_without_a_grid_are_refused():
    few = {(r, c) for r in range(7) for c in range(9) if (r + c) % 3}
    flat, noise = (
        np.full((240, 320, 3), 120, np.uint8),
        np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8),
    )
    for image in (flat, noise, draw_markers((32.9, 31.4), 0, (160, 120), missing=few)[0]):
        refused("image without contact", markers_in(image).grid, 7, 9, "empty.png")


def test_a_unit_is_calibrated_from_one_image(root):
    """A unit shifted, turned and scaled against the reference is found to a fraction of a pixel from its markers."""
    sensors = load_sensors(root / "workflow/sensors.toml")
    like = sensors["gelsight_mini"]
    angle, scale = np.deg2rad(1.5), 1.03
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    move = np.eye(3)
    move[:2, :2], move[:2, 2] = turn, np.array([164, 118]) - turn @ like.markers["centre_px"]
    image, _, _ = draw_markers(
        scale * np.array(like.markers["pitch_px"]), 1.5 + like.markers["rotation_deg"], (164, 118)
    )
    found = projection.fit_projection("new", like, image=image)
    half = np.array([[-8.0, -9], [8, -9], [8, 9], [-8, 9]])
    assert np.abs(transform(found.fit.homography, half) - transform(move @ like.projection, half)).max() < 0.5
    assert found.fit.rms < 0.5


def test_a_picture_that_shows_a_part_of_the_markers_does_not_show_which(root):
    """As of a driver that crops the border: the first marker in it is not the print's first."""
    like = load_sensors(root / "workflow/sensors.toml")["gelsight_mini"]
    image, _, _ = draw_markers(1.4 * np.array(like.markers["pitch_px"]), 0.0, (160, 120))
    said = r"its markers span \d x \d of the 7 x 9.*POINTS=points.csv"
    refused(said, projection.fit_projection, "new", like, image=image)
    on_gel = np.array([[-8.0, -9], [8, -9], [8, 9], [-8, 9], [0, 0]])
    found = projection.fit_projection("new", like, (on_gel, transform(like.projection, on_gel)), image)
    assert found.markers is None and found.fit.rms < 1e-6


def test_the_command_writes_json_picture_and_table(root, reference, tmp_path, capsys):
    out, feats = tmp_path / "unit.json", reference / "feats"
    words = ["--points", feats / "point_correspondences.csv", "--image", feats / "images/nocontact_train_sensor.npy"]
    projection.main(["--sensor", "unit", *map(str, words), "--out", str(out)])
    text = capsys.readouterr().out
    assert "residual 0.000 px rms" in text and "63 of 63" in text and "[unit]" in text
    table = tmp_path / "sensors.toml"
    table.write_text(text[text.index("[unit]") :])
    assert load_sensors(table)["unit"].projection == pytest.approx(GOOD, abs=1e-6)
    assert cv2.imread(str(out.with_suffix(".png"))).shape == (720, 960, 3)


def test_a_scale_that_differs_along_both_axes_is_said_and_doubted(tmp_path, capsys):
    """Four corners fit a stretched picture exactly; millimetres along one axis may be wrong."""
    corners = np.array([[-8.0, -9.0], [8.0, -9.0], [8.0, 9.0], [-8.0, 9.0]])
    for along_x, along_y, doubted in (
        (1.08, 1.0, True), (0.8, 1.0, True), (1.0, 1.03, True), (1.0, 1.0, False), (1.015, 1.0, False)
    ):  # fmt: skip
        rows = np.column_stack([corners / (along_x, along_y), transform(GOOD, corners)]).tolist()
        lines = ["x_mm,y_mm,u_px,v_px", *(",".join(f"{value:.6f}" for value in row) for row in rows)]
        (tmp_path / "p.csv").write_text("\n".join(lines) + "\n")
        projection.main(["--sensor", "unit", "--points", str(tmp_path / "p.csv"), "--out", str(tmp_path / "o.json")])
        said = capsys.readouterr().out
        assert f"{14 * along_x:.2f} px/mm along gel x, {14 * along_y:.2f} along gel y" in said
        assert ("doubt: the scales differ by" in said) == doubted


def test_the_command_refuses_and_replaces_nothing_that_it_reads(tmp_path, monkeypatch, root):
    """The no-contact image of a unit is taken once; the fit drawn over it is no picture to fit by."""
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("small.png", np.zeros((120, 160, 3), np.uint8))
    image = (root / "data/demo/nocontact/mini_a.png").read_bytes()
    (tmp_path / "unit.png").write_bytes(image)
    (tmp_path / "points.csv").write_text("x_mm,y_mm,u_px,v_px\n")
    like = ["--sensor", "unit", "--like", "mini_a", "--image", "unit.png"]
    for arguments, reason in (
        (["--sensor", ""], "SENSOR=name"),
        (["--sensor", "a"], "POINTS=points.csv"),
        (["--sensor", "a", "--image", "small.png"], "160 x 120.*320 x 240"),
        (["--sensor", "a", "--image", "none.png"], "none.png"),
        (["--sensor", "a", "--like", "b"], "'b'"),
        # the drawing of the fit lies beside the JSON, by its stem
        ([*like, "--out", "unit.json"], "unit.png would overwrite an input file"),
        ([*like, "--points", "points.csv", "--out", "points.csv"], "points.csv would overwrite an input file"),
        ([*like, "--out", "fit.png"], "fit.png: its picture would have this name"),
    ):
        refused(reason, projection.main, [*arguments, "--sensors", str(root / "workflow/sensors.toml")])
    assert (tmp_path / "unit.png").read_bytes() == image
    assert sorted(path.name for path in tmp_path.iterdir()) == ["points.csv", "small.png", "unit.png"]
