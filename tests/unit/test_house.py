"""The house: which folder may use which, and a list of loosened modules that only shrinks."""

import ast
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "gelforge"

# Each folder and the folders it may import from; everything may use `errors`. `flow` is files, parameters, make.
ALLOWED = {
    "flow": set(),
    "records": {"flow"},
    "geometry": {"flow", "records"},
    "mechanics": {"flow", "geometry", "records"},
    "labelling": {"flow", "geometry", "records", "mechanics"},
    "formats": {"flow", "records", "labelling", "mechanics"},
    "networks": {"flow", "records"},
    "calibration": {"flow", "records", "geometry", "mechanics"},
    "virtualrig": {"flow", "records", "geometry", "mechanics", "labelling"},
    "sweeps": {"flow", "records", "geometry", "mechanics", "labelling"},
    "reporting": {"flow", "records", "geometry", "mechanics", "labelling", "calibration"},
    "live": {"records", "reporting", "formats"},
}
# Rooms of a folder, and the rooms that each may import from. Of mechanics scene, material and their like above them are for
# all; of networks `pipeline.py` above them puts them together.
MECHANICS = {
    "linear": set(),
    "mesh": set(),
    "elements": {"linear", "mesh"},
    "contact": {"linear", "mesh"},
    "path": {"contact", "elements", "linear", "mesh"},
    "ccx": {"mesh"},
    "solvers": {"ccx", "contact", "elements", "linear", "mesh", "path"},
}
NETWORKS = {
    "models": set(),
    "preprocess": {"models"},
    "balls": {"preprocess"},
    "uncertainty": {"preprocess", "inference"},
    "checkpoint": {"models", "uncertainty"},
    "inference": {"checkpoint", "preprocess", "uncertainty"},
    "data": {"models", "preprocess"},
    "training": {"models", "data", "checkpoint", "preprocess"},
    "evaluation": {"models", "data", "checkpoint", "preprocess", "uncertainty", "inference"},
}
TORCH = {"models", "training", "data/loader.py", "data/augment.py", "checkpoint/weights.py", "checkpoint/onnxexport.py",
         "checkpoint/convert.py", "pipeline.py"}  # fmt: skip
ON_TOP = {"stages", "commands"}  # thin mains, which may use all of the above


def imports(path: Path) -> set[str]:
    """Modules that a file imports anywhere in it, also inside functions."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def folders_used(path: Path) -> set[str]:
    """Folders of the package that a file imports from."""
    names = {name.split(".")[1] for name in imports(path) if name.startswith("gelforge.")}
    return {name for name in names if (PACKAGE / name).is_dir()}


def test_folders_use_only_what_they_may():
    folders = {path.name for path in PACKAGE.iterdir() if any(path.glob("*.py"))}
    assert folders == ALLOWED.keys() | ON_TOP
    wrong = [
        f"{path.relative_to(PACKAGE)} imports {used}"
        for folder, allowed in ALLOWED.items()
        for path in (PACKAGE / folder).rglob("*.py")
        for used in folders_used(path) - allowed - {folder}
    ]
    assert wrong == []


@pytest.mark.parametrize(
    ("folder", "rooms", "for_all"), [("mechanics", MECHANICS, True), ("networks", NETWORKS, False)]
)
def test_rooms_use_only_what_they_may(folder, rooms, for_all):
    home = PACKAGE / folder
    assert {path.name for path in home.iterdir() if any(path.glob("*.py"))} == rooms.keys()
    above = {path.stem for path in home.glob("*.py")} if for_all else set()
    wrong = [
        f"{path.relative_to(home)} imports {name}"
        for room, allowed in rooms.items()
        for path in (home / room).rglob("*.py")
        for name in imports(path)
        if name.startswith(f"gelforge.{folder}.") and name.split(".")[2] not in {*allowed, *above, room}
    ]
    assert wrong == []


def test_torch_stays_where_it_is_needed():
    home = PACKAGE / "networks"
    found = {
        path.relative_to(home)
        for path in home.rglob("*.py")
        if any(m.split(".")[0] == "torch" for m in imports(path))
    }
    assert {str(path) for path in found if not {str(path), path.parts[0]} & TORCH} == set()


def test_no_stage_uses_a_command():
    """What both need is a library."""
    assert [path.name for path in (PACKAGE / "stages").rglob("*.py") if "commands" in folders_used(path)] == []


def test_the_face_of_the_package_stands_on_libraries_alone():
    assert [path.name for path in PACKAGE.glob("*.py") if folders_used(path) & ON_TOP] == []


def test_allowed_arrows_make_no_circle():
    TopologicalSorter(ALLOWED).prepare()


def test_the_product_imports_no_test_and_no_benchmark():
    assert [path for path in PACKAGE.rglob("*.py") if any(m.split(".")[0] == "tests" for m in imports(path))] == []


def test_no_module_is_let_off_by_the_type_checker():
    overrides = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]["overrides"]
    assert [table["module"] for table in overrides if table.get("ignore_errors")] == []


def test_no_two_public_classes_have_one_name():
    homes: dict[str, list[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(str(path.relative_to(PACKAGE)))
    assert {name: where for name, where in homes.items() if len(where) > 1} == {}


def test_no_two_libraries_have_one_name():
    """Commands and stages have the names that people type; what they call is named by what it is."""
    homes: dict[str, list[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        folder = path.relative_to(PACKAGE).parts[0]
        if folder not in ON_TOP and path.name != "__init__.py":
            homes.setdefault(path.stem, []).append(str(path.relative_to(PACKAGE)))
    assert {name: where for name, where in homes.items() if len(where) > 1} == {}


def test_pictures_are_drawn_on_one_canvas():
    drawing = {"matplotlib.pyplot", "matplotlib.figure.Figure", "matplotlib.backends.backend_agg"}
    found = [str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("*.py") if imports(path) & drawing]
    assert found == ["reporting/canvas.py"]
