"""The network of two stages: what it is taught of the gel's shape, and that its graphs are the network."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gelforge.errors import BadInput
from gelforge.networks.checkpoint.graph import Graph
from gelforge.networks.checkpoint.onnxexport import Exported, export, sample_pictures
from gelforge.networks.data.arrays import open_data
from gelforge.networks.data.augment import misplace_shapes
from gelforge.networks.data.concatenate import concatenate
from gelforge.networks.data.loader import generator
from gelforge.networks.inference.predictor import Predictor
from gelforge.networks.models.registry import build
from gelforge.networks.training.geometryloss import mirrored, relative_loss, shape_loss
from gelforge.records.geometryfile import STEP, Geometry, load_geometry
from gelforge.stages.train import train
from tests.support.parameters import with_values
from tests.support.small_networks import GRID, IMAGE
from tests.support.synthetic_presses import SETTINGS, write_dataset

MODEL = {"kind": "geometry", "reads": "pair", "width": 8, "blocks": 2}
NORM = {"reads": "pair", "image_mean": [0.3, 0.4, 0.5], "image_std": [0.2, 0.2, 0.2], "label": [0.1, 0.1, 0.4]}
METADATA = {"name": "m", "normalisation": NORM, "image": IMAGE, "tta": False}


def with_shapes(folder: Path) -> Path:
    """A made-up dataset whose shapes follow its labels: slopes of the normal force's map, motion by the sideways ones."""
    write_dataset(folder, 48, IMAGE, GRID)
    labels = np.load(folder / "labels.npy")
    height = torch.nn.functional.interpolate(torch.tensor(labels[:, 2:]), (24, 32), mode="bilinear")[:, 0].numpy()
    slopes = np.stack(np.gradient(height, axis=(2, 1)), 1) / STEP
    np.save(folder / "slopes.npy", np.clip(np.rint(slopes), -127, 127).astype(np.int8))
    np.save(folder / "motion.npy", (10 * labels[:, :2]).astype(np.float16))
    return folder


@pytest.fixture(scope="module")
def shaped(tmp_path_factory):
    return open_data(with_shapes(tmp_path_factory.mktemp("shaped") / "6x8"))


def test_it_learns_the_shapes_that_it_is_given(shaped):
    """After some epochs slopes are nearer to the true ones than level ones are, and forces nearer than the mean force."""
    settings = with_values(SETTINGS, epochs=30, learning_rate=4e-3, schedule="cosine")
    trained = train(shaped, "geometry", MODEL, settings)
    assert list(trained.model.stages) == ["slopes", "forces"]
    rows = shaped.splits["train"]
    predictor = Predictor(trained.model, shaped.nocontact["mini0"])
    error, level, totals = [], [], []
    for row in rows:
        seen = predictor.prepare(np.ascontiguousarray(shaped.images[row]))
        found = predictor.stages["slopes"]({name: seen.feature(name) for name in ("image", "nocontact")})["slopes"][0]
        true = shaped.shapes.slopes[row].astype(float) * STEP
        error.append(((found - true) ** 2).mean())
        level.append((true**2).mean())
        totals.append(predictor.predict(np.ascontiguousarray(shaped.images[row])).total[2])
    target = shaped.totals(rows)[:, 2]
    assert np.mean(error) < 0.5 * np.mean(level)
    assert np.abs(np.array(totals) - target).mean() < 0.5 * np.abs(target - target.mean()).mean()


def test_it_learns_from_forces_alone_where_no_shape_is_known(data):
    assert data.shapes is None
    trained = train(data, "geometry", MODEL, with_values(SETTINGS, epochs=2))
    assert [np.isfinite(row["loss"]) for row in trained.metadata["curve"]] == [True, True]


def test_its_graphs_one_after_the_other_are_the_network():
    torch.manual_seed(0)
    net = build(MODEL, IMAGE, GRID).eval()
    graphs = export(net, METADATA)
    given = dict(zip(("image", "nocontact"), sample_pictures(IMAGE, 2), strict=True))
    shape = Graph(graphs["slopes"], "slopes")(given)
    assert shape["slopes"].shape[1:] == (2, 24, 32) and shape["motion"].shape[1:] == (2, 6, 8)
    found = Graph(graphs["forces"], "forces")(shape)["forces"]
    with torch.inference_mode():
        target = Exported(net, METADATA)(*(torch.from_numpy(one) for one in given.values())).numpy()
    np.testing.assert_allclose(found, target, atol=1e-4 * np.ptp(target))
    assert (found[:, 2] <= 0).all()  # a gel cannot be pulled


