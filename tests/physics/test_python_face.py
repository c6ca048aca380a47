"""What a Python program uses of gelforge: each example of five lines runs, and importing costs nothing."""

import importlib
import math
import pickle
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

import gelforge
from gelforge.api import _body, gelsight_mini
from gelforge.commands import predict
from gelforge.commands import solve as commands_solve
from gelforge.errors import BadInput
from gelforge.geometry.indenters import CATALOGUE
from gelforge.geometry.triangles import write_stl
from gelforge.labelling.sensor import load_sensors
from gelforge.live.reading import readings
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.reading.forcereading import interval_text
from gelforge.reading.markers import markers_in
from gelforge.reading.model import load_model
from gelforge.reading.profile import Gain, make_profile, write_profile
from gelforge.reading.reader import Reader
from gelforge.reading.wear import painted_over
from gelforge.records.film import numbered
from gelforge.records.image import read_image, write_png
from gelforge.records.log import read_presses
from tests.support.pictures import moved
from tests.support.refused import refused

BALL = {"kind": "sphere", "diameter": 10, "height": 10}
STICKS = math.inf  # the friction that costs least to solve


@pytest.fixture(scope="module")
def press():
    return gelforge.solve(BALL, depth=0.5, friction=STICKS)


def test_solving_a_press(press):
    assert press.total[2] < 0.0, "the indenter pushes the gel down"
    assert np.abs(press.total[:2]).max() < 0.02 * -press.total[2], "a ball on the apex pushes straight down"


def test_a_label_holds_the_whole_force(press):
    cells = gelforge.label(press, resolution="12x16")
    assert cells.shape == (3, 12, 16)
    assert cells[2].sum() == pytest.approx(press.total[2], rel=1e-6), "this contact lies inside the image"
    assert np.array_equal(gelforge.label(press, (12, 16)), cells)


def test_a_press_is_solved_and_labelled_from_a_shell_as_in_python(tmp_path, capsys):
    """Numbers that begin with a minus, too; a pair that is none is refused."""
    commands_solve.main(["sphere_10", "--depth", "0.2", "--shear", "-0.1,0", "--out", str(tmp_path / "one")])
    press = gelforge.solve("sphere_10", 0.2, shear=(-0.1, 0.0))
    assert str(press) in capsys.readouterr().out
    np.testing.assert_allclose(np.load(tmp_path / "one.npy"), gelforge.label(press), atol=1e-9)
    assert read_image(tmp_path / "one.png").size
    with pytest.raises(SystemExit):
        commands_solve.main(["sphere_10", "--tilt", "1"])


def test_every_name_of_the_documentation_is_one_of_gelforge(root):
    named = re.findall(r"^::: ([\w.]+)\.(\w+)$", (root / "workflow/guide/api.md").read_text(), re.M)
    assert sorted(name for _, name in named) == sorted(gelforge.__all__)
    for home, name in named:
        assert getattr(gelforge, name) is getattr(importlib.import_module(home), name)


def test_the_sensor_of_a_label_is_that_of_the_workflow(root):
    """An installed package has no workflow/ to read it from."""
    known, built_in = load_sensors(root / "workflow" / "sensors.toml")["gelsight_mini"], gelsight_mini()
    assert (built_in.gel, tuple(built_in.image)) == (known.gel, tuple(known.image))
    assert np.array_equal(built_in.projection, known.projection)


def test_deeper_is_harder(press):
    assert gelforge.solve(BALL, depth=0.8, friction=STICKS).total[2] < press.total[2]


def test_force_is_proportional_to_stiffness_and_grows_as_the_gel_keeps_its_volume(press):
    twice = gelforge.solve(BALL, depth=0.5, c10=2 * REFERENCE_C10, friction=STICKS)
    np.testing.assert_allclose(twice.total, 2 * press.total, rtol=1e-12, atol=0)
    assert twice.error_n == pytest.approx(2 * press.error_n) and 0.0 < press.error_n < -0.05 * press.total[2]
    looser = gelforge.solve(BALL, depth=0.5, nu=0.4, friction=STICKS)
    assert 0.0 > looser.total[2] > 0.95 * press.total[2]


def test_a_name_of_the_catalogue_is_its_body(press, root):
    """An installed package has no workflow/ to read it from."""
    assert CATALOGUE.read_bytes() == (root / "workflow/indenters.toml").read_bytes()
    by_name = gelforge.solve("sphere_10", depth=0.5, friction=STICKS)
    np.testing.assert_array_equal(by_name.forces, press.forces)
    assert len(repr(by_name)) < 160 and "sphere_10" in repr(by_name)


