"""Force maps of a video or a running camera: `gelforge live --video FILE | --camera N`.

--web serves a page to this machine, with recording and replay. --foxglove serves messages of ROS 2 to Foxglove, and --record
writes them as MCAP. --jsonl and --csv write the predictions, without a display.
Unless a no-contact image is given, a network that needs one takes the mean of the first frames at rest; frames before these
are skipped.
"""

import itertools
import sys
import threading
import time
from argparse import Namespace
from collections import deque
from pathlib import Path

import numpy as np

from gelforge.commands.camera import camera_number
from gelforge.commands.sensoroptions import ENGINE, MODE, MODEL, NOCONTACT, PROFILE, SENSOR
from gelforge.errors import BadInput
from gelforge.flow.files import publish
from gelforge.flow.main import command, option, positive
from gelforge.records.axes import CHANNEL_OF_AXIS
from gelforge.records.film import Film, open_source, source_name
from gelforge.records.nocontactimage import FEWEST, find_nocontact
from gelforge.records.regular import real_place, refuse_to_replace

RATE_OVER = 30  # frames that the shown rate is averaged over


class Overlay:
    """Turn frames into pictures with forces on them, keeping count of time."""

    def __init__(self, predictor):
        self.predictor = predictor
        self.recent: deque[float] = deque(maxlen=RATE_OVER)
        self.network_ms: deque[float] = deque(maxlen=10_000)  # of a camera that films for hours
        self.flagged = 0

    def __call__(self, frame) -> np.ndarray:
        """Return the picture (BGR) of a frame (h, w, 3) BGR."""
        import cv2

        from gelforge.reporting.forcemaps import overlay

        started = time.perf_counter()
        found = self.predictor.predict(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))
        self.network_ms.append(1e3 * (time.perf_counter() - started))
        self.flagged += found.flag
        self.recent.append(started)
        span = self.recent[-1] - self.recent[0]
        rate = (len(self.recent) - 1) / span if span > 0 else 0.0
        lines = [
            force_line(found.cells),
            f"{rate:5.1f} frames/s, {self.network_ms[-1]:.1f} ms a frame",
        ]
        return overlay(cv2.cvtColor(found.image, cv2.COLOR_RGB2BGR), found.cells, lines, found.reason)


def force_line(forces: np.ndarray) -> str:
    """Total force of a map (3, rows, cols) N along the gel's axes, in words."""
    x, y, z = forces.sum((1, 2))[list(CHANNEL_OF_AXIS)]
    return f"x {x:+6.2f}  y {y:+6.2f}  z {z:+7.2f} N"


def write_video(pictures, path: Path, rate: float) -> int:
    """Write pictures (h, w, 3) BGR as a motion-JPEG AVI; return how many.

    Where they end by BadInput, as those of a film do that is cut, what was written until then is kept first.
    """
    from gelforge.commands.live_readings import make_folder_of

    make_folder_of(path)
    with publish(path) as part:
        count, fault = write_avi(pictures, part, path, rate)
        if not count:
            raise fault or BadInput(f"{path}: stopped before the first frame; nothing is written")
        if not is_whole(part, count):
            raise BadInput(
                f"{path}: a film of {count} frames could not be written whole; free space, then start again"
            )
    if fault:
        print(f"{path}: kept, and ends after {count} frames")
        raise fault
    return count


def write_avi(pictures, part: Path, path: Path, rate: float) -> tuple[int, BadInput | None]:
    """Write pictures to `part`, which becomes `path`; return how many, and what they ended by where they failed."""
    import cv2

    count, writer = 0, None
    try:
        for picture in pictures:
            if writer is None:
                size = picture.shape[1], picture.shape[0]
                writer = cv2.VideoWriter(str(part), cv2.VideoWriter.fourcc(*"MJPG"), rate, size)
                if not writer.isOpened():
                    hint = "name another folder" if path.suffix == ".avi" else "give a name that ends in .avi"
                    raise BadInput(f"{path}: cannot be written as a video; {hint}")
            writer.write(picture)
            count += 1
    except BadInput as fault:
        return count, fault
    finally:
        if writer is not None:
            writer.release()
    return count, None


def is_whole(film: Path, count: int) -> bool:
    """Whether a film that was written holds so many frames: OpenCV's writer does not say where the disk is full."""
    import cv2

    written = cv2.VideoCapture(str(film))
    try:
        return int(written.get(cv2.CAP_PROP_FRAME_COUNT)) == count
    finally:
        written.release()


def show(pictures) -> int:
    """Show pictures in a window until q is pressed; return how many. BadInput where OpenCV has no window."""
    import cv2

    count = 0
    for picture in pictures:
        try:
            cv2.imshow("gelforge live", picture)
            count += 1
            if cv2.waitKey(1) & 0xFF == ord("q"):
                break
        except cv2.error as error:
            raise BadInput(
                "this OpenCV has no window (a headless build or no display): use --web, --jsonl FILE, --csv FILE or --out FILE.avi"
            ) from error
    return count


