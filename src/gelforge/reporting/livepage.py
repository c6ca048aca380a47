"""Readings of a running sensor for others: a local web page, JSON lines, CSV, recordings that can be replayed."""

import contextlib
import csv
import json
import os
import re
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TextIO

import numpy as np

from gelforge.errors import BadInput
from gelforge.records.totals import TOTAL_COLUMNS, total_columns
from gelforge.reporting.parts import jpeg, pack

WEB = Path(__file__).parent / "web"
COLUMNS = ("frame", "time_s", *TOTAL_COLUMNS, "flag", "reason", "ms")
NAME = re.compile(r"[0-9]{8}-[0-9]{6}(-[0-9]+)?")
LOCAL = ("127.0.0.1", "localhost")
QUIET_S = 5.0  # without a reading a page is sent a comment, so that one that left is noticed


@dataclass(frozen=True)
class Reading:
    """One frame: image (h, w, 3) uint8 RGB, forces (3, rows, cols) N per cell, how unlike training it is, and its cost.

    half_width: (3,) N, half of the 90 % interval of the totals; by_dots: (3,) N, what the dots tell by themselves; none
    where it is not known.
    """

    frame: int
    time_s: float
    image: np.ndarray
    forces: np.ndarray
    flag: bool
    reason: str
    ms: float
    half_width: np.ndarray | None = None
    by_dots: np.ndarray | None = None

    def row(self) -> dict:
        """Totals and judgement as one row."""
        return {
            "frame": self.frame, "time_s": round(self.time_s, 4),
            **total_columns(self.forces, self.half_width, self.by_dots),
            "flag": bool(self.flag), "reason": self.reason, "ms": round(self.ms, 2),
        }  # fmt: skip

    def event(self) -> dict:
        """All that the page shows of it."""
        half = None if self.half_width is None else [round(float(v), 4) for v in self.half_width]
        return self.row() | {"half_width": half, "grid": list(self.forces.shape[1:]), "image": jpeg(self.image),
                             "forces": pack({"forces": self.forces})}  # fmt: skip


class Hub:
    """The latest event, which any number of pages wait for; a page that is slow misses some."""

    def __init__(self):
        self.changed = threading.Condition()
        self.number, self.latest = 0, {}

    def tell(self, event: dict) -> None:
        """Give an event to all who wait."""
        with self.changed:
            self.number, self.latest = self.number + 1, event
            self.changed.notify_all()

    def after(self, number: int, patience: float) -> tuple[int, dict | None]:
        """The event after the one of that number, or none if none came in time."""
        with self.changed:
            self.changed.wait_for(lambda: self.number > number, patience)
            return (self.number, self.latest) if self.number > number else (number, None)


