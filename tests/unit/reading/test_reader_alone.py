"""What a robot's computer installs: `pip install gelforge`, without the packages that only the flow needs."""

import os
import re
import shutil
import signal
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import version

import cv2
import pytest

import gelforge
from gelforge.commands.gelforge import COMMANDS
from gelforge.flow.cli import EXTRAS
from tests.support.films import write_film

pytestmark = pytest.mark.processes

# Several commands with only the base dependencies importable: a package of an extra is as if not installed.
ALONE = """
import sys
for name in {blocked!r}:
    sys.modules[name] = None
from gelforge.commands import gelforge
for words in {runs!r}:
    print("RUN", *words, flush=True)
    try:
        gelforge.main(words)
    except SystemExit as ended:
        print("ENDED", ended.code, flush=True)
"""
# Import names that are not the package's own.
MODULES = {
    "mcap-ros2-support": ["mcap_ros2"],
    "mcap-protobuf-support": ["mcap_protobuf"],
    "foxglove-sdk": ["foxglove"],
    "vtk": ["vtk", "vtkmodules"],
}
ONE_SENTENCE = re.compile(
    r"error: this needs the package \w+, which is not installed: pip install '\.\[\w+\]' in a clone.*"
)


def bare(requirement):
    """Name of a requirement, without its extras and versions."""
    return re.split(r"[\[<>= ]", requirement)[0]


