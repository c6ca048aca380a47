"""A server of the Hugging Face hub's protocol for one dataset; the hub's own library is its client (HF_ENDPOINT).

As at the hub, large files are behind a redirect, and listings are paged.
"""

import hashlib
import json
import threading
import time
from collections import Counter
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

PAGE = 40  # files per page of a listing


class HubServer(ThreadingHTTPServer):
    """Serves the files below a folder as the dataset `name`.

    loaded: how often each file's content was sent completely. pace_s: least time for each, s.
    """

    daemon_threads = True

    def __init__(self, folder: Path, name: str):
        super().__init__(("127.0.0.1", 0), Handler)
        self.folder, self.name, self.pace_s = folder, name, 0.0
        self.loaded: Counter = Counter()
        self.digests: dict[tuple, str] = {}

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"

    @property
    def cdn(self) -> str:
        """URL of the content, under another host name than the hub's."""
        return f"http://localhost:{self.server_address[1]}"

    def files(self) -> dict[str, Path]:
        """Files by path below the folder."""
        return {str(path.relative_to(self.folder)): path for path in sorted(self.folder.rglob("*")) if path.is_file()}

    def digest(self, path: Path) -> str:
        """SHA-256 of a file."""
        key = path, path.stat().st_mtime_ns
        if key not in self.digests:
            self.digests[key] = hashlib.sha256(path.read_bytes()).hexdigest()
        return self.digests[key]

    def commit(self) -> str:
        """The commit of the folder's current content."""
        every = "".join(f"{name} {self.digest(path)}" for name, path in self.files().items())
        return hashlib.sha1(every.encode()).hexdigest()

    def handle_error(self, request, client_address) -> None:
        """Ignore the error of a client that was killed."""


class Handler(BaseHTTPRequestHandler):
    server: HubServer
    protocol_version = "HTTP/1.1"

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        url = urlsplit(self.path)
        api, files = f"/api/datasets/{self.server.name}", f"/datasets/{self.server.name}/resolve/"
        if url.path.startswith(f"{api}/tree/"):
            self.tree(int(parse_qs(url.query).get("cursor", ["0"])[0]))
        elif url.path in (api, f"{api}/revision/main"):
            self.answer({"_id": "1", "id": self.server.name, "sha": self.server.commit(),
                         "siblings": [{"rfilename": name} for name in self.server.files()]})  # fmt: skip
        elif url.path.startswith(files):
            revision, _, name = url.path.removeprefix(files).partition("/")
            self.file(name, self.server.commit() if revision == "main" else revision)
        elif url.path.startswith("/cdn/"):
            self.content(url.path.removeprefix("/cdn/"))
        else:
            self.send_error(404)

    def tree(self, start: int) -> None:
        """A page of the listing."""
        found = list(self.server.files().items())
        entries = [{"type": "file", "path": name, "size": path.stat().st_size, "oid": "0" * 40,
                    "lfs": {"oid": self.server.digest(path), "size": path.stat().st_size, "pointerSize": 131}}
                   for name, path in found[start : start + PAGE]]  # fmt: skip
        more = start + PAGE < len(found)
        link = f'<{self.server.url}{urlsplit(self.path).path}?recursive=true&cursor={start + PAGE}>; rel="next"'
        self.answer(entries, {"Link": link} if more else {})

    def answer(self, value, headers: dict | None = None) -> None:
        """Send JSON."""
        content = json.dumps(value).encode()
        self.send_response(200)
        for name, said in {
            **(headers or {}),
            "Content-Type": "application/json",
            "Content-Length": len(content),
        }.items():
            self.send_header(name, str(said))
        self.end_headers()
        self.wfile.write(content)

    def file(self, name: str, commit: str) -> None:
        """Redirect to the content of a file."""
        path = self.server.folder / name
        self.send_response(302)
        for header, said in {"Location": f"{self.server.cdn}/cdn/{name}", "X-Repo-Commit": commit, "Content-Length": 0,
                             "X-Linked-Etag": f'"{self.server.digest(path)}"', "X-Linked-Size": path.stat().st_size}.items():  # fmt: skip
            self.send_header(header, str(said))
        self.end_headers()

    def content(self, name: str) -> None:
        """The content of a file."""
        held = (self.server.folder / name).read_bytes()
        self.send_response(200)
        self.send_header("Content-Length", str(len(held)))
        self.end_headers()
        if self.command == "HEAD":
            return
        time.sleep(self.server.pace_s)
        self.wfile.write(held)
        self.server.loaded[name] += 1

    def log_message(self, *_) -> None:
        """Log no request."""


@contextmanager
def hub(folder: Path, name: str = "erikhelmut/FEATS"):
    """A running server, stopped at the end."""
    server = HubServer(folder, name)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
