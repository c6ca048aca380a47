"""What the shipped network reads in pictures of real sensors that it never saw, where something of the truth is known.

No force was measured beside these pictures. What is known: a released gel bears nothing; two fingers that hold one object
press it equally; a sideways force moves the dots its way; FEATS published its own maps of 51 presses; a cuboid leaves a
square and a tube a ring, whose sizes are known. Each figure is given for the network as `gelforge live` and `predict` use
it, and in its note for the bare network that takes a film's first frame for the untouched sensor.
"""

from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from gelforge.api import gelsight_mini
from gelforge.errors import BadInput
from gelforge.flow.main import command, option
from gelforge.flow.progress import progress
from gelforge.formats.numpy_pickle import read_npy
from gelforge.networks.modelfile import SensorNet, Trained, predict_images
from gelforge.networks.sensorprofile import Gain, fingerprint, fit_opposite
from gelforge.networks.sitting import place_sitting
from gelforge.networks.still import SETTLING, find_untouched
from gelforge.networks.use import Untouched, fit_size, load_for_use, predict_one
from gelforge.records.image import read_image
from gelforge.records.markers import find_blobs
from gelforge.records.totals import BEYOND
from tests.benchmarks.figures import PUBLISHED_DATA, Figure, publish_figures
from tests.pictures import moved

EVERY = 3  # every so manyth frame of a film is read
RELEASED_PX = 0.6  # nine of ten dots nearer than this to where they are at rest: nothing touches
HELD_PX = 1.0  # and farther than this: something does
MOST_AT_EDGE = 0.7  # edge_peak up to which most of a contact is taken to be seen
TRACKED = {"winSize": (21, 21), "maxLevel": 2}
PANEL = 200  # px of width of each of the four panels of FEATS' film: x, y, normal map, picture
NAMED = np.s_[:5, :10]  # cells of a map that the panels' names cover
# Where pictures show the gel, and where FEATS' maps place it, px at 320 x 240 (gelsight_mini and feats_mini of
# workflow/sensors.toml).
PX_PER_MM, FEATS_PX_PER_MM = float(np.hypot(*gelsight_mini().projection[0, :2])), 14.0
# What the rig's labels tell of the reference's bodies, whose edges are round: side of the square in which a cuboid of 10
# mm presses at least half as hard as anywhere (144 presses, 25 to 35 N; nine of ten within 0.2 mm), and diameter of the
# ring that a tube of 10 and 7 mm presses (140 presses; within 0.05 mm).
CUBOID_MM, TUBE_MM = 9.4, 8.6
TUBES = (9, 31, 45, 49)  # frames of FEATS' film in which the whole ring of that tube presses
FOOT = 0.35  # share of a map's largest force from which a cell counts as pressed
# How a gel that was put back may be seen (tests.pictures.moved), and presses from which that can be told, N.
MOVES = {"shifted by 2 px": {"shift": (1.6, 1.2)}, "3 % larger": {"zoom": 1.03}}
LEAST_PRESS = 2.0
HELD = ("gripper_videos", "feats/images")  # folders of the reference data that are read

Way = Callable[[np.ndarray], np.ndarray]  # a picture (h, w, 3) to forces (3, rows, cols) N


def frames(path: Path) -> Iterator[np.ndarray]:
    """Frames (h, w, 3) uint8 RGB of a film."""
    source = cv2.VideoCapture(str(path))
    if not source.isOpened():
        raise BadInput(f"{path}: cannot be opened as a film")
    while True:
        good, frame = source.read()
        if not good:
            source.release()
            return
        yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)


def as_used(trained: Trained, untouched: np.ndarray, sitting: Sequence[np.ndarray] = ()) -> Way:
    """How `predict` reads the pictures of a sitting, or, where none are named, `live` reads a frame."""
    one = Untouched(trained, untouched)
    placement = place_sitting(one, sitting)
    return lambda image: predict_one(one, image, placement)[1]


def bare(trained: Trained, untouched: np.ndarray, _sitting: Sequence[np.ndarray] = ()) -> Way:
    """The network alone on the two pictures as they are."""
    reader = SensorNet(trained, fit_size(untouched, trained.about["image"])[0]).eval()
    return lambda image: predict_images(reader, image[None])[0]


# -- films


