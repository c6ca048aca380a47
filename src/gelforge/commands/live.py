"""Forces of a film or a running camera, frame by frame: `gelforge live --video FILE | --camera N`.

--web serves a page to this machine, --foxglove sends ROS 2 messages to Foxglove, --record writes the same messages as
MCAP, and --csv writes a table. Outputs can be combined. If a file fails, viewers show the error and continue. A
network that needs a no-contact image takes the mean of the first frames at rest, unless one is given; earlier frames
are skipped.
"""

import itertools
import signal
import sys
import threading
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from gelforge.commands.camera import camera_number
from gelforge.commands.sensoroptions import ENGINE, MODE, MODEL, NOCONTACT, PROFILE, SENSOR
from gelforge.errors import BadInput
from gelforge.flow.cli import command, option, positive
from gelforge.live.reading import Reading, StartInDoubt, readings
from gelforge.live.recording import CsvTable, McapRecording
from gelforge.live.topics import RosMessages
from gelforge.live.webpage import PageServer
from gelforge.reading.model import ForceModel, load_model, require_sensor
from gelforge.reading.profile import files_of
from gelforge.reading.reader import Reader
from gelforge.records.film import Film, Frame, open_source, source_name
from gelforge.records.image import read_image
from gelforge.records.nocontactimage import FEWEST, find_nocontact
from gelforge.records.regular import refuse_to_replace


class Outputs:
    """Destinations of readings: files, and servers with viewers. fault: the first error, or None.

    stack: ends what it is given.
    """

    def __init__(self, stack: ExitStack) -> None:
        self.fault: BadInput | None = None
        self.servers: list = []
        self.files: list = []
        self._stack = stack

    def serve(self, server) -> None:
        """Send readings to the viewers of a server, too."""
        self.servers.append(server)
        self._stack.callback(server.stop)

    def keep(self, file) -> None:
        """Write readings to a file, too."""
        self.files.append(file)
        self._stack.callback(file.drop)

    def send(self, found: Iterable[Reading]) -> int:
        """Send readings to all outputs until they end or no output is left; return how many were sent."""
        count = 0
        try:
            for reading in found:
                for file in [*self.files]:
                    self._guard(file, file.send, reading)
                for server in self.servers:
                    server.send(reading)
                count += 1
                if not self.files and not self.servers:
                    break  # no output is left
        except BadInput as error:
            self.fault = self.fault or error
        return count

    def end(self, said: str) -> None:
        """Complete the files, and show viewers `said` or the first error."""
        for file in [*self.files]:
            if kept := self._guard(file, file.end):
                report(kept)
        self.announce(str(self.fault or said), self.fault is not None)

    def announce(self, sentence: str, fault: bool) -> None:
        """Show a sentence to all viewers, and on the terminal where there are servers."""
        for server in self.servers:
            server.announce(sentence, fault)
        if self.servers:
            report(sentence)

    def _guard(self, file, act: Callable, *what) -> str | None:
        """Call `act` on a file; if it fails, drop the file and show viewers the error."""
        try:
            return act(*what)
        except BadInput as error:
            self.files.remove(file)
            self.fault = self.fault or error
            self.announce(str(error), fault=True)
            return None


def report(sentence: str) -> None:
    """Print on standard error, because standard output is for the table."""
    print(sentence, file=sys.stderr, flush=True)