def refuse_two_faces(args: Namespace) -> None:
    """BadInput where outputs are named of which only one kind would be made."""
    asked = [
        face
        for face, given in (
            ("--web", args.web),
            ("--foxglove", args.foxglove),
            ("--record without --web or --foxglove", args.record and not (args.web or args.foxglove)),
            ("--jsonl or --csv", args.jsonl or args.csv),
            ("--out", args.out),
        )
        if given
    ]
    if len(asked) > 1:
        raise BadInput(f"{' and '.join(asked)} do not go together; start `gelforge live` once for one of them")


def refuse_taken_files(args: Namespace) -> None:
    """BadInput where what is written would take the place of what is read, or of each other."""
    from gelforge.networks.inference.sensorprofile import files_of

    written = {name: getattr(args, name) for name in ("out", "jsonl", "csv")}
    # - is standard output, one for both
    files = {name: path if str(path) == "-" else real_place(path) for name, path in written.items() if path}
    read = [args.video, args.nocontact, *files_of(args.profile), args.model]
    for name, path in files.items():
        refuse_to_replace(f"--{name} {written[name]}", [path], read)
    if len(set(files.values())) < len(files):
        raise BadInput(f"--jsonl and --csv both name {args.csv}; name two files")


def need_frames(asked: int | None) -> None:
    """BadInput where fewer frames are asked for than it takes to find the no-contact image."""
    if asked is not None and asked < FEWEST:
        raise BadInput(
            f"--frames {asked}: the no-contact image is found among the first frames, {FEWEST} at least; ask for more, or"
            " give it with --nocontact or --profile"
        )


def predictor_of(args: Namespace, model, picture: np.ndarray | None, seen, name: str) -> tuple:
    """The model beside the sensor's no-contact image (networks.inference.predictor), and the frames to read (records.film.Frame).

    picture: what was given for it, (h, w, 3) RGB; where nothing was, the profile's serves; where there is none either and the
    network needs one, it is found in the frames.
    """
    import cv2

    from gelforge.camera import CameraPredictor
    from gelforge.networks.inference.sensorprofile import with_profile

    if picture is None and not args.profile and model.needs_nocontact:
        need_frames(args.frames)
        picture, seen = find_nocontact(seen, name)
        first = next(seen)
        print(f"{name}: frames before the no-contact image are not read: {first.number}", file=sys.stderr)
        seen = itertools.chain([first], seen)
        picture = cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    picture, gain, table = with_profile(args.profile, picture, model.metadata)
    predictor = CameraPredictor(model, picture, gain, args.device, args.threads, table)
    if predictor.text:
        print(f"{name}: {predictor.text}", file=sys.stderr)
    return predictor, seen


def draw(args: Namespace, predictor, seen, film: Film, name: str, over: threading.Event) -> None:
    """Write a film of frames with forces on them, or show them in a window, and say how fast it went."""
    from gelforge.commands.live_readings import is_lost, lost, until

    overlay = Overlay(predictor)
    pictures = (overlay(frame.image) for frame in until(over, seen))
    started = time.perf_counter()
    count = write_video(pictures, args.out, film.rate) if args.out else show(pictures)
    seconds = time.perf_counter() - started
    print(
        f"{count} frames in {seconds:.1f} s: {count / seconds:.1f} a second with overlay; network and check "
        f"{np.median(overlay.network_ms or [0.0]):.1f} ms a frame; {overlay.flagged} flagged"
    )
    if args.out and is_lost(args, over, film):
        raise BadInput(lost(name, film.taken))


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
    option("--port", type=int, default=8765, help="port to listen on; 0: any free one"),
    option(
        "--record",
        type=Path,
        help="folder of the page's recordings (default: recordings), or for an MCAP file of all messages",
        default=None,
    ),
    option("--jsonl", type=Path, help="file with one JSON line per frame; - for standard output", default=None),
    option("--csv", type=Path, help="file with one row per frame", default=None),
    option(
        "--out",
        type=Path,
        help="video with the force maps (.avi); without any output a window is opened, which needs a display",
        default=None,
    ),
)
def main(args: Namespace) -> None:
    if (args.video is None) == (args.camera is None):
        raise BadInput("give either --video FILE or --camera NUMBER")
    refuse_two_faces(args)
    refuse_taken_files(args)
    from gelforge.commands.live_readings import keep_readings, show_page, stopping
    from gelforge.commands.live_topics import show_topics
    from gelforge.networks.inference.predictor import load_for_use
    from gelforge.records.image import read_image

    model = load_for_use(args.model, args.sensor)
    picture = read_image(args.nocontact) if args.nocontact else None
    name = source_name(args.video, args.camera)
    with open_source(args.video, args.camera, args.mode) as (capture, announced):
        film = Film(capture, announced, name, args.frames, args.camera is not None, args.video)
        predictor, seen = predictor_of(args, model, picture, film, name)
        with stopping() as over:
            topics = args.foxglove or (args.record and not args.web)
            face = (
                show_page
                if args.web
                else show_topics
                if topics
                else keep_readings
                if args.jsonl or args.csv
                else draw
            )
            face(args, predictor, seen, film, name, over)


if __name__ == "__main__":
    main.exit()
