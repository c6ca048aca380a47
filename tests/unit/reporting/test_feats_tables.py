"""FEATS' published errors beside those of networks here."""

import numpy as np
import pytest

from gelforge.records.samplefile import TEST, UNSEEN_SENSOR
from gelforge.reporting.feats_tables import UNET, comparison, published_errors


def lumps(*totals):
    """Labels (n, 3, 2, 2) of these normal forces."""
    labels = np.zeros((len(totals), 3, 2, 2), np.float32)
    labels[:, 2] = np.array(totals)[:, None, None] / 4
    return labels


def test_errors_are_those_of_feats_own_evaluation():
    labels = lumps(-10.0, -20.0, -50.0)  # the last one is left out, as there
    predicted = labels.copy()
    predicted[0, 2] += 0.1
    predicted[1, 2] -= 0.3
    predicted[2] = 99.0
    found = published_errors(predicted, labels)
    assert found["n"] == 2
    assert found["total"][2] == pytest.approx([0.8, np.std([0.4, 1.2], ddof=1)], rel=1e-5)
    assert found["cell"][2] == pytest.approx([0.2, np.std([0.1, 0.3], ddof=1)], rel=1e-5)
    assert found["total"][0] == [0.0, 0.0]
    assert "cell" not in published_errors(predicted.sum((2, 3), keepdims=True), labels)
    assert published_errors(predicted[2:], labels[2:]) is None


def test_networks_stand_beside_the_paper():
    found = published_errors(lumps(-10.5, -19.0), lumps(-10.0, -20.0))
    table = comparison({"tuned": {TEST: found}, "unet": {TEST: None, UNSEEN_SENSOR: found}})
    assert table["columns"][3:6] == [UNET, "tuned", "unet"]
    rows = {tuple(row[:3]): row[3:] for row in table["rows"]}
    assert rows[f"known indenters ({TEST})", "total", "fz"][:3] == ["0.799 ± 1.014", "0.750 ± 0.354", "-"]
    assert rows[f"known indenters ({TEST})", "total", "fz"][3:] == ["1.513", "0.783", "0.761", "1.037"]
    assert rows[f"another sensor ({UNSEEN_SENSOR})", "total", "fz"][:3] == ["1.79", "-", "0.750 ± 0.354"]
    assert rows[f"another sensor ({UNSEEN_SENSOR})", "cell", "fz"][:2] == ["-", "-"]
