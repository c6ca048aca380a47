"""Pictures laid onto an untouched one of another day, where the gel sat or was seen otherwise.

A gel that was taken out and put back, or a driver that crops otherwise, moves every dot alike: by a shift, a turn and a
zoom, which a small network tells from what contact does (networks.placereader). How a gel sits is the same in all pictures
of one sitting: the middle of what each of them tells is nearer to it than any one of them.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gelforge.networks.dots import Followed, PrintedDots
from gelforge.networks.lattice import PITCH, without_still
from gelforge.networks.placereader import PlaceReader, Places, PlacesOneByOne

LEAST_FOUND = 0.5  # of the dots: a picture in which fewer are found tells nothing of where the gel sits
# Farthest that is put right without a word, px of each way, degrees, and part of a zoom: beyond that, dots at the rim are
# half a pitch and more from where they were, and may leave the picture.
SURE_SHIFT, SURE_TURN, SURE_ZOOM = 9.0, 3.0, 0.06
# A move of the dots, root mean square, is none that is smaller than so many px and this share of what contact did to all of
# them alike, which is what the reader's errors grow with. Of 1600 pictures of gels that sat still, under presses that the
# reader did not learn from, four in a thousand are told to have been moved. Of several pictures' middle the share falls
# with the root of their number, as errors do that each contact makes by itself.
LEAST_MOVE, LEAST_SHARE = 0.5, 0.2
LEAST_CONTACT = 0.1  # px that contact is taken to do at least: pictures that nothing touches all have the same say


@dataclass(frozen=True)
class Placement:
    """Where the untouched picture's points lie in another one: point -> matrix @ (u, v, 1), matrix (2, 3).

    shift: (2,) px along u and v of the dot nearest to the picture's middle.
    """

    matrix: np.ndarray
    shift: np.ndarray

    @property
    def a(self) -> complex:
        """Turn and zoom: a dot at z px from the one nearest to the picture's middle is at a z + b, z = u + i v."""
        return complex(*self.matrix[:, 0])

    @property
    def b(self) -> complex:
        """The shift, px."""
        return complex(*self.shift)

    @functools.cached_property
    def moves(self) -> bool:
        """Whether anything is put right."""
        return not np.array_equal(self.matrix, np.eye(2, 3))

    @property
    def turn(self) -> float:
        """Degrees, positive from u towards v."""
        return float(np.degrees(np.arctan2(self.matrix[1, 0], self.matrix[0, 0])))

    @property
    def zoom(self) -> float:
        """Factor by which it is larger."""
        return float(np.hypot(*self.matrix[:, 0]))

    @property
    def correction(self) -> str:
        """What was put right, as a person reads it; empty where nothing was."""
        if not self.moves:
            return ""
        right, down = self.shift
        return (
            f"({right:+.1f}, {down:+.1f}) px aside, {self.turn:+.1f} degrees turned, {self.zoom:.3f} times as large, as its"
            " dots tell"
        )

    @property
    def fault(self) -> str:
        """What tells that it lies too far away to be put right; empty where it does not."""
        if not self.moves:
            return ""
        far = np.abs(self.shift).max() > SURE_SHIFT or abs(self.turn) > SURE_TURN or abs(self.zoom - 1.0) > SURE_ZOOM
        return f"the gel sits too far from where it sat untouched to be sure: {self.correction}" if far else ""

    def undo(self, image: np.ndarray) -> np.ndarray:
        """The image (h, w, 3) uint8 as it would be seen from where the untouched one was taken."""
        import cv2

        if not self.moves:
            return image
        how = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        return cv2.warpAffine(image, self.matrix, image.shape[1::-1], flags=how, borderMode=cv2.BORDER_REPLICATE)


UNPLACED = Placement(np.eye(2, 3), np.zeros(2))


def tells_place(dots: PrintedDots, followed: Followed) -> bool:
    """Whether enough of the dots were found in a picture to tell where its gel sits."""
    return dots.known and bool(followed.found[dots.placed].mean() >= LEAST_FOUND)


def place(reader: PlaceReader | PlacesOneByOne | None, dots: PrintedDots, sitting: Sequence[Followed]) -> Placement:
    """Placement of pictures of one sitting on the untouched one whose dots these are, by what its dots did in each of them.

    Nothing is moved where no reader is given, no picture shows enough of the print, or the move may be the reader's error.
    """
    telling = [followed for followed in sitting if tells_place(dots, followed)]
    if reader is None or not telling:
        return UNPLACED
    return believed(dots, places_of(reader, dots, telling), len(telling), UNPLACED)


