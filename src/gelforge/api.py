"""Python interface of gelforge: solve a press and label it; `reading.reader` reads images."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ParamSpec, TypeVar

import numpy as np

from gelforge.errors import BadInput, GelforgeError, nearest
from gelforge.flow.cli import missing_extra
from gelforge.flow.files import digest_of
from gelforge.geometry.gel import gels_from, load_gel
from gelforge.geometry.solids import Indenter
from gelforge.labelling.grid import Grid
from gelforge.labelling.sensor import Sensor, gelsight_mini
from gelforge.mechanics.material import REFERENCE_C10, Material
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.result import friction_error_n, moment_of_nodes
from gelforge.mechanics.scene import FRICTION, FRICTION_ERROR, Interface, Scene
from gelforge.records.press import Press

PARAMETERS = Path(__file__).parent / "flow"  # folder of params.toml in an installed package
P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True)
class SolvedPress:
    """A solved press.

    Attributes:
        gel: name of the gel.
        mesh: its n nodes (n, 3) mm in the gel frame, undeformed, and its elements.
        forces: contact force on the gel at the nodes, (n, 3) N along gel x, y, z; pressing is negative.
        displacement: of the nodes, (n, 3) mm.
        error_n: 90 % bound on the error of the mesh, of the total force's magnitude, N; NaN if unknown.
        friction_error_n: by how much the total force is off, N, if the friction coefficient is off by 0.2; NaN unless
            `friction` is a finite coefficient above 0. evidence["slipping"]: share of the force in points that slip.
        evidence: diagnostics of the solver, such as its load steps.
        indenter, method: names of the body and of the method that solved it.
        depth: of the tip below the gel's apex, mm.
    """

    gel: str
    mesh: GelMesh
    forces: np.ndarray
    displacement: np.ndarray
    error_n: float
    friction_error_n: float
    evidence: dict[str, Any]
    indenter: str
    method: str
    depth: float

    @property
    def total(self) -> np.ndarray:
        """Resultant contact force on the gel along its x, y, z, (3,) N."""
        return self.forces.sum(axis=0)

    @property
    def moment(self) -> np.ndarray:
        """Moment of the contact force on the gel about gel x, y, z through the apex, (3,) N mm.

        The apex is the middle of the gel's undeformed surface, the origin of the gel frame.
        """
        return moment_of_nodes(self.mesh.nodes + self.displacement, self.forces).sum(axis=0)

    @property
    def moment_error(self) -> float:
        """90 % bound on the error of the mesh, of the moment's magnitude, N mm; NaN if unknown.

        `error_n` times the distance of the force's centre from the apex, and the contact's radius of gyration beside it.
        """
        size, places = np.linalg.norm(self.forces, axis=1), self.mesh.nodes + self.displacement
        if not size.any():
            return 0.0
        centre = np.average(places, axis=0, weights=size)
        spread = np.average(((places - centre) ** 2).sum(axis=1), weights=size)
        return float(self.error_n * (np.linalg.norm(centre) + np.sqrt(spread)))

    def __repr__(self) -> str:
        (x, y, z), (mx, my, mz) = self.total, self.moment
        return (
            f"SolvedPress({self.indenter} on {self.gel}, {self.method}: fx {x:+.3f}, fy {y:+.3f}, fz {z:+.3f} +- {self.error_n:.3f} N,"
            f" mx {mx:+.2f}, my {my:+.2f}, mz {mz:+.2f} +- {self.moment_error:.2f} N mm, {len(self.mesh.nodes)} nodes)"
        )

    def plot(self, resolution: str | tuple[int, int] = "24x32", sensor: Sensor | None = None) -> Any:
        """Draw the three maps of force per cell.

        Args:
            resolution: rows and columns of the grid, as in `label`.
            sensor: as in `label`.

        Returns:
            A matplotlib Figure: one panel for each component, N per cell; `figure.savefig(path)` writes it.
        """
        return _drawn(label(self, resolution, sensor), repr(self))


def _needs_extra(run: Callable[P, R]) -> Callable[P, R]:
    """Decorator: a ModuleNotFoundError of the function names the extra that installs the package."""

    @wraps(run)
    def with_extra(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return run(*args, **kwargs)
        except ModuleNotFoundError as error:
            said = missing_extra(error)
            if said is None:
                raise
            raise ModuleNotFoundError(said, name=error.name) from error

    return with_extra


@_needs_extra
def _drawn(cells: np.ndarray, title: str) -> Any:
    from gelforge.reporting.forcemaps import maps_figure

    return maps_figure(cells, title)


@_needs_extra
def solve(
    indenter: Indenter | dict[str, Any] | str,
    depth: float | None = None,
    at: tuple[float, float] = (0.0, 0.0),
    shear: tuple[float, float] = (0.0, 0.0),
    rot_deg: float = 0.0,
    tilt: tuple[float, float] = (0.0, 0.0),
    gel: str = "gelsight_mini",
    c10: float = REFERENCE_C10,
    nu: float = 0.475,
    friction: float = FRICTION,
    method: str = "draft",
    gels: Path | str | None = None,
    meshes: Path | str | None = None,
    force: float | None = None,
) -> SolvedPress:
    """Press an indenter into a gel, down and then sideways, by finite elements in process.

    Args:
        indenter: a name of workflow/indenters.toml, such as "sphere_10", a table as in that file (mm), or a body.
        depth: of the tip below the gel's apex, mm, 0 or positive; or give `force`.
        at: x, y of the tip in the gel frame before shear, mm.
        shear: x, y of the sideways motion at that depth, mm.
        rot_deg: rotation of the indenter about z, degrees.
        tilt: after that, right-handed rotations about the tip, first about gel x, then about gel y, degrees.
        gel: name of a gel; NAME-3.6mm is the same gel with that thickness at its apex.
        c10: stiffness of the neo-Hookean gel, MPa.
        nu: its Poisson's ratio, from 0 to below 0.5.
        friction: Coulomb friction coefficient between indenter and gel, 0 or more; 0: none, math.inf: points that touch
            stick.
        method: "draft", "label" or "fine": hexahedra, fast to slow; "ccx": CalculiX, which must be installed; "auto":
            the first of draft, label, ccx that states an error within 2.4 %, else the one that states the least.
        gels: file with your own gels, such as workflow/gels.toml; `gel` may then name one of them.
        meshes: folder in which the mesh of each gel is kept for "ccx" and "auto", so that it is made once and results
            repeat; None: it is made once in each process, by pytetwild, whose meshes differ from run to run.
        force: in place of `depth`: normal force on the gel at the end of the path, N, above 0. The depth is found at which the
            solved force differs from it by at most 0.5 %, usually by two solves; it is `depth` of the result. Sideways motion
            is given in mm alone.

    Returns:
        The state at the end of the path: a mesh, and forces in N and displacements in mm of its nodes.

    Raises:
        BadInput: an argument is invalid; the message names it.
        GelforgeError: the press has no solution; the message says why.
    """
    from gelforge.flow.tables import METHODS, SOFTEST, STIFFEST

    if not (_finite(c10, nu) and SOFTEST <= c10 <= STIFFEST and 0.0 <= nu < 0.5):
        raise BadInput(
            f"gelforge.solve: c10 = {c10!r}, nu = {nu!r}: give c10 from {SOFTEST:g} to {STIFFEST:g} MPa and nu from 0 to below 0.5"
        )
    if method not in METHODS:
        raise BadInput(f"gelforge.solve: method = {method!r}: choose {', '.join(METHODS)}")
    if not (_finite(friction) or friction == float("inf")) or friction < 0.0:
        raise BadInput(
            f"gelforge.solve: friction = {friction!r}: give a coefficient of 0 or more, or math.inf for points that stick"
        )
    pairs = np.shape(at) == np.shape(shear) == np.shape(tilt) == (2,)
    if (depth is None) == (force is None) or not (force is None or (_finite(force) and force > 0.0)):
        raise BadInput(
            f"gelforge.solve: depth = {depth!r}, force = {force!r}: give one of both, a depth of 0 mm or more or a force above 0 N"
        )
    if not (pairs and _finite(depth or 0.0, *at, *shear, rot_deg, *tilt) and (depth or 0.0) >= 0.0):
        raise BadInput(
            f"gelforge.solve: depth = {depth!r}, at = {at!r}, shear = {shear!r}, rot_deg = {rot_deg!r}, tilt = {tilt!r}: give finite"
            " numbers: two each for at, shear and tilt, along gel x and y, and a depth of 0 mm or more, positive into the gel"
        )
    from gelforge.flow.params import load_params
    from gelforge.mechanics.mesh.basemesh import meshes_in
    from gelforge.mechanics.mesh.names import load_mesh
    from gelforge.mechanics.solve import Solvers
    from gelforge.mechanics.toforce import press_to

    body = _body(indenter)
    interface = Interface.of_friction(float(friction))
    with gels_from(gels), meshes_in(meshes), TemporaryDirectory() as workdir:
        solvers = Solvers(workdir, load_params(PARAMETERS).fea)

        def scene_at(depth: float) -> Scene:
            press = Press(at[0], at[1], 0.0, shear[0], shear[1], -depth, rot_deg, *map(float, tilt))
            return Scene(load_gel(gel), Material(nu), body, press, interface)

        reached = depth or 0.0
        if force is None:
            result = solvers.solve(scene_at(reached), method)
        else:
            reached, result = press_to(
                force * REFERENCE_C10 / c10, scene_at, lambda each: solvers.solve(each, method)
            )
        if not (result.status.valid and result.evidence.get("mesh")):
            raise GelforgeError(f"the press was not solved: {result.evidence.get('reason') or result.status.value}")
        mesh = load_mesh(result.evidence["mesh"])
    stiffer = c10 / REFERENCE_C10  # exact, because stress is proportional to C10
    forces, error_n = stiffer * result.forces, stiffer * result.error_n
    friction_n = stiffer * friction_error_n(result.evidence, interface.mu, FRICTION_ERROR)
    how = result.evidence["method"]
    return SolvedPress(
        gel, mesh, forces, result.displacement, error_n, friction_n, result.evidence, body.name, how, reached
    )


_BUILT: dict[tuple[str, str], Indenter] = {}  # bodies of tables, the latest MOST_BUILT
MOST_BUILT = 16


def _body(indenter: Indenter | dict[str, Any] | str) -> Any:
    """The body of an argument: a name, a table or a body."""
    from gelforge.geometry.indenters import CATALOGUE, build, read_catalogue

    if isinstance(indenter, str):
        tables = read_catalogue(CATALOGUE)
        if indenter not in tables:
            raise BadInput(
                f"gelforge.solve: indenter = {indenter!r}: not in workflow/indenters.toml{nearest(indenter, tables)}"
            )
        return build(indenter, tables[indenter], "workflow/indenters.toml")
    if isinstance(indenter, dict):
        # a sampled STL takes up to a minute, so what was built of the same table and file is kept
        file = Path(str(indenter.get("file", "")))
        key = repr(sorted(indenter.items())), digest_of(file) if file.is_file() else ""
        if key not in _BUILT:
            while len(_BUILT) >= MOST_BUILT:
                _BUILT.pop(next(iter(_BUILT)))
            _BUILT[key] = build(str(indenter.get("kind", "")), indenter, "gelforge.solve")
        return _BUILT[key]
    if not hasattr(indenter, "distance"):
        raise BadInput(
            f"gelforge.solve: indenter = {indenter!r}: give a name or a table of workflow/indenters.toml, or a body"
        )
    return indenter


def _finite(*values: Any) -> bool:
    """Whether all of these are finite numbers."""
    return all(isinstance(value, int | float | np.number) and bool(np.isfinite(value)) for value in values)


@_needs_extra
def label(
    solved: SolvedPress, resolution: str | tuple[int, int] = "24x32", sensor: Sensor | None = None
) -> np.ndarray:
    """Bin a solved press into force per cell of an image grid.

    Args:
        solved: what `solve` returned.
        resolution: rows and columns of the grid, such as "24x32" or (24, 32).
        sensor: projection from gel to image; None: a GelSight Mini with the image of its maker's driver.

    Returns:
        Force on the gel per cell, (3, rows, cols) N, along gel x, y and z (pressing is
        negative). Forces outside the image are left out.

    Raises:
        BadInput: an invalid resolution, or a sensor whose image shows no part of the gel.
    """
    from gelforge.labelling.operator import assemble

    nodes = np.flatnonzero(solved.forces.any(axis=1))
    operator = assemble(solved.mesh, sensor or gelsight_mini(), Grid.of(resolution))
    cells, _outside = operator.apply([0, len(nodes)], nodes, solved.forces[nodes])
    return cells[0]
