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
from gelforge.records.film import Film, open_source, source_name
from gelforge.records.nocontactimage import FEWEST, find_nocontact
from gelforge.records.regular import refuse_to_replace


class Outputs:
    """Destinations of readings: files, and servers with viewers. fault: the first error, or None."""

    def __init__(self, args: Namespace, name: str, stack: ExitStack):
        messages = RosMessages(args.sensor or (args.profile.stem if args.profile else "gelforge"))
        self.fault: BadInput | None = None
        self.servers: list = []
        self.files: list = []
        if args.web:
            self._serve(PageServer(args.host, args.port), stack)
        if args.foxglove:
            from gelforge.live.foxglove import FoxgloveServer

            # two servers cannot listen on one port
            self._serve(FoxgloveServer(args.host, args.port + bool(args.web and args.port), messages), stack)
        if args.record:
            self._keep(McapRecording(args.record, messages), stack)
        if args.csv:
            self._keep(CsvTable(args.csv), stack)
        for server in self.servers:
            report(f"{server.url} shows {name}; Ctrl-C ends")

    def _serve(self, server, stack: ExitStack) -> None:
        self.servers.append(server)
        stack.callback(server.stop)

    def _keep(self, file, stack: ExitStack) -> None:
        self.files.append(file)
        stack.callback(file.drop)

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
    from gelforge.reading.profile import files_of

    if (args.video is None) == (args.camera is None):
        raise BadInput("give either --video FILE or --camera NUMBER")
    if not (args.web or args.foxglove or args.record or args.csv):
        raise BadInput("give an output: --web, --foxglove, --record FOLDER or --csv FILE")
    if args.csv and str(args.csv) != "-":
        refuse_to_replace(
            f"--csv {args.csv}", [args.csv], [args.video, args.nocontact, *files_of(args.profile), args.model]
        )


def need_frames(asked: int | None) -> None:
    """BadInput where fewer frames are requested than the search for a no-contact image needs."""
    if asked is not None and asked < FEWEST:
        raise BadInput(
            f"--frames {asked}: the no-contact image is found among the first frames, {FEWEST} at least; ask for more, or"
            " give it with --nocontact or --profile"
        )


def predictor_of(args: Namespace, model, picture: np.ndarray | None, seen, name: str) -> tuple:
    """A predictor (reading.predictor) with the no-contact image, and the frames to read (records.film.Frame).

    picture: the given no-contact image (h, w, 3) RGB, or None. Then it is the profile's; without a profile, and if
    the network needs one, it is found in the frames. BadInput where a found one is unusable.
    """
    import cv2

    from gelforge.reading.predictor import Predictor
    from gelforge.reading.profile import with_profile

    found = picture is None and not args.profile and model.needs_nocontact
    if found:
        need_frames(args.frames)
        picture, seen = find_nocontact(seen, name)
        first = next(seen)
        report(f"{name}: frames skipped before the no-contact image: {first.number}")
        seen = itertools.chain([first], seen)
        picture = cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    picture, gain = with_profile(args.profile, picture, model.metadata)
    predictor = Predictor(model, picture, gain, args.device, args.threads)
    if found and predictor.fault:
        raise BadInput(
            f"{name}: {predictor.fault}. Start it while nothing touches the sensor, or give a no-contact image with --nocontact"
        )
    if predictor.text:
        report(f"{name}: {predictor.text}")
    return predictor, seen


def show(
    args: Namespace,
    predictor,
    frames,
    film: Film,
    name: str,
    over: threading.Event,
    start: StartInDoubt | None = None,
) -> None:
    """Send readings of frames to all outputs until frames end or `over` is set, and serve viewers until it is set.

    Raises BadInput at the end if an output failed, or a camera stopped early.
    """
    with ExitStack() as stack:
        outputs = Outputs(args, name, stack)
        paced = bool(outputs.servers) and not film.camera
        count = outputs.send(until(over, readings(predictor, frames, paced, start)))
        asked = over.is_set() or (args.frames is not None and film.taken >= args.frames)
        if film.camera and not asked and not outputs.fault:
            outputs.fault = BadInput(
                f"{name}: stopped after {film.taken} frames; check that it is plugged in, and start again"
            )
        outputs.end(f"{name}: ended after {count} frames")
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
    from gelforge.reading.predictor import load_for_use
    from gelforge.records.image import read_image

    model = load_for_use(args.model, args.sensor)
    picture = read_image(args.nocontact) if args.nocontact else None
    name = source_name(args.video, args.camera)
    with open_source(args.video, args.camera, args.mode) as (capture, announced):
        film = Film(capture, announced, name, args.frames, args.camera is not None, args.video)
        predictor, seen = predictor_of(args, model, picture, film, name)
        with stopping() as over:
            start = None if args.nocontact or args.profile else StartInDoubt(predictor, name)
            show(args, predictor, seen, film, name, over, start)


if __name__ == "__main__":
    main.exit()
