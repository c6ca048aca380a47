"""What gelforge offers to a Python program: solve a press, label it, read images."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gelforge.errors import BadInput, GelforgeError
from gelforge.flow.params.tables import SOFTEST, STIFFEST
from gelforge.geometry.gel import load_gel
from gelforge.labelling.grid import Grid
from gelforge.labelling.sensor import Sensor
from gelforge.mechanics.mesh import GelMesh
from gelforge.mechanics.scene import REFERENCE_C10, Indenter, Material, Scene
from gelforge.records.axes import AXIS_OF_CHANNEL
from gelforge.records.press import Press

if TYPE_CHECKING:  # at run time it would bring torch along
    from gelforge.networks.placement import Placement
    from gelforge.networks.use import Judgement


@dataclass(frozen=True)
class SolvedPress:
    """A solved press: forces (n, 3) N on the gel and displacement (n, 3) mm of the nodes of `mesh`."""

    gel: str
    mesh: GelMesh
    forces: np.ndarray
    displacement: np.ndarray
    evidence: dict[str, Any]

    @property
    def total(self) -> np.ndarray:
        """Resultant contact force on the gel along its x, y, z, (3,) N."""
        return self.forces.sum(axis=0)


def solve(
    indenter: Indenter | dict[str, Any],
    depth: float,
    at: tuple[float, float] = (0.0, 0.0),
    shear: tuple[float, float] = (0.0, 0.0),
    rot_deg: float = 0.0,
    gel: str = "gelsight_mini",
    c10: float = REFERENCE_C10,
    nu: float = 0.475,
    quality: str = "draft",
) -> SolvedPress:
    """Press an indenter into a gel, down by `depth` mm and then sideways by `shear` mm, by finite elements in process.

    indenter: a body, or a table as in workflow/indenters.toml. at: where its tip meets the crown plane, mm.
    depth: mm from 0 on, positive into the gel. c10: stiffness of the gel, MPa. nu: its Poisson's ratio. quality: "label", "draft" or "demo", slow to fast.
    A press that cannot be solved raises GelforgeError with its reason.
    """
    if not (_finite(c10, nu) and SOFTEST <= c10 <= STIFFEST and 0.0 <= nu < 0.5):
        raise BadInput(
            f"gelforge.solve: c10 = {c10!r}, nu = {nu!r}: give c10 from {SOFTEST:g} to {STIFFEST:g} MPa and nu from 0 to below 0.5"
        )
    pairs = np.shape(at) == np.shape(shear) == (2,)
    if not (pairs and _finite(depth, *at, *shear, rot_deg) and depth >= 0.0):
        raise BadInput(
            f"gelforge.solve: depth = {depth!r}, at = {at!r}, shear = {shear!r}, rot_deg = {rot_deg!r}: give finite numbers, two "
            "of them, along gel x and y, for at and for shear, and a depth in mm from 0 on, positive into the gel"
        )
    from gelforge.geometry.indenters import build
    from gelforge.mechanics.hex.hexsolver import HexSolver
    from gelforge.mechanics.hex.settings import quality as settings

    body: Any = build("indenter", indenter, "gelforge.solve") if isinstance(indenter, dict) else indenter
    if not hasattr(body, "distance"):
        raise BadInput(f"gelforge.solve: indenter = {body!r}: give a body, or a table as in workflow/indenters.toml")
    press = Press(at[0], at[1], 0.0, shear[0], shear[1], -depth, rot_deg)
    scene = Scene(load_gel(gel), Material(nu), body, press)
    result = HexSolver(settings(quality)).solve(scene)
    if not result.status.valid or result.bricks is None:
        raise GelforgeError(f"the press was not solved: {result.evidence.get('reason') or result.status.value}")
    forces = result.forces * (c10 / REFERENCE_C10)  # exactly so: the solid's stress is proportional to C10
    return SolvedPress(gel, result.bricks.mesh(), forces, result.displacement, result.evidence)


def _finite(*values: Any) -> bool:
    """Whether all of these are finite numbers."""
    return all(isinstance(value, int | float | np.number) and bool(np.isfinite(value)) for value in values)


def label(solved: SolvedPress, resolution: str = "24x32", sensor: Sensor | None = None) -> np.ndarray:
    """Bin a solved press into force per cell of an image grid, N: (3, rows, cols) in the order of FEATS' channels.

    sensor: how gel and image meet; `gelsight_mini()` where None. What lies outside its image is left out.
    """
    from gelforge.labelling.operator import assemble

    nodes = np.flatnonzero(solved.forces.any(axis=1))
    operator = assemble(solved.mesh, sensor or gelsight_mini(), Grid.parse(resolution))
    cells, _outside = operator.apply([0, len(nodes)], nodes, solved.forces[nodes])
    return cells[0][list(AXIS_OF_CHANNEL)]


def gelsight_mini() -> Sensor:
    """A GelSight Mini as its maker's driver shows it: 15.77 px/mm, image 320 x 240 (workflow/sensors.toml)."""
    projection = np.array([[0.0, -15.77, 160.0], [-15.77, 0.0, 120.0], [0.0, 0.0, 1.0]])
    return Sensor("gelsight_mini", (320, 240), projection)


