"""What a robot's computer installs: `pip install gelforge`, without the packages that only the flow needs."""

import re
import subprocess
import sys
import tomllib

import numpy as np
import pytest

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
        "predict": ["predict", str(picture), "--untouched", str(rest), "--out", str(tmp_path / "out")],
        "sensor": ["sensor", "--name", "mine", "--untouched", str(rest), "--readings", str(tmp_path / "r.csv"),
                   "--out", str(tmp_path / "mine.toml")],
        "live": ["live", "--video", str(film(tmp_path / "f.avi", picture)), "--untouched", str(rest), "--csv",
                 str(tmp_path / "live.csv")],
    }[goal]  # fmt: skip
    program = ALONE.format(blocked=flow_modules(root), words=words)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-1500:]


def film(path, picture):
    import cv2

    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, (320, 240))
    for _ in range(3):
        writer.write(np.ascontiguousarray(cv2.imread(str(picture))))
    writer.release()
    return path
