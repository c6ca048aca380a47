"""One map from channels to axes: a force along an axis of the gel arrives in the channel that the map names."""

import numpy as np
import pytest

from gelforge.flow.files import read_csv
from gelforge.networks.data.arrays import open_data
from gelforge.networks.evaluation.evaluation import reference_totals
from gelforge.records.axes import AXIS_OF_CHANNEL, CHANNEL_OF_AXIS, CHANNELS, FORCE_OF_CHANNEL, TITLES
from gelforge.records.forcefile import SampleForces, write_forces
from gelforge.records.labelfile import read_labels
from gelforge.records.press import FORCE
from tests.support.pressed_dataset import bump, collect, label, write_pressed


def test_the_map_is_its_own_inverse_and_names_feats_channels():
    assert [AXIS_OF_CHANNEL[channel] for channel in CHANNEL_OF_AXIS] == [0, 1, 2]
    assert [FORCE_OF_CHANNEL[channel] for channel in CHANNEL_OF_AXIS] == list(FORCE)
    assert CHANNELS == ("grid_x", "grid_y", "grid_z")
    assert TITLES == ("grid_x: force along gel y", "grid_y: force along gel x", "grid_z: force along gel z")


def test_a_force_along_one_axis_fills_its_channel_and_its_column(tmp_path):
    for axis in range(3):
        made = write_pressed(tmp_path / str(axis), count=8)
        force = np.zeros(3)
        force[axis] = -2.0
        load, surface = bump(made["mesh"], 0.5, -1.0, 3.0, force), made["mesh"].surface_nodes
        samples = [SampleForces(f"s{k:03d}", "OK", "hexahedra", surface, load[surface], 0 * load[surface])
                   for k in range(8)]  # fmt: skip
        write_forces(made["results"] / "40_forces/0000.npz", samples, 0.0725)
        totals = read_labels(label(made, "6x8") / "0000.npz").label.sum(axis=(2, 3))
        channel = CHANNEL_OF_AXIS[axis]
        assert totals[:, channel] == pytest.approx(np.full(8, -2.0), rel=1e-5)
        assert np.abs(np.delete(totals, channel, axis=1)).max() < 1e-6
        folder = collect(made, "6x8")
        for row in read_csv(folder / "samples.csv"):
            assert [abs(float(row[name])) > 1.0 for name in FORCE] == [at == axis for at in range(3)]
        # what the bench measured along gel x, y, z stands beside the label in the order of its channels
        data = open_data(folder)
        measured = np.stack([data.column(f"measured_{name}") for name in FORCE], axis=1)
        assert np.array_equal(reference_totals(data, "sensor"), measured[:, list(AXIS_OF_CHANNEL)])
