"""One thing given to one part of the product, in a process and a folder of its own, and whether that part holds."""

import os
import resource
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from gelforge.errors import GelforgeError
from gelforge.sweeps.isolate import isolated

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 60.0
MEMORY = 8 * 2**30  # of address space that a case may take
CANARY = "pwned"  # what foreign code would leave behind


@dataclass(frozen=True)
class Case:
    """One thing to try. run(folder) returns what was answered; expected: that answer of clean input, None: a refusal.

    strict: nothing but the expected answer will do, as where bad input must not stop the good.
    """

    area: str
    name: str
    run: Callable[[Path], object]
    expected: object = None
    strict: bool = False


# -- judging


def attempt(case: Case, folder: Path) -> dict:
    """Run a case in a process of its own; what came of it."""

    def child() -> dict:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        os.chdir(folder)
        try:
            return {"status": "answered", "answer": case.run(folder)}
        except GelforgeError as error:
            return {"status": "refused", "reason": str(error)}
        except SystemExit as error:
            return {"status": "refused", "reason": str(error)}

    return isolated(child, LIMIT_S, get_context("fork"))  # what is tried are closures, which pickle does not take


def verdict(case: Case, found: dict, strangers: list[str]) -> str:
    """Why a case does not hold; empty where it does."""
    if strangers:
        return f"left {', '.join(strangers)}"
    if found["status"] == "refused":
        reason = found["reason"]
        if case.strict:
            return f"refused, though it is good: {reason[:200]}"
        if not reason.strip() or len(reason) > 2000 or any(not (c.isprintable() or c == "\n") for c in reason):
            return f"refused, but not in a sentence: {reason[:200]!r}"
        return ""
    if found["status"] != "answered":
        return f"{found['status']}: {found.get('reason', '')[:300]}"
    if case.expected is None:
        return f"accepted: {str(found['answer'])[:200]}"
    return "" if found["answer"] == case.expected else f"another answer: {str(found['answer'])[:200]}"


def judge(case: Case, work: Path) -> dict:
    """Try one case; a record of it."""
    outer = Path(tempfile.mkdtemp(dir=work))
    folder = outer / "inside" / "deep"
    folder.mkdir(parents=True)
    try:
        found = attempt(case, folder)
        beside = [
            p.name for place in (outer, outer / "inside") for p in place.iterdir() if p.name not in ("inside", "deep")
        ]
        strangers = beside + [str(p) for p in folder.rglob(CANARY)]
        return {"area": case.area, "case": case.name, "fault": verdict(case, found, strangers)}
    finally:
        shutil.rmtree(outer, ignore_errors=True)
