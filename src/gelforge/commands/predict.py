"""Force maps and totals from images: `gelforge predict IMAGE…`.

For every image a picture and the map as .npy, float32 (3, rows, cols) in N per cell, and one totals.csv.
Columns grid_x_n, grid_y_n, grid_z_n are FEATS' channels: force along gel y, along gel x, along the normal.
A network that reads differences needs a picture of the sensor while nothing touches it: --untouched FILE, or one
of the training sensors by its name, or, where neither is named, the training sensor that the image is nearest to.
"""

import tempfile
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput, printable
from gelforge.flow.files import publish, write_csv
from gelforge.flow.main import command, option, positive
from gelforge.records.axes import CHANNELS
from gelforge.records.image import read_image

SHIPPED = Path(__file__).parents[1] / "networks" / "default.pt"
COLUMNS = ["image", *(f"{name}_n" for name in CHANNELS), "untouched", "unlike_training", "flagged", "reason"]


def load_for_use(path, sensor: str | None = None):
    """Load a model for prediction and check that it is for `sensor`, where one is named."""
    from gelforge.networks.modelfile import load_model, require_sensor

    if path is None and not SHIPPED.exists():
        raise BadInput(
            "no model came with this copy of gelforge: train one with `make train` and name it with --model"
        )
    trained = load_model(path or SHIPPED)
    if sensor:
        require_sensor(trained, {sensor})
    return trained


def fit_size(image, size) -> tuple[np.ndarray, str]:
    """Bring an image to a model's (height, width); the second value says what was done, empty for nothing."""
    import cv2

    if image.shape[:2] == tuple(size):
        return image, ""
    resized = cv2.resize(image, (size[1], size[0]), interpolation=cv2.INTER_AREA)
    return resized, f"size {image.shape[1]} x {image.shape[0]}, trained on {size[1]} x {size[0]}"


class Untouched:
    """Finds the picture of the untouched sensor that an image is read against.

    picture: (h, w, 3) uint8 RGB of any size, given by the user. sensor: name of a training sensor. With neither,
    each image is read against the training sensor it is nearest to.
    """

    def __init__(self, trained, picture: np.ndarray | None = None, sensor: str | None = None):
        self.trained, self.known = trained, trained.untouched
        if not trained.needs_untouched:
            self.known = {"": None}
        elif picture is not None:
            self.known = {"given": fit_size(picture, trained.about["image"])[0]}
        elif sensor in trained.untouched:
            self.known = {sensor: trained.untouched[sensor]}
        elif sensor or not trained.untouched:
            raise BadInput(
                f"model {trained.about['name']} has no picture of the untouched sensor {sensor or 'of any name'}: give "
                "one with --untouched"
            )
        self._readers: dict[str, Any] = {}

    def of(self, image) -> str:
        """Name of the picture for an image (h, w, 3) of the model's size."""
        from gelforge.networks.statistics import distance

        if len(self.known) == 1:
            return next(iter(self.known))
        return min(self.known, key=lambda name: distance(image, self.known[name]))

    def reader(self, name: str):
        """The network for the sensor of that picture."""
        from gelforge.networks.modelfile import Reader

        if name not in self._readers:
            self._readers[name] = Reader(self.trained, self.known[name]).eval()
        return self._readers[name]


def predict_one(untouched: Untouched, image) -> tuple[np.ndarray, np.ndarray, dict]:
    """Predict an image of any size; return it as the network saw it, forces (3, rows, cols), and the judgement.

    The judgement is that of networks.statistics.judge, and `untouched`: what picture the image was read against.
    """
    from gelforge.networks.latency import predict_images
    from gelforge.networks.statistics import judge

    trained = untouched.trained
    image, resized = fit_size(image, trained.about["image"])
    name = untouched.of(image)
    verdict = judge(trained.about["statistics"], image, untouched.known[name]) | {"untouched": name}
    if resized:
        verdict = verdict | {"flag": True, "reason": "; ".join(filter(None, [resized, verdict["reason"]]))}
    return image, predict_images(untouched.reader(name), image[None])[0], verdict


def totals_row(name: str, forces, verdict: dict) -> dict:
    """One row of totals.csv."""
    total = forces.sum((1, 2), dtype=np.float64)
    return {
        "image": name,
        **{f"{channel}_n": f"{value:.4f}" for channel, value in zip(CHANNELS, total, strict=True)},
        "untouched": verdict["untouched"],
        "unlike_training": f"{verdict['score']:.2f}",
        "flagged": int(verdict["flag"]),
        "reason": verdict["reason"],
    }


def output_names(paths) -> list[str]:
    """Stems for the outputs, made distinct where two images share one."""
    seen: dict[str, int] = {}
    names = []
    for path in paths:
        stem = Path(path).stem
        seen[stem] = seen.get(stem, 0) + 1
        names.append(stem if seen[stem] == 1 else f"{stem}-{seen[stem]}")
    return names


def need_folder(out: Path) -> None:
    """Make the folder of the outputs; one that cannot be written into raises BadInput before anything is read."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise BadInput(f"--out {out}: cannot be written into ({error.strerror}); name another folder") from error


def predict_files(paths, untouched: Untouched, out: Path) -> list[dict]:
    """Predict image files and write their maps and totals.csv below `out`; return the rows of totals.csv.

    Every image is read before anything is written.
    """
    from gelforge.reporting.forcemaps import write_maps

    images = [read_image(path) for path in paths]
    need_folder(out)
    rows = []
    for path, name, image in zip(paths, output_names(paths), images):
        image, forces, verdict = predict_one(untouched, image)
        row = totals_row(str(path), forces, verdict)
        with publish(out / f"{name}.npy") as part:
            np.save(part, forces)
        with publish(out / f"{name}.png") as part:
            flag = f" | UNLIKE TRAINING: {verdict['reason']}" if verdict["flag"] else ""
            write_maps(part, image, forces, f"{name}, score {verdict['score']:.1f}{flag}")
        rows.append(row)
    write_csv(out / "totals.csv", COLUMNS, rows)
    return rows


@command(
    option("images", nargs="+", type=Path, metavar="IMAGE"),
    option("--model", type=Path, help="model file; the one that came with gelforge if not named", default=None),
    option("--sensor", help="the sensor of the images; refused if the model is for another one", default=None),
    option("--untouched", type=Path, metavar="IMAGE", help="the sensor while nothing touches it", default=None),
    option("--out", type=Path, default=Path("predictions"), help="folder (default: %(default)s)"),
    option("--threads", type=positive, default=1),
)
def main(args: Namespace) -> None:
    import torch

    torch.set_num_threads(args.threads)
    picture = read_image(args.untouched) if args.untouched else None
    untouched = Untouched(load_for_use(args.model, args.sensor), picture, args.sensor)
    rows = predict_files(args.images, untouched, args.out)
    for row in rows:
        warning = f"  UNLIKE TRAINING ({row['unlike_training']}): {row['reason']}" if row["flagged"] else ""
        against = f" against {row['untouched']}" if row["untouched"] else ""
        forces = ", ".join(f"{channel} {row[f'{channel}_n']}" for channel in CHANNELS)
        print(printable(f"{row['image']}: {forces} N{against}{warning}"))
    print(f"maps and totals.csv in {args.out}")


if __name__ == "__main__":
    main.exit()
