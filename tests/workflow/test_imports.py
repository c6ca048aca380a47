"""What others recorded as MCAP becomes a dataset on which a network trains."""

import tomllib

import numpy as np

from gelforge.flow.files import read_csv, read_json, write_csv, write_json, write_text
from gelforge.flow.layout import Layout
from gelforge.flow.params import plain
from gelforge.formats.mcap_import import Topics, import_recordings
from gelforge.labelling.sensor import load_sensors
from gelforge.reading.model import load_model
from gelforge.records.image import read_image, write_png
from gelforge.stages import dataset, train
from gelforge.stages.plan import logged_rows, write_shards
from tests.support.parameters import write_stage
from tests.support.recordings import IMAGE, MS, WRENCH, filmed, ramp, wrench, write
from tests.support.synthetic_presses import SETTINGS


def later(messages, ms):
    """The same messages so much later."""
    shift = ms * MS
    return [(time + shift, wrench(time + shift, force["z"], x=force["x"], y=force["y"])) for time, force in
            ((time, said["wrench"]["force"]) for time, said in messages)]  # fmt: skip


def test_the_dataset_trains_on_totals(tmp_path, root):
    """From import to network, at one cell; rows that name no sensor are of the dataset's."""
    of = Layout(tmp_path / "results/lab")
    (tmp_path / "in").mkdir()
    for k, name in enumerate("abcd"):
        times = 100.0 + 40.0 * np.arange(14)
        size = [3.0 * ((j // 10) % 2) for j in range(300)]
        forces = [(time, wrench(time, -n, x=0.1 * n, y=0.2 * n)) for n, (time, _) in zip(size, ramp(), strict=True)]
        write(tmp_path / "in" / f"{name}.mcap", filmed(times + 60_000 * k, lambda k: 0.0), later(forces, 60_000 * k))
    write_text(tmp_path / "topics.toml", f'image = "{IMAGE}"\nwrench = "{WRENCH}"\n')
    sensor = load_sensors(root / "workflow" / "sensors.toml")["gelsight_mini"]
    import_recordings(tmp_path / "in", of.data, Topics.read(tmp_path / "topics.toml"), sensor)
    write_png(of.data / "nocontact" / "gelsight_mini.png", read_image(of.data / read_csv(of.log)[0]["image"]))
    log = of.log
    rows = read_csv(log)
    name = rows[0]["sensor_id"]
    write_csv(log, list(rows[0]), [row | {"sensor_id": ""} for row in rows])
    write_shards(of, logged_rows(log, name), 30, {})
    write_json(of.parameters("indenters"), {})
    write_stage(of.params, "dataset", dataset={"validation": 0.2, "test": 0.2})
    write_json(of.parameters("sensors"), tomllib.loads((root / "workflow/sensors.toml").read_text()))
    assert dataset.main([str(of.root), "1x1"]) == 0
    about = read_json(of.dataset_table("1x1"))
    assert about["grid"] == [1, 1] and about["samples"] == 4 * 14 and {"train", "val", "test"} == set(about["splits"])
    write_json(of.parameters("models/small"), {"small": {"kind": "grid", "width": 8, "blocks": 1}})
    write_stage(of.params, "train", train={**plain(SETTINGS), "epochs": 1, "shift_cells": 0})
    assert train.main([str(of.root), "1x1", "small"]) == 0
    assert load_model(of.network("1x1", "small")).metadata["grid"] == [1, 1]