@pytest.mark.slow
def test_methods_agree_within_what_they_state(press):
    """CalculiX, which others wrote, and the choice by stated errors; the name says what solved it."""
    found = {
        method: gelforge.solve(BALL, depth=0.5, friction=STICKS, method=method) for method in ("label", "ccx", "auto")
    }
    assert [one.method for one in found.values()] == ["label", "ccx", "draft"]
    for one in found.values():
        assert abs(one.total[2] - press.total[2]) < one.error_n + press.error_n
        assert gelforge.label(one)[2].sum() == pytest.approx(one.total[2], rel=1e-6)


def test_presses_and_readings_are_drawn(press, root, tmp_path):
    """One panel for each component, on a page of three."""
    rest = read_image(root / "data/demo/nocontact/mini_a.png")
    found = gelforge.Reader(nocontact=rest)(read_image(root / "data/demo/images/demo-000000.png"))
    assert len(repr(found)) < 160 and "array" not in repr(found)
    for k, drawn in enumerate((press, found)):
        drawn.plot().savefig(tmp_path / f"{k}.png")
        height, width = read_image(tmp_path / f"{k}.png").shape[:2]
        assert width > 2 * height


@pytest.mark.parametrize(("value", "half", "text"), [
    (-3.4417, 2.4928, "-3.4 +- 2.5"), (0.0124, 0.0926, "+0.012 +- 0.093"), (-31.27, 21.6, "-31 +- 22"), (1.5, 0.0004, "+1.5000 +- 0.0004"),
    (-0.25, None, "-0.250"), (-0.25, float("nan"), "-0.250"),
])  # fmt: skip
def test_a_force_has_the_digits_that_its_interval_allows(value, half, text):
    assert interval_text(value, half) == text


@pytest.mark.slow
def test_a_drag_is_felt_along_itself():
    """Whichever way a round indenter is turned."""
    for along, turned in ((0, 0.0), (1, 40.0)):
        drag = tuple(0.2 * (k == along) for k in (0, 1))
        total = gelforge.solve(BALL, depth=0.3, shear=drag, rot_deg=turned).total
        assert total[along] > 0.1 * -total[2] and abs(total[1 - along]) < 0.1 * total[along]


