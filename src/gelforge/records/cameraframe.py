"""Images of a GelSight Mini's camera, of any size, crop and orientation, brought to the frame that networks read.

The no-contact image shows how: its markers, which are printed alike on every gel, give scale and middle; the light behind
them and the coloured fringes that the three lights leave around them give the orientation, and whether it is mirrored.
"""

import math
from dataclasses import dataclass

import numpy as np

from gelforge.errors import BadInput
from gelforge.records.markers import find_blobs, lattice_of, marker_pitch

MOST_SIDE = 640  # px: longer side at which markers are looked for, and of the image in a profile
PITCH_PX = 31.2  # between markers in 320 x 240 of the maker's driver (FEATS' sensor and another one)
OF_WIDTH = 320.0
DRIVER_CROP = (
    1 / 7
)  # of each side of the camera's whole image, which the maker's driver cuts off (gsrobotics, gs_sdk)
GRID = (7, 9)  # markers of a Mini's gel, rows and columns
LEAST_MARKERS, ON_GRID = 12, 0.6  # of a grid, and the fraction of all dark spots that stand on it
UNEVEN = 0.12  # fraction by which sensors differ in the distance of their markers, px
SAME_SHAPE = 0.02  # fraction by which the sides of an image may be in another ratio
SQUARE = 0.1  # the same below which an image is neither upright nor across
# First moments over the image of the part of red, green and blue in its light, and over a marker's surroundings of the darkness
# of each colour beyond that of all three: of real Minis, (3, 2) along u and v, length 1.
LIGHT = np.array([[0.03, 0.74], [-0.11, -0.12], [0.07, -0.62]])
FRINGES = np.array([[0.28, 0.62], [-0.45, -0.13], [0.15, -0.50]])
LEAST_FRINGES = 0.02  # of a marker's darkness: printed flat, markers have none
SURE = 0.6  # least correlation by which an image is turned
AHEAD = 0.3  # by how much an orientation must agree better than the image as it is


@dataclass(frozen=True)
class Orientation:
    """How an image is turned: transposed first, then mirrored along u and v."""

    transposed: bool = False
    flip_u: bool = False
    flip_v: bool = False

    @property
    def mirrored(self) -> bool:
        """Whether it shows the gel as a mirror does."""
        return self.transposed ^ self.flip_u ^ self.flip_v

    def moments(self, moments: np.ndarray) -> np.ndarray:
        """Moments (3, 2) along u and v of the image once it is turned."""
        turned = moments[:, ::-1] if self.transposed else moments
        return turned * np.array([1 - 2 * self.flip_u, 1 - 2 * self.flip_v])

    def of(self, image: np.ndarray) -> np.ndarray:
        """The image (h, w, 3), turned."""
        turned = image.transpose(1, 0, 2) if self.transposed else image
        return np.ascontiguousarray(turned[:: -1 if self.flip_v else 1, :: -1 if self.flip_u else 1])

    def __str__(self) -> str:
        """In words, empty for an image that stays as it is."""
        quarter = {(False, False): "", (True, True): "turned by 180 degrees"}
        turn = "turned by 90 degrees" if self.transposed else quarter.get((self.flip_u, self.flip_v), "")
        return " and ".join(filter(None, (turn, "mirrored back" if self.mirrored else "")))


AS_IT_IS = Orientation()


