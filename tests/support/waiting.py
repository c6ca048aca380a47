"""Waiting for a process on a machine that may be busy, and interrupting it whatever started the tests."""

import signal
import subprocess
import time
from collections.abc import Callable

HANG = 600.0  # seconds after which a process counts as hung, far more than it needs on a loaded machine


def heed_interrupts() -> None:
    """For Popen's preexec_fn: heed interrupts, which the tests' parent may ignore, as nohup and the shell's & do."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def wait_until(condition: Callable[[], object], seconds: float = HANG, of: subprocess.Popen | None = None) -> None:
    """Wait until the condition is true; AssertionError if the process `of` ends before that, or time runs out."""
    until = time.monotonic() + seconds
    while not condition():
        if of is not None and of.poll() is not None:
            assert condition(), f"the process ended ({of.returncode}) before it came true"
            return
        assert time.monotonic() < until, f"{condition} not true within {seconds} s"
        time.sleep(0.02)
