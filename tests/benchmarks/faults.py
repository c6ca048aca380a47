"""Whether the tests notice single faults that are planted in the code: `make benchmark-faults`; --random N draws others.

faults.toml lists them: a file, a text that occurs in it once, its replacement, and the tests that must then fail.
Faults of different packages whose tests lie in different files are planted at once in a copy of the project; a fault
is caught where one of its own tests fails, and passes without the faults. Method: mutation testing (DeMillo, Lipton,
Sayward, "Hints on test data selection", Computer 1978), with faults chosen by hand.
"""

import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from argparse import Namespace
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from gelforge.flow.cli import command, option
from gelforge.flow.files import digest_of_value, record_of, write_json
from tests.support.figures import PUBLISHED_DATA, ROOT, Figure, publish_figures
from tests.support.sandbox import clean_environment

LIST = Path(__file__).with_suffix(".toml")
LEAST = 4  # faults per package
SECONDS = 600  # limit of a test, because a fault may make it wait for ever
# Pytest's exit status. Others mean that nothing was judged, for example because a file cannot be imported.
PASSED, FAILED = 0, 1
CAUGHT, TIMED_OUT, SURVIVES, UNJUDGED, UNFIT = "caught", "timed out", "SURVIVES", "not judged", "DOES NOT FIT"


@dataclass(frozen=True)
class Fault:
    """One fault to plant: in the project's `file`, `new` replaces `old`; `tests` are pytest's arguments, `marks` theirs."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    marks: str = ""

    @property
    def room(self) -> str:
        """The package of gelforge that holds the file, or the top folder."""
        parts = Path(self.file).parts
        return parts[2] if len(parts) > 3 else parts[0]

    @property
    def test_files(self) -> set[str]:
        """Files of its tests."""
        return {test.partition("::")[0] for test in self.tests}

    def compiled(self, root: Path = ROOT) -> bool:
        """Whether its file is compiled by numba."""
        return b"njit" in (root / self.file).read_bytes()

    def names(self, test: str) -> bool:
        """Whether a test, as pytest names it, is one of its own."""
        return any(test == own or test.startswith((f"{own}::", f"{own}[")) for own in self.tests)

    def key(self, root: Path = ROOT) -> str:
        """Digest of what the outcome depends on most: the fault, the file it is planted in, and its tests' files."""
        files = sorted({self.file, *self.test_files})
        texts = [(root / file).read_text(encoding="utf-8") for file in files]
        return digest_of_value([self.name, self.old, self.new, self.tests, texts])


def listed(path: Path) -> list[Fault]:
    """The faults of the list, in its order."""
    tables = tomllib.loads(path.read_text(encoding="utf-8"))["fault"]
    return [Fault(**table | {"tests": tuple(table["tests"])}) for table in tables]


def unfit() -> Iterator[str]:
    """What of the list cannot be planted, and packages of which it has too few."""
    every = listed(LIST)
    yield from (f"{LIST.name}: {fault.name!r}: {said}" for fault in every for said in misfits(fault))
    yield from gaps(every)


def misfits(fault: Fault, root: Path = ROOT) -> Iterator[str]:
    """Why a fault cannot be planted, or its tests cannot be run."""
    path = root / fault.file
    count = path.read_text(encoding="utf-8").count(fault.old) if path.is_file() else 0
    if count != 1:
        yield f"its old text stands {count} times in {fault.file}, not once"
    for test in fault.tests:
        file, _, name = test.partition("::")
        text = (root / file).read_text(encoding="utf-8") if (root / file).is_file() else ""
        if not text or (name and f"def {name}(" not in text):
            yield f"there is no test {test}"


def gaps(faults: list[Fault], root: Path = ROOT) -> Iterator[str]:
    """Packages with too few faults."""
    package = root / "src" / "gelforge"
    for room in sorted(["rules", *(path.name for path in package.iterdir() if any(path.glob("*.py")))]):
        found = sum(fault.room == room for fault in faults)
        if found < LEAST:
            yield f"{found} faults are of {room}, {LEAST} are asked for"


SWAPPED = {"+": "-", "-": "+", "*": "/", "/": "*", "<": ">", ">": "<", "<=": ">", ">=": "<", "0": "1", "1": "0"}


