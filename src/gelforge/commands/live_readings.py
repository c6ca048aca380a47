"""Predictions of `gelforge live`, sent to a page or written to files."""

import signal
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.live.reading import Reading, write_lines
from gelforge.live.recording import Recorder
from gelforge.live.server import Hub, Server, serve
from gelforge.records.film import Film, Frame

LONGEST_LINE = 2**20  # bytes, of a reading that is written


def readings(predictor, frames: Iterable[Frame], paced: bool = False) -> Iterator[Reading]:
    """Read frames; paced: not before their time, as a film is shown."""
    import cv2

    started = None
    for frame in frames:
        now = time.perf_counter()
        started = now - frame.time_s if started is None else started
        if paced:
            time.sleep(max(0.0, started + frame.time_s - now))
        now = time.perf_counter()
        found = predictor.predict(cv2.cvtColor(frame.image, cv2.COLOR_BGR2RGB))
        took = 1e3 * (time.perf_counter() - now)
        yield Reading(frame.number, frame.time_s, found, took)


def lost(name: str, count: int) -> str:
    """What is said of a camera that gives no more frames, unasked."""
    return f"{name}: stopped after {count} frames; see that it is plugged in, and start again"


def is_lost(args: Namespace, over: threading.Event, film: Film) -> bool:
    """Whether a camera gave no more frames although nobody asked it to end; a film may end."""
    asked = over.is_set() or (args.frames is not None and film.taken >= args.frames)
    return film.camera and not asked


def keep_readings(args: Namespace, predictor, frames, film: Film, name: str, over: threading.Event) -> None:
    """Write readings to files until the frames end or `over` is set."""
    found = readings(predictor, until(over, frames))
    count, flagged = write_files(found, args.jsonl, args.csv)
    if is_lost(args, over, film):
        raise BadInput(lost(name, film.taken))
    print(f"{count} frames read; {flagged} flagged", file=sys.stderr)


def show_page(args: Namespace, predictor, frames, film: Film, name: str, over: threading.Event) -> None:
    """Serve the page until `over` is set."""
    with ExitStack() as stack:
        hub, recorder = Hub(), Recorder(args.record or Path("recordings"))
        server = Server(args.host, args.port, hub, recorder)
        stack.callback(server.server_close)
        stack.callback(recorder.stop)
        server.start()
        stack.callback(server.shutdown)
        print(f"{server.url} shows {name}; Ctrl-C ends", flush=True)
        try:
            count = serve(until(over, readings(predictor, frames, paced=not film.camera)), hub, recorder)
            said = lost(name, film.taken) if is_lost(args, over, film) else f"{name}: ended after {count} frames"
        except BadInput as error:
            said = str(error)
        with suppress(BadInput):  # the recorder keeps it, and pages see its state
            recorder.stop()
        hub.send(hub.latest | {"ended": said})  # a page that is opened later still sees the last frame
        print(*filter(None, (said, recorder.trouble)), sep="\n", file=sys.stderr, flush=True)
        over.wait()  # the page can still be looked at and recordings replayed


@contextmanager
def stopping() -> Iterator[threading.Event]:
    """An event that Ctrl-C and a request to end set, so that what was read until then is kept."""
    over = threading.Event()
    before = {number: signal.signal(number, lambda *_: over.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield over
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def until(over: threading.Event, items) -> Iterator:
    """Items until the event is set."""
    for item in items:
        if over.is_set():
            return
        yield item


def write_files(found, jsonl: Path | None, table: Path | None) -> tuple[int, int]:
    """Write readings to the files named, and return what `write_lines` does.

    BadInput where a file cannot be written, which then ends in its last whole line.
    """
    try:
        with text_file(jsonl) as lines, text_file(table) as rows:
            return write_lines(found, lines, rows)
    except BrokenPipeError:
        raise  # whoever reads standard output has enough
    except OSError as error:
        raise BadInput(
            f"{error.filename or jsonl or table}: cannot be written ({error.strerror}); free space or name another file"
        ) from error


def make_folder_of(path: Path) -> None:
    """Make the folder that a file goes into; BadInput where it cannot be made."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{path}: its folder cannot be made ({error.strerror}); name another file") from error


@contextmanager
def text_file(path: Path | None):
    """A text stream to a file, to standard output for -, or none; a file that cannot be written on ends in a whole line."""
    if path is None:
        yield None
        return
    if str(path) == "-":
        yield sys.stdout
        return
    make_folder_of(path)
    stream = path.open("w", encoding="utf-8", newline="")
    try:
        yield stream
        stream.close()
    except OSError:
        with suppress(OSError):
            stream.close()
        cut_to_whole_lines(path)
        raise
    finally:
        with suppress(OSError):
            stream.close()


def cut_to_whole_lines(path: Path) -> None:
    """Take away what was begun of a line, from a file; nothing else has lines that can be taken back."""
    if path.is_file():
        with path.open("r+b") as stream:
            start = max(0, path.stat().st_size - LONGEST_LINE)
            stream.seek(start)
            stream.truncate(start + stream.read().rfind(b"\n") + 1)