@contextmanager
def stopping() -> Iterator[threading.Event]:
    """Yield an event that SIGINT and SIGTERM set, so that earlier readings are kept."""
    over = threading.Event()
    before = {number: signal.signal(number, lambda *_: over.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield over
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def until(over: threading.Event, items: Iterable) -> Iterator:
    """Items until the event is set."""
    for item in items:
        if over.is_set():
            return
        yield item


def refuse_unusable(args: Namespace) -> None:
    """BadInput where input or output is missing, or an output would overwrite an input."""
    if (args.video is None) == (args.camera is None):
        raise BadInput("give either --video FILE or --camera NUMBER")
    if not (args.web or args.foxglove or args.record or args.csv):
        raise BadInput("give an output: --web, --foxglove, --record FOLDER or --csv FILE")
    if args.csv and str(args.csv) != "-":
        refuse_to_replace(
            f"--csv {args.csv}", [args.csv], [args.video, args.nocontact, *files_of(args.profile), args.model]
        )
        if args.csv.is_file() and args.csv.stat().st_size:
            raise BadInput(f"--csv {args.csv}: exists already and would be replaced; name another file, or remove it")


def need_frames(asked: int | None) -> None:
    """BadInput where fewer frames are requested than the search for a no-contact image needs."""
    if asked is not None and asked < FEWEST:
        raise BadInput(
            f"--frames {asked}: the no-contact image is found among the first frames, {FEWEST} at least; ask for more, or"
            " give it with --nocontact or --profile"
        )


def outputs_of(args: Namespace, name: str, stack: ExitStack) -> Outputs:
    """The outputs that are asked for, of a film or camera `name`."""
    messages = RosMessages(args.sensor or (args.profile.stem if args.profile else "gelforge"))
    outputs = Outputs(stack)
    if args.web:
        outputs.serve(PageServer(args.host, args.port))
    if args.foxglove:
        from gelforge.live.foxglove import FoxgloveServer

        # two servers cannot listen on one port
        outputs.serve(FoxgloveServer(args.host, args.port + bool(args.web and args.port), messages))
    if args.record:
        outputs.keep(McapRecording(args.record, messages))
    if args.csv:
        outputs.keep(CsvTable(args.csv))
    for server in outputs.servers:
        report(f"{server.url} shows {name}; Ctrl-C ends")
    return outputs


def found_picture(seen: Iterable[Frame], name: str) -> tuple[np.ndarray, Iterator[Frame]]:
    """The no-contact image (h, w, 3) uint8 RGB found at the start of a stream, and the frames from there on."""
    import cv2

    picture, seen = find_nocontact(seen, name)
    first = next(seen)
    report(f"{name}: frames skipped before the no-contact image: {first.number}")
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), itertools.chain([first], seen)


def reader_beside(picture: np.ndarray, model: ForceModel, name: str) -> Reader:
    """A reader with a no-contact image that was found in a stream; BadInput where that is unusable."""
    reader = Reader(picture, model=model)
    if fault := reader.fault or reader.doubt:
        raise BadInput(
            f"{name}: {fault}. Start it while nothing touches the sensor, or give a no-contact image with --nocontact"
        )
    return reader


def await_page(server: PageServer, over: threading.Event) -> None:
    """Wait until a page of the server was opened, or `over` is set: a film begins while somebody looks."""
    while not (over.is_set() or server.watched.wait(0.1)):
        pass


def show(outputs: Outputs, found: Iterable[Reading], film: Film, over: threading.Event, frames: int | None) -> None:
    """Send readings to all outputs until they end or `over` is set, and serve viewers until it is set.

    frames: how many are asked for; None: all. Raises BadInput at the end if an output failed, or a camera stopped early.
    """
    count = outputs.send(until(over, found))
    asked = over.is_set() or (frames is not None and film.taken >= frames)
    if film.camera and not asked and not outputs.fault:
        outputs.fault = BadInput(
            f"{film.name}: stopped after {film.taken} frames; check that it is plugged in, and start again"
        )
    outputs.end(f"{film.name}: ended after {count} frames")
    if outputs.servers:
        over.wait()  # viewers keep the last frame
    if outputs.fault:
        raise outputs.fault


@command(
    option("--video", type=Path, help="video file", default=None),
    option("--camera", type=camera_number, help="number of the camera, if no video is given", default=None),
    MODE,
    MODEL,
    SENSOR,
    NOCONTACT,
    PROFILE,
    option("--frames", type=positive, help="number of frames after which to stop", default=None),
    *ENGINE,
    option("--web", action="store_true", help="serve a page with image, forces and flag"),
    option("--foxglove", action="store_true", help="serve image, forces and flag to Foxglove as ROS 2 messages"),
    option("--host", default="127.0.0.1", help="address to listen on; 0.0.0.0: everyone on the network"),
    option("--port", type=int, default=8765, help="port to listen on (Foxglove beside a page: the next one); 0: any free one"),
    option("--record", type=Path, help="folder for an MCAP file of the messages that --foxglove serves", default=None),
    option("--csv", type=Path, help="file with one row per frame; - for standard output", default=None),
)  # fmt: skip
def main(args: Namespace) -> None:
    refuse_unusable(args)
    model = load_model(args.model, args.device, args.threads)
    require_sensor(model, args.sensor)
    picture = read_image(args.nocontact) if args.nocontact else None
    name, start = source_name(args.video, args.camera), None
    with open_source(args.video, args.camera, args.mode) as (capture, announced):
        film = Film(capture, announced, name, args.frames, args.camera is not None, args.video)
        seen: Iterable[Frame] = film
        if picture is None and not args.profile and model.needs_nocontact:
            need_frames(args.frames)
            picture, seen = found_picture(film, name)
            reader = reader_beside(picture, model, name)
            start = StartInDoubt(reader, name)
        else:
            reader = Reader(picture, args.profile, model)
        for said in filter(None, (reader.text, reader.doubt)):
            report(f"{name}: {said}")
        with stopping() as over, ExitStack() as stack:
            outputs = outputs_of(args, name, stack)
            paced = bool(outputs.servers) and not film.camera
            if paced and args.web and not (args.foxglove or outputs.files):
                await_page(outputs.servers[0], over)
            show(outputs, readings(reader, seen, paced, start), film, over, args.frames)


if __name__ == "__main__":
    main.exit()
