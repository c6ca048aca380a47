"""`gelforge predict` on small networks: maps and totals of pictures, and what is refused before anything is written."""

import csv
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelforge.commands import predict
from gelforge.reading.markers import grey_of
from gelforge.reading.measures import count_markers
from gelforge.reading.reader import Reader
from gelforge.reading.wear import darkness_of
from gelforge.reporting import forcemaps
from tests.support.limited import small_disk
from tests.support.refused import refused
from tests.support.small_networks import GRID, IMAGE
from tests.support.waiting import heed_interrupts


def write_png(path, image) -> Path:
    cv2.imwrite(str(path), cv2.cvtColor(np.asarray(image), cv2.COLOR_RGB2BGR))
    return path


def totals(folder) -> list[dict]:
    with (folder / "totals.csv").open() as stream:
        return list(csv.DictReader(stream))


@pytest.fixture
def given(data, paths, tmp_path):
    """(picture, words of a call that reads it by a small network into out)."""
    image = write_png(tmp_path / "p.png", data.images[0])
    return image, [str(image), "--model", str(paths["unet"]), "--out", str(tmp_path / "out")]


def test_predict_writes_maps_and_totals(data, paths, tmp_path, capsys, monkeypatch):
    """The title of a picture calls its score as the table does."""
    titles, write_maps = [], forcemaps.write_maps
    monkeypatch.setattr(forcemaps, "write_maps", lambda *args: titles.append(args[-1]) or write_maps(*args))
    images = [write_png(tmp_path / f"{i}.png", data.images[i]) for i in range(2)]
    assert predict.main([*map(str, images), "--model", str(paths["unet"]), "--out", str(tmp_path / "out")]) == 0
    rows = totals(tmp_path / "out")
    for i, row in enumerate(rows):
        forces = np.load(tmp_path / "out" / f"{i}.npy")
        assert forces.shape == (3, *GRID)
        # totals.csv has four decimals.
        assert float(row["fz_n"]) == pytest.approx(forces[2].sum(), abs=1e-3)
        assert row["flagged"] == "0" and titles[i].startswith(str(i))
        assert row["map"] == f"{i}.npy" and (tmp_path / "out" / f"{i}.png").exists()
    lines = capsys.readouterr().out.splitlines()
    assert ["CROPPED" in line for line in lines[: len(rows)]] == [float(row["edge_peak"]) >= 0.2 for row in rows]


def test_what_is_no_picture_is_refused_before_anything_is_written(given, paths, tmp_path):
    good, (_, *words) = given
    for name, content in (("bad.png", b"no picture"), ("film.avi", b"no picture"), ("empty.png", b"")):
        (tmp_path / name).write_bytes(content)
    (tmp_path / "loop.png").symlink_to("loop.png")
    for name, said in (
        ("bad.png", "cannot be read as an image .of another kind"),
        ("absent.png", "not found"),
        ("empty.png", "is empty"),
        ("film.avi", "is a film; `gelforge live --video"),
        ("", rf"{tmp_path}: is a folder; name the pictures in it, such as {tmp_path}/\*\.png"),
        ("loop.png", r"loop.png: cannot be .*symbolic links"),
        (f"{'a' * 300}.png", "File name too long"),
    ):
        refused(said, predict.main, [str(good), str(tmp_path / name), *words])
    refused("digit", predict.main, [str(good), *words, "--sensor", "digit"])
    refused("loop.png: cannot be", predict.main, [str(good), *words, "--nocontact", str(tmp_path / "loop.png")])
    refused("give it with --nocontact", predict.main, [str(good), *words, "--model", str(paths["pair"])])
    assert not (tmp_path / "out").exists()


def test_a_name_too_long_for_any_file_is_one_line(given, data, tmp_path, capsys):
    """A picture may have the longest name that there is; that of its map is longer."""
    image = write_png(tmp_path / f"{'a' * 250}.png", data.images[0])
    with pytest.raises(SystemExit) as ended:
        predict.main.exit([str(image), *given[1][1:]])
    reported = capsys.readouterr().err
    assert ended.value.code == 2 and reported.count("\n") == 1 and "File name too long; give another name" in reported


def test_predict_never_takes_the_place_of_what_it_reads(given, data, paths, tmp_path):
    image, (_, *words) = given
    shots, kept = tmp_path / "shots", tmp_path / "kept"
    for folder in (shots, kept):
        folder.mkdir()
    shot, rest = (write_png(folder / "nocontact.png", data.images[0]) for folder in (shots, kept))
    table = write_png(tmp_path / "t.png", data.images[0]).rename(shots / "totals.csv")
    before = {path: path.read_bytes() for path in (image, rest, table)}
    for out, more in (
        (image.parent, [str(image)]),
        (shots, [str(table)]),
        (kept, [str(shot), "--nocontact", str(rest)]),
    ):
        refused("would overwrite an input file", predict.main, [*more, *words, "--out", str(out)])
    assert before == {path: path.read_bytes() for path in before} and len(list(kept.iterdir())) == 1


