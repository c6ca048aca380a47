"""User-facing parts at 15 000 presses: the page in a browser, exports, and questions to the flow."""

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from gelforge.commands.estimate import estimated, planned_rows
from gelforge.commands.export import FORMATS, export
from gelforge.errors import BadInput
from gelforge.flow.cli import command, option, positive
from gelforge.flow.files import bytes_of, read_csv, read_json, write_csv
from gelforge.flow.layout import Layout
from gelforge.formats.export.samples import Samples
from tests.benchmarks.parts.reach import time_fetch, time_live
from tests.support.browser import WIDTHS, browser, console_errors, wait_for
from tests.support.explored import write_page
from tests.support.exported import READERS, lay
from tests.support.figures import Figure, publish_figures
from tests.support.recorded_flow import lay as lay_flow
from tests.support.sandbox import make

PRESSES = 15_000
CHOICES = 20
REPORT = Path("results/demo/90_report/24x32-tuned.html")


def time_page(folder: Path, presses: int) -> list[Figure]:
    """Open the page of all presses at both widths, choose presses throughout, sort and filter."""
    page, opened, took, sorting, errors = write_page(folder, presses), [], [], [], 0
    for width in WIDTHS:
        with browser(width) as driver:
            started = time.perf_counter()
            driver.get(page.as_uri())
            wait_for(driver, "return document.body.dataset.shown")
            opened.append(time.perf_counter() - started)
            for k in range(CHOICES):
                name = f"made-{(7919 * (k + 1)) % presses:06d}"
                driver.execute_script("choose(PLACE.get(arguments[0]))", name)
                wait_for(driver, f"return document.body.dataset.shown === {json.dumps(name)}")
                took.append(float(driver.execute_script("return document.body.dataset.took")) / 1e3)
            for action in ("el('worst').click()", "state.filter = {indenter: 'sphere_15'}; arrange()"):
                sorting.append(
                    driver.execute_script(f"const t = performance.now(); {action}; return performance.now() - t")
                    / 1e3
                )
            errors += len(console_errors(driver))
    note = f"{presses} presses, parts beside the page, widths {WIDTHS[0]} and {WIDTHS[1]} px"
    return [
        Figure("page opens", max(opened), "<=", 3.0, "s", f"{note}; the first press is drawn"),
        Figure("a choice answers, slowest", max(took), "<=", 0.2, "s", f"{len(took)} presses all over it"),
        Figure("a choice answers, median", float(np.median(took)), "<=", 0.2, "s"),
        Figure("sorting or filtering, slowest", max(sorting), "<=", 0.2, "s"),
        Figure("console errors", errors, "==", 0, "", note),
    ]


