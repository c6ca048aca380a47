"""Limits of flags: what they are set by."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.geometry.gel import USUAL_GEL, Gel
from gelforge.learning.data import open_data
from gelforge.learning.export import load_weights
from gelforge.learning.fitting import set_limits
from gelforge.learning.recipe import Start
from gelforge.reading.predictor import SHIPPED
from gelforge.stages.train import train
from gelforge.virtualrig.render import Renderer
from gelforge.virtualrig.rigplan import DrawnUnits
from gelforge.virtualrig.units import draw_units
from tests.support.refused import refused
from tests.support.sandbox import ROOT
from tests.support.synthetic_presses import SETTINGS, write_dataset


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    """Pictures of gels that nothing touches, two of each of 20 units: every other unit's under another fall of light and worn."""
    appearances, sensors = draw_units(DrawnUnits("units.toml", 20, 0), USUAL_GEL, ROOT / "workflow/rig", seed=8)
    images, nocontact, altered = [], {}, []
    for k, (name, seen) in enumerate(appearances.items()):
        often = float(k % 2)
        drift = replace(seen.drift, relit=often, worn=often)
        camera = Renderer(replace(seen, drift=drift), sensors[name].projection, Gel())
        nocontact[name], *two = (camera.image(rng=np.random.default_rng([k, at])) for at in range(3))
        images += two
        altered += 2 * [drift.draw(seen.markers, np.random.default_rng([k, 0])).altered]
    data = open_data(write_dataset(tmp_path_factory.mktemp("limits") / "24x32", len(images)))
    table = [
        replace(one, press=replace(one.press, sensor_id=name), altered=how)
        for one, name, how in zip(data.table, np.repeat(list(nocontact), 2), altered, strict=True)
    ]
    return replace(data, images=np.stack(images), nocontact=nocontact, table=table)


def without_notes(data):
    return replace(data, table=[replace(one, altered="") for one in data.table])


def test_pictures_that_a_rig_altered_set_no_limits(learnt, shipped):
    kept = {name: learnt.unaltered(rows) for name, rows in learnt.splits.items()}
    assert 0 < sum(map(len, kept.values())) < len(learnt.table)
    of_all = set_limits(shipped.metadata, learnt, None)["limits"]
    of_kept = set_limits(shipped.metadata, without_notes(replace(learnt, splits=kept)), None)["limits"]
    assert of_all == of_kept
    looser = set_limits(shipped.metadata, without_notes(learnt), None)["limits"]
    assert looser["largest_rim_lost"] > of_all["largest_rim_lost"]


def test_a_dataset_of_altered_pictures_alone_is_refused_before_training(learnt):
    nothing = replace(learnt, table=[replace(one, altered="image relit") for one in learnt.table])
    start = Start(*load_weights(SHIPPED.with_suffix(".safetensors")))
    refused("lower relit_fraction", train, nothing, "tuned", start.metadata["model"], SETTINGS, start=start)
