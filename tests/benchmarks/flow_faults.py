"""A flow that is disturbed: corrupt results, kills, full disks, time stamps, two makes at once, changes, links, languages.

Each case works on a copy of a small project that was built to its labels. It holds where the next make says in a sentence
what is wrong, or ends with the very labels of an undisturbed run.
"""

import hashlib
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelforge.errors import GelforgeError
from gelforge.flow.files import read_csv, write_csv, write_text
from tests.benchmarks.attempts import ROOT, Case
from tests.benchmarks.sandbox import clean_environment, comma_language, link_project, make

NAME = "tiny"
# Coarse and in process: the flow is on trial here, not the mechanics.
SETTINGS = '[params.plan]\nshard_size = 2\n[params.fea]\nfidelity = "hex"\nhex_quality = "demo"\ntolerance = 0.2\n'
BUILT = re.compile(rf"^results/{NAME}/(\S+)  [\d.]+ s", re.MULTILINE)
PREDICTED = re.compile(rf"gelforge\.flow\.step results/{NAME}/(\S+)", re.MULTILINE)
ENDLESS_S = 300.0  # after which a make of four presses is taken to plan for ever
LABELS = f"results/{NAME}/50_labels/24x32"

Act = Callable[[Path], object]


def lay_project(folder: Path, count: int = 4) -> Path:
    """A sandbox whose dataset holds the first presses of the demo."""
    project, demo = link_project(ROOT, folder), ROOT / "data" / "demo"
    rows = read_csv(demo / "log.csv")[:count]
    write_csv(project / "data" / NAME / "log.csv", list(rows[0]), rows)
    base = (demo / "dataset.toml").read_text(encoding="utf-8").split("[params")[0]
    write_text(project / "data" / NAME / "dataset.toml", base + SETTINGS)
    for row in rows:
        image = project / "data" / NAME / row["image"]
        image.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(demo / row["image"], image)
    return project


def labels_of(project: Path) -> str:
    """Digest of every label and its sample's name."""
    digest = hashlib.sha256()
    for path in sorted((project / LABELS).glob("[0-9]*.npz")):
        if not path.is_file():
            return f"{path.name} is no file"
        with np.load(path, allow_pickle=False) as shard:
            for name in ("sample_id", "label"):
                digest.update(np.ascontiguousarray(shard[name]).tobytes())
    return digest.hexdigest()


def finish(project: Path, *goals: str) -> str:
    """Make the labels; their digest, or why make refused."""
    done = make(project, f"DATASET={NAME}", *(goals or ("labels",)))
    if "Traceback" in done.stdout:
        return "traceback: " + done.stdout[-400:]
    if done.returncode:
        raise GelforgeError(done.stdout.strip()[-600:].replace("\t", " "))
    return labels_of(project)


class Sandboxes:
    """Copies of one project, as checked out (`raw`) or built to its labels (`built`)."""

    def __init__(self, base: Path):
        self.raw = lay_project(base / "flow-raw")
        self.built = shutil.copytree(self.raw, base / "flow-built", symlinks=True)
        self.expected = finish(self.built)

    def case(self, name: str, start: Path, act: Act, expected: object = None) -> Case:
        """A case on a copy of one of the two; nothing but the expected answer will do."""

        def run(folder: Path) -> object:
            return act(shutil.copytree(start, folder / "project", symlinks=True))

        return Case("flow", name, run, self.expected if expected is None else expected, strict=True)


# -- results that are corrupt

CORRUPTIONS: dict[str, Callable[[Path], object]] = {
    "deleted": lambda path: path.unlink(),
    "empty": lambda path: path.write_bytes(b""),
    "cut in half": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "one byte changed": lambda path: path.write_bytes(flipped(path.read_bytes())),
    "a folder in its place": lambda path: (path.unlink(), path.mkdir()),
}


def flipped(data: bytes) -> bytes:
    """The bytes with one in the middle changed."""
    at = len(data) // 2
    return data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :]


def corruption_cases(boxes: Sandboxes) -> Iterator[Case]:
    results = boxes.built / "results" / NAME
    for stage in ("10_poses", "20_meshes", "30_fea", "40_forces", "50_labels"):
        files = sorted(p for p in (results / stage).rglob("*") if p.is_file() and not p.name.startswith("."))
        for suffix in sorted({p.suffix for p in files}):
            which = next(p for p in files if p.suffix == suffix).relative_to(boxes.built)
            for how, corrupt in CORRUPTIONS.items():

                def act(project: Path, which=which, corrupt=corrupt) -> object:
                    corrupt(project / which)
                    return finish(project, "dataset")  # a reader of every stage

                name = f"{which.relative_to(Path('results') / NAME)}: {how}"
                case = boxes.case(name, boxes.built, act)
                # what is corrupt may be refused, where it is named
                yield case if how == "deleted" else replace(case, strict=False)


# -- runs that end early


