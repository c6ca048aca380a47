"""Pictures of the README, made from what they show; beside each lies the digest of its data, so that a test can tell."""

import hashlib
import shutil
from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import publish, read_json, write_json
from gelforge.flow.main import command, group, option

SHIPPED = Path("src/gelforge/networks/default.pt")
SHOWN = 3  # frames of a film, where it presses hardest


def digest(paths: list[Path]) -> str:
    """Digest of files, in the order given."""
    found = hashlib.sha256()
    for path in paths:
        found.update(path.read_bytes())
    return found.hexdigest()


def publish_picture(out: Path, content: bytes, data: list[Path]) -> None:
    """Write a picture, and beside it what it was made from."""
    with publish(out) as part:
        part.write_bytes(content)
    write_json(out.with_suffix(".json"), {"data": {str(path): digest([path]) for path in data}})


def outdated(picture: Path) -> list[str]:
    """Data of a picture that are here and are no longer what it shows."""
    known = read_json(picture.with_suffix(".json"))["data"]
    return [name for name, held in known.items() if Path(name).exists() and digest([Path(name)]) != held]


def hardest_frames(film: Path, trained, count: int = SHOWN):
    """(image, forces) of a film's frames with the largest force, one each third of it, as far as the camera sees."""
    import cv2

    from gelforge.networks.still import find_untouched
    from gelforge.networks.use import Untouched, predict_one
    from gelforge.records.film import frames, open_source

    source, announced = open_source(film, None)
    seen = (cv2.cvtColor(frame, cv2.COLOR_BGR2RGB) for frame in frames(source, announced, str(film), None))
    picture, images = find_untouched(seen, str(film))
    untouched = Untouched(trained, picture)
    read = [predict_one(untouched, image)[:2] for image in images]
    parts = np.array_split(np.arange(len(read)), count)
    hardest = [max((read[at] for at in part), key=lambda pair: -pair[1][2].sum()) for part in parts if len(part)]
    return [shown(image, forces, untouched.view) for image, forces in hardest]


def shown(image: np.ndarray, forces: np.ndarray, view) -> tuple[np.ndarray, np.ndarray]:
    """The part of an image (h, w, 3) and of its forces (3, rows, cols) that a view shows (networks.canonical.View)."""
    pixels = view.shown(image.shape)
    cells = tuple(
        slice(round(part.start * count / size), round(part.stop * count / size))
        for part, count, size in zip(pixels, forces.shape[1:], image.shape, strict=False)
    )
    return image[pixels], forces[(slice(None), *cells)]


@command(option("films", nargs="+", type=Path), option("--out", type=Path))
def real(args: Namespace) -> None:
    """Real sensor pictures beside the force maps that the shipped network reads in them."""
    from gelforge.networks.use import load_for_use
    from gelforge.reporting.canvas import canvas_with_axes, to_png

    trained, rows = load_for_use(None), []
    for film in args.films:
        rows.append(hardest_frames(film, trained))
    figure, axes = canvas_with_axes(len(rows), 2 * SHOWN, 12, 1.6 * len(rows) + 0.3)
    for line, pairs in zip(axes, rows, strict=True):
        most = max(float(-forces[2].min()) for _, forces in pairs)  # one scale for the frames of a film
        for axis in line:
            axis.set_axis_off()
        for k, (image, forces) in enumerate(pairs):
            line[2 * k].imshow(image)
            line[2 * k + 1].imshow(-forces[2], cmap="inferno", vmin=0, vmax=most)
            line[2 * k + 1].set_title(f"{-forces[2].sum():.1f} N", fontsize=9)
    publish_picture(args.out, to_png(figure), [SHIPPED, *args.films])


@command(
    option("--chart", type=Path, help="picture that a branch drew"),
    option("--data", type=Path),
    option("--out", type=Path),
)
def copy(args: Namespace) -> None:
    """A branch's chart as it was drawn."""
    if not (args.chart.exists() and args.data.exists()):
        raise BadInput(f"{args.chart}: not there; draw it with make pareto and make stability, which take hours")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    publish_picture(args.out, args.chart.read_bytes(), [args.data])
    shutil.copystat(args.chart, args.out)


main = group(real=real, copy=copy)


if __name__ == "__main__":
    main.exit()
