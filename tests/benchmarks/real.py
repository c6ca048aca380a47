"""The shipped network on images of real, unseen sensors for which part of the truth is known.

No force was measured with these images. Known are: the force under a ball of known diameter
(`tests/benchmarks/parts/balls.py`); zero force on a released gel; the direction of a tangential force, by the
markers' motion; the sizes of the square under a cuboid and of the ring under a tube; and, of 28 of FEATS' presses, the
force by shading and by markers outside of the contact, whose mean is the consensus below. FEATS' published maps of 51
presses are no truth: they are solves without the tilt of their bench. Their totals have no goal. The same images are
also corrupted on purpose (`tests/benchmarks/parts/spoilt.py`); balls are rendered whose markers move otherwise than by
finite elements, and flat bodies that lean (`tests/benchmarks/parts/twins.py`).
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
from gelforge.records.table import read_table
from tests.benchmarks.parts.ball_presses import BACKGROUND, read_presses
from tests.benchmarks.parts.balls import FOLDER as BALLS
from tests.benchmarks.parts.balls import ball_figures, motion_figures
from tests.benchmarks.parts.films import finger_figures, read_film, released_figures, sideways_figures
from tests.benchmarks.parts.imprint import found_radius
from tests.benchmarks.parts.spoilt import EACH, Series, spoilt_figures
from tests.benchmarks.parts.twins import FOOT, twin_figures
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
NEWTONS = 0.30, 0.17  # N per cell at the end of FEATS' colour scale: both values are in its code
SIDEWAYS_NEWTONS = 0.07  # the same for its tangential maps, which goes with the first value
PARTS = ("films", "maps", "balls", "spoilt", "drawn", "twins", "cuboid")
HOLD = 88.0, 95.0  # per cent of forces that 90 % intervals may hold
WIDTH, PROFILED_WIDTH = 45.0, 35.0  # per cent of the force: goals of half an interval without and with a profile
CONSENSUS = "the consensus"
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
        Figure("totals against the sums of FEATS' maps, rank correlation", ranks_alike(both), "", 0.0),
    ]  # fmt: skip


def newton_figures(own: list[np.ndarray], of_feats: np.ndarray) -> list[Figure]:
    """Total normal force against FEATS' maps in newtons. of_feats: (n,) sums of its maps, with one scale from 0 to 1."""
    total = np.array([one[SEEN].sum(dtype=float) for one in own])
    logarithms = np.log(np.maximum(total, LEAST_TOTAL) / of_feats)
    median, other = (float(np.exp(np.median(logarithms))) / newtons for newtons in NEWTONS)
    note = f"{len(logarithms)} presses; median {median:.2f} at {NEWTONS[0]:.2f} N a cell, {other:.2f} at {NEWTONS[1]:.2f}; solves without tilt"
    return [Figure("totals over FEATS' maps, deviation of the logarithm", float(logarithms.std()), "", 0.0, "", note)]


