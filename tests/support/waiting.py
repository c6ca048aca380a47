"""Waiting for another process, however busy the machine is, and interrupting it, whatever started the tests."""

import signal
import subprocess
import time
from collections.abc import Callable

HANG = 600.0  # seconds after which a process is taken to hang: no loaded machine may come near it


def heed_interrupts() -> None:
    """For Popen's preexec_fn: what started the tests may ignore interrupts, as nohup and the shell's & do."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def wait_until(condition: Callable[[], object], seconds: float = HANG, of: subprocess.Popen | None = None) -> None:
    """Wait until the condition is true; AssertionError if the process it is expected of ends before, or time runs out.

    The time is that of a hang: a loaded machine must not come near it.
    """
    until = time.monotonic() + seconds
    while not condition():
        if of is not None and of.poll() is not None:
            assert condition(), f"the process ended ({of.returncode}) before it came true"
            return
        assert time.monotonic() < until, f"{condition} not true within {seconds} s"
        time.sleep(0.02)