@dataclass(frozen=True)
class Read:
    """A film as read: totals (n, 3) N of both ways in the labels' channels, and the dots' motion (n, d, 2) px.

    flagged: (n,) bool, pictures that `predict` flags. peak: (n,) largest force at the picture's edge (records.totals).
    """

    used: np.ndarray
    bare: np.ndarray
    motion: np.ndarray
    flagged: np.ndarray
    peak: np.ndarray

    @property
    def moved(self) -> np.ndarray:
        """How far nine of ten dots have moved, (n,) px."""
        return np.nanpercentile(np.hypot(self.motion[..., 0], self.motion[..., 1]), 90, axis=1)


def motion_of(dots: np.ndarray, rest: np.ndarray, image: np.ndarray) -> np.ndarray:
    """How far dots (d, 2) of the picture at rest have moved in another picture, (d, 2) px; NaN where one is lost.

    A dot is lost that, followed back, does not come home.
    """
    grey = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in (rest, image)]
    start = (dots - 0.5).astype(np.float32).reshape(-1, 1, 2)
    found, seen, _ = cv2.calcOpticalFlowPyrLK(*grey, start, None, **TRACKED)
    home, _, _ = cv2.calcOpticalFlowPyrLK(*grey[::-1], found, None, **TRACKED)
    kept = (seen.ravel() > 0) & (np.hypot(*(home - start).reshape(-1, 2).T) < 1.0)
    return np.where(kept[:, None], (found - start).reshape(-1, 2), np.nan)


def read_film(path: Path, trained: Trained) -> Read:
    """Read every third frame of a film in both ways, and follow its dots."""
    images = list(frames(path))
    rest, _ = find_untouched(iter(images), str(path))
    dots, as_it_is, one = find_blobs(rest)[0], bare(trained, images[0]), Untouched(trained, rest)
    chosen = images[SETTLING::EVERY]  # while a camera sets its exposure nothing is known
    forces, judgements = zip(*(predict_one(one, image)[1:] for image in chosen), strict=True)
    return Read(
        used=np.array([one.sum((1, 2)) for one in forces]),
        bare=np.array([as_it_is(image).sum((1, 2)) for image in chosen]),
        motion=np.array([motion_of(dots, rest, image) for image in chosen]),
        flagged=np.array([judgement.flag for judgement in judgements]),
        peak=np.array([judgement.edge_peak for judgement in judgements]),
    )


def released_figures(films: dict[str, Read]) -> list[Figure]:
    """What is read of a gel that nothing touches."""
    worst, before = {}, {}
    for name, film in films.items():
        free = film.moved < RELEASED_PX
        if free.sum() >= 3:
            worst[name] = float(np.percentile(np.abs(film.used[free]).max(axis=1), 90))
            before[name] = float(np.percentile(np.abs(film.bare[free]).max(axis=1), 90))
    name = max(worst, key=worst.get)
    note = f"{name}; {len(worst)} films, median {np.median(list(worst.values())):.2f}; bare against the first frame: "
    note += f"worst {max(before.values()):.1f}, median {np.median(list(before.values())):.1f}"
    return [Figure("released gels, nine of ten frames of the worst film", worst[name], "<=", 0.3, "N", note)]


