"""How the tilt of a mounting changes the force of a press and moves its centre, from three solves of some presses.

A press is tilted about the tip of its indenter. For a flat body that moves the centre of its force in proportion to
tilt, by 0.1 to 1 mm a degree, and changes the force itself with the square of tilt, by 0 to 3 % at 2 degrees. Both
depend on tilt over a power of depth (DEEPER) alone. A ball does not feel tilt, but it rolls aside, by its radius times
the tilt.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gelforge.calibration.readings import FEWEST, Readings
from gelforge.errors import BadInput
from gelforge.geometry.solids import Indenter, feels_tilt
from gelforge.records.press import Press

# Tilts about gel x and y at which a press is solved, degrees. A linear part of the force, beside the gel's apex, is left
# out: of a block of 10 mm, 1 mm beside it, it is 0.7 % at 2 degrees.
STEP_DEG = 2.0
NODES = ((0.0, 0.0), (STEP_DEG, 0.0), (0.0, STEP_DEG))
MOST_FLAT, MOST_ROUND = 6, 2  # presses of a mounting that are solved at tilts
ROUNDED_MM = 0.05  # to which the depths of these solves are rounded, so that sessions of the same presses share them
# mm; a flat body that leans by 3 degrees is pushed up to 2 mm beside its tip, but all to one side
MOST_BESIDE_MM = 1.5
# Exponent of depth: the tilt that moves the centre as far grows as depth to this power. 0.65 to 1.1 for blocks, cylinders,
# a cross and a tube pressed 0.3 to 1.2 mm deep by `draft`; on a bed of springs it is 1.
DEEPER = 0.8
SHALLOWEST = 0.4  # of the depth that was solved: at less the response is that of this depth


def mountings_of(readings: Readings) -> tuple[str, ...]:
    """Names of the readings' mountings, in their order."""
    return tuple(np.unique(readings.mountings).tolist())


def tilted_mountings(readings: Readings, catalogue: Mapping[str, Indenter]) -> tuple[tuple[str, ...], list[str]]:
    """Mountings whose tilt the readings determine, and a sentence on each of the others that has flat presses.

    That needs FEWEST straight presses of bodies that feel tilt with moments in the log. A mounting whose tilt is stated
    keeps that.
    """
    flat = np.array([feels_tilt(catalogue[name]) for name in readings.indenters], bool)
    found, said = [], []
    for name in mountings_of(readings):
        mine = readings.mountings == name
        if readings.stated[mine].any():
            continue
        straight = mine & flat & ~readings.sheared
        count = int(np.isfinite(readings.centre[straight]).all(axis=1).sum())
        if count >= FEWEST:
            found.append(name)
        elif (mine & flat).any():
            of = f" of mounting {name!r}" if name else ""
            said.append(
                f"The tilt{of} is not calibrated, and labels assume that there is none: that needs {FEWEST} straight presses of"
                f" flat bodies with mx_nm and my_nm in the log, which has {count or 'none'} of them."
            )
    return tuple(found), said


def centre_fault(readings: Readings) -> str:
    """Why the moments of the log cannot be about the gel's apex, or empty."""
    beside = readings.centre - readings.pose[:, :2]
    beside = beside[np.isfinite(beside).all(axis=1)]
    if len(beside) < FEWEST:
        return ""
    spread = float(np.median(np.abs(beside - np.median(beside, axis=0)), axis=0).max())
    if spread <= MOST_BESIDE_MM:
        return ""
    return (
        f"The moments put forces {spread:.1f} mm beside the presses, one to one side and one to another, and were not used: mx_nm and"
        " my_nm are moments on the gel about its apex, N m along gel x and y."
    )


def rounded(depth) -> np.ndarray:
    """Depths, mm, as sessions of the same presses share them: rounded to ROUNDED_MM, and at least that."""
    return np.round(np.maximum(np.round(np.asarray(depth, float) / ROUNDED_MM), 1.0) * ROUNDED_MM, 4)


def nodes_of(readings: Readings, i: int) -> list[Press]:
    """Paths of a press at NODES, straight down where it ends, to its depth rounded to ROUNDED_MM."""
    straight = readings.press(i, float(rounded(readings.depth[i]))).straight_there
    return [replace(straight, tilt_x_deg=x, tilt_y_deg=y) for x, y in NODES]


@dataclass(frozen=True)
class Tilts:
    """Responses of n presses to tilt.

    depth: (n,) mm, at which each was solved. flat: (n,) bool, whether it feels tilt. force: (n, 2) coefficients of the
    logarithm of the normal force, per square degree about gel x and y. centre: (n, 2) mm along gel x and y, of the force
    without tilt, nan where it is not used. moved: (n, 2, 2) mm per degree, how that moves by tilt about gel x and y.
    """

    depth: np.ndarray
    flat: np.ndarray
    force: np.ndarray
    centre: np.ndarray
    moved: np.ndarray

    def take(self, rows) -> "Tilts":
        return Tilts(self.depth[rows], self.flat[rows], self.force[rows], self.centre[rows], self.moved[rows])

    def factor(self, tilt: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Normal force over that without tilt, (w, n), at tilts (w, n, 2) degrees and depths (w, n) mm."""
        return np.exp((self.force * self._alike(tilt, depth) ** 2).sum(axis=2))

    def centres(self, tilt: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Centre of the force on the gel, (w, n, 2) mm, at tilts (w, n, 2) degrees and depths (w, n) mm."""
        return self.centre + np.einsum("nct,wnt->wnc", self.moved, self._alike(tilt, depth))

    def _alike(self, tilt: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """The tilts (w, n, 2) at the solved depths that do the same."""
        deeper = np.maximum(depth / self.depth, SHALLOWEST) ** DEEPER
        return tilt / np.where(self.flat, deeper, 1.0)[..., None]


def response(ends: Sequence[Mapping]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Force (2,), centre (2,) and its motion (2, 2), as in Tilts, from solves at NODES.

    ends: force "end" (3,) N and "centre" (2,) mm of each. A press that does not touch there raises BadInput.
    """
    forces, centres = -np.array([one["end"][2] for one in ends]), np.array([one["centre"] for one in ends])
    if not (forces > 0.0).all():
        raise BadInput("a press does not touch the gel at one of the tilts at which it is solved")
    return np.log(forces[1:] / forces[0]) / STEP_DEG**2, centres[0], (centres[1:] - centres[0]).T / STEP_DEG


def solved_presses(readings: Readings, flat: np.ndarray) -> np.ndarray:
    """Indices of the presses that are solved at tilts: of those with a centre, the ones with the largest forces.

    flat: (n,) bool, whether a press feels tilt. At most MOST_FLAT of these and MOST_ROUND others.
    """
    centred = np.flatnonzero(np.isfinite(readings.centre).all(axis=1))
    firmest = centred[np.argsort(readings.force[centred, 2], kind="stable")]
    return np.sort(np.concatenate([firmest[flat[firmest]][:MOST_FLAT], firmest[~flat[firmest]][:MOST_ROUND]]))
