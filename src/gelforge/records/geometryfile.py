"""The gel's shape in one picture, as the virtual rig leaves it for networks to be taught."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import publish
from gelforge.records.npz import DAMAGED, in_short

STEP = 1 / 64  # of a slope, as it is kept
STEEPEST = 127  # steps


@dataclass(frozen=True)
class Geometry:
    """The gel's shape in a picture.

    slopes: (2, rows, cols) int8, slope of the surface against the unloaded one along u and v in steps of STEP, steeper ones cut.
    motion: (2, rows, cols) float16 px, how far gel points appear moved along u and v.
    """

    slopes: np.ndarray
    motion: np.ndarray

    @classmethod
    def of(cls, slopes: np.ndarray, motion: np.ndarray) -> "Geometry":
        """From slopes in mm per mm and motion in px."""
        steps = np.clip(np.rint(slopes / STEP), -STEEPEST, STEEPEST).astype(np.int8)
        return cls(steps, motion.astype(np.float16))

    def save(self, path: Path) -> None:
        """Write to an .npz file, whole or not at all."""
        with publish(path) as part:
            np.savez_compressed(part, slopes=self.slopes, motion=self.motion)


def load_geometry(path: Path) -> Geometry:
    """Read what `Geometry.save` wrote; anything else raises BadInput."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return Geometry(file["slopes"], file["motion"])
    except DAMAGED as error:
        raise BadInput(
            f"{path}: no shape of a gel ({in_short(error)}); remove it with its picture and make the rig again, or remove"
            f" {path.parent} to do without"
        ) from None
