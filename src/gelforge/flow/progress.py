"""Progress of long work: a bar when a person watches, plain lines otherwise."""

import sys
import time
from collections.abc import Collection, Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")

EVERY_S = 10.0  # between two lines of a log


def progress(items: Iterable[Item], what: str, total: int | None = None) -> Iterator[Item]:
    """Yield `items`, showing how far the work named `what` has come.

    On a terminal this is tqdm's bar. Elsewhere it prints a line with the count, the rate and
    the time left at most every EVERY_S seconds, which reads well in a log file.
    """
    if total is None:
        if not isinstance(items, Collection):
            raise TypeError(f"progress of {what}: say how many there are (total), they cannot be counted")
        total = len(items)
    if sys.stderr.isatty():
        from tqdm import tqdm

        yield from tqdm(items, desc=what, total=total, dynamic_ncols=True)
        return
    start = last = time.monotonic()
    for done, item in enumerate(items, 1):
        yield item
        now = time.monotonic()
        if now - last >= EVERY_S or done == total:
            last = now
            rate = done / max(now - start, 1e-9)
            left = (total - done) / rate
            print(f"{what}: {done}/{total}, {rate:.2f} a second, {left:.0f} s left", file=sys.stderr, flush=True)
