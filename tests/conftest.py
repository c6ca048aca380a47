"""What tests share: where the reference data lie, and skipping where they do not."""

import os
import shutil
from pathlib import Path

import pytest
from hypothesis import settings

# How long an example takes is a matter of the machine's load; no law is broken by it.
settings.register_profile("any machine", deadline=None)
settings.load_profile("any machine")

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = Path(os.environ.get("GELFORGE_REFERENCE", ROOT.parent / "shared" / "reference"))


@pytest.fixture(autouse=True)
def in_project(monkeypatch):
    """Every test starts in the project's folder, wherever the one before it went."""
    monkeypatch.chdir(ROOT)


@pytest.fixture(scope="session")
def root() -> Path:
    """The project's folder."""
    return ROOT


@pytest.fixture(scope="session")
def reference() -> Path:
    """The folder of real measurements; tests that need it are skipped where it is absent."""
    if not REFERENCE.is_dir():
        pytest.skip(f"reference data absent: {REFERENCE} (set GELFORGE_REFERENCE)")
    return REFERENCE


@pytest.fixture(scope="session")
def ccx() -> str:
    """The CalculiX program; tests that need it are skipped where it is absent."""
    found = shutil.which("ccx")
    if not found:
        pytest.skip("CalculiX (ccx) is not on PATH; make setup installs it where it may")
    return found