def believed(dots: PrintedDots, told: Places, presses: int, before: Placement) -> Placement:
    """Placement that pictures of one sitting tell together; where that may be the reader's error, `before` or none.

    told: of `places_of`. presses: how many of their contacts have nothing to do with each other, whose errors do not add up.
    before: what was believed so far, which is kept where what is told now is too uncertain to tell it from no move.
    """
    a, b, contact = _middle(told)
    sure = _sure(contact, presses)
    if _apart(dots, a, b, UNPLACED) >= sure:
        return about_middle(dots, a, b)
    return before if _apart(dots, a, b, before) < sure else UNPLACED


def contradicts(dots: PrintedDots, told: Places, placement: Placement) -> bool:
    """Whether one picture by itself tells that the gel sits otherwise than a placement says; told: of `places_of`, of one."""
    return bool(_apart(dots, told.a[0], told.b[0], placement) >= _sure(told.contact[0], 1))


def placed_nearer(
    coarse: Placement, reader: PlaceReader | PlacesOneByOne | None, dots: PrintedDots, laid: Sequence[Followed]
) -> Placement:
    """How the gel sits once more, and nearer, after a placement was found: from pictures that it laid. laid: their dots.

    A dot is followed where its contrast is, about a px nearer to the middle than where it stands, because the picture is
    brighter there. So in one that is 3 % larger all are told to be 0.05 px from where they are, and much less in one that
    lies nearly as it should.
    """
    telling = [followed for followed in laid if tells_place(dots, followed)]
    if reader is None or not telling:
        return coarse
    a, b, _ = _middle(as_they_lie(coarse, places_of(reader, dots, telling)))
    return about_middle(dots, a, b)


def places_of(reader: PlaceReader | PlacesOneByOne, dots: PrintedDots, sitting: Sequence[Followed]) -> Places:
    """What a reader tells of each picture of a sitting, each of which `tells_place`: for z in px of this print."""
    told = reader.places(without_still(np.stack([dots.on_lattice(followed) for followed in sitting])))
    # of a print of another pitch, or one that stands turned, the same motion is another turn and zoom
    return replace(told, a=1 + (told.a - 1) * PITCH / dots.standing.step)


def as_they_lie(laid: Placement, told: Places) -> Places:
    """What pictures tell that a placement laid, as the same pictures would tell it unlaid."""
    return Places(laid.a * told.a, laid.a * told.b + laid.b, told.contact)


def _middle(told: Places) -> tuple[complex, complex, float]:
    """What pictures of one sitting tell together, a, b and contact: medians, in which those say most that contact did least to.

    Four pictures are so placed with three quarters of the error that the same say of each leaves.
    """
    # by half of their variance at least: no picture has more than twice the usual say, or one that was taken before the gel was
    # pushed home, which nothing touches, could outweigh all others
    says = 1.0 / (told.contact**2 + np.median(told.contact) ** 2 + LEAST_CONTACT**2)
    a, b = (complex(_median(values.real, says), _median(values.imag, says)) for values in (told.a, told.b))
    return a, b, _median(told.contact, says)


def _median(values: np.ndarray, says: np.ndarray) -> float:
    """Median of values (n,), each of which has so much say (n,)."""
    order = values.argsort()
    below = says[order].cumsum() - 0.5 * says[order]
    return float(np.interp(0.5 * says.sum(), below, values[order]))


def _sure(contact: float, presses: int) -> float:
    """How far the dots must be told to have moved, px, to be no error of what is told beside so much contact of so many presses."""
    return LEAST_MOVE + LEAST_SHARE * contact / math.sqrt(presses)


def _apart(dots: PrintedDots, a: complex, b: complex, placement: Placement) -> float:
    """How far the dots are, by a z + b, from where a placement takes them, root mean square, px."""
    moved = (a - placement.a) * dots.standing.points + b - placement.b
    return float(np.sqrt((moved.real**2 + moved.imag**2).mean()))


def about_middle(dots: PrintedDots, a: complex, b: complex) -> Placement:
    """Placement that takes a dot at z px from the lattice's middle to a z + b, z = u + i v."""
    middle, shift = dots.standing.middle, np.array([b.real, b.imag])
    linear = np.array([[a.real, -a.imag], [a.imag, a.real]])
    return Placement(np.column_stack([linear, middle - linear @ middle + shift]), shift)
