"""The same press on other processors: code paths of MKL and numba that differ in the last bits."""

import pytest

from tests.benchmarks.machines import CELLS, TOTAL, compare

pytestmark = pytest.mark.slow


def test_labels_do_not_depend_on_the_processor(root, tmp_path):
    """Presses where rounding decided once: which steps were cut, and which released points; at draft quality."""
    scenes = ["cylinder", "sloping_cuboid", "pyramid"]
    for name, (total, cells) in compare("draft", tmp_path, root / "workflow", scenes).items():
        assert total <= TOTAL and cells <= CELLS, name
