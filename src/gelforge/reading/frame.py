"""Image frame: from a camera's image of any size, crop and orientation to the input of a network.

    frame, markers = image_frame(nocontact, (240, 320), learnt)  # once for each sensor
    framed = frame(image)  # turned, cropped, resized, and zoomed about its middle

A network is trained on images as its sensors logged them. `Learnt`, which the model keeps, describes the view of
their cameras. Images of any other camera are brought to that view; those of the training cameras stay as they are. A
no-contact image is enough for this: its markers, which are printed alike on every gel, give scale and centre; the
light behind them and the coloured fringes that the three lights leave around them give the orientation, and whether
the image is mirrored.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.reading.markers import Markers, markers_in

MOST_SIDE = 640  # px: longer side at which markers are looked for, and of the image in a profile
PITCH_PX = 31.2  # between markers in the 320 x 240 images of the maker's driver (FEATS' sensor and another one)
OF_WIDTH = 320.0
# px: smallest and largest pitch of the units that the shipped network learnt from, as its file has them.
MINI_PITCHES = (29.246747848073397, 33.39090842488236)
# Fraction of the camera's image that the maker's driver crops at each side (gsrobotics, gs_sdk).
DRIVER_CROP = 1 / 7
GRID = (7, 9)  # markers of a Mini's gel, rows and columns
LEAST_MARKERS, ON_GRID = 12, 0.6  # least number of markers on a grid, and least fraction of all dark spots
UNEVEN = 0.12  # fraction by which the marker pitch varies between sensors
SAME_SHAPE = 0.02  # tolerance of the aspect ratio, as a fraction
SQUARE = 0.1  # the same, within which an image counts as square
# Zooms at which an image still shows what a network needs: in training at most 30 % of a view is hidden.
ZOOMS = (0.7, 1.6)
SLACK = 0.02  # precision of the marker pitch measured in an image, as a fraction
# View of real Minis: first moments of red, green and blue along u and v, (3, 2), norm 1. LIGHT: of each colour's
# fraction of the light, over the image. FRINGES: of each colour's darkness less the mean of all three, around a
# marker.
LIGHT = np.array([[0.03, 0.74], [-0.11, -0.12], [0.07, -0.62]])
FRINGES = np.array([[0.28, 0.62], [-0.45, -0.13], [0.15, -0.50]])
LEAST_FRINGES = 0.02  # of a marker's darkness: flat prints have no fringes
SURE = 0.6  # least correlation at which an image is turned
AHEAD = 0.3  # by how much the sum of an orientation's correlations must exceed that of the best one tried before it


@dataclass(frozen=True)
class Orientation:
    """How an image is turned: transposed first, then mirrored along u and v."""

    transposed: bool = False
    flip_u: bool = False
    flip_v: bool = False

    @property
    def mirrored(self) -> bool:
        """Whether it includes a reflection."""
        return self.transposed ^ self.flip_u ^ self.flip_v

    def moments(self, moments: np.ndarray) -> np.ndarray:
        """Moments (3, 2) along u and v of the image once it is turned."""
        turned = moments[:, ::-1] if self.transposed else moments
        return turned * np.array([1 - 2 * self.flip_u, 1 - 2 * self.flip_v])

    def of(self, image: np.ndarray) -> np.ndarray:
        """The image (h, w, 3), turned."""
        turned = image.transpose(1, 0, 2) if self.transposed else image
        return turned[:: -1 if self.flip_v else 1, :: -1 if self.flip_u else 1]

    def points(self, places: np.ndarray) -> np.ndarray:
        """Places (n, 2) of the image, as fractions of its width and height, in the turned image."""
        turned = places[:, ::-1] if self.transposed else places
        return np.where([self.flip_u, self.flip_v], 1.0 - turned, turned)

    def __str__(self) -> str:
        """In words, empty for an image that stays as it is."""
        quarter = {(False, False): "", (True, True): "turned by 180 degrees"}
        turn = "turned by 90 degrees" if self.transposed else quarter.get((self.flip_u, self.flip_v), "")
        return " and ".join(filter(None, (turn, "mirrored back" if self.mirrored else "")))


AS_IT_IS = Orientation()


@dataclass(frozen=True)
class View:
    """How a no-contact image shows the gel: first moments (3, 2) of its light and of the fringes of its markers."""

    light: np.ndarray
    fringes: np.ndarray

    def agrees(self, seen: "View", way: Orientation) -> list[float]:
        """Correlations of the moments with those of another view turned by `way`; only light if it has no fringes."""
        compared = [(self.light, seen.light)]
        if np.linalg.norm(seen.fringes) >= LEAST_FRINGES:
            compared.append((self.fringes, seen.fringes))
        return [_correlation(own, way.moments(other)) for own, other in compared]


@dataclass(frozen=True)
class Learnt:
    """View of the gel in the no-contact images that a network was trained on, in px of its input.

    usual: usual marker pitch, 0 without markers. pitch: smallest and largest marker pitch; None sets no bounds. grid:
    rows and columns of markers. views: of cameras; the images of each training sensor are oriented as one of them.
    """

    usual: float
    pitch: tuple[float, float] | None
    grid: tuple[int, int]
    views: tuple[View, ...]

    def table(self) -> dict[str, Any]:
        """As a model file keeps it."""
        return {
            "usual_px": self.usual,
            "pitch_px": list(self.pitch or ()),
            "grid": list(self.grid),
            "views": [[np.round(one, 6).tolist() for one in (view.light, view.fringes)] for view in self.views],
        }

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> "Learnt":
        """From what a model file keeps."""
        pitch = (table["pitch_px"][0], table["pitch_px"][1]) if table["pitch_px"] else None
        views = tuple(View(np.array(light, float), np.array(fringes, float)) for light, fringes in table["views"])
        return cls(table["usual_px"], pitch, (table["grid"][0], table["grid"][1]), views)


WHOLE = (0.0, 0.0, 1.0, 1.0)
BLUE_FIRST = "red and blue seem to be exchanged in the no-contact image: give all images in RGB, not in OpenCV's BGR"


@dataclass(frozen=True)
class ImageFrame:
    """Map from a camera's images to the (rows, cols) px of a network's input.

    size: (rows, cols). shape: (h, w) of the image that defined the frame; others may have another size, but must have
    its aspect ratio. part: left, top, right and bottom of the shown part, as fractions of the turned image. zoom:
    factor on lengths about the middle of that part, which brings the marker pitch to that of training; below 1 it
    leaves an empty margin of levels `fill`. text: what is done, in one line, empty for nothing. blue_first: whether
    the image that defined the frame seems to be BGR.
    """

    size: tuple[int, int]
    shape: tuple[int, int]
    orientation: Orientation = AS_IT_IS
    part: tuple[float, float, float, float] = WHOLE
    zoom: float = 1.0
    fill: tuple[float, float, float] = (0.0, 0.0, 0.0)
    text: str = ""
    blue_first: bool = False

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """An image (h, w, 3) uint8 as the network reads it; one of another shape is resized whole."""
        import cv2

        if same_shape(image.shape, self.shape):
            turned = self.orientation.of(image)
            left, top, right, bottom = self._window(turned.shape)
            image = turned[top:bottom, left:right]
        rows, cols = self.size
        if image.shape[:2] != (rows, cols):
            smaller = image.shape[0] * image.shape[1] < rows * cols
            how = cv2.INTER_CUBIC if smaller else cv2.INTER_AREA
            image = cv2.resize(np.ascontiguousarray(image), (cols, rows), interpolation=how)
        if self.zoom == 1.0:
            return np.ascontiguousarray(image)
        matrix = np.array([[self.zoom, 0.0, cols - 1], [0.0, self.zoom, rows - 1]])
        matrix[:, 2] *= (1.0 - self.zoom) / 2
        return cv2.warpAffine(image, matrix, (cols, rows), borderMode=cv2.BORDER_CONSTANT, borderValue=self.fill)

    def markers(self, markers: Markers, shape: tuple[int, ...]) -> Markers:
        """Transform markers of an image of a shape (h, w, ...) into the frame; keep those that are wholly inside."""
        height, width = shape[:2]
        turned = self.orientation.points(markers.points / (width, height))
        if self.orientation.transposed:
            height, width = width, height
        left, top, right, bottom = self._window((height, width))
        size = np.array(self.size[::-1])
        scale = size / (right - left, bottom - top)
        points = size / 2 + self.zoom * ((turned * (width, height) - (left, top)) * scale - size / 2)
        diameters = markers.diameters * self.zoom * scale.mean()
        inside = ((points > diameters[:, None] / 2) & (points < size - diameters[:, None] / 2)).all(axis=1)
        return Markers(points, diameters).only(inside)

    def _window(self, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
        """Left, top, right and bottom px of the shown part of a turned image of a shape (h, w, ...)."""
        height, width = shape[:2]
        left, top, right, bottom = self.part
        return round(left * width), round(top * height), round(right * width), round(bottom * height)

    @property
    def as_logged(self) -> bool:
        """Whether images are only resized."""
        return (self.orientation, self.part, self.zoom) == (AS_IT_IS, WHOLE, 1.0)

    @property
    def shows_rim(self) -> bool:
        """Whether images are at the network's scale without a zoom, and so show the gel's rim."""
        return self.zoom == 1.0

    @property
    def shown(self) -> tuple[slice, slice]:
        """Rows and columns of a framed image that show something."""
        return self._within(self.size, math.ceil)

    def cells_shown(self, grid: tuple[int, ...]) -> tuple[slice, slice]:
        """Rows and columns of a map of a framed image, (rows, cols) cells, that show something, to the nearest cell."""
        return self._within(grid, round)

    def _within(self, shape: tuple[int, ...], whole: Callable[[float], int]) -> tuple[slice, slice]:
        across, along = (max(0, whole((1.0 - self.zoom) * size / 2)) for size in shape)
        return slice(across, shape[0] - across), slice(along, shape[1] - along)


def same_shape(one: Sequence[int], other: Sequence[int]) -> bool:
    """Whether two shapes of images (h, w, ...) have one aspect ratio, within SAME_SHAPE."""
    return abs(one[1] * other[0] - one[0] * other[1]) <= SAME_SHAPE * one[0] * other[1]


def reduced(image: np.ndarray) -> np.ndarray:
    """An image (h, w, 3) uint8 whose longer side has at most MOST_SIDE px."""
    import cv2

    height, width = image.shape[:2]
    scale = MOST_SIDE / max(height, width)
    if scale >= 1.0:
        return image
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def of_minis(size: tuple[int, int]) -> Learnt:
    """The view of GelSight Minis by their maker's driver, at a size (rows, cols), px."""
    return Learnt(PITCH_PX * size[1] / OF_WIDTH, None, GRID, (View(LIGHT, FRINGES),))