def consensus_figures(
    reference: Path, model: ForceModel, read: Sequence[ForceReading], normal: Sequence[np.ndarray]
) -> tuple[list[Figure], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Total normal force against the mean of two estimates of 28 presses, and evidence for intervals.

    read: of all of FEATS' presses. normal: FEATS' maps (24, 32) of them, whose cells above `FOOT` of the largest are
    the area of contact. The estimates are forces by shading and by the motion of markers outside of the contact. Their
    own difference is stated: independent errors give their mean half of its deviation.
    """
    rows = read_table(reference / "feats/consensus.csv", "restore it")
    frames = [int(row["frame"]) for row in rows]
    shading, motion, feats = (
        np.array([float(row[name]) for row in rows]) for name in ("shading_n", "motion_n", "feats_n")
    )
    force, total = np.sqrt(shading * motion), np.array([-float(read[frame].total[2]) for frame in frames])
    off = np.log(np.maximum(total, LEAST_TOTAL) / force)
    # cells under the label box belong to no map: they would count as pressed
    area = np.array([((normal[k] > FOOT * normal[k][SEEN].max()) & SEEN).sum() for k in frames])
    trend, median = float(np.corrcoef(off, np.log(area))[0, 1]), float(np.exp(np.median(off)))
    note = (
        f"{len(rows)} presses; FEATS' maps {np.log(feats / force).std():.2f}; deviation of the two estimates"
        f" from each other {np.log(shading / motion).std():.2f}"
    )
    return [
        Figure("totals over the consensus, deviation of the logarithm", float(off.std()), "<=", 0.2, "", note),
        Figure("totals over the consensus, median: at least", median, ">=", 0.9, "", f"mean of the logarithm {off.mean():+.3f}"),
        Figure("totals over the consensus, median: at most", median, "<=", 1.1),
        Figure("totals over the consensus, correlation with the logarithm of the area of contact", abs(trend), "<=", 0.3, "", f"{trend:+.2f}"),
    ], (total, force, own_half_widths(model, [read[frame] for frame in frames]))  # fmt: skip


def interval_figures(
    model: ForceModel, evidence: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]
) -> tuple[list[Figure], dict[str, float]]:
    """Coverage and width of the stated 90 % intervals, and the fractions of force by which they must widen.

    evidence: by kind, the predicted and the known force and half the width of the network's own interval, (n,) N each.
    With a profile, its factor comes from ten presses of the kind. The fractions are those at which the intervals hold
    nine of ten presses of all kinds together: the kinds are two sensors, too few for a fraction by each.
    """
    real, figures = model.metadata["intervals"].get("real", {}), []
    own: dict[str, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = {"unprofiled": [], "profiled": []}
    for kind, (read, force, half) in evidence.items():
        ten = np.round(np.linspace(0, len(read) - 1, 10)).astype(int)
        others, gain = np.setdiff1d(np.arange(len(read)), ten), fit_gain(force[ten], read[ten])
        scaled = gain.value * read[others]
        cases = {"unprofiled": (read, force, half),
                 "profiled": (scaled, force[others], np.hypot(gain.value * half[others], gain.unsure * scaled))}  # fmt: skip
        for (case, found), name, widest in zip(
            cases.items(),
            ("without a profile", "with a profile of ten presses"),
            (WIDTH, PROFILED_WIDTH),
            strict=True,
        ):
            own[case].append(found)
            found_read, known, width = found[0], found[1], np.hypot(found[2], real.get(case, 0.0) * found[0])
            what, held = f"90 % interval {name}", 100 * float(np.mean(np.abs(found_read - known) <= width))
            note = f"{len(known)} images; factor {gain.value:.2f}" if case == "profiled" else f"{len(known)} images"
            figures += [
                Figure(f"{what} holds on {kind}: at least", held, ">=", HOLD[0], "%", note),
                Figure(f"{what} holds on {kind}: at most", held, "<=", HOLD[1], "%"),
                Figure(f"{what}, half of it over the force, median on {kind}",
                       100 * float(np.median(width / found_read)), "<=", widest, "%"),
            ]  # fmt: skip
    widths = {
        case: round(real_width(*map(np.concatenate, zip(*found, strict=True))), 3) for case, found in own.items()
    }
    return figures, widths


def sideways_width(model: ForceModel, read: Sequence[ForceReading]) -> float:
    """The fraction of a force's magnitude by which intervals of sideways force must widen on real sensors.

    read: of presses straight down on real sensors, whose sideways force is zero.
    """
    own = {**model.metadata, "intervals": {**model.metadata["intervals"], "real": {}}}
    half = np.array([widths[:2] for one in read if (widths := half_widths(own, one.total)) is not None])
    aside, whole = np.array([one.total[:2] for one in read]), magnitudes(np.array([one.total for one in read]))
    return real_sideways(aside, whole, half) if len(half) == len(read) else 0.0


def aside_figures(kind: str, read: Sequence[ForceReading]) -> list[Figure]:
    """Predicted tangential forces of presses straight down, where they are zero: the largest, and whether intervals hold zero."""
    error = np.abs(np.array([one.total[:2] for one in read]))
    widths = np.array([one.half_width[:2] for one in read if one.half_width is not None])
    normal = abs(read[int(error.max(axis=1).argmax())].total[2])
    note = f"of {normal:.1f} N; median {np.median(error):.2f} N; {len(read)} presses"
    held = 100 * float(np.mean(error <= widths)) if len(widths) == len(error) else 0.0
    return [
        Figure(f"{kind}: sideways force, largest error", float(error.max()), "<=", 0.6, "N", note),
        Figure("the same: 90 % intervals hold", held, ">=", 90.0, "%"),
    ]  # fmt: skip


def own_half_widths(model: ForceModel, read: Sequence[ForceReading]) -> np.ndarray:
    """Half the widths of the network's own intervals of normal force, without what real sensors add, (n,) N."""
    own = {**model.metadata, "intervals": {**model.metadata["intervals"], "real": {}}}
    widths = [half_widths(own, one.total) for one in read]
    return np.array([0.0 if width is None else float(width[2]) for width in widths])


def feats_figures(
    reference: Path, model: ForceModel, nocontact: np.ndarray
) -> tuple[list[Figure], tuple[np.ndarray, np.ndarray, np.ndarray], Series]:
    """Figures of FEATS' presses; predicted force, consensus and half the network's own interval of 28; what is spoilt."""
    folder, predictor = reference / "feats/images", Reader(nocontact, model=model)
    presses = feats_maps(folder / "demo.gif", nocontact)
    read, normal = [predictor(image) for image, _ in presses], [normal for _, normal in presses]
    own = [-one.cells[2] for one in read]
    with np.load(folder / "demo_maps.npz") as stored:
        sums, *aside = (stored[axis][:, SEEN].sum(axis=1, dtype=float) for axis in "zyx")  # FEATS' x is gel y
    series = Series("FEATS' presses", model, nocontact, [image for image, _ in presses[::EACH]], read[::EACH])
    known, evidence = consensus_figures(reference, model, read, normal)
    off = np.abs(np.array([one.total[:2] for one in read]) - SIDEWAYS_NEWTONS * np.stack(aside, axis=1))
    figures = [
        *gif_figures(own, normal),
        *tube_figures(own),
        *newton_figures(own, sums),
        *known,
        Figure("sideways totals against FEATS' maps, median error", float(np.median(off)), "", 0.0, "N", f"largest {off.max():.1f} N"),
        Figure("good FEATS' presses flagged", 100 * float(np.mean([one.flag for one in read])), "<=", 2.0, "%"),
    ]  # fmt: skip
    return figures, evidence, series


def real_ball_figures(
    folder: Path, model: ForceModel
) -> tuple[list[Figure], tuple[np.ndarray, np.ndarray, np.ndarray], list[ForceReading], Series]:
    """Figures of the presses of a ball, which are straight down, evidence as in `feats_figures`, readings, what is spoilt."""
    background = read_image(folder / BACKGROUND)
    presses = read_presses(folder, PX_PER_MM)
    predictor = Reader(background, model=model)
    read = [predictor(press.image) for press in presses]
    series = Series("real balls", model, background, [press.image for press in presses[::EACH]], read[::EACH])
    figures = [
        *ball_figures(presses, read, np.array([found_radius(predictor.compare(press.image)) for press in presses])),
        *aside_figures("real balls", read),
    ]
    normal, force = np.array([-one.total[2] for one in read]), np.array([press.force for press in presses])
    return figures, (normal, force, own_half_widths(model, read)), read, series


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
        found, evidence[CONSENSUS], feats = feats_figures(args.reference, model, nocontact)
        figures += found
    if "balls" in args.parts:
        found, evidence["real balls"], straight, balls = real_ball_figures(args.reference / BALLS, model)
        figures += found
    if {"maps", "balls", "spoilt"} <= set(args.parts):
        figures += [figure for series in (feats, balls) for figure in spoilt_figures(series)]
    if "drawn" in args.parts:
        figures += motion_figures(model)
    if "twins" in args.parts:
        figures += twin_figures(args.reference, model)
    if "cuboid" in args.parts:
        cuboid = read_cuboid(args.reference, model, nocontact)
        figures += cuboid_figures(cuboid)
    told = {}
    if {"maps", "balls", "cuboid"} <= set(args.parts):
        intervals, real = interval_figures(model, evidence)
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