def test_an_interrupted_call_leaves_no_table_of_an_earlier_one(given, tmp_path, monkeypatch):
    assert predict.main(given[1]) == 0 and (tmp_path / "out/totals.csv").is_file()
    monkeypatch.setattr(predict.Reader, "__call__", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        predict.main(given[1])
    assert not (tmp_path / "out/totals.csv").exists()


@pytest.mark.processes
def test_who_interrupts_keeps_the_rows_of_what_was_read(given, tmp_path):
    """A person who reads a hundred pictures and presses Ctrl-C at the second line."""
    command = [sys.executable, "-m", "gelforge.commands.predict", *[str(given[0])] * 99, *given[1]]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, preexec_fn=heed_interrupts
    ) as child:
        assert child.stdout.readline() and child.stdout.readline()
        child.send_signal(signal.SIGINT)
        printed = 2 + len(child.stdout.readlines())
    rows = totals(tmp_path / "out")
    assert child.returncode != 0 and printed <= len(rows) < 100
    assert all((tmp_path / "out" / f"p{'' if k == 0 else f'-{k + 1}'}.npy").exists() for k in range(len(rows)))


@pytest.mark.processes
def test_a_full_disk_leaves_each_map_with_its_row(given, tmp_path):
    """Maps and their rows are written together: the disk took a map of which no table said anything."""
    with small_disk(tmp_path / "disk") as disk:
        command = [sys.executable, "-m", "gelforge.commands.predict", *[str(given[0])] * 9, *given[1]]
        command[command.index("--out") + 1] = str(disk / "out")
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 2 and "No space left" in done.stderr and "Traceback" not in done.stderr
        table = disk / "out/totals.csv"
        rows = totals(disk / "out") if table.exists() else []
        kept = {path.name for path in (disk / "out").iterdir()} - {"totals.csv"}
        assert kept == {f"{row['map'].removesuffix('.npy')}{end}" for row in rows for end in (".npy", ".png")}


def test_any_name_of_a_file_is_only_a_name(given, data, tmp_path):
    """Not a formula, not text that every table can hold; and two images of one name keep apart."""
    assert predict.output_names(["a/x.png", "b/x.png", "y.png"]) == ["x", "x-2", "y"]
    names = predict.output_names(["l/0.png", "r/0.png", "0-2.png", "m/0.png"])
    assert len(set(names)) == 4 and names[:2] == ["0", "0-2"]
    odd = [tmp_path / "p$_$q.png", tmp_path / os.fsdecode(b"a\xff.png")]
    for path in odd:
        write_png(tmp_path / "new.png", data.images[0]).rename(path)
    predict.main([*map(str, odd), *given[1][1:]])
    assert [Path(row["image"]).name for row in totals(tmp_path / "out")] == ["p$_$q.png", r"a\udcff.png"]


def test_unlike_images_are_flagged(data, models):
    predictor = Reader(model=models["unet"].model)
    assert not any(predictor(data.images[row]).flag for row in data.splits["test"])
    for image, reason in (
        (np.zeros((*IMAGE, 3), np.uint8), "dark, covered or of one colour"),
        (np.full((*IMAGE, 3), 120, np.uint8), "dark, covered or of one colour"),
        (cv2.resize(np.asarray(data.images[0]), (160, 96)), "aspect ratio differs"),
    ):
        found = predictor(image)
        assert found.flag and reason in found.reason
    coloured = models["unet"].metadata["normalisation"] | {"image_mean": [0.2, 0.4, 0.6]}
    metadata = models["unet"].metadata | {"normalisation": coloured}  # these images of all colours have none
    assert (
        "monochrome"
        in Reader(model=replace(models["unet"].model, metadata=metadata))(
            np.repeat(data.images[0][..., :1], 3, axis=2)
        ).reason
    )


def test_markers_of_real_sensors_are_counted(reference):
    feats = cv2.imread(str(reference / "feats" / "images" / "cuboid_10-2-284.png"))
    # 7 x 9 markers, two of which lie at the rim.
    for image, count, apart in ((feats, 63, 4), (cv2.medianBlur(feats, 61), 0, 3)):
        assert count_markers(darkness_of(grey_of(cv2.split(image)))) == pytest.approx(count, abs=apart)
