"""The whole suite of tests again and again: in random order, with other seeds, on other code paths, with two threads.

A test that holds on every machine holds in each of these runs. Every run is a process of its own; what it gave is kept
beside the JSON and taken from there while code and tests stay the same, so an interrupted benchmark goes on.
"""

import hashlib
import json
import os
import subprocess
import sys
from argparse import Namespace
from pathlib import Path
from xml.etree import ElementTree

from gelforge.errors import BadInput
from gelforge.flow.files import read_json, write_json
from gelforge.flow.main import command, option
from tests.benchmarks.figures import Figure, publish_figures
from tests.benchmarks.machines import CASES, environment

RUNS = 20
ROOT = Path(__file__).parents[2]


def digest_of_tests() -> str:
    """Digest of what the outcome of a test may depend on: code, tests, rules, parameters and the packages' versions."""
    places = ("src", "tests", "rules", "workflow", "envs")
    files = [path for place in places for path in sorted((ROOT / place).rglob("*")) if path.is_file()]
    digest = hashlib.sha256()
    for path in [ROOT / "Makefile", ROOT / "pyproject.toml", *files]:
        if "__pycache__" not in path.parts and ".egg-info" not in str(path):
            digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def outcome(report: Path) -> dict:
    """How many tests passed and were skipped, which failed, and seconds, of a report in JUnit's form."""
    suite = next(ElementTree.parse(report).getroot().iter("testsuite"))
    failed = [
        f"{case.get('classname')}::{case.get('name')}"
        for case in suite.iter("testcase")
        if case.find("failure") is not None or case.find("error") is not None
    ]
    total, skipped = int(suite.get("tests", 0)), int(suite.get("skipped", 0))
    return {"passed": total - skipped - len(failed), "skipped": skipped, "failed": failed,
            "seconds": float(suite.get("time", 0))}  # fmt: skip


def run_once(number: int, tests: list[str], folder: Path, jobs: int) -> dict:
    """Outcome of the suite in the order of seed `number`, on one of the machines' cases; kept in the folder."""
    case = list(CASES)[number % len(CASES)]
    content = json.dumps([digest_of_tests(), tests, number, case])
    kept = folder / f"{number:03d}-{hashlib.sha256(content.encode()).hexdigest()[:16]}.json"
    if not kept.exists():
        folder.mkdir(parents=True, exist_ok=True)
        report, log = kept.with_suffix(".xml"), kept.with_suffix(".log")
        asked = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-n",
            str(jobs),
            "--dist",
            "loadfile",
            "--max-worker-restart=0",
            "-p",
            "no:cacheprovider",
        ]
        asked += [
            "-p",
            "randomly",
            f"--randomly-seed={number}",
            f"--hypothesis-seed={number}",
            f"--junitxml={report}",
        ]
        with log.open("w") as out:
            ended = subprocess.run(
                [*asked, *tests], cwd=ROOT, stdout=out, stderr=out, env=environment(case, folder), check=False
            )
        if ended.returncode not in (0, 1):
            raise BadInput(
                f"the suite did not run to its end (exit code {ended.returncode}); what it said is in {log}"
            )
        write_json(kept, {"case": case, "seed": number, **outcome(report)})
    return read_json(kept)


def figures_of(runs: list[dict]) -> list[Figure]:
    """What failed in any run, and in how many cases all runs passed."""
    failed = sorted({name for run in runs for name in run["failed"]})
    cases = {run["case"] for run in runs}
    return [
        Figure("runs of the suite, each in another order with other seeds", len(runs), ">=", RUNS),
        Figure("machines among them", len(cases), ">=", len(CASES), "", ", ".join(sorted(cases))),
        Figure("tests that failed in any of them", len(failed), "<=", 0, "", ", ".join(failed)),
        Figure("tests passed in the run with the fewest", min(run["passed"] for run in runs), ">=", 1),
    ]


@command(
    option("--runs", type=int, default=RUNS, help="how many"),
    option("--jobs", type=int, default=os.cpu_count(), help="tests at a time"),
    option("--tests", nargs="+", default=["tests"], help="files or folders of tests"),
    option("--out", type=Path, help="results/benchmarks/suites.json"),
)
def main(args: Namespace) -> None:
    runs = []
    for number in range(args.runs):
        runs.append(run_once(number, args.tests, args.out.resolve().parent / "suites", args.jobs))
        print(f"{number}: {runs[-1]}", flush=True)
    publish_figures(args.out, figures_of(runs))


if __name__ == "__main__":
    main.exit()
