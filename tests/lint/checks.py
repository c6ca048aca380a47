"""Style of the repository, and what is generated in it: `make lint` checks, `make format` writes (--fix)."""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from gelforge.flow.files import read_json, write_text
from gelforge.flow.layout import FOLDERS
from gelforge.records.networkkind import KINDS
from gelforge.records.press import FORCE, POSE
from gelforge.records.samplefile import SPLITS, TEST, TRAINING
from tests.benchmarks.faults import unfit as unfit_faults
from tests.lint.parameters_page import page
from tests.lint.readme_pictures import outdated
from tests.lint.tables import KEPT
from tests.lint.tables import generated as with_figures

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "src" / "gelforge"
TESTS = ROOT / "tests"

# Each folder and the folders it may import from; everything may use `errors`. `flow` is files, parameters, make.
ALLOWED: dict[str, set[str]] = {
    "flow": set(),
    "records": {"flow"},
    "geometry": {"flow", "records"},
    "mechanics": {"flow", "geometry", "records"},
    "labelling": {"flow", "geometry", "records", "mechanics"},
    "formats": {"flow", "records", "labelling", "mechanics"},
    "reading": {"flow", "records", "mechanics", "labelling", "reporting"},
    "learning": {"flow", "records", "mechanics", "labelling", "reading"},
    "calibration": {"flow", "records", "geometry", "mechanics"},
    "virtualrig": {"flow", "records", "reading", "geometry", "mechanics", "labelling"},
    "sweeps": {"flow", "records", "geometry", "mechanics", "labelling"},
    "reporting": {"flow", "records", "geometry", "mechanics", "labelling", "calibration"},
    "live": {"flow", "records", "reading", "reporting", "formats"},
    "evidence": {"flow", "records", "geometry", "labelling", "reading"},
}
# Folders of tests, and those of tests that each may import from; of others what tests share.
SHARED = {"support"}
OF_TESTS = {
    "benchmarks": {"benchmarks", "support"},
    "lint": {"benchmarks", "lint", "support"},
    "unit": {"lint", "support"},
}
ON_TOP = {"stages", "commands"}  # thin mains, which may use all of the above
# Rooms of a folder, and the rooms that each may import from. Of mechanics scene, material and their like above them are for
# all.
ROOMS: dict[str, dict[str, set[str]]] = {
    "mechanics": {
        "linear": set(),
        "mesh": set(),
        "elements": {"linear", "mesh"},
        "contact": {"linear", "mesh"},
        "path": {"contact", "elements", "linear", "mesh"},
        "ccx": {"mesh"},
        "solvers": {"ccx", "contact", "elements", "linear", "mesh", "path"},
    },
}
FOR_ALL = {"mechanics"}  # folders whose modules above the rooms may be used in them
TORCH = {"nets.py", "augment.py", "batches.py", "start.py", "train.py", "export.py"}  # of learning
# What one module alone may do or say; besides, a picture in grey, and a surface coloured by how far it moved.
HOMES = {
    "draws with matplotlib": {"reporting/canvas.py"},
    "makes a pool of processes": {"flow/jobs.py"},
    "names kinds of networks": {"learning/nets.py"},
    "spells a folder of results": {"flow/layout.py"},
    "chooses colours of values": {"reporting/forcemaps.py", "commands/look.py"},
}
RESULTS = re.compile(rf"\S*(?<!\w)({'|'.join(name for name in FOLDERS if name[0].isdigit())})(?!\w)\S*")