def as_shipped(size: tuple[int, int]) -> Learnt:
    """The view of the shipped network, which also brings narrow and wide views to one scale, at a size (rows, cols), px."""
    low, high = (pitch * size[1] / OF_WIDTH for pitch in MINI_PITCHES)
    return replace(of_minis(size), pitch=(low, high))


def learnt_from(pictures: Iterable[np.ndarray], before: Learnt | None = None) -> Learnt:
    """The view of a network that is trained on sensors with these no-contact images (h, w, 3) uint8 RGB of one size.

    before: the view of the network that is fine-tuned.
    """
    pitches, grids, found, shape = list(before.pitch or ()) if before else [], [], [], (1, 1)
    for picture in pictures:
        shape = picture.shape[:2]
        markers = markers_in(picture)
        if markers.pitch:
            pitches.append(markers.pitch)
            grids.append(
                tuple((np.ptp(markers.lattice[0], axis=0) + 1).tolist()) if len(markers.lattice[1]) else GRID
            )
            found.append(view_of(picture, markers, markers.pitch))
    usual = before.usual if before and before.usual else float(np.median(pitches)) if pitches else 0.0
    grid = before.grid if before else max(sorted(set(grids)), key=grids.count, default=GRID)
    views = list(before.views) if before else []
    if found and not views:
        views = [View(*(_mean_of([getattr(one, what) for one in found]) for what in ("light", "fringes")))]
    learnt = Learnt(usual, (min(pitches), max(pitches)) if pitches else None, (grid[0], grid[1]), tuple(views))
    for _ in found:  # an added view may turn another sensor; in the worst case each sensor gets its own view
        turned = [one for one in found if _orientation(one, learnt.views, (shape, shape)) != AS_IT_IS]
        if not turned:
            break
        learnt = replace(learnt, views=(*learnt.views, turned[0]))
    return learnt