def alone(*runs):
    """[(exit code, lines)] of commands run one after the other without the extras' packages."""
    program = ALONE.format(blocked=sorted(EXTRAS), runs=[list(map(str, words)) for words in runs])
    done = subprocess.run(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    parts = [part.splitlines()[1:] for part in done.stdout.split("RUN ")[1:]]
    assert "Traceback" not in done.stdout and len(parts) == len(runs), done.stdout[-1500:]
    return [(int(lines[-1].removeprefix("ENDED ")), lines[:-1]) for lines in parts]


def test_every_package_of_an_extra_is_known_with_an_extra_that_brings_it(root):
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    base = set(map(bare, project["dependencies"]))
    brought = {}
    for extra in ("solve", "mesh", "stl", "plot", "flow", "train", "exports", "live", "hub"):
        for package in map(bare, project["optional-dependencies"][extra]):
            for name in MODULES.get(package, [package.replace("-", "_")]):
                brought.setdefault(name, set()).add(extra)
    assert brought.pop("gelforge") == {"flow"}
    assert not base & brought.keys() and EXTRAS.keys() == brought.keys()
    assert all(extra in brought[name] for name, extra in EXTRAS.items())


def test_every_command_works_without_the_extras_or_names_the_one_that_it_needs(root, tmp_path):
    out = tmp_path / "out"
    work = [
        ["feats", "fetch", "--downloads", out, "--data", out / "data", "--sensors", root / "workflow/sensors.toml"],
        ["mcap", "--from", root / "README.md", "--topics", tmp_path / "topics.toml", "--data", out,
         "--sensors", root / "workflow/sensors.toml"],
    ]  # fmt: skip
    (tmp_path / "topics.toml").write_text('image = "/a"\nwrench = "/b"\n')
    runs = [[name, "--help"] for name in COMMANDS] + work
    for words, (code, lines) in zip(runs, alone(*runs), strict=True):
        helped = "--help" in words and code == 0 and any("usage: gelforge" in line for line in lines)
        assert helped or (code == 2 and ONE_SENTENCE.fullmatch(lines[-1]) and len(lines) == 1), (words, code, lines)


def test_pictures_are_read_with_the_base_packages_alone(root, tmp_path):
    picture, rest = root / "data/demo/images/demo-000000.png", root / "data/demo/nocontact/mini_a.png"
    (tmp_path / "r.csv").write_text(f"image,force_n\n{picture},3.0\n")
    film = write_film(tmp_path / "f.avi", [cv2.imread(str(picture))] * 3)
    runs = [
        ["predict", picture, "--nocontact", rest, "--out", tmp_path / "out"],
        ["sensor", "--name", "mine", "--nocontact", rest, "--readings", tmp_path / "r.csv", "--out", tmp_path / "mine.toml"],
        ["live", "--video", film, "--nocontact", rest, "--csv", tmp_path / "live.csv"],
    ]  # fmt: skip
    found = alone(*runs)
    assert [code for code, _ in found] == [0, 0, 0], found


def test_python_names_the_extra_that_solve_and_label_need():
    body = "{'kind': 'sphere', 'diameter': 10, 'height': 10}"
    program = f"import sys\nfor name in {sorted(EXTRAS)!r}:\n    sys.modules[name] = None\nimport gelforge\n"
    solve, label = f"gelforge.solve({body}, depth=0.3)", "gelforge.label(None)"
    for call in (solve, label):
        done = subprocess.run([sys.executable, "-c", program + call], capture_output=True, text=True)
        said = done.stderr.splitlines()[-1].replace("ModuleNotFoundError", "error")
        assert ONE_SENTENCE.fullmatch(said) and "[solve]" in said, done.stderr[-1500:]


def test_the_example_that_reads_a_film_needs_no_extra(root):
    program = f"import runpy, sys\nfor name in {sorted(EXTRAS)!r}:\n    sys.modules[name] = None\n"
    program += f"runpy.run_path({str(root / 'workflow/examples/read_a_film.py')!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0 and len(done.stdout.splitlines()) > 50, done.stderr[-1500:]


def test_one_version_stands_everywhere(root):
    """A release is tagged vVERSION; package, citation and change log say the same."""
    citation = (root / "CITATION.cff").read_text(encoding="utf-8")
    changes = re.findall(r"^## v(\S+)", (root / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert re.findall(r"^version: (\S+)$", citation, re.MULTILINE) == [gelforge.__version__] == changes[:1]


@pytest.mark.slow
def test_solve_and_label_work_with_their_extra_alone():
    """What `pip install '.[solve]'` does not bring is as if not installed."""
    absent = sorted(name for name, extra in EXTRAS.items() if extra != "solve")
    program = f"import sys\nfor name in {absent!r}:\n    sys.modules[name] = None\nimport gelforge\n"
    program += "press = gelforge.solve({'kind': 'sphere', 'diameter': 10, 'height': 10}, depth=0.1)\n"
    program += "print(press.total[2] - gelforge.label(press)[2].sum())"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0 and abs(float(done.stdout)) < 1e-9, done.stderr[-1500:]


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
        "gelforge/reading/weights/default.md"
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


# Ends the process at its first socket: a filter of system calls (seccomp), which threads of libraries inherit.
READS_ALONE = """
import ctypes, platform, sys
number = {"x86_64": 41, "aarch64": 198}[platform.machine()]
class Line(ctypes.Structure):
    _fields_ = [("code", ctypes.c_ushort), ("yes", ctypes.c_ubyte), ("no", ctypes.c_ubyte), ("value", ctypes.c_uint)]
class Program(ctypes.Structure):
    _fields_ = [("length", ctypes.c_ushort), ("lines", ctypes.POINTER(Line))]
lines = (Line * 4)(Line(0x20, 0, 0, 0), Line(0x15, 0, 1, number), Line(0x06, 0, 0, 0x80000000), Line(0x06, 0, 0, 0x7FFF0000))
libc = ctypes.CDLL(None)
assert libc.prctl(38, 1, 0, 0, 0) == 0 and libc.prctl(22, 2, ctypes.byref(Program(4, lines)), 0, 0) == 0
import cv2, gelforge
if len(sys.argv) == 2:
    rest = cv2.imread(sys.argv[1])[..., ::-1].copy()
    print(gelforge.Reader(nocontact=rest)(rest).flag)
else:
    import socket
    socket.socket()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="seccomp is Linux' own")
def test_a_reader_opens_no_socket_and_writes_nothing(root, tmp_path):
    """The library that runs the network wrote an id to the home folder and looked up its maker's host."""
    home, work = tmp_path / "home", tmp_path / "work"
    home.mkdir(), work.mkdir()
    env = {
        key: value
        for key, value in os.environ.items()
        if not key.startswith("XDG_") and key != "ORT_DISABLE_TELEMETRY"
    }
    env |= {"HOME": str(home), "TMPDIR": str(work), "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": str(root / "src")}
    run = [sys.executable, "-c", READS_ALONE]
    done = subprocess.run(
        [*run, str(root / "data/demo/nocontact/mini_a.png")], cwd=work, env=env, capture_output=True, text=True
    )
    assert done.returncode == 0 and done.stdout == "False\n", done.stderr
    assert not list(home.rglob("*")) and not list(work.rglob("*"))
    assert subprocess.run(run, cwd=work, env=env, capture_output=True).returncode == -signal.SIGSYS  # the trap holds
