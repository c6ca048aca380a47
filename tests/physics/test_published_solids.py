"""Indenters and gel against the solids published with FEATS."""

import pytest

from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import load_catalogue
from tests.conftest import ROOT
from tests.support.published import compare_gel_top, compare_indenter, published_names, step_file

pytest.importorskip(
    "gmsh",
    reason="gmsh reads STEP files; pip install gmsh to compare with the published solids",
    exc_type=ImportError,
)
CATALOGUE = ROOT / "workflow" / "indenters.toml"


@pytest.mark.parametrize("name", sorted(published_names(CATALOGUE)))
def test_indenter_is_the_published_one(reference, name):
    found = compare_indenter(load_catalogue(CATALOGUE, [name])[name], step_file(reference, name))
    assert abs(found["volume_error"]) < 0.02
    assert found["surface_mm"] < 0.05


def test_every_published_indenter_is_in_the_catalogue(reference):
    published = {path.stem for path in (reference / "feats" / "indenters").glob("*.step")}
    assert published == published_names(CATALOGUE)


def test_gel_top_is_the_published_one(reference):
    # 0.02 mm is the goal; the corners' blend is the largest part
    assert compare_gel_top(Gel(), reference / "feats" / "gelsight_mini.step", 1.0) < 0.02
