"""The modes of a camera, and the recommended one: `gelforge camera [NUMBER]`.

Without a number it lists the cameras that can be opened. With a number it requests each common size; the camera's driver
sets the nearest size that it has, and a few frames give the frame rate. `gelforge live --camera NUMBER --mode WxH` uses a mode.
"""

import argparse
import re
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput
from gelforge.flow.cli import command, from_zero, option
from gelforge.reading.frame import same_shape
from gelforge.records.film import asked_for, open_source

# Image sizes of a GelSight Mini (3280 x 2464, a half and a quarter of it) and of common USB cameras.
SIZES = ((320, 240), (640, 480), (800, 600), (820, 616), (1280, 720), (1640, 1232), (1920, 1080), (3280, 2464))
LEAST = (320, 240)  # px, the size that networks read
FAST = 20.0  # frames a second, enough for pressing by hand
TIMED = 10  # frames over which the rate of a mode is measured


def camera_number(text: str) -> int:
    """A camera's number, as the `type` of an option: a number, a device file such as /dev/video2, or a link to one.

    Numbers depend on the order in which cameras are plugged in; links in /dev/v4l/by-id/ do not.
    """
    device = re.fullmatch(r"video(\d+)", Path(text).resolve().name) if "/" in text else None
    return from_zero(device[1] if device else text)


def camera_mode(text: str) -> tuple[int, int]:
    """A size such as 640x480 as (width, height)."""
    found = re.fullmatch(r"([1-9][0-9]{1,4})x([1-9][0-9]{1,4})", text)
    if not found:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size; give width and height such as 640x480")
    return int(found[1]), int(found[2])


def modes_of(source: Any) -> dict[tuple[int, int], float]:
    """Modes (width, height) of an open camera and their frames a second, 0 for a mode without frames."""
    found: dict[tuple[int, int], float] = {}
    for size in SIZES:
        mode = asked_for(source, size)
        if mode not in found:
            found[mode] = _rate(source)
    return found


def _rate(source: Any) -> float:
    if not source.read()[0]:
        return 0.0
    started = time.perf_counter()
    read = sum(source.read()[0] for _ in range(TIMED))
    return read / max(time.perf_counter() - started, 1e-9)


def best_mode(modes: dict[tuple[int, int], float]) -> tuple[int, int] | None:
    """The smallest mode of LEAST px and FAST frames a second or more, 4:3 if possible; else the fastest, or None."""
    usable = {mode: rate for mode, rate in modes.items() if rate > 0 and mode[0] >= LEAST[0] and mode[1] >= LEAST[1]}
    fast = [mode for mode, rate in usable.items() if rate >= FAST]
    if fast:
        return min(fast, key=lambda mode: (not same_shape(mode[::-1], LEAST[::-1]), mode[0] * mode[1]))
    return max(usable, key=lambda mode: usable[mode], default=None)


def cameras() -> list[int]:
    """Numbers of the existing video devices."""
    names = (path.name.removeprefix("video") for path in Path("/dev").glob("video*"))
    return sorted(int(name) for name in names if name.isdigit())


@command(option("number", type=camera_number, nargs="?", help="number of the camera", default=None))
def main(args: Namespace) -> None:
    there = cameras()
    if args.number is None:
        if not there:
            raise BadInput("no camera found (/dev/video*); plug it in, or check that its cable carries data")
        print(f"cameras: {', '.join(map(str, there))}; `gelforge camera NUMBER` lists the modes of one")
        return
    with open_source(None, args.number) as (source, _):
        modes = modes_of(source)
    for (width, height), rate in sorted(modes.items()):
        print(f"{width:5d} x {height:<5d} {f'{rate:5.1f} frames a second' if rate else 'gives no frame'}")
    best = best_mode(modes)
    if best is None:
        raise BadInput(
            f"camera {args.number}: no mode gives frames of {LEAST[0]} x {LEAST[1]} and more; try another USB port"
        )
    print(f"take: gelforge live --camera {args.number} --mode {best[0]}x{best[1]}")


if __name__ == "__main__":
    main.exit()
