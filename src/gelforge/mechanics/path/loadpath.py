"""The load path of a press: press, then shear, with one path parameter; its frames, and the gel that it meets."""

import math
from dataclasses import replace

import numpy as np

from gelforge.errors import BadInput
from gelforge.geometry import touch
from gelforge.mechanics.path.pathsettings import PathSettings
from gelforge.mechanics.pose import Pose
from gelforge.mechanics.scene import Scene
from gelforge.records.frames import MOST_DEEPER_MM, MOST_FARTHER_MM

ROUNDING_MM = 1e-6  # far below the resolution of an axis
# Part of the way down that a press under friction is walked at least. Walked 0.1 mm for 0.2, blocks and punches with edges of
# 0.1 mm, 1 mm deep, were 2 to 4 % too low: points at the edge that slip on coarse hexahedra stick on fine ones.
LEAST_WALKED = 0.2
WITHIN = 1.0  # mm from the indenter's path within which a face may come into contact


def path_pose(scene: Scene, t: float) -> Pose:
    """Pose at path parameter t: 0 to 1 press, 1 to 2 shear; below 0 the press is extended upwards."""
    return Pose(*touch.pose_at(scene.press, t))


def slides(scene: Scene, start: float) -> bool:
    """Whether a press under a law with friction moves farther sideways than down after `start`, its first touch."""
    aside = math.hypot(scene.press.dx, scene.press.dy)
    return scene.interface.contact.frictional and aside > path_length(scene, start, 1.0)


def fitted(settings: PathSettings, scene: Scene, start: float) -> PathSettings:
    """Settings whose load steps and walk suit a scene's path from `start`, its first touch.

    Under a law with friction no load step is longer than press_mm and shear_mm, and a press that is deep or slides is
    walked longer.
    """
    if not scene.interface.contact.frictional:
        return settings
    down, aside = path_length(scene, start, 1.0), math.hypot(scene.press.dx, scene.press.dy)
    return replace(
        settings, press_steps=max(settings.press_steps, math.ceil(down / settings.press_mm)),
        shear_steps=max(settings.shear_steps, math.ceil(aside / settings.shear_mm)),
        walk_mm=settings.slide_mm if slides(scene, start) else max(settings.walk_mm, LEAST_WALKED * down),
    )  # fmt: skip


def path_length(scene: Scene, begin: float, end: float) -> float:
    """Way of the indenter from one path parameter to a later one, mm."""
    press = scene.press
    down, aside = min(end, 1.0) - min(begin, 1.0), max(end, 1.0) - max(begin, 1.0)
    return down * abs(press.dz) + aside * float(np.hypot(press.dx, press.dy))


def earlier(scene: Scene, end: float, length: float) -> float:
    """Path parameter at which the indenter is `length` mm of its way before path parameter `end`."""
    aside = float(np.hypot(scene.press.dx, scene.press.dy))
    if end > 1.0:
        travelled = (end - 1.0) * aside
        if travelled >= length:
            return end - length / aside
        length, end = length - travelled, 1.0
    return end - length / (max(abs(scene.press.dz), length) or 1.0)


def first_touch(scene: Scene) -> float | None:
    """Path parameter where the indenter first meets the undeformed gel, or None where it never does."""
    return touch.first_touch(scene.gel, scene.indenter, scene.press)


def reachable(scene: Scene, points: np.ndarray) -> np.ndarray:
    """Which undeformed faces (f,) of nodes (f, k, 3) mm come within WITHIN mm of the indenter on its path, bool."""
    centre = points.mean(axis=1)
    size = np.linalg.norm(points - centre[:, None], axis=2).max(axis=1)
    return touch.touched(scene.indenter, scene.press, centre, WITHIN + size)


def gaps(scene: Scene, x: np.ndarray, pose: Pose) -> np.ndarray:
    """Signed distances (m,) mm of points x (m, 3) to the indenter at a pose."""
    return scene.indenter.distance(pose.to_indenter(x))[0]


def frame_time(scene: Scene, last: Scene) -> float:
    """Path parameter of the point on `last`'s path, down and then sideways, that is nearest to the end of `scene`.

    The logged start may differ between frames, and a compliant rig moves a little sideways during the press and a
    little down during the shear. Raises BadInput for a frame beyond the last one: the path has no state for it.
    """
    end, way = (np.array([s.press.dx, s.press.dy]) for s in (scene, last))
    fallen = scene.press.z0 + scene.press.dz - last.press.z0
    _check_frame(last.press.dz - fallen, end, way)
    # eight decimals, so that frames which differ by rounding only are one
    down = float(np.clip(np.round(fallen / last.press.dz, 8), 1e-8, 1.0)) if last.press.dz else 1.0
    if not way @ way:
        return down
    aside = float(np.clip(np.round(end @ way / (way @ way), 8), 0.0, 1.0))
    off_down = np.hypot(np.linalg.norm(end), fallen - down * last.press.dz)
    off_aside = np.hypot(np.linalg.norm(end - aside * way), fallen - last.press.dz)
    return 1.0 + aside if aside > 0.0 and off_aside < off_down else down


def _check_frame(deeper: float, end: np.ndarray, way: np.ndarray) -> None:
    """Raise BadInput for a frame clearly beyond the last one of its press.

    deeper: how far it ends below the last one, mm. end, way: sideways travel (2,) mm of the frame and the last one.
    """
    length = float(np.hypot(*way))
    farther = (float(end @ way) / length if length else float(np.hypot(*end))) - length
    for beyond, most, what in ((deeper, MOST_DEEPER_MM, "deeper"), (farther, MOST_FARTHER_MM, "farther sideways")):
        if beyond > most + ROUNDING_MM:
            raise BadInput(
                f"a frame of a press ends {beyond:.3g} mm {what} than its last one, {most:g} mm are allowed; give frames in"
                " order of time along one path, down and then sideways"
            )
