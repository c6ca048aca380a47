"""The network that comes with gelforge: it reads pictures as soon as the set-up is done."""

import csv

import numpy as np

from gelforge.commands import predict
from gelforge.networks import use
from gelforge.networks.modelfile import load_model

LARGEST = 3 * 2**20  # bytes


def test_it_is_small_and_its_card_says_where_it_learnt():
    assert use.SHIPPED.stat().st_size <= LARGEST
    card = use.SHIPPED.with_suffix(".md").read_text(encoding="utf-8")
    assert "learnt from the virtual rig" in card
    assert f"# Model card: {load_model(use.SHIPPED).about['name']}" in card


def test_it_reads_presses_it_never_saw(root, tmp_path):
    """The demo's presses of a known unit, a plan of its own: far better than the best constant, and none is flagged."""
    log = [row for row in csv.DictReader((root / "data/demo/log.csv").open()) if row["sensor_id"] == "mini_a"]
    truth = {row["sample_id"]: row for row in csv.DictReader((root / "data/demo/truth/presses.csv").open())}
    images = [str(root / "data/demo" / row["image"]) for row in log]
    rest = str(root / "data/demo/nocontact/mini_a.png")
    assert predict.main([*images, "--untouched", rest, "--out", str(tmp_path)]) == 0
    rows = list(csv.DictReader((tmp_path / "totals.csv").open()))
    assert not any(int(row["flagged"]) for row in rows)
    read = np.array([float(row["grid_z_n"]) for row in rows])
    real = np.array([float(truth[row["sample_id"]]["fz_n"]) for row in log])
    assert 3 * np.abs(read - real).mean() < np.abs(np.median(real) - real).mean()
    assert np.load(tmp_path / f"{log[0]['sample_id']}.npy").shape == (3, 24, 32)
