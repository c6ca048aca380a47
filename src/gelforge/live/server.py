"""The web page of a running sensor, served to this machine: readings as they come, recording and replay."""

import json
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.live.reading import Reading
from gelforge.live.recording import Recorder, paced
from gelforge.reporting.forcemaps import FULL_COLOUR_N
from gelforge.reporting.page import COLOURS, LOOK

WEB = Path(__file__).parent / "web"
LOCAL = ("127.0.0.1", "localhost")
KEPT = 600  # readings that the curve shows
LARGE = ("image", "forces")  # of an event, and not in the curve
QUIET_S = 5.0  # without a reading a page is sent the recorder's state alone, so that one that left is noticed


class Hub:
    """The latest event, which any number of pages wait for; a page that is slow misses some.

    Of the events before it the curve is kept, without pictures and maps, for pages that are opened later.
    """

    def __init__(self):
        self.changed = threading.Condition()
        self.number, self.latest = 0, {}
        self._curve = deque(maxlen=KEPT)

    def send(self, event: dict) -> None:
        """Give an event to all who wait."""
        with self.changed:
            if self.latest:
                self._curve.append({name: value for name, value in self.latest.items() if name not in LARGE})
            self.number, self.latest = self.number + 1, event
            self.changed.notify_all()

    def after(self, number: int, patience: float) -> tuple[int, dict | None]:
        """The event after the one of that number, or none if none came in time."""
        with self.changed:
            self.changed.wait_for(lambda: self.number > number, patience)
            return (self.number, self.latest) if self.number > number else (number, None)

    def before(self) -> list[dict]:
        """The events before the latest one, as the curve shows them."""
        with self.changed:
            return list(self._curve)


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
        """A browser that left is no error of ours; others are reported."""
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
            self.answer_json(self.recordings())
        elif self.path.startswith("/replay/"):
            self.stream(self.replay(self.path.removeprefix("/replay/")))
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

    def stream(self, events: Iterable[dict]) -> None:
        """Send events until the browser leaves, each with what the recorder does now: a page may have missed any other."""
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        try:
            for event in events:
                reading = event | self.server.recorder.state()
                self.wfile.write(f"data: {json.dumps(reading)}\n\n".encode())
                self.wfile.flush()
        except ConnectionError:
            self.close_connection = True

    def live(self) -> Iterator[dict]:
        """Events from the latest one on, the first with the curve of those before it."""
        number, before = 0, {"before": self.server.hub.before()}
        while True:
            number, event = self.server.hub.after(number, QUIET_S)
            yield (event or {}) | before
            before = {}

    def recordings(self) -> dict:
        """Names of recordings, or why they cannot be listed, and what the recorder does."""
        recorder = self.server.recorder
        try:
            return {"names": recorder.names()} | recorder.state()
        except BadInput as error:
            return {"names": [], "error": str(error)} | recorder.state()

    def replay(self, name: str) -> Iterator[dict]:
        """Events of a recording, the last of which says why there are no more: the page reads nothing but a stream."""
        try:
            yield from paced(self.server.recorder.read(name))
        except BadInput as error:
            yield {"ended": str(error)}

    def log_message(self, *_) -> None:
        """Requests are not printed on the terminal."""


def page() -> str:
    """The page, one file."""
    files = {"/*look*/": LOOK, "/*colours*/": COLOURS, "/*script*/": WEB / "live.js"}
    html = (WEB / "live.html").read_text(encoding="utf-8")
    for place, path in files.items():
        html = html.replace(place, path.read_text(encoding="utf-8"))
    return html.replace("/*constants*/", f"const FULL_COLOUR_N = {json.dumps(FULL_COLOUR_N)}, KEPT = {KEPT};")


def serve(readings: Iterable[Reading], hub: Hub, recorder: Recorder) -> int:
    """Tell readings to a hub and the recorder until they end; return how many."""
    count = 0
    for reading in readings:
        event = reading.event()
        with suppress(BadInput):  # the recorder keeps it, and pages see its state
            recorder.add(event)
        hub.send(event)
        count += 1
    return count