def predict(
    image: np.ndarray, untouched: np.ndarray | None = None, model: Any = None
) -> tuple[np.ndarray, dict[str, Any]]:
    """Read forces from one image (h, w, 3) uint8 RGB; return (3, rows, cols) N and how far to trust it.

    untouched: a picture of the same sensor while nothing touches it. model: path; the network that ships where None.
    The verdict has what networks.use.Judgement has, by the same names: its `flag` is True where something is wrong with
    the pictures, and `reason` says what.
    """
    from gelforge.networks.use import Untouched, load_for_use, predict_one

    picture = None if untouched is None else check_image(untouched)
    _seen, forces, judgement = predict_one(Untouched(load_for_use(model), picture), check_image(image))
    return forces, vars(judgement) | {"flag": judgement.flag}


@dataclass(frozen=True)
class ForceReading:
    """What was read in one image, forces on the gel in N.

    cells: (3, rows, cols) along gel y, gel x and the gel's normal (FEATS' channels; pressing is negative). In a picture
    of a GelSight Mini gel y points to the left and gel x upwards. total: (3,), their sums. half_width: (3,) of intervals
    that hold nine of ten totals on sensors that the network never saw, of gels as stiff as those it learnt from, or as
    uncertain as the factor of a profile tells; None where the model knows none. flag: True where something is wrong with
    the pictures, and `reason` says what. by_dots: (3,) what the motion of the printed dots tells by itself, whatever the
    light; None where the gel has none, or the network no reader of them. edge_peak: largest normal force of a cell at
    the edge of what the picture shows, over the largest of all; from 0.2 on, what touches goes on beyond the picture, and
    total is a part of its force only. It is NaN where the map has fewer than three rows or columns, as that of a model that
    only knows totals.
    """

    cells: np.ndarray
    total: np.ndarray
    half_width: np.ndarray | None
    flag: bool
    reason: str
    by_dots: np.ndarray | None
    edge_peak: float


class Reader:
    """Reads forces from images of one sensor, NumPy in and out.

    untouched: picture (h, w, 3) uint8 RGB of the sensor while nothing touches it; may be left out with a profile, which
    holds one. profile: path of a profile that `gelforge sensor` wrote, whose factor the forces are multiplied by. model:
    path of a model; the network that ships where None. Raises BadInput for pictures that are none of this sensor.
    """

    def __init__(self, untouched: np.ndarray | None = None, profile: Path | str | None = None, model: Any = None):
        from gelforge.networks.sensorprofile import untouched_of
        from gelforge.networks.use import Untouched, load_for_use

        path, trained = None if profile is None else Path(profile), load_for_use(model)
        picture, gain = untouched_of(path, None if untouched is None else check_image(untouched), trained.about)
        self._untouched = Untouched(trained, picture, gain=gain)

    def __call__(self, image: np.ndarray) -> ForceReading:
        """Read one image (h, w, 3) uint8 RGB by itself; for those that a camera gives one after the other: `stream`."""
        return self._read(check_image(image), None)

    def stream(self, images: Iterable[np.ndarray]) -> Iterator[ForceReading]:
        """Read images (h, w, 3) uint8 RGB as they come from a camera, one reading each, as `gelforge live` does.

        Where the gel sits otherwise than in the untouched picture, the last of them tell it together, which is surer than
        what one does, and keeps forces from jumping as a press begins; a gel that is pushed in its holder is followed within
        20 images. Where images cannot tell it, as those that do not show the gel's rim, each is read by itself. One that is no
        image raises BadInput and ends the stream.
        """
        from gelforge.networks.sitting import Stream

        stream = Stream(self._untouched)
        return (reading_of(*stream.read(check_image(image))[1:]) for image in images)

    def _read(self, image: np.ndarray, placement: "Placement | None") -> ForceReading:
        from gelforge.networks.use import predict_one

        return reading_of(*predict_one(self._untouched, image, placement)[1:])

    def batch(self, images: np.ndarray, one_sitting: bool = False) -> list[ForceReading]:
        """Read images (n, h, w, 3) uint8 RGB, one reading each.

        one_sitting: whether the gel sat in its holder alike in all of them, as `gelforge predict` takes the images of
        one call to be, whose forces these then are. Then four and more of them tell together how it sits, which is
        surer than what one of them does. Otherwise each is read by itself, as if no other were there: where the gel
        sits otherwise than in the untouched picture, or seems to in one of the images, forces differ from those of
        `gelforge predict`.
        """
        from gelforge.networks.sitting import place_sitting

        checked = [check_image(image) for image in images]
        placement = place_sitting(self._untouched, checked) if one_sitting else None
        return [self._read(image, placement) for image in checked]


def reading_of(cells: np.ndarray, judged: "Judgement") -> ForceReading:
    """What was read in an image: forces (3, rows, cols) N, and a judgement of them."""
    total = cells.sum(axis=(1, 2), dtype=float)
    return ForceReading(cells, total, judged.half_width, judged.flag, judged.reason, judged.by_dots, judged.edge_peak)


def check_image(image: np.ndarray) -> np.ndarray:
    """An image (h, w, 3) uint8; anything else raises BadInput."""
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
        raise BadInput(f"an image of shape {image.shape} and type {image.dtype}: give (height, width, 3) uint8 RGB")
    return image
