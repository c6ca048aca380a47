"""What a robot's computer installs: `pip install gelforge`, without the packages that only the flow needs."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import version

import cv2
import pytest

from tests.support.films import write_film

# Reading with only the base dependencies importable: a package of the flow or of the exports is as if not installed.
ALONE = """
import sys
for name in {blocked!r}:
    sys.modules[name] = None
from gelforge.commands import gelforge
gelforge.main({words!r})
"""
MODULES = {"pymeshlab": "pymeshlab", "mcap-ros2-support": "mcap_ros2", "rerun-sdk": "rerun", "emcee": "emcee"}


def flow_modules(root):
    """Import names of what only the extras ask for."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    asked = {re.split(r"[\[<>= ]", name)[0] for key in ("flow", "exports") for name in extras[key]}
    base = {re.split(r"[\[<>= ]", name)[0] for name in project["dependencies"]}
    return sorted(MODULES.get(name, name.replace("-", "_")) for name in asked - base)


@pytest.mark.parametrize("goal", ["predict", "sensor", "live"])
def test_pictures_are_read_with_the_base_packages_alone(root, tmp_path, goal):
    picture, rest = root / "data/demo/images/demo-000000.png", root / "data/demo/nocontact/mini_a.png"
    (tmp_path / "r.csv").write_text(f"image,force_n\n{picture},3.0\n")
    words = {
        "predict": ["predict", str(picture), "--nocontact", str(rest), "--out", str(tmp_path / "out")],
        "sensor": ["sensor", "--name", "mine", "--nocontact", str(rest), "--readings", str(tmp_path / "r.csv"),
                   "--out", str(tmp_path / "mine.toml")],
        "live": ["live", "--video", str(write_film(tmp_path / "f.avi", [cv2.imread(str(picture))] * 3)), "--nocontact", str(rest), "--csv",
                 str(tmp_path / "live.csv")],
    }[goal]  # fmt: skip
    program = ALONE.format(blocked=flow_modules(root), words=words)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-1500:]


@pytest.fixture(scope="module")
def wheel(root, tmp_path_factory):
    """The wheel that `pip wheel .` builds of a copy, because building writes beside the sources."""
    if int(version("setuptools").split(".")[0]) < 77:
        pytest.skip("setuptools is older than pyproject.toml asks for; pip install -U setuptools")
    copy, made = tmp_path_factory.mktemp("copy"), tmp_path_factory.mktemp("wheel")
    shutil.copytree(root / "src", copy / "src", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(root / name, copy / name)
    words = ["wheel", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", str(made), str(copy)]
    done = subprocess.run([sys.executable, "-m", "pip", *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-1500:]
    return next(made.glob("*.whl"))


def test_a_wheel_holds_every_file_of_the_package(root, wheel):
    package = root / "src"
    there = {str(path.relative_to(package)) for path in (package / "gelforge").rglob("*") if path.is_file()}
    needed = {name for name in there if "__pycache__" not in name and not name.endswith(".md")} | {
        "gelforge/networks/weights/default.md"
    }
    assert needed <= set(zipfile.ZipFile(wheel).namelist())


def test_the_wheel_reads_a_picture_far_from_its_sources(root, wheel, tmp_path):
    picture, rest = root / "data/demo/images/demo-000000.png", root / "data/demo/nocontact/mini_a.png"
    zipfile.ZipFile(wheel).extractall(tmp_path / "installed")
    words = ["predict", str(picture), "--nocontact", str(rest), "--out", "out"]
    program = (
        f"import gelforge\nfrom gelforge.commands.gelforge import main\nprint(gelforge.__file__)\nmain({words!r})"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(tmp_path / "installed")},
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-1500:]
    assert str(tmp_path / "installed") in done.stdout and (tmp_path / "out" / "totals.csv").exists()
