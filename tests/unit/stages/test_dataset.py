"""Stage 60: splits without leaks, arrays that belong together, images of the right size."""

import math
import os
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, read_json, write_csv, write_text
from gelforge.flow.schema import altered
from gelforge.learning.data import open_data
from gelforge.learning.split import group_presses, split_presses
from gelforge.reading.light import match_light
from gelforge.records.press import repeats
from gelforge.stages.dataset import link_or_copy, published_splits
from tests.support.parameters import with_values
from tests.support.press_records import press_record
from tests.support.pressed_dataset import SETTINGS, collect, label, write_pressed
from tests.support.refused import refused


def presses(count, seed, touches=None, indenters=4, sensors=2):
    """Rows of presses; several presses per touch where `touches` are fewer."""
    rng = np.random.default_rng(seed)
    # On a lattice of 0.1 mm, so that no two touches are close enough to be one.
    places = np.array(divmod(rng.permutation(180 * 180)[: touches or count], 180)).T * 0.1 - 9
    rows = []
    for at in range(count):
        touch = int(rng.integers(touches)) if touches else at
        rows.append(
            press_record(
                sample_id=f"s{at}", indenter=f"i{touch % indenters}", sensor_id=f"c{rng.integers(sensors)}",
                x0_mm=places[touch, 0], y0_mm=places[touch, 1],
            )
        )  # fmt: skip
    return rows


@settings(max_examples=60)
@given(st.integers(1, 200), st.integers(1, 80), st.integers(0, 999), st.integers(1, 5))
def test_no_press_is_on_two_sides(count, touches, seed, kinds):
    rows = presses(count, seed, touches, kinds)
    split, group = split_presses(rows, {"i1"}, {}, altered(SETTINGS, unseen_sensors=("c1",), seed=seed))
    for row, name in zip(rows, split, strict=True):
        unseen = row.indenter == "i1", row.sensor_id == "c1"
        expected = {(1, 0): "test_unseen_indenter", (0, 1): "test_unseen_sensor", (1, 1): "test_unseen_both"}
        assert name == expected[unseen] if any(unseen) else name in ("train", "val", "test")
    known = [k for k, name in enumerate(split) if name in ("train", "val", "test")]
    for g in set(group[known]):
        assert len({split[k] for k in known if group[k] == g}) == 1
    places = {(row.indenter, row.x0_mm, row.y0_mm) for row in rows}
    assert len(set(group)) == len(places)


def test_fractions_hold():
    rows = presses(4000, 1)
    split, _ = split_presses(rows, set(), {}, SETTINGS)
    for name, fraction in (("train", 0.7), ("val", 0.1), ("test", 0.2)):
        chosen = split == name
        assert chosen.mean() == pytest.approx(fraction, abs=0.02)  # three deviations of 4000 draws
        for indenter in ("i0", "i3"):
            mine = np.array([row.indenter == indenter for row in rows])
            assert (chosen & mine).sum() / mine.sum() == pytest.approx(fraction, abs=0.04)

    for count in (8, 12, 20, 40):  # small ones still validate and test
        rows = presses(count, 3)
        split, _ = split_presses(rows, set(), {}, with_values(SETTINGS, validation=0.05, test=0.1))
        assert {"train", "val", "test"} <= set(split) and (split == "train").sum() > count / 2


def test_the_seed_decides():
    rows = presses(300, 2)
    first, again = (split_presses(rows, set(), {}, SETTINGS)[0] for _ in range(2))
    other = split_presses(rows, set(), {}, altered(SETTINGS, seed=2))[0]
    assert (first == again).all() and (first != other).any()