@dataclass(frozen=True)
class CameraFrame:
    """From a camera's images to (rows, cols) px: orientation, and the part of the turned image that is shown.

    part: left, top, right and bottom as fractions of the turned image. shape: (h, w) of the image in which it was found; others may be
    larger or smaller, but must have its shape. text: what is done, in one line, empty for nothing. blue_first: whether the image in
    which it was found seems to have its colours as OpenCV reads them.
    """

    size: tuple[int, int]
    shape: tuple[int, int]
    orientation: Orientation
    part: tuple[float, float, float, float]
    text: str
    blue_first: bool = False

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """An image (h, w, 3) uint8 in the network's frame; one of another shape than the no-contact image stays as it is."""
        import cv2

        if not same_shape((image.shape[0], image.shape[1]), self.shape):
            return image  # of another mode of the camera: networks flag its shape
        turned = self.orientation.of(image) if self.orientation != AS_IT_IS else image
        height, width = turned.shape[:2]
        left, right = round(self.part[0] * width), round(self.part[2] * width)
        top, bottom = round(self.part[1] * height), round(self.part[3] * height)
        shown = turned[top:bottom, left:right]
        if shown.shape[:2] == self.size:
            return np.ascontiguousarray(shown)
        smaller = shown.shape[0] * shown.shape[1] < self.size[0] * self.size[1]
        how = cv2.INTER_CUBIC if smaller else cv2.INTER_AREA
        return cv2.resize(shown, self.size[::-1], interpolation=how)

    def fault(self, image: np.ndarray) -> str:
        """What is wrong with the shape of an image (h, w, 3); empty for nothing."""
        (height, width), (rows, cols) = image.shape[:2], self.shape
        if same_shape((height, width), self.shape):
            return ""
        return (
            f"the picture is {width} x {height}, of another shape than the no-contact image of {cols} x {rows}: take both in one mode"
            " of the camera"
        )


