"""An environment of its own for LeRobot, whose package wants other versions than the project: made once, then kept.

It lies in the user's cache folder. What it does not bring, such as torch, comes from the environment that runs the tests,
which stays as it is.
"""

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
from functools import cache
from pathlib import Path

LOCK = Path(__file__).resolve().parents[1] / "envs" / "lerobot.lock"
MOST_S = 300.0  # that making it may take, of which most is fetching


def folder() -> Path:
    """Where the environment of this list of packages lies: another list or another torch make another one."""
    import torch

    told = f"{LOCK.read_text()} {torch.__version__} {sys.version} {sysconfig.get_path('purelib')}"
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return home / "gelforge" / f"lerobot-{hashlib.sha256(told.encode()).hexdigest()[:12]}"


@cache
def lerobot_python() -> tuple[Path | None, str]:
    """The interpreter that imports LeRobot, made where it is not there; or none, and why it cannot be made."""
    place = folder()
    python = place / "bin" / "python"
    place.parent.mkdir(parents=True, exist_ok=True)
    with (place.parent / f"{place.name}.lock").open("w") as one_at_a_time:
        fcntl.flock(one_at_a_time, fcntl.LOCK_EX)
        if (place / "whole").exists():
            return python, ""
        shutil.rmtree(place, ignore_errors=True)
        try:
            run(sys.executable, "-m", "venv", place)
            run(python, "-m", "pip", "install", "--quiet", "--no-deps", "--retries", "1", "-r", LOCK)
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired, OSError) as error:
            shutil.rmtree(place, ignore_errors=True)
            said = (getattr(error, "stderr", "") or str(error)).strip().splitlines()
            return None, f"LeRobot's environment cannot be made: {said[-1][:200] if said else type(error).__name__}"
        # after its own packages, so that those come first
        for path in {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}:
            packages = next(place.glob("lib/python*/site-packages"))
            (packages / "zz-beside.pth").write_text(f"{path}\n")
        (place / "whole").touch()
    return python, ""


def run(*words: object) -> None:
    """Run a program to its end; its failure raises with what it said."""
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run([str(word) for word in words], check=True, capture_output=True, text=True, timeout=MOST_S, env=env)
