"""Frames that a camera tears: how many are read wrong and not flagged, of real balls and films, and of drawn presses.

A frame is torn at a random row, through the contact or not. What is read of the whole frame is taken as true, so only
the tear counts. Frames that are flagged when whole are left out.
"""

from argparse import Namespace
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from gelforge.flow.cli import command, option
from gelforge.reading.model import fingerprint, load_model
from gelforge.reading.reader import Reader
from gelforge.records.film import numbered
from gelforge.records.image import read_image
from gelforge.records.log import read_presses as read_log
from gelforge.records.nocontactimage import SETTLING, find_nocontact
from tests.benchmarks.parts.ball_presses import BACKGROUND, read_presses
from tests.benchmarks.parts.balls import FOLDER as BALLS
from tests.benchmarks.real import PX_PER_MM
from tests.support.figures import PUBLISHED_DATA, Figure, publish_figures
from tests.support.films import frames_of

DEMO = Path("data/demo")
EVERY = 8  # every so manyth frame of a film may be torn
LEAST_N = 2.0  # normal force of a frame that is torn
MOST_ROW = 0.85  # and at a row of the middle of the image

Frame = tuple[
    str, Reader, np.ndarray, np.ndarray, np.ndarray
]  # source, reader, image, no-contact image, another image
Tear = Callable[[np.ndarray, np.ndarray, np.ndarray, np.random.Generator], np.ndarray]


def row_of(image: np.ndarray, rng: np.random.Generator) -> int:
    """A row of the middle of an image."""
    return int(len(image) * rng.uniform(1.0 - MOST_ROW, MOST_ROW))


def below(image: np.ndarray, other: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An image whose lower part is of another frame."""
    row = row_of(image, rng)
    return np.concatenate([image[:row], other[row:]])


def stripes(image: np.ndarray, other: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An image with three stripes of another frame, each a twentieth to a fifth of its height."""
    torn = image.copy()
    for _ in range(3):
        row = row_of(image, rng)
        rows = np.s_[row : row + int(len(image) * rng.uniform(0.05, 0.2))]
        torn[rows] = other[rows]
    return torn


def slipped(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An image whose lower part begins 8 to 80 columns too late, as where a packet of a camera is lost."""
    row, torn = row_of(image, rng), image.copy()
    torn[row:] = np.roll(image[row:], int(rng.integers(8, 80)), axis=1)
    return torn


TEARS: dict[str, Tear] = {
    "half of the free gel": lambda image, free, _other, rng: below(image, free, rng),
    "half of another press": lambda image, _free, other, rng: below(image, other, rng),
    "stripes of the free gel": lambda image, free, _other, rng: stripes(image, free, rng),
    "stripes of another press": lambda image, _free, other, rng: stripes(image, other, rng),
    "a lower part aside": lambda image, _free, _other, rng: slipped(image, rng),
}


def drawn(model: object) -> Iterator[Frame]:
    """Presses of the demo, beside another press of the same sensor."""
    presses = read_log(DEMO / "log.csv")
    for name in sorted({press.sensor_id for press in presses}):
        free = read_image(DEMO / f"nocontact/{name}.png")[..., :3]
        reader = Reader(free, model=model)
        images = [read_image(DEMO / press.image)[..., :3] for press in presses if press.sensor_id == name]
        for at, image in enumerate(images):
            yield "drawn", reader, image, free, images[at - 1]


def balls(model: object) -> Iterator[Frame]:
    """Presses of real balls."""
    folder = PUBLISHED_DATA / BALLS
    free = read_image(folder / BACKGROUND)
    reader = Reader(free, model=model)
    images = [press.image for press in read_presses(folder, PX_PER_MM)]
    for at, image in enumerate(images):
        yield "ball", reader, image, free, images[at - 1]


def films(model: object) -> Iterator[Frame]:
    """Frames of the gripper's films, beside the frame a third of a second earlier."""
    for path in sorted((PUBLISHED_DATA / "gripper_videos").glob("*.avi")):
        images = frames_of(path)
        free, _ = find_nocontact(numbered(images), str(path))
        reader = Reader(free, model=model)
        for at in range(SETTLING + EVERY, len(images), EVERY):
            yield "film", reader, images[at], free, images[at - EVERY]


def measure(frames: list[Frame], count: int, rng: np.random.Generator) -> tuple[dict[str, list[int]], int, int]:
    """For each tear: torn frames, those flagged, those outside of their interval and not flagged.

    And how many whole frames were read, and how many of those were called torn.
    """
    found = {name: [0, 0, 0] for name in TEARS}
    whole = accused = torn = 0
    kinds = list(TEARS.items())
    for at in rng.permutation(len(frames)).tolist():
        _, reader, image, free, other = frames[at]
        true = reader(image)
        whole, accused = whole + 1, accused + ("torn" in true.reason)
        if torn == count:
            break
        if true.flag or -true.total[2] < LEAST_N or image.shape != free.shape:
            continue
        name, tear = kinds[torn % len(kinds)]
        read = reader(np.ascontiguousarray(tear(image, free, other, rng)))
        outside = read.half_width is None or bool((np.abs(read.total - true.total) > read.half_width).any())
        torn += 1
        found[name] = [a + b for a, b in zip(found[name], (1, read.flag, outside and not read.flag), strict=True)]
    return found, whole, accused


@command(
    option("--model", type=Path, default=None, help="model file; the one that ships if not named"),
    option("--count", type=int, default=50, help="torn frames, drawn and real ones each"),
    option("--seed", type=int, default=1),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    model, figures, silent, every = load_model(args.model), [], 0, 0
    for source, frames in (("drawn", list(drawn(model))), ("real", [*balls(model), *films(model)])):
        found, whole, accused = measure(frames, args.count, np.random.default_rng(args.seed))
        count, flagged, wrong = np.sum(list(found.values()), axis=0).tolist()
        silent, every = silent + wrong, every + count
        note = ", ".join(f"{name} {flags} flagged, {lost} wrong of {of}" for name, (of, flags, lost) in found.items())
        figures += [
            Figure(f"torn {source} frames that are flagged", 100 * flagged / max(count, 1), "", 0.0, "%", f"of {count}: {note}"),
            Figure(f"whole {source} frames that are called torn", 100 * accused / whole, "<=", 2.0, "%", f"of {whole}"),
        ]  # fmt: skip
    figures.append(
        Figure("torn frames outside of their interval and not flagged", silent, "<=", 5.0, "", f"of {every}")
    )
    publish_figures(args.out, figures, fingerprint(model.metadata), readings=[])


if __name__ == "__main__":
    main.exit()
