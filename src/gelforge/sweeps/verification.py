"""A fraction of presses is solved by a second method, too, and both results are compared."""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import listed, record_of, write_json
from gelforge.flow.schema import altered
from gelforge.flow.tables import FeaTable
from gelforge.labelling.grid import Grid
from gelforge.labelling.operator import assemble
from gelforge.labelling.sensor import Sensor
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.scene import Interface, Scene
from gelforge.sweeps.deviation import cell_error, total_error

ENDING = ".verify.json"
GRID = Grid(24, 32)  # of FEATS' labels, on which the errors of methods are benchmarked
ALLOWED = 0.05  # fraction of the verified presses that may differ by more than their limits
# The second method for each first one, and what their agreement shows.
SECOND = {
    "ccx": ("ccx-contact", "the same ends of presses without friction; CalculiX found the contact itself, so this checks the contact"
                           " and its edge, not friction"),
    "ccx-contact": ("ccx", "the same presses; the contact of the second method was found in process"),
}  # fmt: skip
BY_CALCULIX = (
    "ccx",
    "the same presses on other elements and another mesh, with the equilibrium of CalculiX; both methods find the contact by the same"
    " algorithm, so this checks elements, meshes and equilibrium, not the contact law",
)
HARD, HARD_MM = 1000.0, 0.7  # contact penalty, multiples of C10 per mm, and edges of a check by CalculiX' own contact


@dataclass(frozen=True)
class Verified:
    """Differences of one press between both methods, and their limits, as fractions of the second one's total force.

    key: digest of the inputs of both solves. method, second: the two methods. reason: why there are no differences,
    empty where there are. limit_total, limit_cells: sums of both solves' own error estimates.
    """

    key: str
    sample_id: str
    method: str
    second: str
    reason: str
    total: float | None
    cells: float | None
    limit_total: float
    limit_cells: float

    @property
    def beyond(self) -> bool:
        """Whether a difference exceeds its limit."""
        found = ((self.total, self.limit_total), (self.cells, self.limit_cells))
        return any(value is not None and value > limit for value, limit in found)

    def sentence(self) -> str:
        """The differences of this press as a sentence."""
        return (
            f"{self.sample_id}: {self.method} and {self.second} differ by {self.total:.1%} of total force and {self.cells:.1%} summed"
            f" over the cells; the error estimates of both add up to {self.limit_total:.1%} and {self.limit_cells:.1%}"
        )


def chosen(sample_id: str, fraction: float) -> bool:
    """Whether a press is verified: by a hash of its name, so that the choice is the same everywhere."""
    digest = hashlib.sha256(sample_id.encode()).digest()
    return int.from_bytes(digest[:8], "big") < fraction * 2**64


@dataclass(frozen=True)
class Check:
    """How a press is checked: the scenes that both methods solve, the settings of each; None: the press's own solve."""

    scenes: list[Scene]
    first: FeaTable | None
    second: FeaTable


def check_of(method: str, scenes: list[Scene], fea: FeaTable) -> Check:
    """The check of a press that was solved by `method`.

    Against CalculiX' own contact its end is solved without friction by both: CalculiX counts motion before a point
    touches as stick.
    """
    second, _ = SECOND.get(method, BY_CALCULIX)
    if second == "ccx-contact":
        end = [replace(scenes[-1], interface=Interface("frictionless")).direct]
        return Check(
            end, altered(fea, method=method), altered(fea, method=second, contact_stiffness=HARD, contact_mm=HARD_MM)
        )
    return Check(scenes, None, altered(fea, method=second))


def meaning(method: str, second: str) -> str:
    """What agreement of two methods shows, as a sentence."""
    return f"{method} and {second}: {SECOND.get(method, BY_CALCULIX)[1]}."


def surface_cells(mesh: GelMesh, force: np.ndarray, sensor: Sensor) -> np.ndarray:
    """Force per cell (3, rows, columns) N of forces (s, 3) at the surface nodes of a mesh."""
    nodes = mesh.surface_nodes
    return assemble(mesh, sensor, GRID).apply(np.array([0, len(nodes)]), nodes, force)[0][0]


def compare(
    about: tuple[str, str, str, str], errors: Sequence[tuple[float, float]], found: tuple[np.ndarray, np.ndarray] | str,
    right: tuple[np.ndarray, np.ndarray] | None,
) -> Verified:  # fmt: skip
    """The differences of a press; about: key, sample_id and both methods of `Verified`.

    errors: `error_n` and `cells_error_n` of both solves, N. found: total (3,) and cells (3, rows, columns) N of
    the first, or the reason why there is nothing to compare. right: the same of the second.
    """
    if isinstance(found, str) or right is None:
        return Verified(*about, str(found), None, None, 0.0, 0.0)
    total, cells = np.sum(errors, axis=0) / np.linalg.norm(right[0])
    difference = total_error(found[0], right[0]), cell_error(found[1], right[1], right[0])
    return Verified(*about, "", *difference, float(total), float(cells))


def write_verified(path: Path, found: Verified) -> None:
    """Write the record of one press."""
    write_json(path, asdict(found))


def kept_verified(path: Path) -> Verified | None:
    """The record of one press; None where it is missing or unreadable."""
    record = record_of(path)
    return Verified(**record) if record else None


def read_verified(folders: Sequence[Path]) -> list[Verified]:
    """Records of all presses below folders of stage 30, by sample_id."""
    records = [kept_verified(path) for folder in folders for path in listed(folder, f"*{ENDING}")]
    return sorted((record for record in records if record is not None), key=lambda record: record.sample_id)


def table(records: Sequence[Verified]) -> tuple[list[str], list[list]]:
    """Columns and rows of the differences by method: median and worst, and the median limit."""
    columns = [
        "method",
        "second method",
        "presses",
        "total, median",
        "worst",
        "limit",
        "cells, median",
        "worst",
        "limit",
    ]
    rows = []
    solved = [record for record in records if not record.reason]
    for method, second in sorted({(record.method, record.second) for record in solved}):
        own = [
            (r.total, r.limit_total, r.cells, r.limit_cells)
            for r in solved
            if (r.method, r.second) == (method, second)
        ]
        total, total_limit, cells, cells_limit = np.array(own).T
        shown = (
            np.median(total),
            total.max(),
            np.median(total_limit),
            np.median(cells),
            cells.max(),
            np.median(cells_limit),
        )
        rows.append([method, second, len(own), *(f"{value:.2%}" for value in shown)])
    return columns, rows


def refuse_beyond(records: Sequence[Verified]) -> None:
    """Raise BadInput if more than a fraction ALLOWED of the verified presses exceed their limits."""
    solved = [record for record in records if not record.reason]
    beyond = [record for record in solved if record.beyond]
    if len(beyond) > ALLOWED * len(solved):
        raise BadInput(
            f"{len(beyond)} of {len(solved)} verified presses differ from a second method by more than the sum of both error estimates"
            f" (at most {ALLOWED:.0%} may): {'; '.join(record.sentence() for record in beyond[:5])}; look at these presses, and"
            ' set [fea] method = "ccx", or lower tolerance or edge_mm'
        )