def killed(project: Path, after_s: float, how: signal.Signals) -> None:
    """Start make from nothing and end it, with all it started, after some seconds."""
    started = subprocess.Popen(
        ["make", "-j2", f"DATASET={NAME}", "labels"], cwd=project, env=clean_environment(), start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    time.sleep(after_s)
    if how is signal.SIGKILL:
        os.kill(started.pid, how)  # make alone: what it started has to notice
    else:
        os.killpg(started.pid, how)
    started.wait()


def kill_cases(boxes: Sandboxes) -> Iterator[Case]:
    rng = np.random.default_rng(5)
    for how in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT):
        for after in rng.uniform(0.2, 9.0, 6):

            def act(project: Path, after=float(after), how=how) -> object:
                killed(project, after, how)
                return finish(project)

            yield boxes.case(f"{how.name} after {after:.1f} s", boxes.raw, act)


def disk_cases(boxes: Sandboxes) -> Iterator[Case]:
    for kib in (16, 40, 80, 120, 200, 300, 500, 800):

        def act(project: Path, kib=kib) -> object:
            small = project / "results"
            small.mkdir(exist_ok=True)
            mounted = ["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", str(small)]
            if subprocess.run(mounted, capture_output=True).returncode:
                return boxes.expected  # a disk cannot be mounted here
            try:
                try:
                    finish(project)
                except GelforgeError as error:
                    if "No space left" not in str(error):
                        return f"said: {error}"
                subprocess.run(["mount", "-o", "remount,size=200m", str(small)], check=True)
                parts = [p.name for p in small.rglob("*.part*")]
                return f"left {parts}" if parts else finish(project)
            finally:
                subprocess.run(["umount", "-l", str(small)], check=True)

        yield boxes.case(f"a disk of {kib} KiB", boxes.raw, act)


# -- time stamps and makes at once


def stamp_cases(boxes: Sandboxes) -> Iterator[Case]:
    given = [f"data/{NAME}/log.csv", f"data/{NAME}/dataset.toml", "workflow/params.toml", "workflow/sensors.toml",
             "workflow/indenters.toml", f"data/{NAME}/{read_csv(boxes.raw / 'data' / NAME / 'log.csv')[0]['image']}"]  # fmt: skip
    for name in given:
        for word, days in (("tomorrow", 1), ("in ten years", 3650), ("yesterday", -1), ("in 1980", -16000)):

            def act(project: Path, name=name, days=days) -> object:
                when = time.time() + 86400 * days
                os.utime(project / name, (when, when))
                finish(project)
                done = make(project, f"DATASET={NAME}", "labels")
                again = BUILT.findall(done.stdout)
                return f"made again: {again}" if again or done.returncode else labels_of(project)

            yield boxes.case(f"{Path(name).name} is of {word}", boxes.built, act)


def twin_cases(boxes: Sandboxes) -> Iterator[Case]:
    pairs = {
        "the same goal": (("labels",), ("labels",)),
        "two resolutions": (("labels",), ("labels", "RES=6x8")),
        "a stage and a later one": (("fea",), ("labels",)),
        "status beside it": (("labels",), ("status",)),
        "a dry run beside it": (("labels",), ("-n", "labels")),
    }
    for name, (one, other) in pairs.items():
        for gap in (0.0, 1.5):

            def act(project: Path, one=one, other=other, gap=gap) -> object:
                started = []
                for goals in (one, other):
                    asked = ["make", f"DATASET={NAME}", *goals]
                    started.append(subprocess.Popen(asked, cwd=project, env=clean_environment(), text=True,
                                                    stdout=subprocess.PIPE, stderr=subprocess.STDOUT))  # fmt: skip
                    time.sleep(gap)
                said = [process.communicate()[0] for process in started]
                wrong = [text for text in said if "Traceback" in text]
                return f"said: {wrong[0][-400:]}" if wrong else finish(project)

            yield boxes.case(f"two makes, {name}, {gap:g} s apart", boxes.raw, act)


def midway_cases(boxes: Sandboxes) -> Iterator[Case]:
    """A setting that changes while make runs, and another make that plans with it: the end is that of a fresh run."""
    for name, old, new in (
        ("a quality", '"demo"', '"draft"'),
        ("a tolerance", "tolerance = 0.2", "tolerance = 0.02"),
    ):
        change = edited(f"data/{NAME}/dataset.toml", old, new)
        fresh = shutil.copytree(boxes.raw, boxes.raw.with_name(f"fresh {name}".replace(" ", "-")), symlinks=True)
        change(fresh)
        expected = finish(fresh)
        for after in (0.3, 1.0, 2.0, 3.0, 4.0, 5.5):

            def act(project: Path, change=change, after=after) -> object:
                started = subprocess.Popen(
                    ["make", "-j1", f"DATASET={NAME}", "labels"], cwd=project, env=clean_environment(),
                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )  # fmt: skip
                time.sleep(after)
                change(project)
                make(project, "-n", f"DATASET={NAME}", "labels")
                started.wait()
                return finish(project)

            yield boxes.case(f"{name} changes {after:g} s after make started", boxes.raw, act, expected)


