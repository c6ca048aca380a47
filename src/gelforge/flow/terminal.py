"""The terminal that make was started from, and the one line that a run keeps on it."""

import os
import shutil
from contextlib import suppress


def terminal() -> str | None:
    """The device of the terminal make writes to; none where it writes to a file or a pipe."""
    # make names it here, or says `true` where it cannot tell.
    name = os.environ.get("MAKE_TERMERR", "")
    return name if name.startswith("/dev/") else None


def show_line(device: str, text: str = "") -> None:
    """Put a text in place of the line that is shown; nothing takes the line away."""
    width = shutil.get_terminal_size().columns - 1
    # The terminal may have been closed since.
    with suppress(OSError), open(device, "w", encoding="utf-8", errors="replace") as shown:
        shown.write("\r\033[K" + "".join(c for c in text if c.isprintable())[:width])