@settings(max_examples=40)
@given(st.integers(2, 100), st.floats(0.0, 1.0), st.integers(0, 999), st.booleans(), st.sampled_from([1, 3]))
def test_what_comes_later_moves_no_press(count, part, seed, revisited, frames):
    """A network may go on from one that learnt from the same presses when they were fewer: none that it saw tests it."""
    each = presses(count, seed, count // 2 if revisited else None)
    rows = [
        replace(row, sample_id=f"{row.sample_id}-{k}", press_id=row.sample_id) for row in each for k in range(frames)
    ]
    chosen, first = altered(SETTINGS, unseen_sensors=("c1",), seed=seed), frames * max(1, int(part * count))
    early = split_presses(rows[:first], {"i1"}, {}, chosen)[0]
    assert (early == split_presses(rows, {"i1"}, {}, chosen)[0][:first]).all()


def test_nearly_the_same_touch_is_one_press():
    places = ((0, 0), (0.04, 0), (0.08, 0.3), (0.2, 0), (0.2, 2))
    rows = [press_record(indenter="a", x0_mm=x, rot_deg=turn) for x, turn in places]
    rows += [replace(rows[0], indenter="b"), press_record(indenter="a", x0_mm=math.nan)]
    assert group_presses(rows, 0.05, 0.5, {}).tolist() == [0, 0, 0, 1, 2, 3, 4]


def test_turns_that_bring_an_indenter_onto_itself_are_one_press():
    for order, turns, groups in (
        (1, [180, -180, 0, 359.9, 90, -270, 90.3], [0, 0, 1, 1, 2, 2, 2]),
        (4, [0, 90, 180.2, 45, -45, 359.8], [0, 0, 0, 1, 1, 0]),
        (0, [0, 30, -77, 1e-18, -1e-18], [0, 0, 0, 0, 0]),
        (1, [-1e-18, 360.0, 1e-18], [0, 0, 0]),
        (1000, [0, 17, 99], [0, 0, 0]),
    ):
        rows = [press_record(indenter="a", rot_deg=float(turn)) for turn in turns]
        assert group_presses(rows, 0.05, 0.5, {"a": order}).tolist() == groups, turns


@settings(max_examples=60)
@given(st.integers(2, 80), st.integers(1, 40), st.integers(1, 6), st.integers(0, 999), st.sampled_from([1, 3]))
def test_presses_that_show_one_picture_are_in_one_split(count, pictures, kinds, seed, frames):
    """A frozen camera: also where one of them is of an indenter or a sensor that training must not see."""
    each = presses(count, seed, indenters=kinds)
    rng = np.random.default_rng(seed)
    rows = [
        replace(row, sample_id=f"{row.sample_id}-{k}", press_id=row.sample_id) for row in each for k in range(frames)
    ]
    shown = rng.integers(0, pictures, len(rows)).tolist()
    found, chosen = repeats(rows, shown), altered(SETTINGS, unseen_sensors=("c1",), seed=seed)
    split, group = split_presses(rows, {"i1"}, {}, chosen, found)
    for members in found:
        assert len(set(split[members])) == len(set(group[members])) == 1
    unseen = [at for at, row in enumerate(rows) if row.indenter == "i1" or row.sensor_id == "c1"]
    assert not set(split[unseen]) & {"train", "val", "test"}
    for press in {row.press_id for row in rows}:
        kinds_of = {split[at] for at, row in enumerate(rows) if row.press_id == press and row.sensor_id != "c1"}
        assert len(kinds_of) <= 1, "frames of one press were torn"


def test_frames_of_one_press_may_share_their_picture():
    rows = [press_record(press_id=name) for name in ("p", "p", "", "", "q", "p")]
    assert repeats(rows, ["a", "a", None, None, "b", "b"]) == [[4, 5]]
    assert repeats(rows, ["a", "a", "c", "c", "b", "a"]) == [[2, 3]]


@pytest.fixture(scope="module")
def made(tmp_path_factory, root):
    os.chdir(root)
    made = write_pressed(tmp_path_factory.mktemp("made"), failed=(5,), sensors=("mini_a", "mini_b"))
    for resolution in ("24x32", "6x8"):
        label(made, resolution)
        collect(made, resolution)
    return made


def test_arrays_belong_together(made):
    folder = made["results"] / "60_dataset/24x32"
    data = open_data(folder)
    assert len(data.table) == 23 and data.grid == (24, 32) and data.image_size == (240, 320)
    assert data.info["left_out"] == {"DIVERGED": 1} and data.info["c10"] == 0.0725 and data.info["c10_interval68"]
    for at in (0, 7, 22):
        name = data.table[at].press.sample_id
        image = cv2.imread(str(made["data"] / "images" / f"{name}.png"))[..., ::-1]
        assert np.array_equal(data.images[at], image)
        assert data.totals([at])[0] == pytest.approx(made["loads"][name].sum(axis=0), rel=1e-6)
        for axis, column in enumerate(("fx_n", "fy_n", "fz_n")):
            total = made["loads"][name].sum(axis=0)[axis]
            assert data.column(column)[at] == pytest.approx(total, rel=1e-6)
            assert data.column(f"measured_{column}")[at] == pytest.approx(total, rel=1e-9)
    assert {s.split for s in data.table if s.press.indenter == "triangle_8"} == {"test_unseen_indenter"}


def test_a_press_that_is_solved_later_moves_no_other(tmp_path, root):
    """Groups were named and split by the presses with labels: a failed one that is solved later moved its neighbours."""
    made = write_pressed(tmp_path)
    label(made, "4x4")
    whole = {s.press.sample_id: (s.split, s.group) for s in open_data(collect(made, "4x4")).table}
    shards = sorted((made["results"] / "50_labels/4x4").glob("*.npz"))
    for shard in shards:
        with np.load(shard) as stored:
            arrays = dict(stored)
        arrays["status"] = np.array(
            ["DIVERGED", *arrays["status"][1:]]
        )  # the first press of each shard failed so far
        np.savez(shard, **arrays)
    fewer = {s.press.sample_id: (s.split, s.group) for s in open_data(collect(made, "4x4")).table}
    assert 0 < len(fewer) < len(whole) and all(whole[name] == found for name, found in fewer.items())


@pytest.mark.parametrize("linked", [True, False])
def test_a_file_system_without_hard_links_gets_copies(tmp_path, monkeypatch, linked):
    """exFAT and SMB have none, and stage 60 always failed there."""
    (tmp_path / "a").write_bytes(b"images")
    if not linked:
        monkeypatch.setattr(os, "link", lambda *_: (_ for _ in ()).throw(PermissionError(1, "no links")))
    link_or_copy(tmp_path / "a", tmp_path / "b")
    assert (tmp_path / "b").read_bytes() == b"images" and os.path.samefile(tmp_path / "a", tmp_path / "b") == linked


def test_nocontact_images_come_along_where_they_were_photographed(tmp_path, root):
    made = write_pressed(tmp_path, count=4, sensors=("mini_a", "mini_b"))
    (made["data"] / "nocontact").mkdir()
    picture = np.random.default_rng(3).integers(0, 255, (240, 320, 3), np.uint8)
    cv2.imwrite(str(made["data"] / "nocontact/mini_b.png"), picture)
    label(made, "4x4")
    data = open_data(collect(made, "4x4"))
    assert data.info["nocontact"] == ["mini_b"]
    photographed, other = ([i for i, s in enumerate(data.table) if s.press.sensor_id == name] for name in
                           ("mini_b", "mini_a"))  # fmt: skip
    seen = data.seen(photographed, True)
    lit = [match_light(data.images[i], picture[..., ::-1]).undo(data.images[i]) for i in photographed]
    assert np.array_equal(seen[..., :3], lit)
    assert (seen[..., 3:] == picture[..., ::-1]).all()
    assert np.array_equal(data.seen(other, False), data.images[other])
    refused("nocontact/mini_a.png", data.seen, other, True)


def test_the_truth_of_a_virtual_rig_goes_into_its_columns(tmp_path, root):
    made = write_pressed(tmp_path, count=2)
    (made["data"] / "truth").mkdir()
    (made["data"] / "truth/presses.csv").write_text("sample_id,status,fx_n,fy_n,fz_n\ns001,OK,1.0,2.0,-3.5\n")
    label(made, "4x4")
    rows = read_csv(collect(made, "4x4") / "samples.csv")
    assert [row["true_fz_n"] for row in rows] == ["", "-3.5"] and rows[1]["true_fx_n"] == "1.0"


def test_resolutions_share_split_and_images(made):
    fine, coarse = (made["results"] / "60_dataset" / name for name in ("24x32", "6x8"))
    assert (fine / "split.csv").read_text() == (coarse / "split.csv").read_text()
    assert os.path.samefile(fine / "images.npy", coarse / "images.npy")
    assert [r["split"] for r in read_csv(fine / "samples.csv")] == [r["split"] for r in read_csv(fine / "split.csv")]


def test_a_picture_array_that_was_corrupted_in_place_is_drawn_again(tmp_path):
    """images.npy is a link to what resolutions share: making it again must not link the corruption."""
    made = write_pressed(tmp_path, count=4)
    label(made, "4x4")
    path = collect(made, "4x4") / "images.npy"
    whole = path.read_bytes()
    with path.open("r+b") as stream:
        stream.seek(len(whole) // 2)
        stream.write(bytes([whole[len(whole) // 2] ^ 255]))
    assert path.read_bytes() != whole
    path.unlink()  # as the wrapper does with what it finds corrupt
    assert (collect(made, "4x4") / "images.npy").read_bytes() == whole


def test_a_picture_that_was_replaced_with_its_old_time_is_seen(tmp_path, root):
    made = write_pressed(tmp_path, count=4)
    label(made, "4x4")
    collect(made, "4x4")
    picture = made["data"] / "images/s001.png"
    stamp = picture.stat().st_mtime_ns
    cv2.imwrite(str(picture), np.zeros((240, 320, 3), np.uint8))
    os.utime(picture, ns=(stamp, stamp))
    assert not open_data(collect(made, "4x4")).images[1].any()


def write_png(path, image):
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), image)


def shrink(made):
    cv2.imwrite(str(made["data"] / "images/s002.png"), np.zeros((120, 160, 3), np.uint8))


def escape(made):
    path = made["results"] / "10_poses/0000.csv"
    path.write_text(path.read_text().replace("images/s002.png", "../../../../etc/hostname"))


def without_images(made):
    for table in (made["results"] / "10_poses").glob("*.csv"):
        rows = read_csv(table)
        write_csv(table, list(rows[0]), [{**row, "image": ""} for row in rows])


def corrupt_truth(made, content):
    (made["data"] / "truth").mkdir()
    (made["data"] / "truth/presses.csv").write_bytes(content)


BROKEN = (
    (shrink, {}, r"s002\.png.*160 x 120.*320 x 240.*sensors\.toml"),
    (lambda m: write_png(m["data"] / "nocontact/mini_a.png", np.zeros((12, 16, 3), np.uint8)), {}, r"nocontact/mini_a\.png.*16 x 12"),
    (lambda m: write_text(m["data"] / "nocontact/mini_a.png", "no picture"), {}, r"nocontact/mini_a\.png.*remove it"),
    (lambda m: (m["data"] / "images/s003.png").unlink(), {}, r"s003\.png.*not found"),
    (escape, {}, "hostname.*inside"),
    (without_images, {}, r"log\.csv: names no images, .* ends at labels: run make labels DATASET="),
    (lambda m: (m["results"] / "50_labels/4x4/0000.npz").write_bytes(b"x"), {}, r"0000\.npz.*make labels"),
    (lambda m: write_text(m["data"] / "splits.csv", "sample_id,split\ns000,train\ns003\n"), {}, r"splits\.csv.*row 3.*number of cells"),
    (lambda m: write_text(m["data"] / "splits.csv", "sample_id,split\ns000,\n"), {}, r"splits\.csv.*row 2.*is not a name"),
    (lambda m: write_text(m["data"] / "splits.csv", "sample_id,split\ns000,Train\n"), {},
     r"splits\.csv: row 2: split 'Train' is none of networks' splits; write train"),
    (lambda m: write_text(m["data"] / "splits.csv", "sample_id,split\ns000,train\ns001,train\ns000,test\n"), {},
     r"splits\.csv.*row 4.*'s000' is in two splits"),
    (lambda m: corrupt_truth(m, b"sample_id,fx_n,fy_n,fz_n\n\xff,1,2,3\n"), {}, "presses.csv: not UTF-8"),
    (lambda m: corrupt_truth(m, b"sample_id,fx_n,fy_n,fz_n\ns001,1\n"), {}, "presses.csv: row 2 has another number"),
    (lambda m: None, {"validation": 0.7, "test": 0.4}, "validation.*0.7"),
)  # fmt: skip


def test_broken_inputs_are_refused_and_nothing_is_written(tmp_path, root):
    for k, (breaking, params, said) in enumerate(BROKEN):
        made = write_pressed(tmp_path / f"made{k}", count=6)
        label(made, "4x4")
        breaking(made)
        refused(said, collect, made, "4x4", **params)
        assert not (made["results"] / "60_dataset/4x4/dataset.json").exists()
        assert not list((made["results"] / "60_dataset").rglob(".*.part*"))
    made = write_pressed(tmp_path / "failed", count=2, failed=(0, 1))
    label(made, "4x4")
    refused(r"\(left out: 2 x DIVERGED\)", collect, made, "4x4")


def test_a_press_torn_between_splits_is_refused(tmp_path):
    write_text(tmp_path / "splits.csv", "sample_id,split\na,train\nb,test\nc,train\nd,test\ne,test\n")
    rows = {
        "a": press_record(sample_id="a", press_id="p1", sensor_id="one"),
        "b": press_record(sample_id="b", press_id="p1", sensor_id="two"),
        "c": press_record(sample_id="c", press_id="", sensor_id="one"),
        "d": press_record(sample_id="d", press_id="", sensor_id="one"),
        "e": press_record(sample_id="e", press_id="p1", sensor_id="one"),
    }
    whole = [rows[name] for name in "abcd"]
    assert published_splits(tmp_path, whole, np.array([])).tolist() == ["train", "test", "train", "test"]
    with pytest.raises(BadInput, match="samples a and e are of one press, p1, but in the splits train and test"):
        published_splits(tmp_path, list(rows.values()), np.array([]))


def test_a_published_split_that_tests_on_a_picture_it_taught_is_refused(tmp_path):
    write_text(tmp_path / "splits.csv", "sample_id,split\na,train\nb,test\nc,test\n")
    rows = [press_record(sample_id=name) for name in "abc"]
    assert published_splits(tmp_path, rows, np.array([]), [[1, 2]]).tolist() == ["train", "test", "test"]
    said = r"images of a \(train\) and c \(test\) are equal"
    refused(said, published_splits, tmp_path, rows, np.array([]), [[1, 2], [0, 2]])


def freeze(made, *names):
    """The camera froze after the first of these presses: pictures of equal pixels, files of unlike bytes."""
    folder = made["data"] / "images"
    frozen = cv2.imread(str(folder / f"{names[0]}.png"))
    for name in names[1:]:
        cv2.imwrite(str(folder / f"{name}.png"), frozen, [cv2.IMWRITE_PNG_COMPRESSION, 0])


def test_a_frozen_camera_is_named_and_its_presses_stay_together(tmp_path, root, capsys):
    made = write_pressed(tmp_path)
    label(made, "4x4")
    freeze(made, "s003", "s009", "s011")
    table = {s.press.sample_id: s for s in open_data(collect(made, "4x4")).table}
    said = capsys.readouterr().err
    assert "3 presses share 1 picture of the same content: s003 (images/s003.png), s009" in said and "freeze" in said
    assert len({table[name].group for name in ("s003", "s009", "s011")}) == 1
    # s011 pressed an indenter that training must not see
    assert {table[name].split for name in ("s003", "s009", "s011")} == {"test_unseen_indenter"}


def test_forces_of_the_log_that_do_not_suit_the_labels_are_noted(tmp_path, root, capsys):
    made = write_pressed(tmp_path)
    label(made, "4x4")
    for path in (made["results"] / "10_poses").glob("*.csv"):
        rows = read_csv(path)
        write_csv(path, list(rows[0]), [row | {"fz_n": float(row["fz_n"]) / 4.44822} for row in rows])
    (doubt,) = read_json(collect(made, "4x4") / "dataset.json")["doubts_of_forces"]
    assert "they are in pounds-force" in doubt and f"note: {made['data']}/log.csv: {doubt}" in capsys.readouterr().err