class Recorder:
    """Keeps events as JSON lines, one file a recording: whole when it is stopped, absent when it fails."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.lock = threading.Lock()
        self.stream: TextIO | None = None
        self.name, self.count = "", 0

    @property
    def on(self) -> bool:
        return self.stream is not None

    def part(self) -> Path:
        return self.folder / f".{self.name}.part"

    def start(self) -> str:
        """Begin a recording; return its name."""
        with self.lock:
            if self.on:
                return self.name
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
                stem = time.strftime("%Y%m%d-%H%M%S")
                taken = (f"{stem}-{k}" if k else stem for k in range(1000))
                self.name = next(name for name in taken if not (self.folder / f"{name}.jsonl").exists())
                self.count = 0
                self.stream = self.part().open("w", encoding="utf-8")
            except OSError as error:
                raise BadInput(
                    f"{self.folder}: nothing can be recorded there ({error.strerror}); name another --record"
                ) from error
            return self.name

    def add(self, event: dict) -> None:
        """Record an event, if a recording runs; a full disk ends and removes it with BadInput."""
        with self.lock:
            if self.stream is None:
                return
            try:
                self.stream.write(json.dumps(event) + "\n")
                self.stream.flush()
                self.count += 1
            except OSError as error:
                self.drop()
                raise BadInput(
                    f"{self.folder}: the recording stopped ({error.strerror}) and was removed; free space"
                ) from error

    def drop(self) -> None:
        """Give up what was recorded so far."""
        stream, self.stream = self.stream, None
        try:
            if stream is not None:
                stream.close()
        except OSError:
            pass  # what could not be written is not wanted
        self.part().unlink(missing_ok=True)

    def stop(self) -> int:
        """End a recording and publish it; return how many readings it has. One without any is not kept."""
        with self.lock:
            if self.stream is None:
                return 0
            if not self.count:
                self.drop()
                return 0
            self.stream.close()
            self.stream = None
            os.replace(self.part(), self.folder / f"{self.name}.jsonl")
            return self.count

    def names(self) -> list[str]:
        """Recordings there are, the latest first."""
        return sorted((path.stem for path in self.folder.glob("*.jsonl") if NAME.fullmatch(path.stem)), reverse=True)

    def read(self, name: str) -> Iterator[dict]:
        """Events of a recording; BadInput for a name that is none."""
        if not NAME.fullmatch(name) or name not in self.names():
            raise BadInput(f"recording {name!r}: there is none of that name in {self.folder}")
        return _events(self.folder / f"{name}.jsonl")


def _events(path: Path) -> Iterator[dict]:
    """Events of a recording, read as they are asked for; what is none is left out."""
    with path.open(encoding="utf-8") as stream:
        for line in stream:
            with contextlib.suppress(ValueError):
                event = json.loads(line)
                if isinstance(event, dict) and isinstance(event.get("time_s"), int | float):
                    yield event


class Server(ThreadingHTTPServer):
    """The page of a running sensor; `start` serves it in threads of its own."""

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, host: str, port: int, hub: Hub, recorder: Recorder):
        self.hub, self.recorder, self.local = hub, recorder, host in LOCAL
        try:
            super().__init__((host, port), Handler)
        except (OSError, OverflowError) as error:  # the latter of a number that no port has
            why = getattr(error, "strerror", None) or error
            raise BadInput(f"port {port} of {host}: cannot be served ({why}); name another with --port") from error

    @property
    def url(self) -> str:
        host, port = self.server_address[:2]
        return f"http://{host if isinstance(host, str) else host.decode()}:{port}/"

    def start(self) -> None:
        """Serve until `shutdown`."""
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def handle_error(self, request, client_address) -> None:
        """A browser that left is no error of ours; others are told."""
        import sys

        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class Handler(BaseHTTPRequestHandler):
    """GET /: the page; /events: readings as they come; /recordings; /replay/NAME. POST /record, /stop."""

    server: Server

    def do_GET(self) -> None:
        if not self.allowed():
            return
        if self.path == "/":
            self.answer(page().encode(), "text/html; charset=utf-8")
        elif self.path == "/events":
            self.stream(self.live())
        elif self.path == "/recordings":
            recorder = self.server.recorder
            self.answer_json({"names": recorder.names(), "on": recorder.on})
        elif self.path.startswith("/replay/"):
            self.replay(self.path.removeprefix("/replay/"))
        else:
            self.send_error(404)

    def do_POST(self) -> None:
        # A foreign page can send a plain POST, but no header of this name without being asked for it first.
        if not self.allowed():
            return
        if self.headers.get("X-Gelforge") != "1":
            self.send_error(403)
            return
        try:
            if self.path == "/record":
                self.answer_json({"name": self.server.recorder.start()})
            elif self.path == "/stop":
                self.answer_json({"count": self.server.recorder.stop()})
            else:
                self.send_error(404)
        except BadInput as error:
            self.answer_json({"error": str(error)})

    def allowed(self) -> bool:
        """Whether the request names this machine: a foreign name that leads here does not (DNS rebinding)."""
        host = (self.headers.get("Host") or "").rsplit(":", 1)[0]
        if self.server.local and host not in LOCAL:
            self.send_error(403)
            return False
        return True

    def answer(self, content: bytes, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)

    def answer_json(self, value) -> None:
        self.answer(json.dumps(value).encode(), "application/json")

    def stream(self, events: Iterable[dict | None]) -> None:
        """Send events until the browser leaves."""
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        try:
            for event in events:
                text = ": still here\n\n" if event is None else f"data: {json.dumps(event)}\n\n"
                self.wfile.write(text.encode())
                self.wfile.flush()
        except ConnectionError:
            self.close_connection = True

    def live(self) -> Iterator[dict | None]:
        number = 0
        while True:
            number, event = self.server.hub.after(number, QUIET_S)
            yield event

    def replay(self, name: str) -> None:
        try:
            events = self.server.recorder.read(name)
        except BadInput as error:
            self.answer_json({"error": str(error)})
            return
        self.stream(paced(events))

    def log_message(self, *_) -> None:
        """Requests are not told on the terminal."""


def paced(events: Iterable[dict]) -> Iterator[dict]:
    """Recorded events with the pauses they had."""
    before, count = None, 0
    for event in events:
        if before is not None:
            time.sleep(min(max(event["time_s"] - before, 0.0), 1.0))
        before = event["time_s"]
        count += 1
        yield event
    yield {"ended": f"the recording ended after {count} readings"}


def page() -> str:
    """The page, one file."""
    parts = {name: (WEB / name).read_text(encoding="utf-8") for name in ("live.html", "look.css", "live.js")}
    return parts["live.html"].replace("/*look*/", parts["look.css"]).replace("/*script*/", parts["live.js"])


def write_lines(readings: Iterable[Reading], lines, table) -> int:
    """Write readings as JSON lines and as CSV to open text streams, either may be none; return how many."""
    writer = csv.DictWriter(table, COLUMNS, lineterminator="\n") if table else None
    if writer:
        writer.writeheader()
    count = 0
    for reading in readings:
        row = reading.row()
        if lines:
            lines.write(json.dumps(row) + "\n")
            lines.flush()
        if writer:
            writer.writerow(row)
            table.flush()
        count += 1
    return count


def serve(readings: Iterable[Reading], hub: Hub, recorder: Recorder) -> int:
    """Tell readings to a hub and the recorder until they end; return how many."""
    count = 0
    for reading in readings:
        event = reading.event()
        try:
            recorder.add(event)
        except BadInput as error:
            event = event | {"trouble": str(error)}
        hub.tell(event | {"recording": recorder.on})
        count += 1
    return count