def _mean_of(moments: list[np.ndarray]) -> np.ndarray:
    mean = np.mean(moments, axis=0)
    return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-9))


def view_of(image: np.ndarray, markers: Markers, pitch: float) -> View:
    """How an image (h, w, 3) uint8 RGB shows the gel whose markers are `pitch` px apart."""
    return View(light_moments(image), fringe_moments(image, markers, pitch))


def image_frame(
    nocontact: np.ndarray, size: tuple[int, int], learnt: Learnt | None = None
) -> tuple[ImageFrame, Markers]:
    """The frame of a camera from its no-contact image (h, w, 3) uint8 RGB, and the markers of that image in it.

    size: (rows, cols) of the network's input. learnt: view of its training; None: Minis. An image without markers is
    only resized. An image that shows less of the gel than the network's frame is resized whole, where its aspect
    ratio fits, and zoomed; BadInput where no zoom brings it near enough.
    """
    learnt = learnt or of_minis(size)
    small = reduced(nocontact)
    found = markers_in(small)
    on_grid = len(found.lattice[1]) >= max(LEAST_MARKERS, ON_GRID * len(found.points))
    pitch = found.pitch if on_grid and learnt.usual else 0.0
    orientation = _orientation(view_of(small, found, pitch), learnt.views, (small.shape, size)) if pitch else AS_IT_IS
    height, width = small.shape[1::-1] if orientation.transposed else small.shape[:2]
    part, cut = WHOLE, ""
    required = learnt.usual
    least = min((1.0 - UNEVEN) * required, (1.0 - SLACK) * learnt.pitch[0] if learnt.pitch else math.inf)
    if pitch and not (same_shape((height, width), size) and pitch * size[1] / width > least):
        scale, driver = pitch / required, width * (1.0 - 2.0 * DRIVER_CROP) / size[1]
        as_driver = abs(scale / driver - 1.0) < UNEVEN
        cut = "cropped as the maker's driver does" if as_driver else "cropped by their markers"
        turned = ImageFrame((height, width), small.shape[:2], orientation).markers(found, small.shape)
        part = _part((height, width), turned, driver if as_driver else scale, size, learnt.grid)
    (rows, cols), done = nocontact.shape[:2], [str(orientation), cut]
    if (rows, cols) != tuple(size):
        done.append(f"scaled to {size[1]} x {size[0]}")
    changes = ", ".join(filter(None, done))
    frame = ImageFrame(
        size,
        (rows, cols),
        orientation,
        part,
        text=f"images of {cols} x {rows} are {changes}" if changes else "",
        # exchanged, red and blue look like a mirrored or turned camera, but a Mini's blue light is the brighter one
        blue_first=orientation != AS_IT_IS and bool(small[..., 0].mean() > small[..., 2].mean()),
    )
    as_it_is = (orientation, part, small.shape[:2]) == (AS_IT_IS, WHOLE, tuple(size))
    markers = found if as_it_is else frame.markers(found, small.shape)
    zoom = zoom_of(markers.pitch, learnt.pitch) if learnt.pitch and learnt.usual else 1.0
    if zoom != 1.0:
        red, green, blue = np.rint(frame(nocontact).mean(axis=(0, 1))).tolist()
        frame = replace(frame, zoom=zoom, fill=(red, green, blue))
        markers = frame.markers(found, small.shape)
    return frame, markers