def test_what_the_readme_shows_runs(root):
    rest = read_image(root / "data/demo/nocontact/mini_a.png")
    image = read_image(root / "data/demo/images/demo-000000.png")
    given = {"nocontact": rest, "image": image, "images": iter([image])}
    (shown,) = re.findall(r"```python\n(.*?)```", (root / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    exec(shown, given)
    assert given["cells"].shape == (3, 24, 32)
    np.testing.assert_array_equal(given["found"].cells, given["forces"])


def test_reading_an_image():
    image = np.full((240, 320, 3), 128, np.uint8)
    forces, verdict = gelforge.predict(image, nocontact=image)
    assert forces.shape[0] == 3 and np.isfinite(forces).all()
    assert verdict["flag"], "a grey picture is unlike any sensor"
    reported = {
        "cells",
        "total",
        "half_width",
        "moment",
        "moment_half_width",
        "reason",
        "edge_peak",
        "vanished",
        "flag",
    }
    assert verdict.keys() == reported


def test_reading_many_images_of_one_sensor(root):
    """One object for a sensor: totals, cells, intervals; the same as the function, and as many readings as images."""
    folder = root / "data/demo"
    rest, *images = (
        read_image(path) for path in [folder / "nocontact/mini_a.png", *sorted(folder.glob("images/*.png"))[:2]]
    )
    read = gelforge.Reader(nocontact=rest)
    found = read.batch(np.stack(images))
    assert len(found) == 2
    for image, one in zip(images, found, strict=True):
        np.testing.assert_array_equal(one.cells, gelforge.predict(image, nocontact=rest)[0])
        np.testing.assert_allclose(one.total, one.cells.sum((1, 2)), rtol=1e-5, atol=1e-6)
        assert one.half_width is None or (one.half_width > 0.0).all()
    calm = read(rest)
    assert np.abs(calm.total).max() == 0.0 and calm.reason == ""
    for wrong in (rest[..., 0], rest.astype(float), np.zeros((2, 2, 4), np.uint8), rest[250:], rest[:, :0]):
        with pytest.raises(BadInput, match="uint8 RGB"):
            read(wrong)


def test_what_a_reader_keeps_does_not_change_with_the_buffer_that_it_came_in(root):
    """A camera writes its next frame into the array of the last one."""
    nocontact, image = (
        read_image(root / f"data/demo/{name}") for name in ("nocontact/mini_a.png", "images/demo-000000.png")
    )
    expected, buffer = Reader(nocontact=nocontact.copy())(image.copy()), nocontact.copy()
    reader = Reader(nocontact=buffer)
    buffer[:] = image
    found = reader(buffer)
    buffer[:] = 0
    assert np.array_equal(found.cells, expected.cells) and np.array_equal(found.image, expected.image)


def test_a_nocontact_image_that_shows_nothing_is_reported(root):
    """What is read against it may be any number: an unmarked gel, one out of focus, three rows, part of it."""
    rest = read_image(root / "data/demo/nocontact/mini_a.png")
    for spoilt, said in (
        (cv2.medianBlur(rest, 61), "shows no markers"),
        (cv2.GaussianBlur(rest, (0, 0), 30), "shows no markers"),
        (np.ascontiguousarray(rest[:3]), "shows no markers"),
        (np.ascontiguousarray(rest[:, :240]), "aspect ratio differs"),
    ):
        found = gelforge.Reader(nocontact=spoilt)(rest)
        assert found.flag and said in found.reason
    with pytest.raises(BadInput, match="px apart"):  # half of it, enlarged
        gelforge.Reader(nocontact=np.ascontiguousarray(rest[:, :160]))


def test_the_same_image_gives_the_same_answer_everywhere(root, tmp_path):
    """By `predict`, Reader, its batch and stream, and `live`, whatever was read before."""
    folder = root / "data/demo"
    rest = read_image(folder / "nocontact/mini_a.png")
    of_sensor = [press for press in read_presses(folder / "log.csv") if press.sensor_id == "mini_a"][:4]
    images = [moved(read_image(folder / press.image), (2.0, -1.0)) for press in of_sensor]
    paths = [tmp_path / f"{number}.png" for number in range(len(images))]
    for path, image in zip(paths, images, strict=True):
        write_png(path, image)
    reader, predictor = gelforge.Reader(nocontact=rest), Reader(rest, model=load_model(None))
    expected = [reader(image).cells for image in images]
    assert len(list(predict.predict_files(paths, predictor, tmp_path / "out"))) == len(paths)
    np.testing.assert_array_equal([np.load(tmp_path / "out" / f"{path.stem}.npy") for path in paths], expected)
    np.testing.assert_array_equal([one.cells for one in reader.batch(np.stack(images[::-1]))][::-1], expected)
    reported = readings(predictor, numbered(np.ascontiguousarray(image[..., ::-1]) for image in images))
    np.testing.assert_array_equal([one.found.cells for one in reported], expected)
    taken = []
    found = reader.stream(taken.append(image) or image for image in images)
    first = next(found)
    assert len(taken) == 1
    np.testing.assert_array_equal([one.cells for one in (first, *found)], expected)


def test_a_profile_scales_what_is_read(root, tmp_path):
    rest = read_image(root / "data/demo/nocontact/mini_a.png")
    image = read_image(sorted(root.glob("data/demo/images/*.png"))[3])
    about = load_model(None).metadata
    write_profile(
        tmp_path / "mine.toml", make_profile("mine", rest, markers_in(rest).pitch, Gain(1.25, 1.1, 1.4, 3), about)
    )
    plain, scaled = gelforge.Reader(nocontact=rest)(image), gelforge.Reader(profile=tmp_path / "mine.toml")(image)
    np.testing.assert_allclose(scaled.cells, 1.25 * plain.cells, rtol=1e-6)


def test_a_press_that_is_none_is_no_press_of_0_n():
    nan, inf = float("nan"), float("inf")
    for given in (
        {"depth": nan}, {"depth": -0.5}, {"depth": "0.5"}, {"depth": None}, {"at": (nan, 0.0)}, {"at": (1.0, 0.0, 0.2)},
        {"at": 1.0}, {"shear": (0.2,)}, {"shear": (0.0, inf)}, {"rot_deg": nan}, {"c10": "soft"}, {"c10": 72.5}, {"nu": nan},
        {"friction": -0.1}, {"friction": nan}, {"method": "cxx"}, {"method": 3},
    ):  # fmt: skip
        refused(next(iter(given)), gelforge.solve, BALL, **({"depth": 0.5} | given))
    refused("kind", gelforge.solve, {"kind": "teapot"}, depth=0.5)
    refused("'sphere'.*indenters.toml.*sphere_10", gelforge.solve, "sphere", depth=0.5)


def test_a_name_it_does_not_have_is_refused():
    with pytest.raises(AttributeError, match="solve"):
        gelforge.press  # noqa: B018


def test_a_reader_loads_nothing_but_what_reading_needs(root):
    """No finite elements, and few modules: a robot's computer starts it in a moment."""
    code = (
        "import sys, cv2, gelforge\n"
        "gelforge.Reader(nocontact=cv2.imread(sys.argv[1])[..., ::-1].copy())\n"
        "print(*(name for name in sys.modules if name.partition('.')[0] == 'gelforge'))"
    )
    picture = root / "data/demo/nocontact/mini_a.png"
    ran = subprocess.run([sys.executable, "-c", code, picture], check=True, capture_output=True, text=True)
    found = ran.stdout.split()
    folders = {name.split(".")[1] for name in found if "." in name}
    # of these the gel's shape, the sensor's projection and the gel's stiffness alone, for moments
    light = {"geometry", "labelling", "mechanics"}
    assert folders <= {"errors", "flow", "networks", "reading", "records"} | light and len(found) <= 35, found
    assert not {name for name in found if name.startswith("gelforge.mechanics.")} - {"gelforge.mechanics.material"}


def test_importing_loads_nothing_heavy():
    code = "import sys, gelforge; print({'numpy', 'torch', 'scipy', 'cv2'} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_names_complete_before_they_are_loaded():
    done = subprocess.run(
        [sys.executable, "-c", "import gelforge; print(*dir(gelforge))"], capture_output=True, check=True
    )
    assert done.stdout.decode().split() == sorted(gelforge.__all__)


def test_a_reader_is_pickled_and_shared_by_threads(root):
    """Processes of a data loader and threads of a robot read what one reader reads alone, wear included."""
    rest = read_image(root / "data/demo/nocontact/mini_a.png")
    markers = markers_in(rest)
    images = []
    for k, path in enumerate(sorted(root.glob("data/demo/images/*.png"))[:6]):
        # each image lacks other markers, so that more no-contact images are needed than are kept
        lost = markers.points[[k, k + 9, 2 * k + 20]] - 0.5
        images.append(painted_over(read_image(path), lost, markers.diameter))
    reader = gelforge.Reader(nocontact=rest)
    alone = [reader(image).cells for image in images]
    again = pickle.loads(pickle.dumps(reader))
    assert np.array_equal(again(images[0]).cells, alone[0])
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(again, images * 2))
    assert all(np.array_equal(one.cells, cells) for one, cells in zip(found, alone * 2, strict=True))


def test_readers_of_one_model_share_its_graph(root):
    """A graph for each of 229 sensors took 4.3 GB."""
    model = load_model(None)
    readers = [
        gelforge.Reader(nocontact=read_image(path), model=model)
        for path in sorted(root.glob("data/demo/nocontact/*.png"))
    ]
    assert len(readers) > 1 and all(reader.model.graph is model.graph for reader in readers)


def test_a_body_that_leans_touches_at_no_depth_and_one_that_is_level_does_not():
    """Depth counts at the tip: half of a leaning block is below it."""
    leaning = gelforge.solve("cuboid_10", depth=0.0, tilt=(3.0, 0.0))
    assert -1.5 < leaning.total[2] < -0.3
    assert not gelforge.solve("cuboid_10", depth=0.0).total.any()


def test_a_table_is_built_once_while_its_file_is_the_same(tmp_path):
    corners = np.array([[-4, -3, 5], [4, -3, 5], [4, 3, 5], [-4, 3, 5], [-2, 0, 0], [2, 0, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 4, 5], [0, 5, 1], [2, 5, 4], [2, 4, 3], [0, 3, 4], [1, 5, 2]])
    table = {"kind": "stl", "file": str(tmp_path / "roof.stl"), "spacing": 0.25, "reach": 2.0}
    write_stl(tmp_path / "roof.stl", corners, faces)
    first = _body(table)
    assert _body(dict(table)) is first and _body(table | {"reach": 1.5}) is not first
    write_stl(tmp_path / "roof.stl", 2.0 * corners, faces)
    assert _body(table) is not first
