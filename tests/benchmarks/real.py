"""The shipped network on images of real, unseen sensors for which part of the truth is known.

No force was measured with these images. Known are: the force under a ball of known diameter
(`tests/benchmarks/parts/balls.py`); zero force on a released gel; the direction of a tangential force, by the
markers' motion; FEATS' published maps of 51 presses; the sizes of the square under a cuboid and of the ring under a
tube. The same images are also corrupted on purpose (`tests/benchmarks/parts/spoilt.py`), and balls are rendered whose
markers move less than by finite elements.
"""

import itertools
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from gelforge.api import gelsight_mini
from gelforge.errors import BadInput
from gelforge.flow.cli import command, option
from gelforge.formats.featsfile import read_npy
from gelforge.reading.forcereading import ForceReading
from gelforge.reading.interval import half_widths, magnitudes, real_sideways, real_width
from gelforge.reading.model import ForceModel, fingerprint, load_model
from gelforge.reading.profile import fit_gain
from gelforge.reading.reader import Reader
from gelforge.records.image import read_image
from tests.benchmarks.parts.ball_presses import BACKGROUND, read_presses
from tests.benchmarks.parts.balls import FOLDER as BALLS
from tests.benchmarks.parts.balls import ball_figures, motion_figures
from tests.benchmarks.parts.films import finger_figures, read_film, released_figures, sideways_figures
from tests.benchmarks.parts.imprint import found_radius
from tests.benchmarks.parts.spoilt import EACH, Series, spoilt_figures
from tests.support.feats_film import feats_maps
from tests.support.figures import PUBLISHED_DATA, Figure, publish_figures

NAMED = np.s_[:5, :10]  # cells of a map that the panels' names cover
SEEN = np.ones((24, 32), bool)  # cells that they do not cover
SEEN[NAMED] = SEEN[:3, :11] = False
# Scale of the images and of FEATS' maps at 320 x 240 (gelsight_mini and feats_mini of workflow/sensors.toml).
PX_PER_MM, FEATS_PX_PER_MM = float(np.hypot(*gelsight_mini().projection[0, :2])), 14.0
# Cells of the square in the image of the pressed cuboid, with a margin of one cell on each side.
SQUARE = np.s_[4:20, 8:23]
# Diameter of the ring under a tube of 10 and 7 mm with rounded edges, in the rig's labels (140 presses; +- 0.05 mm).
TUBE_MM = 8.6
TUBES = (9, 31, 45, 49)  # frames of FEATS' film in which the whole ring of that tube presses
FOOT = 0.35  # fraction of a map's largest force from which a cell counts as pressed
NEWTONS = 0.30, 0.17  # N per cell at the end of FEATS' colour scale: both values are in its code
SIDEWAYS_NEWTONS = 0.07  # the same for its tangential maps, which goes with the first value
PARTS = ("films", "maps", "balls", "drawn", "cuboid")
LEAST_TOTAL = 0.05  # N, lower bound of predicted totals before a logarithm
# Folders of the reference data, and files that each must hold.
HELD = {"gripper_videos": "*.avi", "feats/images": "*.gif", BALLS: "background.png"}


# -- FEATS' film of its force maps


def laid(cells: np.ndarray, fraction: float, right: float = 0.0, down: float = 0.0) -> np.ndarray:
    """A map (rows, cols) scaled by `fraction` about its centre and shifted by `right` and `down` cells."""
    size = cells.shape[::-1]
    shift = (1.0 - fraction) * (np.array(size) - 1) / 2 + (right, down)
    matrix = np.array([[fraction, 0.0, shift[0]], [0.0, fraction, shift[1]]])
    return cv2.warpAffine(cells.astype(np.float32), matrix, size)


def likeness(maps: list[tuple[np.ndarray, np.ndarray]], *how: float) -> float:
    """Median correlation of FEATS' normal maps with predicted ones after `laid(…, *how)`, without covered cells."""
    return float(np.median([np.corrcoef(laid(own, *how)[SEEN], normal[SEEN])[0, 1] for own, normal in maps]))