@cache
def tree_of(path: Path) -> ast.Module:
    """The syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports(path: Path) -> set[str]:
    """Names that a file imports, wherever in it: modules, and what is taken from them."""
    found: set[str] = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def folders_used(path: Path) -> set[str]:
    """Folders of the package that a file imports from."""
    names = {name.split(".")[1] for name in imports(path) if name.startswith("gelforge.")}
    return {name for name in names if (PACKAGE / name).is_dir()}


def folders_in(home: Path) -> set[str]:
    """Folders of modules directly below a folder."""
    return {path.name for path in home.iterdir() if any(path.glob("*.py"))}


def wrong_imports() -> Iterator[str]:
    """Imports that the tables above do not allow."""
    if odd := folders_in(PACKAGE) ^ (ALLOWED.keys() | ON_TOP):
        yield f"{sorted(odd)}: the table of folders and src/gelforge differ"
    try:
        TopologicalSorter(ALLOWED).prepare()
    except CycleError as error:
        yield f"allowed imports make a circle: {error.args[1]}"
    for path in PACKAGE.rglob("*.py"):
        name, folder = path.relative_to(PACKAGE), path.relative_to(PACKAGE).parts[0]
        used = folders_used(path)
        if folder in ALLOWED:
            yield from (f"{name} imports {other}" for other in used - ALLOWED[folder] - {folder})
        elif folder not in ON_TOP:
            yield from (f"{name} imports {other}: it stands on libraries" for other in used & ON_TOP)
        elif folder == "stages" and "commands" in used:
            yield f"{name} imports a command: what both need is a library"
        if any(module.split(".")[0] == "tests" for module in imports(path)):
            yield f"{name} imports tests"
    for path in TESTS.rglob("*.py"):
        folder = path.relative_to(TESTS).parts[0]
        used = {name.split(".")[1] for name in imports(path) if name.startswith("tests.")}
        yield from (
            f"tests/{path.relative_to(TESTS)} imports tests.{other}" for other in used - OF_TESTS.get(folder, SHARED)
        )
    for folder, rooms in ROOMS.items():
        home = PACKAGE / folder
        if odd := folders_in(home) ^ rooms.keys():
            yield f"{sorted(odd)}: the table of rooms and {folder} differ"
        above = {path.stem for path in home.glob("*.py")} if folder in FOR_ALL else set()
        for room, allowed in rooms.items():
            for path in (home / room).rglob("*.py"):
                names = {name for name in imports(path) if name.startswith(f"gelforge.{folder}.")}
                wrong = [name for name in names if name.split(".")[2] not in {*allowed, *above, room}]
                yield from (f"{path.relative_to(PACKAGE)} imports {name}" for name in wrong)
    for path in [*(PACKAGE / "learning").rglob("*.py"), *(PACKAGE / "reading").rglob("*.py")]:
        folder, name = (
            path.relative_to(PACKAGE).parts[0],
            path.relative_to(PACKAGE / path.relative_to(PACKAGE).parts[0]),
        )
        torch_there = any(module.split(".")[0] == "torch" for module in imports(path))
        if torch_there and (folder == "reading" or not {str(name), name.parts[0]} & TORCH):
            yield f"{folder}/{name} imports torch"


def same_names() -> Iterator[str]:
    """Public classes, and modules of libraries, that share a name."""
    homes: dict[str, list[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        name = str(path.relative_to(PACKAGE))
        for node in tree_of(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(f"class {node.name}", []).append(name)
        if name.split("/", maxsplit=1)[0] not in ON_TOP and path.name != "__init__.py":
            homes.setdefault(f"module {path.stem}", []).append(name)
    yield from (f"{name} stands in {where}" for name, where in homes.items() if len(where) > 1)


def unchecked_types() -> Iterator[str]:
    """Modules that the type checker leaves out."""
    overrides = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mypy"]["overrides"]
    yield from (f"mypy ignores errors of {table['module']}" for table in overrides if table.get("ignore_errors"))


def texts(node: ast.AST) -> list:
    """Constants in a literal list or tuple, in order."""
    return [item.value for item in getattr(node, "elts", []) if isinstance(item, ast.Constant)]


def called(node: ast.Call) -> str:
    """The name of the function that a call is of."""
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def said_in(path: Path) -> Iterator[str]:
    """What a file does or says that only one module may."""
    if imports(path) & {"matplotlib.pyplot", "matplotlib.figure.Figure", "matplotlib.backends.backend_agg"}:
        yield "draws with matplotlib"
    nodes = [*ast.walk(tree_of(path))]
    helps = {
        id(word.value) for node in nodes if isinstance(node, ast.Call) for word in node.keywords if word.arg == "help"
    }
    for node in nodes:
        match node:
            case ast.Call():
                if called(node) in {"imread", "imdecode", "imwrite", "imencode"}:
                    yield "codes pictures"
                if called(node) in {"ProcessPoolExecutor", "Pool"}:
                    yield "makes a pool of processes"
                keys = [inner.slice for inner in ast.walk(node) if isinstance(inner, ast.Subscript)]
                if called(node) == "float" and any(getattr(key, "value", "") in (*POSE, *FORCE) for key in keys):
                    yield "parses cells of a press"
                if any(word.arg == "cmap" for word in node.keywords):
                    yield "chooses colours of values"
            case ast.Constant(value=str(word)):
                if word in set(SPLITS) - {TRAINING, TEST}:  # these are words of other meanings, too
                    yield "names splits"
                if word in KINDS.keys() - {"grid", "unet"}:  # likewise
                    yield "names kinds of networks"
                if id(node) not in helps and RESULTS.fullmatch(word):
                    yield "spells a folder of results"
            case ast.Subscript(slice=ast.Constant(), value=of):
                if getattr(of, "attr", getattr(of, "id", "")) == "splits":
                    yield "names splits"
            case _ if set(POSE[:5]) <= set(texts(node)) or texts(node) == list(FORCE):
                yield "lists columns of a press"


def facts_twice() -> Iterator[str]:
    """Facts that stand outside their home: `records`, but for those of HOMES."""
    for path in PACKAGE.rglob("*.py"):
        name = str(path.relative_to(PACKAGE))
        if not name.startswith("records/"):
            wrong = [said for said in sorted(set(said_in(path))) if name not in HOMES.get(said, set())]
            yield from (f"{name} {said}: only {sorted(HOMES.get(said, {'records'}))} may" for said in wrong)


def pictures() -> Iterator[str]:
    """Pictures of README and guide without a record of their data, or older than tracked data that they show."""
    pages = [ROOT / "README.md", *sorted((ROOT / "workflow/guide").glob("*.md"))]
    text = "".join(path.read_text(encoding="utf-8") for path in pages)
    for name in sorted(set(re.findall(r"!\[[^\]]*\]\((?:\.\./\.\./)?(results/readme/[^)]+)\)", text))):
        record = (ROOT / name).with_suffix(".json")
        if not record.exists():
            yield f"{name}: {record.name} is missing, which says what it was made from"
            continue
        data = list(read_json(record)["data"])
        yield from (
            f"{record.name}: {source} is a path of one machine" for source in data if Path(source).is_absolute()
        )
        # Charts below results/ are of another machine's seconds: it is unknown whether they are old.
        if any(not source.startswith("results/") for source in data) and (old := outdated(ROOT / name)):
            yield f"{name} is older than {', '.join(old)}: run `make {name}`"


def undated_figures() -> Iterator[str]:
    """Kept figures that do not say when, from which commit and on which machine they were measured."""
    for path in sorted(KEPT.glob("*.json")):
        if [f for f in read_json(path)["figures"] if not (f["measured"] and f["commit"] and f["machine"])]:
            yield f"{path.name}: a figure without its date, commit or machine"


def generated() -> dict[Path, str]:
    """Files that are made from others, and their text."""
    return {
        **with_figures(),
        ROOT / "workflow/guide/parameters.md": page(ROOT / "workflow" / "params.toml"),
    }


def main(fix: bool) -> int:
    """Print what is wrong; the number of faults. fix: write what is generated."""
    faults = [fault for check in CHECKS for fault in check()]
    for path, text in generated().items():
        if path.read_text(encoding="utf-8") != text:
            if fix:
                write_text(path, text)
            else:
                faults.append(f"{path.relative_to(ROOT)} is outdated: run `make format`")
    print(*faults, sep="\n", end="\n" if faults else "")
    return len(faults)


CHECKS = (wrong_imports, same_names, unchecked_types, facts_twice, pictures, undated_figures, unfit_faults)

if __name__ == "__main__":
    sys.exit(bool(main(fix="--fix" in sys.argv[1:])))