def changed(node: ast.AST, line: str) -> str | None:
    """A node's line with another sign, factor, limit, axis or number; None where it has none of these."""
    low = high = new = None
    match node:
        case ast.BinOp(left=one, right=two) | ast.Compare(left=one, comparators=[two]) if (
            one.end_lineno == two.lineno
        ):
            low, high = one.end_col_offset, two.col_offset
        case ast.keyword(arg="axis", value=value):
            low, high = value.col_offset, value.end_col_offset
        case ast.UnaryOp(op=ast.USub()):
            low, high, new = node.col_offset, node.col_offset + 1, ""
        case ast.Constant(value=float(number)):
            low, high, new = node.col_offset, node.end_col_offset, repr(2.0 * number or 1.0)
        case _:
            return None
    old = line[low:high].strip()  # of what stands in an f-string the place is another
    if new is None and old in SWAPPED:
        return f"{line[:low]}{line[low:high].replace(old, SWAPPED[old])}{line[high:]}"
    return line[:low] + new + line[high:] if new is not None and re.fullmatch(r"-|[\d.e-]+", old) else None


def drawn(count: int, seed: int) -> list[Fault]:
    """Random faults of the package, each on a line that its file has once; tests: files that import its module."""
    tests = {path: path.read_text(encoding="utf-8") for path in sorted((ROOT / "tests").glob("*/**/test_*.py"))}
    faults = []
    for path in sorted((ROOT / "src/gelforge").rglob("*.py")):
        text, file = path.read_text(encoding="utf-8"), str(path.relative_to(ROOT))
        module, lines = ".".join(path.relative_to(ROOT / "src").with_suffix("").parts), text.splitlines()
        named = re.compile(
            rf"^from (?:{re.escape(module)} import|{re.escape(module.rpartition('.')[0])} import .*\b{path.stem}\b)",
            re.MULTILINE,
        )
        of = [str(test.relative_to(ROOT)) for test, said in tests.items() if named.search(said)]
        for node in ast.walk(ast.parse(text)):
            line = lines[node.lineno - 1] if hasattr(node, "lineno") else ""
            if line.isascii() and text.count(line) == 1 and of and (new := changed(node, line)):
                faults.append(Fault(f"line {node.lineno}: {new.strip()}", file, line, new, tuple(of), "not slow"))
    return random.Random(seed).sample(faults, count)


def copied(folder: Path) -> Path:
    """A copy of all tracked files in their current state and of what numba compiled, with a link to the environment."""
    said = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    kernels = (str(path.relative_to(ROOT)) for path in (ROOT / "src").rglob("*.nb[ic]"))
    for name in (*filter(None, said.split("\0")), *kernels):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    (folder / ".venv").symlink_to((ROOT / ".venv").resolve())
    return folder


def grouped(faults: list[Fault], root: Path = ROOT) -> list[list[Fault]]:
    """Faults by what is planted at once: one of each package, whose tests share no file.

    Compiled files are planted apart from others, and last, because then all is compiled anew.
    """
    groups: list[list[Fault]] = []
    for fault in faults:
        for group in groups:
            same = any(fault.room == one.room or fault.test_files & one.test_files for one in group)
            if not same and fault.compiled(root) == group[0].compiled(root):
                group.append(fault)
                break
        else:
            groups.append([fault])
    return sorted(groups, key=lambda group: (group[0].compiled(root), -len(group)))


