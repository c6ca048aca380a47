"""Evaluation, prediction, live overlay, ONNX, chart: the parts that people run, on a small model."""

import csv
import os
import shutil
import signal
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from parameters import parameters, with_values
from synthetic_presses import SETTINGS, write_dataset

from gelforge.commands import live, predict
from gelforge.commands.live_readings import readings, stopping, until
from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, read_json, write_csv, write_json
from gelforge.networks import statistics, use
from gelforge.networks.canonical import WHOLE, view_of
from gelforge.networks.data import open_data, rows_to_judge_by
from gelforge.networks.metrics import slope
from gelforge.networks.modelcard import write_card
from gelforge.networks.modelfile import save_model
from gelforge.networks.onnxgraph import TOLERANCE, export, largest_difference, run_onnx
from gelforge.records.axes import CHANNELS
from gelforge.records.markers import pitch_of
from gelforge.records.predictionfile import read_predictions
from gelforge.reporting.networkcharts import draw_curve, draw_predictions
from gelforge.stages import pareto_models
from gelforge.stages.evaluate import another_of_each, evaluate, fitted_rows, keep_predictions
from gelforge.stages.train import train

IMAGE, GRID = (48, 64), (6, 8)
MODELS = {
    "unet": {"kind": "unet", "widths": [4, 8]},
    "small": {"kind": "grid", "width": 8, "blocks": 2},
    "difference": {"kind": "grid", "width": 8, "blocks": 1, "reads": "difference"},
    "pair": {"kind": "grid", "width": 8, "blocks": 1, "reads": "pair"},
    "resnet": {"kind": "resnet", "blocks": [1, 1], "widths": [4, 8]},
}
EVALUATE = with_values(parameters().evaluate, force_edges=[0.0, 5.0, 20.0], bootstrap=50)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return open_data(write_dataset(tmp_path_factory.mktemp("dataset") / "6x8", 48, IMAGE, GRID))


@pytest.fixture(scope="module")
def models(data):
    return {name: train(data, name, model, with_values(SETTINGS, epochs=2)) for name, model in MODELS.items()}