def gif_figures(own: list[np.ndarray], of_feats: list[np.ndarray]) -> list[Figure]:
    """Predicted normal maps (24, 32) N, larger for more pressure, against FEATS' own, by correlation."""
    both, own_mm = list(zip(own, of_feats, strict=True)), FEATS_PX_PER_MM / PX_PER_MM
    ways = itertools.product(np.arange(0.8, 1.01, 0.02), *[np.arange(-2.0, 2.01, 0.25)] * 2)
    best, how = max((likeness(both, *how), how) for how in ways)
    note = f"{len(both)} presses, each at its own mm; pixel for pixel {likeness(both, 1.0):.2f}"
    moved_so = "FEATS' maps {:.2f} times as large, {:+.2f} and {:+.2f} cells to the right and down".format(*how)
    return [
        Figure("normal map against FEATS' maps, correlation, median", likeness(both, own_mm), ">=", 0.9, "", note),
        Figure("the same after one scale and shift for all of them", best, ">=", 0.93, "", moved_so),
        Figure("place of an imprint beside FEATS' maps", float(np.hypot(*how[1:])), "<=", 0.25, "cells"),
        Figure("totals against the sums of FEATS' maps, rank correlation", ranks_alike(both), ">=", 0.9),
    ]  # fmt: skip


def newton_figures(own: list[np.ndarray], of_feats: np.ndarray, normal: list[np.ndarray]) -> list[Figure]:
    """Total normal force against FEATS' maps in newtons. of_feats: (n,) sums of its maps, with one scale from 0 to 1.

    normal: FEATS' maps (24, 32), whose cells above `FOOT` of the largest are the area of contact.
    """
    total = np.array([one[SEEN].sum(dtype=float) for one in own])
    logarithms = np.log(np.maximum(total, LEAST_TOTAL) / of_feats)
    median, other = (float(np.exp(np.median(logarithms))) / newtons for newtons in NEWTONS)
    note = f"{len(logarithms)} presses; with {NEWTONS[1]:.2f} N a cell {other:.2f}"
    nine = float(np.quantile(np.abs(np.exp(np.median(logarithms) - logarithms) - 1.0), 0.9))
    # cells under the label box belong to no map: they would count as pressed
    area = np.array([((one > FOOT * one[SEEN].max()) & SEEN).sum() for one in normal])
    trend = float(np.corrcoef(logarithms, np.log(area))[0, 1])
    return [
        Figure("totals over FEATS' maps, deviation of the logarithm", float(logarithms.std()), "<=", 0.29, "", f"{len(logarithms)} presses"),
        Figure("the same after their median: nine of ten within", 100 * nine, "<=", 46.0, "%"),
        Figure("the same: correlation with the logarithm of the area of contact", abs(trend), "<=", 0.3, "", f"{trend:+.2f}"),
        Figure(f"the same at {NEWTONS[0]:.2f} N a cell, median: at least", median, ">=", 0.85, "", note),
        Figure(f"the same at {NEWTONS[0]:.2f} N a cell, median: at most", median, "<=", 1.15),
    ]  # fmt: skip