def tested(
    project: Path, tests: Collection[str], compiled: Path | None = None, marks: str = ""
) -> subprocess.CompletedProcess:
    """Run tests with these marks. compiled: folder for numba's compiled code; None: beside the sources."""
    environment = {
        **clean_environment(), "PYTHONPATH": str(project / "src"), "GELFORGE_REFERENCE": str(PUBLISHED_DATA.resolve()),
    } | ({"NUMBA_CACHE_DIR": str(compiled)} if compiled else {})  # fmt: skip
    words = ["-q", "-m", marks, "-p", "no:cacheprovider", "--tb=line", f"--timeout={SECONDS}"]
    return subprocess.run(
        [sys.executable, "-m", "pytest", *words, *tests],
        cwd=project,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def failures(done: subprocess.CompletedProcess) -> dict[str, str]:
    """Names of the tests that failed, each with pytest's words."""
    lines = [line.partition(" ")[2] for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return {name: words for name, _, words in (line.partition(" - ") for line in lines)}


@contextmanager
def planted(group: list[Fault], project: Path, moment: int) -> Iterator[None]:
    """Plant faults in a copy, and remove them at the end.

    moment: a unique time stamp for the files, by which Python sees that its compiled code is outdated.
    """
    whole = {fault.file: ((project / fault.file).read_bytes(), (project / fault.file).stat()) for fault in group}
    try:
        for fault in group:
            path = project / fault.file
            path.write_text(whole[fault.file][0].decode().replace(fault.old, fault.new), encoding="utf-8")
            os.utime(path, (moment, moment))
        yield
    finally:
        for name, (content, times) in whole.items():
            (project / name).write_bytes(content)
            os.utime(project / name, ns=(times.st_atime_ns, times.st_mtime_ns))


def outcomes(group: list[Fault], project: Path, moment: int) -> Iterator[tuple[Fault, str]]:
    """Whether each fault of a group is noticed, or why it could not be judged. moment: as for `planted`."""
    # numba does not see that compiled code calls a changed function: then all is compiled anew
    compiled = project.parent / "anew" if group[0].compiled(project) else None
    shutil.rmtree(project.parent / "anew", ignore_errors=True)
    with planted(group, project, moment):
        done = tested(project, sorted({test for fault in group for test in fault.tests}), compiled, group[0].marks)
    failed = failures(done)
    if done.returncode not in (PASSED, FAILED):  # as where a file cannot be imported: which fault is to blame?
        for at, fault in enumerate(group):
            if len(group) == 1:
                yield fault, f"{UNJUDGED}: {done.stdout[-1000:]}"
            else:
                yield from outcomes([fault], project, moment + at + 1)
        return
    # a test that also fails without the faults has noticed nothing
    unsound = failures(tested(project, sorted(failed))) if failed else {}
    for fault in group:
        mine = {name: words for name, words in failed.items() if fault.names(name)}
        noticed = {name: words for name, words in mine.items() if name not in unsound}
        if noticed:
            late = all("from pytest-timeout" in words for words in noticed.values())
            yield fault, TIMED_OUT if late else CAUGHT
        elif mine:
            yield fault, f"{UNJUDGED}: {', '.join(mine)} fail without the fault, too"
        else:
            yield fault, SURVIVES


@command(
    option("--out", type=Path, default=None, metavar="FILE", help="where the figures go (JSON)"),
    option("--only", default="", metavar="TEXT", help="faults whose name or file contains it"),
    option("--random", type=int, default=0, metavar="N", help="as many random faults of the package in place of the list"),
    option("--seed", type=int, default=0, help="of random faults, which the fast tests that name their module must notice"),
    option("--kept", type=Path, default=ROOT / "build" / "faults.json", metavar="FILE",
           help="outcomes of earlier runs, which count while a fault, its file and its tests are the same"),
)  # fmt: skip
def main(args: Namespace) -> int:
    """Plant every fault, and print those that survive or no longer fit the code."""
    every = drawn(args.random, args.seed) if args.random else listed(LIST)
    wrong = {fault.name: "; ".join(said) for fault in every if (said := list(misfits(fault)))}
    faults = [fault for fault in every if args.only in fault.name or args.only in fault.file]
    kept = {key: said for key, said in (record_of(args.kept) or {}).items() if not said.startswith(UNJUDGED)}
    found = {fault.name: f"{UNFIT}: {wrong[fault.name]}" for fault in faults if fault.name in wrong}
    faults = [fault for fault in faults if fault.name not in wrong]
    # of the files as they are now, whoever edits them in the meantime
    keys = {fault.name: fault.key() for fault in faults}
    for fault in faults:
        if keys[fault.name] in kept:
            print(f"{kept[keys[fault.name]]:10}  {fault.file}: {fault.name}", flush=True)
    with tempfile.TemporaryDirectory(prefix="gelforge-faults-") as folder:
        project = copied(Path(folder) / "project")
        for at, group in enumerate(grouped([fault for fault in faults if keys[fault.name] not in kept])):
            for fault, said in outcomes(group, project, 1_000_000_000 + 100 * at):
                kept = (record_of(args.kept) or {}) | kept | {keys[fault.name]: said}
                print(f"{said.partition(': ')[0]:10}  {fault.file}: {fault.name}", flush=True)
            write_json(args.kept, kept)
    found |= {name: kept[key] for name, key in keys.items()}
    print(*(f"{name}: {said}" for name, said in found.items() if said.startswith((UNJUDGED, UNFIT))), sep="\n")
    noticed = sum(said in (CAUGHT, TIMED_OUT) for said in found.values())
    waits = [name for name, said in found.items() if said == TIMED_OUT]
    survivors = [name for name, said in found.items() if said not in (CAUGHT, TIMED_OUT)]
    note = f"{noticed} of {len(found)}, {len(waits)} of them because a test waits for ever; survivors: {survivors or 'none'}"
    fraction = 100.0 * noticed / max(len(found), 1)
    figure = Figure(f"{'random' if args.random else 'planted'} faults caught", fraction, ">=", 95.0, "%", note)
    publish_figures(None if args.only else args.out, [figure])
    return bool(wrong)


if __name__ == "__main__":
    main.exit()