@pytest.mark.parametrize(
    "model, image, why",
    [(MODEL | {"reads": "image"}, IMAGE, 'give reads = "pair"'), (MODEL, (60, 80), "no multiples of 8")],
)
def test_what_it_cannot_be_built_for_is_refused(model, image, why):
    with pytest.raises(BadInput, match=why):
        build(model, image, GRID)


def test_a_misplaced_nocontact_image_shows_in_the_motion():
    """A similarity of the no-contact image moves all points alike: by the shift, and by the zoom with their distance from the middle."""
    settings = with_values(
        SETTINGS.augment, misplaced_share=1.0, misplaced_px=2.0, misplaced_deg=0.0, misplaced_zoom=0.0
    )
    rng = np.random.default_rng(0)
    pairs = rng.integers(0, 255, (3, 48, 64, 6), np.uint8)
    motion = rng.normal(0, 1, (3, 2, 6, 8)).astype(np.float16)
    found, moved = misplace_shapes(pairs, motion, settings, generator(0, "seat"))
    assert (found[..., :3] == pairs[..., :3]).all() and (found[..., 3:] != pairs[..., 3:]).any()
    change = moved - motion.astype(np.float32)
    assert np.ptp(change, axis=(2, 3)).max() < 1e-2 and np.abs(change).max() <= 2.0
    zoomed = with_values(settings, misplaced_px=0.0, misplaced_zoom=0.02)
    still = np.zeros((3, 2, 6, 8), np.float16)
    _, moved = misplace_shapes(pairs, still, zoomed, generator(0, "seat"))
    for one in moved:  # linear along u, and nothing of it along v
        slope = np.diff(one[0], axis=1)
        assert (
            np.ptp(slope) < 1e-4
            and np.abs(np.diff(one[0], axis=0)).max() < 1e-4
            and 0 < np.abs(slope).max() < 0.02 * 8
        )


def test_mirrored_shapes_have_mirrored_forces():
    """Each flip is one of four: what is summed keeps its amount, and the normal force its sign."""
    rng = torch.Generator().manual_seed(0)
    slopes, motion, target = (torch.randn(64, *shape, generator=rng) for shape in ((2, 4, 6), (2, 2, 3), (3, 2, 3)))
    for maps, found in zip((slopes, motion, target), mirrored(slopes, motion, target, rng), strict=True):
        torch.testing.assert_close(found.abs().sum((2, 3)), maps.abs().sum((2, 3)))
    found = mirrored(slopes, motion, target, rng)
    torch.testing.assert_close(found[2][:, 2].sum((1, 2)), target[:, 2].sum((1, 2)))
    signs = torch.sign(found[2][:, :2].sum((2, 3)) / target[:, :2].sum((2, 3)))
    assert {tuple(row.tolist()) for row in signs} == {(1, 1), (1, -1), (-1, 1), (-1, -1)}


def test_losses_are_zero_for_the_truth_and_grow_with_the_error():
    target, scale = -torch.rand(4, 3, 6, 8), torch.ones(3)
    assert relative_loss(target, target, scale) == 0
    assert 0 < relative_loss(1.05 * target, target, scale) < relative_loss(1.2 * target, target, scale)
    slopes, motion = torch.randn(2, 2, 8, 8), torch.randn(2, 2, 2, 2)
    assert shape_loss(slopes, motion, slopes, motion) == 0
    assert shape_loss(1.1 * slopes, motion, slopes, motion) > 0 < shape_loss(slopes, motion + 0.1, slopes, motion)


def test_a_shape_is_kept_to_half_a_step(tmp_path):
    rng = np.random.default_rng(0)
    slopes, motion = rng.uniform(-1.9, 1.9, (2, 6, 8)), rng.normal(0, 3, (2, 3, 4))
    Geometry.of(slopes, motion).save(tmp_path / "a.npz")
    found = load_geometry(tmp_path / "a.npz")
    assert np.abs(found.slopes * STEP - slopes).max() <= STEP / 2 and np.abs(found.motion - motion).max() < 0.01
    assert Geometry.of(np.full((2, 1, 1), -9.0), motion).slopes.min() == -127  # steeper ones are cut, not wrapped
    (tmp_path / "a.npz").write_bytes(b"nothing")
    with pytest.raises(BadInput, match="no shape of a gel"):
        load_geometry(tmp_path / "a.npz")


def test_datasets_have_shapes_together_only_where_each_has(shaped, data):
    other = replace(shaped, info=shaped.info | {"name": "other"})
    both = concatenate(shaped, [other])
    np.testing.assert_array_equal(both.shapes.slopes[len(shaped.table) + 1], shaped.shapes.slopes[1])
    assert concatenate(shaped, [replace(data, info=data.info | {"name": "plain"})]).shapes is None
