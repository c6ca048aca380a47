"""What `gelforge live` reads, told to a page or written to files."""

import signal
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.reporting.livepage import Hub, Reading, Recorder, Server, serve, write_lines


def readings(untouched, frames, pace_s: float = 0.0) -> Iterator[Reading]:
    """Read frames (h, w, 3) BGR, at most one every `pace_s`."""
    import cv2

    from gelforge.networks.use import predict_one

    started = time.perf_counter()
    for number, frame in enumerate(frames):
        time.sleep(max(0.0, started + number * pace_s - time.perf_counter()))
        now = time.perf_counter()
        image, forces, verdict = predict_one(untouched, cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))
        took = 1e3 * (time.perf_counter() - now)
        flag, half = bool(verdict["flag"]), verdict["half_width"]
        yield Reading(number, now - started, image, forces, flag, verdict["reason"], took, half, verdict["by_dots"])


def ended(name: str, camera: bool, count: int) -> str:
    """Why no more frames come."""
    if camera:
        return f"{name}: stopped after {count} frames; see that it is plugged in, and start again"
    return f"{name}: ended after {count} frames"


def tell(args: Namespace, untouched, frames, capture, name: str) -> None:
    """Serve the page until interrupted, or write files until the frames end."""
    import cv2

    with ExitStack() as stack:
        stack.callback(capture.release)
        if not args.web:
            count = write_files(readings(untouched, frames), args.jsonl, args.csv)
            limit = args.frames
            if args.camera is not None and (limit is None or count < limit):
                raise BadInput(ended(name, True, count))
            print(f"{count} frames read", file=sys.stderr)
            return
        hub, recorder = Hub(), Recorder(args.record)
        server = Server(args.host, args.port, hub, recorder)
        stack.callback(server.server_close)
        stack.callback(recorder.stop)
        server.start()
        stack.callback(server.shutdown)
        print(f"{server.url} shows {name}; Ctrl-C ends", flush=True)
        pace = 0.0 if args.camera is not None else 1.0 / (capture.get(cv2.CAP_PROP_FPS) or 25.0)
        over = stop_signal()
        try:
            count = serve(until(over, readings(untouched, frames, pace)), hub, recorder)
            said = ended(name, args.camera is not None, count)
        except BadInput as error:
            said = str(error)
        recorder.stop()
        hub.tell(hub.latest | {"ended": said})  # a page that is opened later still sees the last frame
        print(said, file=sys.stderr, flush=True)
        over.wait()  # the page can still be looked at and recordings replayed


def stop_signal() -> threading.Event:
    """An event that Ctrl-C and a request to end set."""
    over = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: over.set())
    return over


def until(over: threading.Event, items) -> Iterator:
    """Items until the event is set."""
    for item in items:
        if over.is_set():
            return
        yield item


def write_files(found, jsonl: Path | None, table: Path | None) -> int:
    """Write readings to the files named; BadInput where one cannot be written."""
    try:
        with text_file(jsonl) as lines, text_file(table) as rows:
            return write_lines(found, lines, rows)
    except OSError as error:
        raise BadInput(
            f"{error.filename or jsonl or table}: cannot be written ({error.strerror}); free space or name another file"
        ) from error


@contextmanager
def text_file(path: Path | None):
    """A text stream to a file, to standard output for -, or none."""
    if path is None:
        yield None
    elif str(path) == "-":
        yield sys.stdout
    else:
        with path.open("w", encoding="utf-8", newline="") as stream:
            yield stream