def same_shape(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether sides (h, w) of two images are in one ratio."""
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


def camera_frame(nocontact: np.ndarray, size: tuple[int, int]) -> CameraFrame:
    """The frame of a camera by its no-contact image (h, w, 3) uint8 RGB; size: (rows, cols) that networks read.

    An image without markers is left as it is, and resized whole. One that shows less than the network's frame is, too, where its
    shape allows it: networks know how to scale it (`View`).
    """
    small = reduced(nocontact)
    points = find_blobs(small)[0]
    pitch = marker_pitch(points) if stand_on_a_grid(points) else 0.0
    orientation = orientation_of(small, points, pitch) if pitch else AS_IT_IS
    turned = orientation.of(small)
    height, width = turned.shape[:2]
    part, cut = (0.0, 0.0, 1.0, 1.0), ""
    required = PITCH_PX * size[1] / OF_WIDTH
    fits = same_shape((height, width), size)
    if pitch and not (fits and pitch * size[1] / width > (1.0 - UNEVEN) * required):
        scale, driver = pitch / required, width * (1.0 - 2.0 * DRIVER_CROP) / size[1]
        whole = abs(scale / driver - 1.0) < UNEVEN
        cut = "cropped as the maker's driver does" if whole else "cropped by their markers"
        part = _part(turned, driver if whole else scale, size, pitch)
    (rows, cols), done = nocontact.shape[:2], [str(orientation), cut]
    if (rows, cols) != tuple(size):
        done.append(f"scaled to {size[1]} x {size[0]}")
    changes = ", ".join(filter(None, done))
    text = f"images of {cols} x {rows} are {changes}" if changes else ""
    red, _, blue = small.mean(axis=(0, 1))
    # exchanged, red and blue look like a mirrored or turned camera, but a Mini's blue light is the brighter one
    blue_first = orientation != AS_IT_IS and bool(red > blue)
    return CameraFrame((size[0], size[1]), (rows, cols), orientation, part, text, blue_first)


def stand_on_a_grid(points: np.ndarray) -> bool:
    """Whether most of the points (n, 2) px are markers of one grid, as specks and noise are not."""
    try:
        _, used = lattice_of(points)
    except BadInput:
        return False
    return len(used) >= max(LEAST_MARKERS, ON_GRID * len(points))


def _part(turned: np.ndarray, scale: float, size: tuple[int, int], pitch: float) -> tuple[float, float, float, float]:
    """The part of a turned image that the network's frame shows, smaller where the image does not reach so far.

    scale: px of the image for one of the frame. The part lies about the middle of the image, as the gel does but for its
    mounting; about the middle of the marker grid where that is over a pitch (px) away.
    """
    height, width = turned.shape[:2]
    scale = min(scale, width / size[1], height / size[0])
    across, along = scale * size[1], scale * size[0]
    middle = width / 2, height / 2
    grid = _middle(find_blobs(turned)[0], middle)
    u, v = grid if math.dist(grid, middle) > pitch else middle
    left, top = min(max(u - across / 2, 0.0), width - across), min(max(v - along / 2, 0.0), height - along)
    return left / width, top / height, (left + across) / width, (top + along) / height


def _middle(points: np.ndarray, otherwise: tuple[float, float]) -> tuple[float, float]:
    """The middle of the marker grid by its points (n, 2), where all of it is seen; else another point."""
    try:
        index, used = lattice_of(points)
    except BadInput:
        return otherwise
    extent = np.ptp(index, axis=0) + 1
    if tuple(extent) != GRID or len(used) < 0.8 * math.prod(GRID):
        return otherwise
    design = np.column_stack([np.ones(len(index)), index])
    model = np.linalg.lstsq(design, points[used], rcond=None)[0]
    u, v = (np.array([1.0, *(index.min(axis=0) + (extent - 1) / 2)]) @ model).tolist()
    return u, v


def orientation_of(image: np.ndarray, points: np.ndarray, pitch: float) -> Orientation:
    """How a no-contact image (h, w, 3) uint8 RGB must be turned to lie as networks know it; as it is where nothing is sure."""
    height, width = image.shape[:2]
    light, fringes = light_moments(image), fringe_moments(image, points, pitch)
    known = np.linalg.norm(fringes) >= LEAST_FRINGES
    both = [(LIGHT, light)] + [(FRINGES, fringes)] * bool(known)

    def agreement(orientation: Orientation) -> list[float]:
        return [_correlation(known, orientation.moments(seen)) for known, seen in both]

    upright = height > (1 + SQUARE) * width
    across = width > (1 + SQUARE) * height
    found, most = AS_IT_IS, sum(agreement(AS_IT_IS)) if not upright else -math.inf
    flips = [(u, v) for u in (False, True) for v in (False, True)]
    candidates = [
        Orientation(t, u, v) for t in (False, True) for u, v in flips if not ((t and across) or (upright and not t))
    ]
    # without fringes both sides look alike: a turned camera is likelier than a mirrored one
    for one in sorted(candidates, key=lambda each: each.mirrored):
        agreed = agreement(one)
        if min(agreed) > SURE and sum(agreed) > most + AHEAD:
            found, most = one, sum(agreed)
    return found


def _correlation(known: np.ndarray, seen: np.ndarray) -> float:
    size = float(np.linalg.norm(known) * np.linalg.norm(seen))
    return float((known * seen).sum()) / size if size > 0 else 0.0


def light_moments(image: np.ndarray) -> np.ndarray:
    """First moments (3, 2) along u and v of the fraction of each colour in the light of an image (h, w, 3) uint8."""
    import cv2

    small = cv2.resize(cv2.medianBlur(np.ascontiguousarray(image), 31), (8, 8), interpolation=cv2.INTER_AREA) + 1.0
    colours = small / small.sum(axis=2, keepdims=True)
    colours -= colours.mean(axis=(0, 1))
    place = (np.arange(8) + 0.5) / 8 - 0.5
    return np.column_stack(
        [(colours * place[None, :, None]).sum((0, 1)), (colours * place[:, None, None]).sum((0, 1))]
    )


def fringe_moments(image: np.ndarray, points: np.ndarray, pitch: float) -> np.ndarray:
    """First moments (3, 2) along u and v, in pitches, of how much darker each colour is around a marker than all colours are.

    Relative to the marker's darkness. image: (h, w, 3) uint8; points: (n, 2) px.
    """
    import cv2

    behind = [cv2.medianBlur(np.ascontiguousarray(colour), 51) for colour in np.moveaxis(image, 2, 0)]
    background = np.stack([cv2.GaussianBlur(one.astype(np.float32), (0, 0), 12.0) for one in behind], 2) + 1.0
    darkness = 1.0 - image / background
    reach = max(2, round(pitch / 2))
    place = np.arange(-reach, reach + 1) / pitch
    found = []
    for u, v in np.floor(points).astype(int).tolist():
        dark = darkness[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1]
        if dark.shape[:2] != (2 * reach + 1, 2 * reach + 1):
            continue
        more = dark - dark.mean(axis=2, keepdims=True)
        moments = np.column_stack(
            [(more * place[None, :, None]).sum((0, 1)), (more * place[:, None, None]).sum((0, 1))]
        )
        found.append(moments / max(float(dark.mean(axis=2).sum()), 1e-9))
    return np.median(found, axis=0) if found else np.zeros((3, 2))
