"""The web page of a running sensor, served to this machine: readings as they come."""

import json
import threading
from collections import deque
from collections.abc import Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.live.reading import Reading
from gelforge.reading.forcereading import BEYOND
from gelforge.reporting.forcemaps import FULL_COLOUR_N
from gelforge.reporting.page import COLOURS, LOOK

WEB = Path(__file__).parent / "web"
LOCAL = ("127.0.0.1", "localhost")
KEPT = 600  # readings that the curve shows
LARGE = ("image", "forces")  # entries of an event that the curve does without
QUIET_S = 5.0  # without a reading, after which a page is sent an empty event, so that a closed one is noticed


class PageServer(ThreadingHTTPServer):
    """Serves the page in threads of its own until `stop`; BadInput where the port cannot be served.

    Any number of pages wait for the latest event; a slow one misses some. Earlier events are kept without images and maps,
    for the curve on pages that are opened later.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, host: str, port: int):
        self.local = host in LOCAL
        self.changed = threading.Condition()
        self.number = 0
        self.latest: dict = {}
        self.said: dict = {}  # the last sentence that was announced
        self._curve: deque[dict] = deque(maxlen=KEPT)
        self.watched = threading.Event()  # set once a page was opened
        try:
            super().__init__((host, port), Handler)
        except (OSError, OverflowError) as error:  # the latter for a port number out of range
            why = getattr(error, "strerror", None) or error
            raise BadInput(f"port {port} of {host}: cannot be served ({why}); name another with --port") from error
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        host, port = self.server_address[:2]
        return f"http://{host if isinstance(host, str) else host.decode()}:{port}/"

    def send(self, reading: Reading) -> None:
        """Show a reading."""
        self.give(reading.event() | self.said)

    def announce(self, sentence: str, fault: bool = False) -> None:
        """Show a sentence on all pages, in red for a fault, with the last reading and all later ones.

        Pages that are opened later show it, too.
        """
        self.said = {"said": sentence, "fault": fault}
        self.give(self.latest | self.said)

    def give(self, event: dict) -> None:
        """Give an event to all pages."""
        with self.changed:
            if self.latest:
                self._curve.append({name: value for name, value in self.latest.items() if name not in LARGE})
            self.number, self.latest = self.number + 1, event
            self.changed.notify_all()

    def events(self) -> Iterator[dict]:
        """Events from the latest one on; the first has the curve of earlier ones. An empty one after QUIET_S without any."""
        seen = 0
        with self.changed:
            before = {"before": list(self._curve)}
        while True:
            with self.changed:
                newer = self.changed.wait_for(partial(self._newer, seen), QUIET_S)
                event, seen = self.latest if newer else {}, self.number
            yield event | before
            before = {}

    def _newer(self, number: int) -> bool:
        return self.number > number

    def stop(self) -> None:
        """Stop the server."""
        self.shutdown()
        self.server_close()

    def handle_error(self, request, client_address) -> None:
        """Report an error, unless a browser left."""
        import sys

        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class Handler(BaseHTTPRequestHandler):
    """GET /: the page; /events: readings as they come."""

    server: PageServer

    def do_GET(self) -> None:
        # refuse another site's name that resolves to this machine (DNS rebinding)
        host = (self.headers.get("Host") or "").rsplit(":", 1)[0]
        if self.server.local and host not in LOCAL:
            self.send_error(403)
        elif self.path == "/":
            self.begin("text/html; charset=utf-8")
            self.wfile.write(page().encode())
        elif self.path == "/events":
            self.begin("text/event-stream")
            self.stream()
        else:
            self.send_error(404)

    def begin(self, kind: str) -> None:
        """Send the headers of a response, which ends with the connection."""
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()

    def stream(self) -> None:
        """Send events until the browser leaves."""
        self.server.watched.set()
        try:
            for event in self.server.events():
                self.wfile.write(f"data: {json.dumps(event)}\n\n".encode())
                self.wfile.flush()
        except ConnectionError:
            self.close_connection = True

    def log_message(self, *_) -> None:
        """Requests are not printed on the terminal."""


def page() -> str:
    """The HTML of the page, with its styles and scripts."""
    files = {"/*look*/": LOOK, "/*colours*/": COLOURS, "/*script*/": WEB / "live.js"}
    html = (WEB / "live.html").read_text(encoding="utf-8")
    for place, path in files.items():
        html = html.replace(place, path.read_text(encoding="utf-8"))
    return html.replace(
        "/*constants*/", f"const FULL_COLOUR_N = {json.dumps(FULL_COLOUR_N)}, BEYOND = {BEYOND}, KEPT = {KEPT};"
    )