def interval_figures(
    evidence: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> tuple[list[Figure], dict[str, float]]:
    """Coverage of 90 % intervals on real sensors, and the fraction of force by which they must widen.

    evidence: by kind, the predicted and the known force and half the width of the network's own interval, (n,) N
    each. Without a profile, each kind is tested with the width that the other kinds need. With a profile, its factor
    comes from ten presses, and the rest of the kind is tested with the width that the other kinds need.
    """
    unprofiled, profiled, rest = {}, {}, {}
    for kind, (read, force, half) in evidence.items():
        unprofiled[kind] = real_width(read, force, half)
        ten = np.round(np.linspace(0, len(read) - 1, 10)).astype(int)
        gain = fit_gain(force[ten], read[ten])
        others = np.setdiff1d(np.arange(len(read)), ten)
        scaled = gain.value * read[others], force[others], gain.value * half[others]
        profiled[kind], rest[kind] = (
            real_width(scaled[0], scaled[1], np.hypot(scaled[2], gain.unsure * scaled[0])),
            (*scaled, gain),
        )
    figures = []
    for kind, (read, force, half) in evidence.items():
        width = max(value for other, value in unprofiled.items() if other != kind)
        held = 100 * float(np.mean(np.abs(read - force) <= np.hypot(half, width * read)))
        own = 100 * float(np.mean(np.abs(read - force) <= half))
        note = f"+- {100 * width:.0f} %; the network's own hold {own:.0f} %; {len(read)} images need {100 * unprofiled[kind]:.0f} %"
        figures.append(
            Figure(
                f"90 % interval without a profile, width by other sensors: holds on {kind}",
                held,
                ">=",
                85.0,
                "%",
                note,
            )
        )
        read, force, half, gain = rest[kind]
        width = max(value for other, value in profiled.items() if other != kind)
        held = 100 * float(np.mean(np.abs(read - force) <= np.hypot(half, np.hypot(gain.unsure, width) * read)))
        note = f"factor {gain.value:.2f} from ten; +- {100 * width:.0f} % beside it; {len(read)} images need {100 * profiled[kind]:.0f} %"
        figures.append(
            Figure(f"the same with a profile of ten presses: holds on {kind}", held, ">=", 85.0, "%", note)
        )
    return figures, {"unprofiled": round(max(unprofiled.values()), 3), "profiled": round(max(profiled.values()), 3)}


def sideways_width(model: ForceModel, read: Sequence[ForceReading]) -> float:
    """The fraction of a force's magnitude by which intervals of sideways force must widen on real sensors.

    read: of presses straight down on real sensors, whose sideways force is zero.
    """
    own = {**model.metadata, "intervals": {**model.metadata["intervals"], "real": {}}}
    half = np.array([widths[:2] for one in read if (widths := half_widths(own, one.total)) is not None])
    aside, whole = np.array([one.total[:2] for one in read]), magnitudes(np.array([one.total for one in read]))
    return real_sideways(aside, whole, half) if len(half) == len(read) else 0.0


def aside_figures(kind: str, read: Sequence[ForceReading], known: np.ndarray | None = None) -> list[Figure]:
    """Predicted tangential forces: the largest error, and the coverage of their intervals.

    known: true ones, (n, 2) N along gel x and y; None for presses straight down, where they are zero.
    """
    aside = np.array([one.total[:2] for one in read])
    error = np.abs(aside if known is None else aside - known)
    widths = np.array([one.half_width[:2] for one in read if one.half_width is not None])
    normal = abs(read[int(error.max(axis=1).argmax())].total[2])
    note = f"of {normal:.1f} N; median {np.median(error):.2f} N; {len(read)} presses"
    if known is not None:
        note += f"; correlation {np.corrcoef(aside.ravel(), known.ravel())[0, 1]:.2f}"
    held = 100 * float(np.mean(error <= widths)) if len(widths) == len(error) else 0.0
    return [
        Figure(f"{kind}: sideways force, largest error", float(error.max()), "<=", 0.6, "N", note),
        Figure("the same: 90 % intervals hold", held, ">=", 90.0, "%"),
    ]  # fmt: skip


def evidence_of(
    model: ForceModel, read: Sequence[ForceReading], forces: np.ndarray, seen: np.ndarray | slice = np.s_[:]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Predicted normal force, known one, and half the width of the network's own interval, (n,) N each.

    seen: cells that count.
    """
    own = {**model.metadata, "intervals": {**model.metadata["intervals"], "real": {}}}
    widths = [half_widths(own, one.total) for one in read]
    half = np.array([0.0 if width is None else float(width[2]) for width in widths])
    return np.array([-float(one.cells[2][seen].sum(dtype=float)) for one in read]), forces, half


def feats_figures(
    reference: Path, model: ForceModel, nocontact: np.ndarray
) -> tuple[list[Figure], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Figures of FEATS' presses, and their `evidence_of` intervals."""
    folder, predictor = reference / "feats/images", Reader(nocontact, model=model)
    presses = feats_maps(folder / "demo.gif", nocontact)
    read = [predictor(image) for image, _ in presses]
    own = [-one.cells[2] for one in read]
    with np.load(folder / "demo_maps.npz") as stored:
        sums, *aside = (stored[axis][:, SEEN].sum(axis=1, dtype=float) for axis in "zyx")  # FEATS' x is gel y
    series = Series("FEATS' presses", model, nocontact, [image for image, _ in presses[::EACH]], read[::EACH])
    figures = [
        *gif_figures(own, [normal for _, normal in presses]),
        *tube_figures(own),
        *newton_figures(own, sums, [normal for _, normal in presses]),
    ]
    flagged = Figure("good FEATS' presses flagged", 100 * float(np.mean([one.flag for one in read])), "<=", 2.0, "%")
    figures += aside_figures("FEATS' presses", read, SIDEWAYS_NEWTONS * np.stack(aside, axis=1))
    return [*figures, flagged, *spoilt_figures(series)], evidence_of(model, read, NEWTONS[0] * sums, SEEN)


def real_ball_figures(
    folder: Path, model: ForceModel
) -> tuple[list[Figure], tuple[np.ndarray, np.ndarray, np.ndarray], list[ForceReading]]:
    """Figures of the presses of a ball, which are straight down, their `evidence_of` intervals, and what is read."""
    background = read_image(folder / BACKGROUND)
    presses = read_presses(folder, PX_PER_MM)
    predictor = Reader(background, model=model)
    read = [predictor(press.image) for press in presses]
    series = Series("real balls", model, background, [press.image for press in presses[::EACH]], read[::EACH])
    figures = [
        *ball_figures(presses, read, np.array([found_radius(predictor.compare(press.image)) for press in presses])),
        *aside_figures("real balls", read),
        *spoilt_figures(series),
    ]
    return figures, evidence_of(model, read, np.array([press.force for press in presses])), read


def ranks_alike(maps: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Spearman's rank correlation of the sums of pairs of maps, without covered cells."""
    from scipy.stats import spearmanr

    return float(spearmanr([[own[SEEN].sum(), normal[SEEN].sum()] for own, normal in maps]).statistic)


def ring_diameter(pressed: np.ndarray) -> float:
    """Diameter in cells of the circle fitted to pressed cells of a map (rows, cols), by least squares (Kasa 1976)."""
    weight = np.sqrt(np.where(pressed > FOOT * pressed.max(), pressed, 0.0)).ravel()
    v, u = np.indices(pressed.shape).reshape(2, -1).astype(float)
    sides = np.stack([u, v, np.ones_like(u)], axis=1) * weight[:, None]
    (along, across, rest), *_ = np.linalg.lstsq(sides, -(u * u + v * v) * weight, rcond=None)
    return float(np.sqrt(along * along + across * across - 4.0 * rest))


def tube_figures(own: list[np.ndarray]) -> list[Figure]:
    """Predicted diameter of the rings under a tube of known size, which checks the scale of the images.

    own: predicted normal map (24, 32) N of each of FEATS' presses.
    """
    widths = []
    for tube in TUBES:
        pressed = own[tube].copy()
        pressed[NAMED] = 0.0
        widths.append(ring_diameter(pressed) * 10.0 / PX_PER_MM)
    off = 100 * abs(float(np.mean(widths)) / TUBE_MM - 1.0)
    note = f"{np.mean(widths):.2f} mm for {TUBE_MM:g}; {', '.join(f'{width:.2f}' for width in widths)}"
    return [Figure("tube of 10 and 7 mm: diameter of the ring read, error", off, "<=", 3.0, "%", note)]


def read_cuboid(reference: Path, model: ForceModel, nocontact: np.ndarray) -> ForceReading:
    """What is read of a 10 mm cuboid that is pressed straight down."""
    image = read_image(reference / "feats/images/cuboid_10-2-284.png")[..., :3]
    return Reader(nocontact, model=model)(image)


def cuboid_figures(cuboid: ForceReading) -> list[Figure]:
    """A 10 mm cuboid pressed straight: tangential over normal force, and the fraction predicted inside its square."""
    cells = cuboid.cells
    normal, sideways = -cells[2].sum(), float(np.hypot(*cells[:2].sum((1, 2))))
    within = 100 * float(cells[2][SQUARE].sum() / cells[2].sum())
    return [
        Figure("cuboid pressed straight, sideways over normal force", 100 * sideways / abs(normal), "<=", 3.0, "%", f"normal {normal:.1f} N"),
        Figure("cuboid: normal force that is read within its square", within, ">=", 90.0, "%", "the gel is mounted 10 px beside its no-contact image"),
    ]  # fmt: skip


def need_pictures(reference: Path) -> None:
    """BadInput if a folder does not hold the real images."""
    missing = [f"{name}/{kind}" for name, kind in HELD.items() if not any((reference / name).glob(kind))]
    if missing:
        raise BadInput(
            f"{reference}: holds no {' and no '.join(missing)}; name the folder of the real pictures: REFERENCE=FOLDER"
            " for make real-check, the environment variable GELFORGE_REFERENCE for make benchmark-real"
        )


@command(
    option("--reference", type=Path, default=PUBLISHED_DATA),
    option("--model", type=Path, default=None, help="model file; the one that ships if not named"),
    option("--parts", nargs="+", choices=PARTS, default=PARTS, help="fewer only to try it out; a page needs all"),
    option("--out", type=Path, default=Path("results/benchmarks/real.json")),
    option("--page", type=Path, default=None, help="write the pictures and what is read in them to this page"),
)
def main(args: Namespace) -> None:
    need_pictures(args.reference)
    model = load_model(args.model)
    films = sorted((args.reference / "gripper_videos").glob("*.avi"))
    nocontact = read_npy(args.reference / "feats/images/nocontact_train_sensor.npy")["gs_img"]
    figures = []
    evidence: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
    if "films" in args.parts:
        read = {path.stem: read_film(path, model) for path in tqdm(films, "films", len(films))}
        figures += [*released_figures(read), *finger_figures(read), *sideways_figures(read)]
    if "maps" in args.parts:
        found, evidence["FEATS' presses"] = feats_figures(args.reference, model, nocontact)
        figures += found
    if "balls" in args.parts:
        found, evidence["real balls"], straight = real_ball_figures(args.reference / BALLS, model)
        figures += found
    if "drawn" in args.parts:
        figures += motion_figures(model)
    if "cuboid" in args.parts:
        cuboid = read_cuboid(args.reference, model, nocontact)
        figures += cuboid_figures(cuboid)
    told = {}
    if {"maps", "balls", "cuboid"} <= set(args.parts):
        intervals, real = interval_figures(evidence)
        straight = [*straight, cuboid]  # both are pressed straight down
        figures, told = (
            [*figures, *intervals],
            {"real": real | {"sideways": round(sideways_width(model, straight), 3)}},
        )
    publish_figures(args.out, figures, fingerprint(model.metadata), **told)
    if args.page and len(args.parts) == len(PARTS):
        from tests.benchmarks.parts.real_page import write_page

        write_page(args.page, model, args.reference, films, figures)


if __name__ == "__main__":
    main.exit()