def many(folder: Path, count: int, pictures: int = 48) -> Samples:
    """A dataset of `count` samples that share `pictures` images of a sensor's size."""
    samples = lay(folder, pictures, (24, 32), (320, 240))
    rows = read_csv(samples.dataset / "samples.csv")
    # two frames per press, as in `lay`
    rows = [
        {**rows[k % pictures], "sample_id": f"s{k}", "group": str(k // 2), "press_id": f"p{k // 2}"}
        for k in range(count)
    ]
    write_csv(samples.dataset / "samples.csv", list(rows[0]), rows)
    begin = datetime(2026, 4, 8, 12, 25, tzinfo=UTC)
    times = [(begin + timedelta(seconds=k // 2 + 0.125 * (k % 2))).isoformat() for k in range(count)]
    log = [{"sample_id": row["sample_id"], "time_utc": when} for row, when in zip(rows, times, strict=True)]
    write_csv(samples.data / "log.csv", list(log[0]), log)
    np.save(samples.dataset / "labels.npy", np.tile(samples.labels, (-(-count // pictures), 1, 1, 1))[:count])
    return Samples.open(samples.data, samples.dataset, folder / "sensors.json")


def time_exports(folder: Path, presses: int) -> list[Figure]:
    """Time of an export in every format."""
    samples, found = many(folder / "large", presses), []
    for form in FORMATS:
        started, spent = time.perf_counter(), time.process_time()
        export(samples, form, folder / f"out{READERS[form][0]}")
        seconds, note = (
            time.process_time() - spent,
            f"processor time; {time.perf_counter() - started:.0f} s by the clock",
        )
        found.append(Figure(f"export of {presses} samples, {form}", seconds, "<=", 60.0, "s", note))
    return found


def time_provenance(folder: Path, presses: int) -> list[Figure]:
    """Time of the command, including the start of Python."""
    results = folder / "results" / "d"
    lay_flow(results, presses)
    words = [
        sys.executable,
        "-m",
        "gelforge.commands.provenance",
        str(results),
        "--id",
        f"s{presses - 1:05d}",
    ]
    seconds = []
    for _ in range(5):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(words, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return [
        Figure(
            "provenance of one label", min(seconds), "<=", 0.3, "s", f"{presses} samples; processor time, best of 5"
        )
    ]


def time_wheel(folder: Path, presses: int) -> list[Figure]:
    """Build the wheel, install it with its dependencies into a clean environment, and predict an image there."""
    made, python = folder / "wheels", folder / "clean" / "bin" / "python"
    copied = folder / "sources"
    shutil.copytree("src", copied / "src", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(name, copied / name)
    install = ["-m", "pip", "install", "--quiet", "-c", str(Path("envs/requirements.lock").resolve())]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    picture, rest = (Path("data/demo", name).resolve() for name in ("images/demo-000000.png", "nocontact/mini_a.png"))

    def run(*words) -> float:
        started = time.perf_counter()
        subprocess.run([str(word) for word in words], check=True, cwd=folder, env=environment, capture_output=True)
        return time.perf_counter() - started

    run(sys.executable, "-m", "pip", "wheel", "--no-deps", "--wheel-dir", made, copied)
    run(sys.executable, "-m", "venv", folder / "clean")
    run(python, *install, next(made.glob("*.whl")))
    run(folder / "clean" / "bin" / "gelforge", "predict", picture, "--nocontact", rest, "--out", "read")
    imports = min(run(python, "-c", "from gelforge import Reader, Sensor") for _ in range(3))
    installed = len(list(folder.glob("clean/lib/*/site-packages/*.dist-info")))
    return [
        Figure("pictures that the wheel reads in a clean environment", len(read_csv(folder / "read" / "totals.csv")), "==", 1, "",
               f"{installed} packages installed, pip among them"),
        Figure("import of its reader", imports, "<=", 1.0, "s", "start of Python included, best of 3"),
    ]  # fmt: skip


def run_of_demo(results: Path) -> list[Figure]:
    """Cost of the last make demo, from its records, and of an estimate of it."""
    records = [read_json(path) for path in (results / "metrics").rglob("*.json")]
    seconds = max(r["started"] + r["seconds"] for r in records) - min(r["started"] for r in records)
    took = {"cpu": sum(r["cpu_seconds"] for r in records), "disk": bytes_of(results), "wall": seconds}
    cores = os.cpu_count() or 1
    costs = estimated(Layout(results), "24x32", "shipped", planned_rows(Layout(results)), cores)
    expected = {
        "cpu": sum(cost.cpu for cost in costs),
        "disk": sum(cost.disk for cost in costs),
        "wall": sum(cost.cpu / cost.cores for cost in costs),
    }
    note = "from the records of the run that made it; whole only if it ran from nothing"
    return [
        Figure("page of the demo", REPORT.stat().st_size / 1e6, "<=", 15.0, "MB"),
        Figure("make demo, wall time", seconds / 60, "<=", 5.0, "min", note),
        *(
            Figure(f"factor of the demo's estimate, {name}", max(expected[key] / took[key], took[key] / expected[key]), "<=", 1.5, "",
                   f"estimated {expected[key]:.3g} {unit}, took {took[key]:.3g}")
            for key, name, unit in (("cpu", "processor time", "s"), ("disk", "disk", "bytes"), ("wall", "time", "s"))
        ),
    ]  # fmt: skip


def time_demo(folder: Path, presses: int) -> list[Figure]:
    """Cost of the demo that was made here, which does not depend on `presses`."""
    if not REPORT.exists():
        raise BadInput(f"{REPORT}: absent; make demo, from nothing, then make benchmark-face")
    return [*run_of_demo(Path("results/demo")), demo_again()]


def demo_again() -> Figure:
    """Time that make needs to find that the demo is up to date; BadInput if it is not."""
    if make(Path.cwd(), "-q", "demo").returncode:
        raise BadInput("the demo is not as its files ask for; make demo, from nothing, then make benchmark-face")
    seconds = []
    for _ in range(5):
        started = time.perf_counter()
        make(Path.cwd(), "demo")
        seconds.append(time.perf_counter() - started)
    return Figure("make demo again, with nothing to do", min(seconds), "<=", 0.5, "s", "by the clock, best of 5")


PARTS = {"demo": time_demo, "page": time_page, "exports": time_exports, "provenance": time_provenance, "wheel": time_wheel,
         "fetch": time_fetch, "live": time_live}  # fmt: skip


@command(
    option("--parts", nargs="+", choices=list(PARTS), default=list(PARTS)),
    option("--presses", type=positive, default=PRESSES, help="fewer only to try it out"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    figures = []
    for name in args.parts:
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / name).mkdir()
            figures += PARTS[name](Path(folder) / name, args.presses)
    publish_figures(args.out, figures)


if __name__ == "__main__":
    main.exit()
