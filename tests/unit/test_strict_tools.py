"""Tests that skip where a tool is missing fail under --strict-tools, others skip as before."""

import shutil
import subprocess
import sys

SKIPS = """
import pytest


@pytest.mark.skipif(True, reason="Slurm is absent")
def test_marked():
    pass


def test_says_so():
    pytest.skip("reference data absent")


def test_of_something_else():
    pytest.skip("this browser draws no three dimensions")
"""


def test_a_missing_tool_is_a_failure_where_that_is_asked_for(root, tmp_path):
    (tmp_path / "tests").mkdir()
    shutil.copy(root / "tests/conftest.py", tmp_path / "tests")
    (tmp_path / "tests/test_skips.py").write_text(SKIPS)

    def ended(*options: str) -> str:
        asked = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options, "tests/test_skips.py"]
        environment = {"PYTHONPATH": f"{tmp_path}:{root / 'src'}:{root}", "PATH": "/usr/bin:/bin"}
        return subprocess.run(asked, cwd=tmp_path, env=environment, capture_output=True, text=True).stdout

    assert "3 skipped" in ended()
    assert "1 failed, 1 skipped, 1 error" in ended(
        "--strict-tools"
    )  # pytest calls a failure before the call an error
