"""Pictures laid onto an untouched one of another day, where the gel sat or was seen otherwise.

A gel that was taken out and put back, or a driver that crops otherwise, moves every dot alike: by a shift, a turn and a
zoom, which a small network tells from what contact does (networks.placereader). How a gel sits is the same in all pictures
of one sitting: the middle of what each of them tells is nearer to it than any one of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gelforge.networks.dotaugment import PITCH
from gelforge.networks.dots import COLS, ROWS, Followed, PrintedDots
from gelforge.networks.placereader import PlaceReader

# Root mean square over the dots; a smaller move is none. Of presses of gels that sat still, by units that the reader did
# not learn from, three in a thousand are told to have been moved farther, and one in a hundred where ten dots are worn.
LEAST_MOVE = 0.75  # px


@dataclass(frozen=True)
class Placement:
    """Where the untouched picture's points lie in another one: point -> matrix @ (u, v, 1), matrix (2, 3).

    shift: (2,) px along u and v of the dot nearest to the picture's middle.
    """

    matrix: np.ndarray
    shift: np.ndarray

    @property
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
    def told(self) -> str:
        """What was put right, as a person reads it; empty where nothing was."""
        if not self.moves:
            return ""
        right, down = self.shift
        return (
            f"({right:+.1f}, {down:+.1f}) px aside, {self.turn:+.1f} degrees turned, {self.zoom:.3f} times as large, as its"
            " dots tell"
        )

    def undo(self, image: np.ndarray) -> np.ndarray:
        """The image (h, w, 3) uint8 as it would be seen from where the untouched one was taken."""
        import cv2

        if not self.moves:
            return image
        how = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        return cv2.warpAffine(image, self.matrix, image.shape[1::-1], flags=how, borderMode=cv2.BORDER_REPLICATE)


UNPLACED = Placement(np.eye(2, 3), np.zeros(2))


def place(reader: PlaceReader | None, dots: PrintedDots, sitting: Sequence[Followed]) -> Placement:
    """Placement of pictures of one sitting on the untouched one whose dots these are, by what its dots did in each of them.

    Nothing is moved where no reader is given, no print is seen, or the move is below LEAST_MOVE.
    """
    if reader is None or not dots.known or not sitting:
        return UNPLACED
    a, b = reader.similarities(np.stack([dots.on_lattice(followed) for followed in sitting]))
    return about_middle(dots, _middle(a), _middle(b))


def _middle(values: np.ndarray) -> complex:
    """Medians of the real and the imaginary parts of complex numbers (n,)."""
    return complex(np.median(values.real), np.median(values.imag))


def about_middle(dots: PrintedDots, a: complex, b: complex) -> Placement:
    """Placement that takes a dot at z px from the lattice's middle to a z + b, z = u + i v for dots PITCH px apart."""
    known = dots.at[:, 0] >= 0
    rests, index = dots.points[known], dots.at[known] - (ROWS // 2, COLS // 2)
    middle = rests[np.flatnonzero(~index.any(axis=1))[0]]
    # of a print of another pitch the same motion is another turn and zoom
    pitch = np.linalg.norm(rests - middle) / np.linalg.norm(index)
    a = 1 + (a - 1) * float(PITCH / pitch)
    shift, linear = np.array([b.real, b.imag]), np.array([[a.real, -a.imag], [a.imag, a.real]])
    moved = (rests - middle) @ (linear - np.eye(2)).T + shift
    if np.sqrt((moved**2).sum(axis=1).mean()) < LEAST_MOVE:
        return UNPLACED
    return Placement(np.column_stack([linear, middle - linear @ middle + shift]), shift)