@pytest.fixture(scope="module")
def paths(models, tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    for name, trained in models.items():
        save_model(folder / f"{name}.pt", trained)
    return {name: folder / f"{name}.pt" for name in models}


@pytest.mark.parametrize("name", MODELS)
def test_evaluation_holds_what_is_asked(data, models, name):
    result, predictions = evaluate(data, models[name], EVALUATE)
    assert set(result["splits"]) == {"val", "test", "test_unseen_indenter", "test_unseen_sensor"}
    test = result["splits"]["test"]
    rows, forces = predictions["test"]
    error = np.abs(forces.sum((2, 3), dtype=float) - data.totals(rows))
    assert test["total"]["grid_z"]["mae"] == pytest.approx(error[:, 2].mean())
    assert (test["cell"] is None) == (name == "resnet")
    assert set(test["controls"]) == {"constant_guess", "shuffled_images", "linear_on_image_means"}
    assert {len(row) for table in result["tables"] for row in table["rows"]} <= {4, 5, 6, 7, 8}
    assert all(len(row) == len(table["columns"]) for table in result["tables"] for row in table["rows"])


def test_sensor_and_truth_are_compared_on_the_right_axis(data, models):
    against = evaluate(data, models["small"], EVALUATE)[0]["splits"]["test"]["against"]
    for axis in CHANNELS:
        # The made-up force sensor reads 0.1 N too much, the made-up truth is the label (float32 sums).
        assert against["sensor"]["labels"][axis]["bias"] == pytest.approx(-0.1, abs=1e-5)
        assert against["truth"]["labels"][axis]["mae"] < 1e-5


def test_labels_are_held_against_the_truth_in_size(data, models):
    against = evaluate(data, models["small"], EVALUATE)[0]["splits"]["test"]["against"]
    assert against["truth"]["labels_over"]["grid_z"] == pytest.approx(1.0, abs=1e-5)
    assert slope(np.full((4, 3), 0.98), np.ones((4, 3))) == pytest.approx(dict.fromkeys(CHANNELS, 0.98))


def test_evaluation_tells_what_predict_tells(data, models):
    trained = models["pair"]
    told = evaluate(data, trained, EVALUATE)[0]["splits"]["test"]["told"]
    rows = data.splits["test"]
    names = data.names("sensor_id")[rows]
    forces = [
        use.predict_one(use.Untouched(trained, data.nocontact[name]), np.asarray(data.images[row]))[1]
        for row, name in zip(rows, names, strict=True)
    ]
    error = np.sum(forces, axis=(2, 3), dtype=float) - data.totals(rows)
    for k, axis in enumerate(CHANNELS):
        assert told["total"][axis]["mae"] == pytest.approx(np.abs(error[:, k]).mean())
    assert evaluate(data, models["small"], EVALUATE)[0]["splits"]["test"]["told"] is None


def test_evaluation_of_a_network_on_nothing_but_what_it_learnt_from_is_refused(data, models):
    only = replace(data, splits={"train": data.splits["train"]})
    with pytest.raises(BadInput, match="one other"):
        evaluate(only, models["small"], EVALUATE)


@pytest.mark.parametrize("count", [1, 3])
def test_a_dataset_of_few_presses_is_read_by_a_network_that_did_not_learn_from_it(models, tmp_path, count):
    """The first presses of a bench are all of one split; their report shows them all the same."""
    few = open_data(write_dataset(tmp_path / "6x8", count, IMAGE, GRID, seed=9))
    assert set(few.splits) == {"train"}
    result, predictions = evaluate(few, models["pair"], EVALUATE)
    assert set(result["splits"]) == {"train"} and len(predictions["train"][0]) == count
    keep_predictions(tmp_path / "p.npz", few, models["pair"], predictions)
    assert read_predictions(tmp_path / "p.npz")


@pytest.mark.parametrize("name", MODELS)
def test_onnx_equals_torch(models, name, data, tmp_path):
    export(models[name], tmp_path / "m.onnx")
    found = largest_difference(models[name], tmp_path / "m.onnx", np.asarray(data.images[:3]))
    assert found and max(found.values()) <= TOLERANCE


def test_pictures_and_card_are_written(data, models, tmp_path):
    about = models["small"].about
    result, predictions = evaluate(data, models["small"], EVALUATE)
    draw_curve(tmp_path / "curve.png", about["curve"], about["best_epoch"], "small")
    draw_predictions(tmp_path / "predictions.png", data, predictions)
    for name in ("curve", "predictions"):
        assert cv2.imread(str(tmp_path / f"{name}.png")).std() > 5
    assert "virtual rig" in write_card(about, result)
    left = [{"readings": 5, "factor_percent": 1.62, "factor_between": [0.3, 3.1], "force_n": 0.7, "force_between": [0.4, 1.1],
             "held_percent": 99.6}]  # fmt: skip
    assert "| 5 | 1.6 (0.3 to 3.1) | 0.70 (0.40 to 1.10) | 100 |" in write_card(about, result, readings=left)
    real = about | {"data": about["data"] | {"simulated": False}}
    assert "virtual rig" not in write_card(real, result)


def write_png(path, image) -> Path:
    cv2.imwrite(str(path), cv2.cvtColor(np.asarray(image), cv2.COLOR_RGB2BGR))
    return path


def test_predict_writes_maps_and_totals(data, models, paths, tmp_path, capsys):
    images = [write_png(tmp_path / f"{i}.png", data.images[i]) for i in range(2)]
    assert predict.main([*map(str, images), "--model", str(paths["small"]), "--out", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "totals.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    for i, row in enumerate(rows):
        forces = np.load(tmp_path / "out" / f"{i}.npy")
        assert forces.shape == (3, *GRID)
        # totals.csv has four decimals.
        assert float(row["grid_z_n"]) == pytest.approx(forces[2].sum(), abs=1e-3)
        assert row["flagged"] == "0"
        assert (tmp_path / "out" / f"{i}.png").exists()


def test_the_documented_steps_around_an_onnx_graph_give_what_predict_gives(models, data, tmp_path):
    """Light, scale, tare and factor outside, the network inside: what someone without torch would write."""
    trained, gain = models["pair"], 1.2
    rest = np.asarray(data.nocontact["mini0"])
    image = np.clip(np.rint(0.93 * np.asarray(data.images[3]).astype(float) + 3), 0, 255).astype(np.uint8)
    _, wanted, verdict = use.predict_one(use.Untouched(trained, rest, gain=gain), image)
    assert verdict["light"].known and verdict["light"].gain.min() < 0.97
    export(trained, tmp_path / "m.onnx")
    learnt = trained.about.get("pitch_px")
    view = view_of(rest, pitch_of(rest), tuple(learnt)) if learnt else WHOLE
    picture = view.of(rest)
    lit, _ = view.match(view.of(image), picture)
    tensors = np.stack([lit, picture]).transpose(0, 3, 1, 2).astype(np.float32)
    for read in run_onnx(tmp_path / "m.onnx", tensors, tensors[1:]).values():
        np.testing.assert_allclose(gain * (read[0] - read[1]), wanted, atol=2e-5 * np.abs(wanted).max())


def test_predict_refuses_before_it_writes(data, paths, tmp_path):
    good = write_png(tmp_path / "good.png", data.images[0])
    (tmp_path / "bad.png").write_bytes(b"no picture")
    for bad, word in ((tmp_path / "bad.png", "cannot be read"), (tmp_path / "absent.png", "not found")):
        with pytest.raises(BadInput, match=word):
            predict.main([str(good), str(bad), "--model", str(paths["small"]), "--out", str(tmp_path / "out")])
    with pytest.raises(BadInput, match="digit"):
        predict.main([str(good), "--model", str(paths["small"]), "--sensor", "digit", "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


def test_predict_finds_the_untouched_sensor(data, models, paths, tmp_path):
    image = write_png(tmp_path / "p.png", data.images[0])
    own = data.nocontact["mini0"]
    other = replace(models["pair"], untouched={"bright": np.clip(own.astype(int) + 60, 0, 255).astype(np.uint8)} |
                    models["pair"].untouched)  # fmt: skip
    assert use.Untouched(other).of(data.images[0]) == "mini0"
    assert use.Untouched(other, sensor="bright").of(data.images[0]) == "bright"
    assert use.predict_one(use.Untouched(other, sensor="bright"), data.images[0])[2]["flag"]
    with pytest.raises(BadInput, match="--untouched"):
        use.Untouched(other, sensor="mini9")
    totals = []
    for more in ([], ["--untouched", str(write_png(tmp_path / "own.png", own))], ["--sensor", "mini0"]):
        predict.main([str(image), "--model", str(paths["pair"]), "--out", str(tmp_path / "out"), *more])
        with (tmp_path / "out" / "totals.csv").open() as stream:
            totals.append([{**row, "untouched": ""} for row in csv.DictReader(stream)])
    assert totals[0] == totals[1] == totals[2]


def test_two_images_of_one_name_keep_apart():
    assert predict.output_names(["a/x.png", "b/x.png", "y.png"]) == ["x", "x-2", "y"]
    names = predict.output_names(["l/0.png", "r/0.png", "0-2.png", "m/0.png"])
    assert len(set(names)) == 4 and names[:2] == ["0", "0-2"]


def test_predict_never_takes_the_place_of_what_it_reads(data, paths, tmp_path):
    image = write_png(tmp_path / "p.png", data.images[0])
    before = image.read_bytes()
    with pytest.raises(BadInput, match="would take the place"):
        predict.main([str(image), "--model", str(paths["small"]), "--out", str(tmp_path)])
    assert image.read_bytes() == before and [path.name for path in tmp_path.iterdir()] == ["p.png"]


def test_unlike_images_are_flagged(data, models):
    reader = use.Untouched(models["small"])
    like = [use.predict_one(reader, data.images[row])[2]["flag"] for row in data.splits["test"]]
    assert not any(like)
    black = np.zeros((*IMAGE, 3), np.uint8)
    plain = np.full((*IMAGE, 3), 120, np.uint8)
    larger = cv2.resize(np.asarray(data.images[0]), (128, 96))
    for image, reason in ((black, ""), (plain, ""), (data.images[0][..., ::-1] // 3, ""), (larger, "size")):
        verdict = use.predict_one(reader, image)[2]
        assert verdict["flag"] and reason in verdict["reason"]


def read_frames(path) -> list[np.ndarray]:
    source, images = cv2.VideoCapture(str(path)), []
    while True:
        good, frame = source.read()
        if not good:
            return images
        images.append(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))


def test_dots_of_real_sensors_are_counted(reference):
    image = cv2.imread(str(reference / "feats" / "images" / "cuboid_10-2-284.png"))
    # 7 x 9 dots, two of which lie at the rim.
    assert statistics.find_dots(image)[0] == pytest.approx(63, abs=4)
    assert statistics.find_dots(cv2.medianBlur(image, 61))[0] <= 3


def test_score_tells_real_sensors_apart(reference):
    videos = {
        name: read_frames(reference / "slip_videos" / f"{name}.avi")
        for name in ("cheese_tube_camera_0", "cheese_tube_camera_2", "glass_box_camera_0")
    }
    own = np.stack([statistics.describe(image) for image in videos["cheese_tube_camera_0"]])
    model = statistics.fit(own[::2], own[1::4])
    assert not any(statistics.score(model, row) > model["threshold"] for row in own[3::4])
    image = videos["cheese_tube_camera_0"][0]
    feats = cv2.cvtColor(cv2.imread(str(reference / "feats" / "images" / "cuboid_10-2-284.png")), cv2.COLOR_BGR2RGB)
    unlike = {
        "black": np.zeros_like(image),
        "no dots": cv2.medianBlur(image, 61),
        "red and blue swapped": image[..., ::-1],
        "other sensor": videos["cheese_tube_camera_2"][0],
        "FEATS' sensor": feats,
    }
    assert [
        name for name, other in unlike.items() if not statistics.judge(model, np.ascontiguousarray(other))["flag"]
    ] == []


def write_avi(path, images) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, (IMAGE[1], IMAGE[0]))
    for image in images:
        writer.write(cv2.cvtColor(np.asarray(image), cv2.COLOR_RGB2BGR))
    writer.release()
    return path


def test_live_overlays_a_video(data, paths, tmp_path, capsys):
    video = write_avi(tmp_path / "in.avi", data.images[:12])
    out = tmp_path / "out.avi"
    assert live.main(["--video", str(video), "--model", str(paths["small"]), "--out", str(out)]) == 0
    frames = read_frames(out)
    assert len(frames) == 12 and frames[0].shape[1] == 2 * IMAGE[1]
    assert "12 frames" in capsys.readouterr().out


def test_live_refuses_what_it_would_not_write(data, paths, tmp_path):
    video = write_avi(tmp_path / "in.avi", data.images[:12])
    asked = ["--video", str(video), "--model", str(paths["small"])]
    for more in (["--csv", "r.csv", "--out", "o.avi"], ["--web", "--jsonl", "r.jsonl"], ["--web", "--out", "o.avi"]):
        with pytest.raises(BadInput, match="do not go together"):
            live.main([*asked, *more])
    before = video.read_bytes()
    with pytest.raises(BadInput, match="would take the place"):
        live.main([*asked, "--out", str(video)])
    assert video.read_bytes() == before


@pytest.mark.parametrize("while_reading", [False, True])
def test_an_interrupt_keeps_what_was_filmed_and_read(data, models, tmp_path, while_reading):
    """Wherever it comes: while a frame is awaited, or while one is read."""
    overlay, seen = live.Overlay(use.Untouched(models["small"])), [0]

    def interrupt(here: bool) -> None:
        if here == while_reading and seen[0] == 4:
            os.kill(os.getpid(), signal.SIGINT)

    def images():
        for image in data.images[:8]:
            seen[0] += 1
            interrupt(False)
            yield cv2.cvtColor(np.asarray(image), cv2.COLOR_RGB2BGR)

    def overlaid(frame):
        interrupt(True)
        return overlay(frame)

    before = signal.getsignal(signal.SIGINT)
    with stopping() as over:
        written = live.write_video((overlaid(frame) for frame in until(over, images())), tmp_path / "o.avi", 25.0)
    assert written == 3 + while_reading and len(read_frames(tmp_path / "o.avi")) == written
    assert signal.getsignal(signal.SIGINT) is before


def test_a_film_of_no_frames_is_not_written(tmp_path):
    with pytest.raises(BadInput, match="before the first frame"):
        live.write_video(iter(()), tmp_path / "none.avi", 25.0)
    assert not list(tmp_path.iterdir())


def test_the_film_names_axes_as_everything_else_does():
    """x is force along gel x, the channel grid_y."""
    forces = np.zeros((3, *GRID), np.float32)
    forces[:, 0, 0] = 1.0, 2.0, -3.0
    assert live.force_line(forces).split() == ["x", "+2.00", "y", "+1.00", "z", "-3.00", "N"]


def test_live_takes_the_first_frames_at_rest_for_the_untouched_sensor(data, models, paths, tmp_path):
    """The first ones are brighter, as of a camera that still sets its exposure."""
    rest = data.nocontact["mini0"]
    exposing = [np.clip(rest * (1.5 - 0.06 * k), 0, 255).astype(np.uint8) for k in range(8)]
    seen = [*exposing, *[rest] * 6, *data.images[:3]]
    video = write_avi(tmp_path / "in.avi", seen)
    live.main(["--video", str(video), "--model", str(paths["pair"]), "--out", str(tmp_path / "o.avi")])
    filmed = read_frames(video)
    overlay = live.Overlay(use.Untouched(models["pair"], filmed[10]))
    wanted = overlay(cv2.cvtColor(filmed[-1], cv2.COLOR_RGB2BGR))
    got = read_frames(tmp_path / "o.avi")
    assert len(got) == len(seen)
    # the video is compressed; the lines that tell times differ
    assert np.median(np.abs(got[-1].astype(int) - wanted[..., ::-1])) <= 2


def test_live_refuses_a_film_that_never_rests(data, paths, tmp_path):
    video = write_avi(tmp_path / "in.avi", [*data.images[:24]])
    with pytest.raises(BadInput, match="without movement.*--untouched"):
        live.main(["--video", str(video), "--model", str(paths["pair"]), "--out", str(tmp_path / "o.avi")])


def test_live_on_a_real_video(reference, paths, tmp_path, capsys):
    video = reference / "slip_videos" / "plier_camera_2.avi"
    live.main(
        ["--video", str(video), "--model", str(paths["small"]), "--frames", "5", "--out", str(tmp_path / "o.avi")]
    )
    assert "5 flagged" in capsys.readouterr().out


def test_broken_videos_leave_nothing_behind(data, paths, tmp_path):
    whole = write_avi(tmp_path / "in.avi", data.images[:20]).read_bytes()
    (tmp_path / "cut.avi").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "no.avi").write_bytes(b"not a video")
    for name in ("cut", "no", "absent"):
        with pytest.raises(BadInput, match=name):
            live.main(
                [
                    "--video",
                    str(tmp_path / f"{name}.avi"),
                    "--model",
                    str(paths["small"]),
                    "--out",
                    str(tmp_path / "out" / "o.avi"),
                ]
            )
    assert not list((tmp_path / "out").glob("*")) if (tmp_path / "out").exists() else True


def test_camera_that_is_not_there_is_named(paths):
    with pytest.raises(BadInput, match="camera 97"):
        live.main(["--camera", "97", "--model", str(paths["small"]), "--out", "unused.avi"])


def test_front_and_choice():
    assert pareto_models.front([(1, 3), (2, 2), (3, 2.5), (4, 1)]) == [True, True, False, True]
    errors = {f"{what}_{axis}": 1.0 for what in ("total", "cell") for axis in CHANNELS}
    base = {"model": "unet", "cpu1_median_ms": 10.0, "percent": 5.0, **errors}
    fast = {"model": "fast", "cpu1_median_ms": 1.0, "percent": 4.0, **errors, "cell_grid_z": 1.1}
    light = {"model": "light", "cpu1_median_ms": 1.5, "percent": 4.5, **errors}
    good = {"model": "good", "cpu1_median_ms": 2.0, "percent": 4.0, **errors, "total_grid_x": 0.9}
    best = {"model": "best", "cpu1_median_ms": 2.1, "percent": 3.0, **errors}
    totals = {"model": "totals", "cpu1_median_ms": 0.5, "percent": 2.0, **errors, "cell_grid_z": None}
    assert pareto_models.choose([base, fast, light, good, best, totals])["model"] == "good"
    assert pareto_models.choose([base, fast, best]) is None and pareto_models.choose([fast]) is None


def test_chart_of_models_against_latency(data, models, paths, tmp_path):
    evaluations = {}
    for name, trained in models.items():
        write_json(tmp_path / f"{name}.json", evaluate(data, trained, EVALUATE)[0])
        evaluations[name] = tmp_path / f"{name}.json"
    out = tmp_path / "chart" / "6x8.json"
    argv = [
        "--dataset",
        str(data.folder),
        "--models",
        *map(str, paths.values()),
        "--seconds",
        "0.05",
        "--evaluations",
        *map(str, evaluations.values()),
        "--out",
        f"{out}.part",
    ]
    assert pareto_models.main(argv) == 0
    shutil.move(f"{out}.part", out)
    with out.with_suffix(".csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["model"] for row in rows} == set(MODELS) and all(float(row["cpu2_median_ms"]) > 0 for row in rows)
    assert out.with_suffix(".png").exists()
    with pytest.raises(BadInput, match="same names"):
        pareto_models.main([*argv[:4], *argv[6:]])


@pytest.mark.parametrize("press", ["ab", "abc", "abcd", "abcdefghijklmnopq", "aabb", "abacbc", "aaabbbcd"])
def test_shuffling_leaves_no_press_a_prediction_of_its_own(press):
    press = np.array(list(press))
    for seed in range(20):
        other = another_of_each(press, np.random.default_rng(seed))
        assert sorted(other) == list(range(len(press)))
        assert (press[other] != press).all()


def test_force_outside_the_picture_is_no_error_of_label_or_network(data, models):
    """The truth is of the whole gel; what fell outside is told beside the label, and no picture shows it."""
    beyond = np.array([0.3, -0.2, -1.5])
    table = [
        replace(
            each,
            outside=beyond,
            truth={n: str(float(v) + beyond[at]) for at, (n, v) in enumerate(each.truth.items())},
        )
        for each in data.table
    ]
    against = evaluate(replace(data, table=table), models["small"], EVALUATE)[0]["splits"]["test"]["against"]["truth"]
    assert against["labels"]["grid_z"]["mae"] == pytest.approx(0.0, abs=1e-6)
    assert against["labels_over"]["grid_z"] == pytest.approx(1.0, abs=1e-6)


def test_intervals_are_judged_on_other_pictures_than_they_were_set_on(tmp_path):
    """Of two sensors that training did not see they are set on the first; the second's pictures lie otherwise."""
    folder = write_dataset(tmp_path / "6x8", 352, IMAGE, GRID)
    rows = read_csv(folder / "samples.csv")
    for k, row in enumerate(rows):
        if row["split"] == "test_unseen_sensor":
            row["sensor_id"] = "mini1" if k % 16 < 8 else "mini2"
    write_csv(folder / "samples.csv", list(rows[0]), rows)
    rest = np.load(folder / "nocontact.npy")
    np.save(folder / "nocontact.npy", np.concatenate([rest] * 3))
    write_json(
        folder / "dataset.json", read_json(folder / "dataset.json") | {"nocontact": ["mini0", "mini1", "mini2"]}
    )
    both = open_data(folder)
    trained = train(both, "pair", MODELS["pair"], with_values(SETTINGS, epochs=1))
    assert trained.about["intervals"]["sensors"] == ["mini1"]
    fitted = both.names("sensor_id")[fitted_rows(trained, both)]
    assert set(fitted) == {"mini1"}
    rows = both.splits["test_unseen_sensor"]
    told = use.tell_rows(trained, both, rows)
    others = both.names("sensor_id")[rows] == "mini2"
    error = np.abs(told.forces.sum((2, 3), dtype=float) - both.totals(rows))
    held = (error <= told.half_widths)[others].mean(axis=0)
    split = evaluate(both, trained, EVALUATE)[0]["splits"]["test_unseen_sensor"]
    assert list(split["told"]["held"].values()) == pytest.approx(held.tolist())


def test_intervals_are_those_of_what_predict_tells(tmp_path):
    """With tare and light: nine of ten of the pictures that they were set on lie within."""
    made = open_data(write_dataset(tmp_path / "6x8", 176, IMAGE, GRID))
    trained = train(made, "pair", MODELS["pair"], with_values(SETTINGS, epochs=1))
    rows = rows_to_judge_by(made)
    told = use.tell_rows(trained, made, rows)
    error = np.abs(told.forces.sum((2, 3), dtype=float) - made.labels[rows].sum((2, 3), dtype=float))
    assert ((error <= told.half_widths).mean(axis=0) >= 0.85).all()


def test_a_film_has_the_time_of_its_frames(data, models):
    frames = [np.ascontiguousarray(data.images[0])] * 3
    untouched = use.Untouched(models["small"])
    assert [reading.time_s for reading in readings(untouched, frames, frame_s=0.04)] == pytest.approx(
        [0.0, 0.04, 0.08]
    )