def colour_fault(nocontact: np.ndarray) -> list[str]:
    """Whether red and blue of a no-contact image (h, w, 3) uint8 seem to be exchanged: one sentence, or none."""
    return [BLUE_FIRST] * image_frame(nocontact, (nocontact.shape[0], nocontact.shape[1]))[0].blue_first


def at_scale(pitch: float, learnt: Sequence[float]) -> bool:
    """Whether a marker pitch in px is that of training, up to SLACK; learnt: smallest and largest pitch there.

    An image without markers (pitch 0) has no known scale and passes.
    """
    return pitch == 0.0 or (1 - SLACK) * learnt[0] <= pitch <= (1 + SLACK) * learnt[1]


def zoom_of(pitch: float, learnt: Sequence[float]) -> float:
    """The zoom that brings a marker pitch in px to that of training; learnt: as of `at_scale`.

    Gels are printed alike, so a camera with a smaller or larger pitch sees more or less of the gel. The zoom is 1 for
    an image without markers (pitch 0); BadInput where the zoom needed is outside ZOOMS.
    """
    if at_scale(pitch, learnt):
        return 1.0
    zoom = sum(learnt) / 2 / pitch
    if not ZOOMS[0] <= zoom <= ZOOMS[1]:
        remedy = "crop or scale all images of this sensor so that its markers stand about as far apart"
        if zoom < 1.0:
            remedy = "the images show too little of the gel: take them in a mode of the camera that crops less"
        raise BadInput(
            f"the markers of the no-contact image stand {pitch:.1f} px apart, in training {learnt[0]:.0f} to"
            f" {learnt[1]:.0f} px: {remedy}"
        )
    return zoom