# -- links and languages


def content_with(project: Path, **options) -> object:
    """The labels' digest, where a second make finds nothing to do."""
    for _ in range(2):
        done = make(project, f"DATASET={NAME}", "labels", timeout=ENDLESS_S, **options)
        if done.returncode:
            return done.stdout[-400:]
    again = BUILT.findall(done.stdout)
    return f"made again: {again}" if again else labels_of(project)


def linked(project: Path, name: str, behind: Path) -> None:
    """Move what a project holds to another place, and leave a link to it."""
    shutil.move(project / name, behind)
    (project / name).symlink_to(behind)


def link_cases(boxes: Sandboxes) -> Iterator[Case]:
    data = f"data/{NAME}"
    image = read_csv(boxes.raw / data / "log.csv")[0]["image"]
    pictures = [f"{data}/{image}", f"{data}/{Path(image).parent}"]
    others = [f"{data}/log.csv", f"{data}/dataset.toml", "workflow/params.toml", "workflow/sensors.toml"]
    for name in [*pictures, *others, "workflow/indenters.toml", data, "data"]:

        def act(project: Path, name=name) -> object:
            # pictures must stay inside their dataset
            linked(project, name, (project / data if name in pictures else project.parent) / "behind")
            return content_with(project)

        yield boxes.case(f"{name} is a link", boxes.built, act)
    for name in pictures:

        def act(project: Path, name=name) -> object:
            linked(project, name, project.with_name("behind"))
            done = make(project, f"DATASET={NAME}", "STRICT=1", "labels")
            return done.returncode != 0 and "the path leaves the dataset's folder" in done.stdout

        yield boxes.case(f"{name} is a link out of its dataset", boxes.built, act, True)


def language_cases(boxes: Sandboxes) -> Iterator[Case]:
    def act(project: Path) -> object:
        environment = comma_language(project)
        return boxes.expected if environment is None else content_with(project, environment=environment)

    yield boxes.case("numbers have a comma", boxes.built, act)


# -- single changes: what make -n says is what is made


def edited(name: str, old: str, new: str) -> Act:
    """Replace text of a file once."""

    def act(project: Path) -> None:
        path = project / name
        text = path.read_text(encoding="utf-8")
        if old not in text:
            raise ValueError(f"{name} holds no {old!r}")
        path.write_text(text.replace(old, new, 1), encoding="utf-8")

    return act


def without_row(project: Path) -> None:
    """Take the last press out of the log."""
    path = project / "data" / NAME / "log.csv"
    rows = read_csv(path)
    write_csv(path, list(rows[0]), rows[:-1])


def swapped_images(project: Path) -> None:
    """One press gets the picture of another."""
    rows = read_csv(project / "data" / NAME / "log.csv")
    shutil.copy(project / "data" / NAME / rows[1]["image"], project / "data" / NAME / rows[0]["image"])


def change_cases(boxes: Sandboxes) -> Iterator[Case]:
    settings, params = f"data/{NAME}/dataset.toml", "workflow/params.toml"
    changes: dict[str, Act] = {
        "a comment in params.toml": edited(params, "[fea]", "# a comment\n[fea]"),
        "a tolerance": edited(settings, "tolerance = 0.2", "tolerance = 0.3"),
        "a quality": edited(settings, '"demo"', '"draft"'),
        "shards of one press": edited(settings, "shard_size = 2", "shard_size = 1"),
        "a fraction of labels": edited(params, "largest_outside_share = 0.02", "largest_outside_share = 0.03"),
        "an indenter that is not used": edited("workflow/indenters.toml", "[bar_10]", "[another_bar]"),
        "a press less": without_row,
        "another picture": swapped_images,
        "the law of friction": edited(params, 'law = "no_slip"', 'law = "frictionless"'),
    }
    for name, change in changes.items():

        def act(project: Path, change=change) -> object:
            change(project)
            asked = make(project, "-n", f"DATASET={NAME}", "labels")
            finish_text = make(project, f"DATASET={NAME}", "labels")
            said, made = sorted(PREDICTED.findall(asked.stdout)), sorted(BUILT.findall(finish_text.stdout))
            if asked.returncode or finish_text.returncode:
                return f"exit {asked.returncode}, {finish_text.returncode}: {finish_text.stdout[-300:]}"
            return "as it said" if said == made else f"said {said}, made {made}"

        yield boxes.case(f"make -n after {name}", boxes.built, act, "as it said")


def flow_cases(base: Path) -> Iterator[Case]:
    """Every disturbance of a small flow, on copies of projects below `base`."""
    boxes = Sandboxes(base)
    for cases in (
        corruption_cases,
        kill_cases,
        disk_cases,
        stamp_cases,
        twin_cases,
        midway_cases,
        link_cases,
        language_cases,
        change_cases,
    ):
        yield from cases(boxes)
