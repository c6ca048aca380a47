"""The contact problem in process on ten-node tetrahedra: a whole load path, or its end alone."""

import numpy as np

from gelforge.mechanics.contact.facepoints import FacePoints
from gelforge.mechanics.path.tetpath import Kinematics, PathSettings, TetPath
from gelforge.mechanics.path.tetsolid import TetSolid
from gelforge.mechanics.path.transfer import LoadPath, volume_motion
from gelforge.mechanics.result import NoEquilibrium
from gelforge.mechanics.scene import Scene


def follow(scene: Scene, solid: TetSolid, points: FacePoints, start: float, settings: PathSettings) -> Kinematics:
    """Follow press and shear from the press fraction `start` of first touch to the end of the path.

    points: of the faces that may come to touch (`contact.reach.reachable`). Failure is a field of the result.
    """
    path = TetPath(scene, solid, points, settings)
    # nothing touches before: where a point is first met is sought from here on
    path.at = np.array([min(start, 0.98), 0.0])
    reason = ""
    try:
        for fraction in np.linspace(path.at[0], 1.0, path.press_steps() + 1)[1:]:
            path.advance(np.array([fraction, 0.0]))
        if scene.press.dx or scene.press.dy:
            for fraction in np.linspace(0.0, 1.0, settings.shear_steps + 1)[1:]:
                path.advance(np.array([1.0, fraction]))
        converged = path.iterate_contact()
        reason = "" if converged else "the contact set did not converge on the path"
    except NoEquilibrium as error:
        converged, reason = False, str(error)
    return Kinematics(path.contact, path.u, converged, reason, path.iterations, path.steps, path.rounds)


def arrive(
    scene: Scene,
    solid: TetSolid,
    points: FacePoints,
    nodes: np.ndarray,
    coarse_path: LoadPath,
    settings: PathSettings,
) -> Kinematics:
    """End of a path that was followed on hexahedra: no slip only. nodes: (n, 3) mm, undeformed.

    Where points stick comes from their own way through that path; what pulls or penetrates there is judged anew.
    """
    path = TetPath(scene, solid, points, settings)
    path.at = np.ones(2)
    u = np.where(solid.free[:, None], volume_motion(coarse_path.mesh, coarse_path.states[-1], nodes, scene.gel), 0.0)
    try:
        path.u = path.unfolded(u)
        converged = path.arrive(coarse_path) and path.iterate_contact()
        reason = "" if converged else "the contact set did not converge at the path's end"
    except NoEquilibrium as error:
        converged, reason = False, str(error)
    return Kinematics(
        path.contact, path.u, converged, reason, path.iterations, len(coarse_path.times) - 1, path.rounds
    )
