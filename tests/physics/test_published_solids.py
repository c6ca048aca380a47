"""Indenters and gel against the solids published with FEATS."""

import pytest

from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import load_catalogue
from tests.support.published import compare_gel_top, compare_indenter, published_names, step_file
from tests.support.sandbox import ROOT

pytest.importorskip(
    "gmsh",
    reason="gmsh reads STEP files; pip install gmsh to compare with the published solids",
    exc_type=ImportError,
)
CATALOGUE = ROOT / "workflow" / "indenters.toml"


@pytest.mark.slow
def test_indenters_are_the_published_ones(reference):
    published = {path.stem for path in (reference / "feats" / "indenters").glob("*.step")}
    assert published == published_names(CATALOGUE)
    for name, body in load_catalogue(CATALOGUE, sorted(published)).items():
        found = compare_indenter(body, step_file(reference, name))
        assert abs(found["volume_error"]) < 0.02 and found["surface_mm"] < 0.05, name


def test_gel_top_is_the_published_one(reference):
    # 0.02 mm is the goal; the corners' blend is the largest part
    assert compare_gel_top(Gel(), reference / "feats" / "gelsight_mini.step", 1.0) < 0.02
