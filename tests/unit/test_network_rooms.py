"""The rooms of networks/: which may import which, and where torch is needed."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "src" / "gelforge"
NETWORKS = PACKAGE / "networks"
# Each room and the rooms that it may import from. `pipeline.py` above them puts them together.
ALLOWED = {
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


def modules_of(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return found


def test_rooms_import_what_they_may():
    wrong = [
        f"{path.relative_to(NETWORKS)} imports {name}"
        for room, allowed in ALLOWED.items()
        for path in (NETWORKS / room).glob("*.py")
        for name in modules_of(path)
        if name.startswith("gelforge.networks.") and name.split(".")[2] not in allowed | {room}
    ]
    assert wrong == []


def test_torch_stays_where_it_is_needed():
    found = [
        str(path.relative_to(NETWORKS))
        for path in NETWORKS.rglob("*.py")
        if any(name.split(".")[0] == "torch" for name in modules_of(path))
    ]
    assert [name for name in found if name not in TORCH and name.split("/")[0] not in TORCH] == []