def _part(
    shape: tuple[int, int], markers: Markers, scale: float, size: tuple[int, int], grid: tuple[int, int]
) -> tuple[float, float, float, float]:
    """Left, top, right and bottom, as fractions, of the part of a turned image (h, w) that the network's frame shows.

    It is smaller where the image is too small. markers: of that image. scale: its px per px of the frame. The part is
    centred on the image, as the gel is but for its mounting; or on the marker grid, where the whole grid is seen and
    its middle is more than a pitch away.
    """
    height, width = shape
    scale = min(scale, width / size[1], height / size[0])
    across, along = scale * size[1], scale * size[0]
    u, v = width / 2, height / 2
    index, used = markers.lattice
    extent = np.ptp(index, axis=0) + 1 if len(used) else np.zeros(2)
    if tuple(extent) == grid and len(used) >= 0.8 * math.prod(grid):
        design = np.column_stack([np.ones(len(index)), index])
        model = np.linalg.lstsq(design, markers.points[used], rcond=None)[0]
        middle = np.array([1.0, *(index.min(axis=0) + (extent - 1) / 2)]) @ model
        if math.dist(middle, (u, v)) > markers.pitch:
            u, v = middle.tolist()
    left, top = min(max(u - across / 2, 0.0), width - across), min(max(v - along / 2, 0.0), height - along)
    return left / width, top / height, (left + across) / width, (top + along) / height


def _orientation(seen: View, views: Sequence[View], shapes: tuple[Sequence[int], Sequence[int]]) -> Orientation:
    """How an image must be turned to be oriented as those of training; AS_IT_IS where no orientation is certain.

    shapes: of the image and of what the network reads, (h, w, ...) each.
    """
    quarter = _upright(shapes[0]) * _upright(shapes[1])  # -1: only a quarter turn fits
    found, most = AS_IT_IS, -math.inf
    # AS_IT_IS first, mirrored ones last: without fringes both look alike, and a turned camera is likelier than a
    # mirrored one
    for one in sorted(
        itertools.starmap(Orientation, itertools.product((False, True), repeat=3)), key=lambda o: o.mirrored
    ):
        if quarter and one.transposed != (quarter < 0):
            continue
        agreement = max((view.agrees(seen, one) for view in views), key=sum, default=[0.0])
        if one == AS_IT_IS or (min(agreement) > SURE and sum(agreement) > most + AHEAD):
            found, most = one, sum(agreement)
    return found


def _upright(shape: Sequence[int]) -> int:
    """1 for a shape (h, w, ...) that is wider than high, -1 for one that is higher, 0 for a square one."""
    height, width = shape[:2]
    return (width > (1 + SQUARE) * height) - (height > (1 + SQUARE) * width)


def _correlation(of_minis: np.ndarray, seen: np.ndarray) -> float:
    size = float(np.linalg.norm(of_minis) * np.linalg.norm(seen))
    return float((of_minis * seen).sum()) / size if size > 0 else 0.0


def light_moments(image: np.ndarray) -> np.ndarray:
    """First moments (3, 2) along u and v of the fraction of each colour in the light of an image (h, w, 3) uint8."""
    import cv2

    small = cv2.resize(cv2.medianBlur(np.ascontiguousarray(image), 31), (8, 8), interpolation=cv2.INTER_AREA) + 1.0
    colours = small / small.sum(axis=2, keepdims=True)
    return _first_moments(colours - colours.mean(axis=(0, 1)), (np.arange(8) + 0.5) / 8 - 0.5)


def fringe_moments(image: np.ndarray, markers: Markers, pitch: float) -> np.ndarray:
    """First moments (3, 2) along u and v, in pitches, of each colour's darkness around a marker less the mean of all.

    Relative to the marker's darkness, median over markers. image: (h, w, 3) uint8; markers: of this image, `pitch` px
    apart.
    """
    darkness = 1.0 - image / markers.background
    reach = max(2, round(pitch / 2))
    found = []
    for u, v in np.floor(markers.points).astype(int).tolist():
        dark = darkness[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1]
        if dark.shape[:2] == (2 * reach + 1, 2 * reach + 1):
            moments = _first_moments(dark - dark.mean(axis=2, keepdims=True), np.arange(-reach, reach + 1) / pitch)
            found.append(moments / max(float(dark.mean(axis=2).sum()), 1e-9))
    return np.median(found, axis=0) if found else np.zeros((3, 2))


def _first_moments(colours: np.ndarray, place: np.ndarray) -> np.ndarray:
    """First moments (3, 2) along u and v of values (n, n, 3) at places (n,) along both sides."""
    along_u, along_v = colours * place[None, :, None], colours * place[:, None, None]
    return np.column_stack([along_u.sum((0, 1)), along_v.sum((0, 1))])
