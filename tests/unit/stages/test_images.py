"""Stage 15 on the demo's images: what stops make, what is left out of the dataset, and what is read again."""

import shutil

import numpy as np
import pytest

from gelforge.flow.files import read_csv, read_json, read_toml, write_csv, write_json
from gelforge.flow.layout import Layout
from gelforge.records.image import read_image, write_png
from gelforge.records.log import read_shard
from gelforge.records.press import parse
from gelforge.stages import images
from gelforge.stages.dataset import wrong_imported
from gelforge.stages.plan import spare, used
from tests.support.parameters import write_stage
from tests.support.refused import refused

# Rows of the demo: fourteen of mini_a and one of mini_e; and what tells an order or a shape, all of mini_a.
FEW = [0, 1, 2, 3, 5, 6, 7, 9, 10, 13, 15, 16, 17, 18, 21]
MORE = [0, 1, 2, *range(5, 11), *range(13, 19), 21]


@pytest.fixture(params=[FEW], ids=["few"])
def folder(request, root, tmp_path):
    """Some of the demo's presses as the plan leaves them, and their images."""
    of, demo = Layout(tmp_path / "results/demo"), root / "data/demo"
    shutil.copytree(demo / "nocontact", of.data / "nocontact")
    (of.data / "images").mkdir()
    sensors, catalogue = (read_toml(root / "workflow" / f"{name}.toml") for name in ("sensors", "indenters"))
    every = read_csv(demo / "log.csv")
    rows = [every[at] | {"row": at + 2} for at in request.param]
    for row in rows:
        shutil.copy(demo / row["image"], of.data / "images")
    for name, part in (("0000", rows[:8]), ("0001", rows[8:])):
        write_csv(of.shard(name), list(rows[0]), part)
        bodies = used(catalogue, {row["indenter"] for row in part})
        write_json(of.used(name), {"sensors": sensors, "indenters": bodies})
    write_json(of.parameters("sensors"), sensors)
    write_json(of.parameters("spare"), spare(catalogue, used(catalogue, {row["indenter"] for row in rows})))
    return of.root


def judge(folder, capsys, **poses) -> tuple[int, str]:
    """Exit status of stage 15 and what it writes to people."""
    write_stage(folder / "00_plan/params", "images", poses=poses)
    status = images.main([str(folder)])
    return status, capsys.readouterr().err


def exchange(folder, one: int, other: int) -> None:
    first, second = (Layout(folder).data / f"images/demo-{at:06d}.png" for at in (one, other))
    kept = first.read_bytes()
    first.write_bytes(second.read_bytes())
    second.write_bytes(kept)


def test_wrong_images_are_left_out(folder, capsys):
    assert judge(folder, capsys) == (0, "")
    found = read_json(folder / "15_images/images.json")
    assert found["judged"] == len(FEW) and not found["left_out"] and not found["notes"]
    exchange(folder, 13, 16)  # of the second shard
    shutil.copy(Layout(folder).data / "images/demo-000003.png", Layout(folder).data / "images/demo-000005.png")
    status, said = judge(folder, capsys)
    assert status == 0
    assert read_json(folder / "15_images/images.json")["left_out"].keys() == {
        "demo-000005",
        "demo-000013",
        "demo-000016",
    }
    assert (
        said.count("rejected: ") == 3
        and "different sensors" in said
        and "row 15 (demo-000013)" in said
        and "(row 7)" in said
    )


@pytest.mark.parametrize("folder", [MORE], indirect=True, ids=["more"])
def test_shifted_images_stop_make_unless_all_are_to_be_used(folder, capsys):
    after = dict(zip(MORE, [*MORE[1:], MORE[0]], strict=True))
    for table in (folder / "00_plan/shards").glob("*.csv"):
        rows = [row | {"image": f"images/demo-{after[int(row['row']) - 2]:06d}.png"} for row in read_csv(table)]
        write_csv(table, list(rows[0]), rows)
    refused(r"shifted by one row.*judge_images = false", judge, folder, capsys)
    assert not (folder / "15_images/images.json").exists()
    assert judge(folder, capsys, judge_images=False) == (0, "")


@pytest.mark.parametrize("folder", [MORE], indirect=True, ids=["more"])
def test_an_indenter_that_no_row_names_is_recognised(folder, capsys):
    of = Layout(folder)
    others = read_json(of.parameters("spare"))
    for name in of.names():
        rows = read_csv(of.shard(name))
        named = [row | {"indenter": row["indenter"].replace("cylinder_8", "triangle_10")} for row in rows]
        write_csv(of.shard(name), list(rows[0]), named)
        tables = read_json(of.used(name))
        others["cylinder_8"] = tables["indenters"].pop("cylinder_8")
        write_json(of.used(name), tables)
    write_json(of.parameters("spare"), others)
    status, said = judge(folder, capsys)
    assert status == 0 and "images of triangle_10 show the shape of cylinder_8" in said


def test_a_pressed_no_contact_image_stops_make(folder, capsys):
    shutil.copy(Layout(folder).data / "images/demo-000003.png", Layout(folder).data / "nocontact/mini_e.png")
    refused(r"nocontact/mini_e.png: .* touch the gel", judge, folder, capsys)


def test_a_no_contact_image_of_another_unit_or_size_stops_make(folder, capsys):
    """Also where images are used as they are: one size of all is needed, and solves would come first."""
    of = Layout(folder)
    mine, other = of.data / "nocontact/mini_a.png", of.data / "nocontact/mini_e.png"
    picture = read_image(mine)
    shutil.copy(other, mine)
    refused(
        r"sensor mini_a: 1\d of 14 images .* are of different sensors.*judge_images = false", judge, folder, capsys
    )
    assert judge(folder, capsys, judge_images=False) == (0, "")
    write_png(mine, np.ascontiguousarray(np.resize(picture, (480, 640, 3))))
    for judged in (True, False):
        refused(r"mini_a.png.*640 x 480.*320 x 240", judge, folder, capsys, judge_images=judged)


def test_a_sensor_all_of_whose_images_are_as_opencv_reads_them_is_noted(folder, capsys):
    """They suit each other, but not what the shipped network learnt from."""
    data = Layout(folder).data
    for path in [*data.glob("images/*.png"), *data.glob("nocontact/*.png")]:
        write_png(path, np.ascontiguousarray(read_image(path)[..., ::-1]))
    status, said = judge(folder, capsys)
    assert status == 0 and said.count("not in OpenCV's BGR") == 2 and "nocontact/mini_e.png: red and blue" in said


def test_imported_images_are_judged_where_the_dataset_is_made(folder, capsys):
    """Without poses there is no stage 15: an image of another unit and a mirrored one are named by their rows."""
    mirrored = Layout(folder).data / "images/demo-000006.png"
    write_png(mirrored, np.ascontiguousarray(read_image(mirrored)[:, ::-1]))
    shutil.copy(Layout(folder).data / "images/demo-000003.png", Layout(folder).data / "images/demo-000005.png")
    found = wrong_imported(
        Layout(folder), [parse(row, "log.csv")[0] for row in read_shard(Layout(folder).shard("0000"))]
    )
    assert found.keys() == {"demo-000005", "demo-000006"} and "mirrored left to right" in found["demo-000006"]
    assert "(row 8)" in capsys.readouterr().err


def test_every_press_is_in_one_chunk(block):
    presses = list(range(10))
    chunks = list(images.in_chunks(presses))
    assert [press for chunk in chunks for press in chunk] == presses and all(chunks)
