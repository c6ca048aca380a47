"""What tests share: where the reference data lie, and skipping where they do not."""

import os
import signal
import sys
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.support.sandbox import OF_MAKE

# How long an example takes is a matter of the machine's load; no law is broken by it.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")

ROOT = Path(__file__).resolve().parent.parent

# What a person's shell may hold, and what would make other tests of these, here and in every process that they start:
# make's variables of the project, another checkout's code, other languages of messages, a proxy for this very machine.
LEFT_OVER = (
    *OF_MAKE, "DATASET", "RES", "MODEL", "ID", "EXECUTOR", "SLURM_PROFILE", "CHARTED", "GELFORGE_SOLVES",
    "COLUMNS",
    "http_proxy", "https_proxy", "all_proxy", "HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY",
)  # fmt: skip
for name in LEFT_OVER:
    os.environ.pop(name, None)
# Python keeps what it compiled: else every worker, and every stage that a test starts, compiles all of it again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT / "src"), os.environ.get("PYTHONPATH")]))
os.environ["LC_ALL"] = "C.UTF-8"
# Training is held to the last bit, which graphics cards do not keep; one thread sums in one order.
os.environ["CUDA_VISIBLE_DEVICES"] = ""
for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

REFERENCE = Path(os.environ.get("GELFORGE_REFERENCE", ROOT.parent / "shared" / "reference"))


# What --strict-tools asks for: words of the reasons with which tests skip where a tool or the reference data are missing.
TOOLS = ("CalculiX", "Slurm", "chromium", "getfem", "reference data")


def pytest_addoption(parser):
    parser.addoption(
        "--strict-tools",
        action="store_true",
        help=f"fail, not skip, where one of these is missing: {', '.join(TOOLS)}",
    )
    parser.addoption(
        "--longest",
        type=float,
        default=0.0,
        help="processor seconds above which a test without the mark slow fails; 0: none",
    )


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item):
    """Under --strict-tools a skip for want of a tool is a failure with the same reason."""
    report = (yield).get_result()
    reason = report.longrepr[2] if report.skipped and isinstance(report.longrepr, tuple) else ""
    if item.config.getoption("--strict-tools") and any(tool in reason for tool in TOOLS):
        report.outcome, report.longrepr = "failed", f"{reason} (--strict-tools)"


# Processor seconds that counting to COUNT takes on a processor for which --longest is meant.
COUNT, COUNTED = 2_000_000, 0.04
SLOW = {"slow", "slurm"}


def processor_seconds() -> float:
    """User and system time of this process and of the children that it waited for."""
    return sum(os.times()[:4])


def slower() -> float:
    """How many times as long as COUNTED this processor counts to COUNT, 1 at least."""
    times = []
    for _ in range(5):
        began = time.process_time()
        sum(range(COUNT))
        times.append(time.process_time() - began)
    return max(1.0, min(times) / COUNTED)


def compiled_since(moment: float) -> bool:
    """Whether numba has written compiled code since then, as in a fresh clone: a test is not to blame for that."""
    return any(path.stat().st_mtime >= moment for path in (ROOT / "src").rglob("*.nbi"))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """With --longest a test over it that is not marked as slow fails: `make test` stays short."""
    longest = item.config.getoption("--longest")
    began, moment = processor_seconds(), time.time()
    result = yield
    spent = processor_seconds() - began
    marked = SLOW & {mark.name for mark in item.iter_markers()}
    if (
        longest
        and spent > longest
        and not marked
        and spent > (limit := longest * slower())
        and not compiled_since(moment)
    ):
        pytest.fail(
            f"took {spent:.1f} s of processor time, at most {limit:.1f} s are allowed: test the same law for less, or mark it"
            " as slow",
            pytrace=False,
        )
    return result


@pytest.fixture(autouse=True, scope="module")
def no_meshes_of_others():
    """A stage that a test of another module ran in this process left its folder of meshes; fixtures begin without it."""
    os.environ.pop("GELFORGE_MESHES", None)


@pytest.fixture(autouse=True)
def in_project(monkeypatch):
    """Every test starts in the project's folder, wherever the one before it went, and with the project's gels and no folder of meshes."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("GELFORGE_GELS", str(ROOT / "workflow" / "gels.toml"))
    monkeypatch.delenv("GELFORGE_MESHES", raising=False)


@pytest.fixture(scope="session")
def answers_to_signals() -> dict:
    """What this process did on signals when it was last looked at."""
    return process_signals()


@pytest.fixture(autouse=True)
def signals_kept(answers_to_signals):
    """No test leaves the process with other answers to signals: a later one would die of them without a word."""
    yield
    before, now = dict(answers_to_signals), process_signals()
    answers_to_signals.update(now)
    assert now == before, "a library changed what this process does on signals: run it in a process of its own"


def process_signals() -> dict[str, str]:
    """Which of signals 1 to 31 this process ignores and catches, as Linux reports; native code shows here, too.

    But for the alarm, which is of the time limit of tests.
    """
    seen = 0x7FFFFFFF & ~(1 << signal.SIGALRM - 1)
    status = Path("/proc/self/status").read_text().splitlines()
    words = dict(line.split(":\t") for line in status if line.startswith(("SigIgn", "SigCgt")))
    return {name: f"{int(word, 16) & seen:08x}" for name, word in words.items()}


@pytest.fixture(scope="session")
def root() -> Path:
    """The project's folder."""
    return ROOT


@pytest.fixture(scope="session")
def reference() -> Path:
    """The folder of real measurements; tests that need it are skipped where it is absent."""
    if not REFERENCE.is_dir():
        pytest.skip(f"reference data absent: {REFERENCE} (set GELFORGE_REFERENCE)")
    return REFERENCE


@pytest.fixture(scope="session")
def _browser():
    """The browser that all tests of a process share; it takes seconds to start."""
    from tests.support.browser import browser

    with browser() as driver:
        yield driver


@pytest.fixture
def chromium(_browser):
    """A browser of 1280 pixels without a page; the test's page is closed behind it."""
    from tests.support.browser import console_errors, resize

    resize(_browser, 1280)
    yield _browser
    _browser.get("about:blank")
    console_errors(_browser)


@pytest.fixture(scope="session")
def ccx() -> str:
    """The CalculiX program; tests that need it are skipped where it is absent."""
    from gelforge.mechanics.ccx.program import ccx_program

    found = ccx_program()
    if not found:
        pytest.skip("CalculiX (ccx) is not on PATH; make setup installs it where it may")
    return found


# Constants that say how much is read, written or cut at a time: results do not depend on them.
BLOCKS = (
    "gelforge.learning.data.CHUNK", "gelforge.labelling.clip.PAIRS_AT_ONCE", "gelforge.formats.export.hdf5.BLOCK",
    "gelforge.formats.export.lerobot.BLOCK", "gelforge.formats.export.lerobot.FILE_BYTES",
    "gelforge.formats.export.lerobot.CHUNK_FILES", "gelforge.records.rowfile.LET_GO", "gelforge.stages.images.CHUNK",
    "gelforge.stages.labels.BLOCK_BYTES",
)  # fmt: skip


@pytest.fixture(params=[1, 3, None], ids=["blocks of one", "blocks of three", "one block"])
def block(request, monkeypatch) -> None:
    """What is done in blocks is done one by one, in threes, or all at once, in this process."""
    for name in BLOCKS if request.param else ():
        monkeypatch.setattr(name, request.param)