def every_frame(one: Read, two: Read, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Of the first `count` frames of two fingers those in which both are touched, and those that their likeness is told of."""
    return (one.moved[:count] > HELD_PX) & (two.moved[:count] > HELD_PX), np.ones(count, bool)


def mostly_seen(one: Read, two: Read, count: int) -> tuple[np.ndarray, np.ndarray]:
    """As `every_frame`, without frames that are flagged, and those in which a contact presses hardest about a picture's edge.

    Of frames in which just one is touched nothing is known.
    """
    both, _ = every_frame(one, two, count)
    good = ~(one.flagged[:count] | two.flagged[:count])
    neither = (one.moved[:count] < RELEASED_PX) & (two.moved[:count] < RELEASED_PX)
    both = both & good & (one.peak[:count] < MOST_AT_EDGE) & (two.peak[:count] < MOST_AT_EDGE)
    return both, both | (neither & good)


def seen_whole(one: Read, two: Read, count: int) -> tuple[np.ndarray, np.ndarray]:
    """As `mostly_seen`, without frames in which a contact goes on beyond its picture: only what both see whole is equal."""
    both, told = mostly_seen(one, two, count)
    whole = (one.peak[:count] < BEYOND) & (two.peak[:count] < BEYOND)
    return both & whole, told & whole


def grasps_of(films: dict[str, Read], way: str, frames_of: Callable) -> np.ndarray:
    """Median normal force in N of either finger while both are touched, and their correlation over time, (grasps, 3).

    frames_of: `every_frame`, `mostly_seen` or `seen_whole`.
    """
    found = []
    for name, one in films.items():
        two = films.get(name.removesuffix("camera_0") + "camera_2")
        if not name.endswith("camera_0") or two is None:
            continue
        count = min(len(one.moved), len(two.moved))
        both, told = frames_of(one, two, count)
        left, right = (-getattr(film, way)[:count, 2] for film in (one, two))
        if both.sum() >= 5 and min(np.median(left[both]), np.median(right[both])) > 0.0:
            likeness = float(np.corrcoef(left[told], right[told])[0, 1])
            found.append((float(np.median(left[both])), float(np.median(right[both])), likeness))
    return np.array(found).reshape(-1, 3)


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Factor by which forces (n,) N stand apart, median."""
    return float(np.exp(np.median(np.abs(np.log(one / other)))))


def finger_figures(films: dict[str, Read]) -> list[Figure]:
    """Normal forces of two fingers that hold one object, over all frames in which both see most of what touches them."""
    used, bare = (grasps_of(films, way, mostly_seen) for way in ("used", "bare"))
    every, whole = (grasps_of(films, "used", frames_of) for frames_of in (every_frame, seen_whole))
    others = [np.delete(used, k, axis=0) for k in range(len(used))]
    gains = [fit_opposite(rest[:, 0], rest[:, 1], Gain()).value for rest in others]
    usual, plain, of_all = (apart(*grasps[:, :2].T) for grasps in (used, bare, every))
    return [
        Figure("two fingers on one object, factor apart, median", usual, "<=", 1.25, "",
               f"{len(used)} grasps; both see all of the contact in {len(whole)}; bare {plain:.2f}; {of_all:.2f} over all"
               f" frames of {len(every)}"),
        Figure("the same once the other grasps brought one finger to the other", apart(used[:, 0], gains * used[:, 1]),
               "<=", 1.25, "",
               f"by their median ratio, a factor of {np.median(gains):.2f}; `gelforge sensor` leaves out those that it sees cut"),
        Figure("the same over time, correlation, median", float(np.median(used[:, 2])), ">=", 0.95, "",
               f"bare {np.median(bare[:, 2]):.2f}; {np.median(every[:, 2]):.2f} over all frames"),
    ]  # fmt: skip


def sideways_figures(films: dict[str, Read]) -> list[Figure]:
    """Sideways force against the mean motion of the dots: likeness over all films, angle film by film."""
    found = {}
    for way in ("used", "bare"):
        moved, pulled, angles = [], [], []
        for film in films.values():
            motion = np.nanmean(film.motion, axis=1)
            # image columns run against gel y, rows against gel x; the channels hold the forces along these
            force = -getattr(film, way)[:, :2]
            held = np.hypot(*motion.T) > HELD_PX
            if held.sum() < 10:
                continue
            moved.append(motion[held])
            pulled.append(force[held])
            cross = motion[held, 0] * force[held, 1] - motion[held, 1] * force[held, 0]
            angles.append(np.median(np.degrees(np.abs(np.arctan2(cross, (motion[held] * force[held]).sum(axis=1))))))
        motion, force = np.concatenate(moved), np.concatenate(pulled)
        likeness = min(np.corrcoef(motion[:, k], force[:, k])[0, 1] for k in (0, 1))
        found[way] = float(likeness), float(np.median(angles)), len(angles)
    told = f"{found['used'][2]} films; bare {found['bare'][0]:.3f} and {found['bare'][1]:.1f} degrees"
    return [
        Figure(
            "sideways force against dots, correlation, lesser of two axes", found["used"][0], ">=", 0.98, "", told
        ),
        Figure("sideways force against dots, angle, median", found["used"][1], "<=", 5.0, "degrees"),
    ]


# -- FEATS' film of its own maps


def map_of(panel: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Values 0 to 1 (24, 32) of a panel (h, w, 3) that shows cells in a colour map (256, 3)."""
    cells = cv2.resize(panel.astype(np.float32), (32, 24), interpolation=cv2.INTER_AREA).reshape(-1, 1, 3)
    return np.argmin(((cells - colours) ** 2).sum(axis=2), axis=1).reshape(24, 32) / 255.0


def feats_maps(path: Path, untouched: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Picture and normal map (24, 32), larger where pressed more, of each press; the picture's name is covered."""
    import matplotlib as mpl

    colours = 255.0 * mpl.colormaps["viridis"](np.arange(256))[:, :3]
    for image in frames(path):
        shown = cv2.resize(image[:, 3 * PANEL :], (320, 240), interpolation=cv2.INTER_CUBIC)
        shown[:32, :82] = untouched[:32, :82]
        yield shown, 1.0 - map_of(image[:, 2 * PANEL : 3 * PANEL], colours)


def in_feats_cells(cells: np.ndarray) -> np.ndarray:
    """A map (24, 32) of a picture in the cells of FEATS' maps: those hold the same mm, about the same middle."""
    share, size = FEATS_PX_PER_MM / PX_PER_MM, cells.shape[::-1]
    shift = (1.0 - share) * (np.array(size) - 1) / 2
    matrix = np.array([[share, 0.0, shift[0]], [0.0, share, shift[1]]])
    return cv2.warpAffine(cells.astype(np.float32), matrix, size)


def gif_figures(
    presses: list[tuple[np.ndarray, np.ndarray]], trained: Trained, untouched: np.ndarray
) -> list[Figure]:
    """Normal maps against FEATS' own, which are scaled each to itself; so are the totals' ranks. presses: of feats_maps."""
    found, seen = {}, np.ones((24, 32), bool)
    seen[NAMED] = False
    for way, make in (("used", as_used), ("bare", bare)):
        read = make(trained, untouched, [picture for picture, _ in presses])
        maps = [(-read(picture)[2], normal) for picture, normal in presses]
        in_mm, in_px = (
            float(np.median([np.corrcoef(place(own)[seen], normal[seen])[0, 1] for own, normal in maps]))
            for place in (in_feats_cells, np.asarray)
        )
        sums = np.array([(own[seen].sum(), normal[seen].sum()) for own, normal in maps]).T
        ranks = [np.argsort(np.argsort(values)) for values in sums]
        found[way] = in_mm, in_px, float(np.corrcoef(*ranks)[0, 1])
    (in_mm, in_px, rank), (bare_mm, _, bare_rank) = found["used"], found["bare"]
    told = f"{len(presses)} presses, each at its own mm; bare {bare_mm:.2f}; pixel for pixel {in_px:.2f}"
    return [
        Figure("normal map against FEATS' maps, correlation, median", in_mm, ">=", 0.88, "", told),
        Figure(
            "totals against the sums of FEATS' maps, rank correlation", rank, ">=", 0.9, "", f"bare {bare_rank:.2f}"
        ),
    ]


def ring_diameter(pressed: np.ndarray) -> float:
    """Diameter in cells of the circle about which a map (rows, cols) presses, by least squares (Kasa 1976)."""
    weight = np.sqrt(np.where(pressed > FOOT * pressed.max(), pressed, 0.0)).ravel()
    v, u = np.indices(pressed.shape).reshape(2, -1).astype(float)
    sides = np.stack([u, v, np.ones_like(u)], axis=1) * weight[:, None]
    (along, across, rest), *_ = np.linalg.lstsq(sides, -(u * u + v * v) * weight, rcond=None)
    return float(np.sqrt(along * along + across * across - 4.0 * rest))


def tube_figures(
    presses: list[tuple[np.ndarray, np.ndarray]], trained: Trained, untouched: np.ndarray
) -> list[Figure]:
    """How wide the rings are read that a tube of known size presses: whether pictures are of the scale that is said."""
    read = as_used(trained, untouched, [picture for picture, _ in presses])
    widths = []
    for tube in TUBES:
        pressed = -read(presses[tube][0])[2]
        pressed[NAMED] = 0.0
        widths.append(ring_diameter(pressed) * 10.0 / PX_PER_MM)
    off = 100 * abs(float(np.mean(widths)) / TUBE_MM - 1.0)
    told = f"{np.mean(widths):.2f} mm for {TUBE_MM:g}; {', '.join(f'{width:.2f}' for width in widths)}"
    return [Figure("tube of 10 and 7 mm: diameter of the ring read, off by", off, "<=", 3.0, "%", told)]


def moved_figures(
    presses: list[tuple[np.ndarray, np.ndarray]], trained: Trained, untouched: np.ndarray
) -> list[Figure]:
    """How far FEATS' pressed pictures read otherwise when they are moved, each by itself, as frames of `live` are read."""
    own_place = [picture for picture, _ in presses]
    figures = []
    for what, move in MOVES.items():
        changes = {}
        for way, make in (("used", as_used), ("bare", bare)):
            read = make(trained, untouched)
            own, after = (
                np.array([read(picture).sum((1, 2)) for picture in pictures])
                for pictures in (own_place, [moved(picture, **move) for picture in own_place])
            )
            change = np.abs(after - own).max(axis=1) / np.abs(own[:, 2])
            changes[way] = 100 * change[own[:, 2] < -LEAST_PRESS]
        used, plain = (float(np.median(changes[way])) for way in ("used", "bare"))
        told = f"{len(changes['used'])} presses; bare {plain:.0f} %"
        figures.append(Figure(f"real presses {what}: force changes by, median", used, "<=", 2.0, "%", told))
    return figures


def cuboid_figures(reference: Path, trained: Trained, untouched: np.ndarray) -> list[Figure]:
    """A 10 mm cuboid pressed straight: sideways force beside the normal one, and how wide the contact is read."""
    image = read_image(reference / "feats/images/cuboid_10-2-284.png")[..., :3]
    used, plain = as_used(trained, untouched, [image])(image), bare(trained, untouched)(image)
    normal, sideways = -used[2].sum(), float(np.hypot(*used[:2].sum((1, 2))))
    pressed = -used[2]
    area = np.count_nonzero(pressed > 0.5 * np.percentile(pressed, 98)) * (10.0 / PX_PER_MM) ** 2
    told = f"normal {normal:.1f} N; bare {-plain[2].sum():.1f} N"
    return [
        Figure("cuboid pressed straight, sideways over normal force", 100 * sideways / abs(normal), "<=", 3.0, "%", told),
        Figure("cuboid: side of the square read, off by", abs(float(np.sqrt(area)) - CUBOID_MM), "<=", 10 / PX_PER_MM, "mm"),
    ]  # fmt: skip


def need_pictures(reference: Path) -> None:
    """BadInput where a folder does not hold the real pictures."""
    missing = [f"{name}/" for name in HELD if not (reference / name).is_dir()]
    if missing:
        raise BadInput(
            f"{reference}: holds no {' and no '.join(missing)}; name the folder of the real pictures: REFERENCE=FOLDER"
            " for make real-check, the environment variable GELFORGE_REFERENCE for make benchmark-real"
        )


@command(
    option("--reference", type=Path, default=PUBLISHED_DATA),
    option("--model", type=Path, default=None, help="model file; the one that ships if not named"),
    option("--out", type=Path, default=Path("results/benchmarks/real.json")),
    option("--page", type=Path, default=None, help="write the pictures and what is read in them to this page"),
)
def main(args: Namespace) -> None:
    need_pictures(args.reference)
    torch.set_num_threads(1)  # networks so small are read faster by one, and beside other work far faster
    trained = load_for_use(args.model)
    films = sorted((args.reference / "gripper_videos").glob("*.avi"))
    read = {path.stem: read_film(path, trained) for path in progress(films, "films", len(films))}
    untouched = read_npy(args.reference / "feats/images/nocontact_train_sensor.npy")["gs_img"]
    figures = [*released_figures(read), *finger_figures(read), *sideways_figures(read)]
    presses = list(feats_maps(args.reference / "feats/images/demo.gif", untouched))
    for measure in (gif_figures, tube_figures, moved_figures):
        figures += measure(presses, trained, untouched)
    figures += cuboid_figures(args.reference, trained, untouched)
    publish_figures(args.out, figures, fingerprint(trained.about))
    if args.page:
        from tests.benchmarks.real_page import write_page

        write_page(args.page, trained, args.reference, films, figures)


if __name__ == "__main__":
    main.exit()
