"""How a body from a file stands: what touches first, how far from the axis, and doubts that this pose is intended."""

from dataclasses import dataclass

import numpy as np

from gelforge.geometry.triangles import Mesh, below

TIP_MM = 0.1  # height above the lowest point of the section that is examined
LEVEL = 0.999  # least |z| of the unit normal of a horizontal face
FLAT_SHARE = 0.5  # least area of a flat side, as a fraction of the section at TIP_MM
# Largest offset of a body's middle from the axis, as a fraction of its width and in mm; with a corner at the origin
# the fraction is 0.5.
MOST_ASIDE, ASIDE_MM = 0.4, 0.5
# A body was most likely meant to stand on an end if it is LYING times as long as high, the sections of its ends
# differ by the factor ENDS_DIFFER, those at bottom and top agree within the fraction ALIKE, and the one half-way is
# larger by the factor BULGE, so that it is neither a block nor a wedge.
LYING, ENDS_DIFFER, ALIKE, BULGE = 1.2, 2.0, 0.1, 1.15
SHARP_DEG = 60.0  # least angle between the outward normals of a ridge's sides; facets of a fillet turn by less


@dataclass(frozen=True)
class Cut:
    """A horizontal section of a body: area mm2, centroid (2,), lowest and highest x, y (2,) mm."""

    area: float
    middle: np.ndarray
    low: np.ndarray
    high: np.ndarray


def cut_at(mesh: Mesh, height: float) -> Cut:
    """The section at a height in mm of a closed surface whose lowest point is at z = 0."""
    vertices, faces = below(*mesh, height)
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    cap = (np.abs(corners[..., 2] - height) < 1e-9 + 1e-6 * height).all(axis=1) & (normal[:, 2] > 0.0)
    flat, area = corners[cap][..., :2], 0.5 * normal[cap, 2]
    middle = (flat.mean(axis=1) * area[:, None]).sum(axis=0) / area.sum()
    return Cut(float(area.sum()), middle, flat.min(axis=(0, 1)), flat.max(axis=(0, 1)))


@dataclass(frozen=True)
class Standing:
    """What touches first, as a sentence, and doubts about the pose, none for a usual one."""

    touches: str
    doubts: list[str]


def standing(vertices: np.ndarray, faces: np.ndarray) -> Standing:
    """How a closed surface stands on its lowest point; it is pressed along the z axis."""
    vertices = vertices - [0.0, 0.0, vertices[:, 2].min()]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = high - low
    section = cut_at((vertices, faces), min(TIP_MM, size[2] / 2.0))
    wide = section.high - section.low
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = (corners[..., 2].max(axis=1) < TIP_MM / 2.0) & (normal[:, 2] < -LEVEL * np.linalg.norm(normal, axis=1))
    area = -0.5 * float(normal[flat, 2].sum())
    what = "a tip or a rounded side"
    if area > FLAT_SHARE * section.area:
        _, turn, beyond, (one, other) = _edges(vertices, faces, normal)
        what = f"a flat side of {area:.3g} mm2"
        if ((flat[one] != flat[other]) & (turn > SHARP_DEG) & (beyond < 0.0)).any():
            what += " with sharp edges (the grid rounds them by 0 to 0.6 `spacing`; model the real radius, it decides the force)"
    x, y = section.middle
    touches = (
        f"of {size[0]:.3g} x {size[1]:.3g} x {size[2]:.3g} mm, x by y by z; {what} touches first, {wide[0]:.3g} x {wide[1]:.3g} mm"
        f" wide {TIP_MM:g} mm above its lowest point, its middle {np.hypot(x, y):.2f} mm beside the axis (x {x:.2f}, y {y:.2f})"
    )
    return Standing(touches, [*_aside(low, high), *_lying((vertices, faces), size), *_ridge(vertices, faces, normal)])


def _edges(
    vertices: np.ndarray, faces: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Of each edge of a closed surface: ends, degrees between its sides' normals, convexity, and the faces of both sides.

    The edge is convex where the third is below 0: the middle of one side beyond the plane of the other.
    """
    half = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort(half.T)
    one, other = order[::2] // 3, order[1::2] // 3  # every edge of a closed surface has two sides
    ends = vertices[half[order[::2]]]
    unit = normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    turn = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", unit[one], unit[other]), -1.0, 1.0)))
    beyond = np.einsum("ij,ij->i", unit[one], vertices[faces[other]].mean(axis=1) - ends[:, 0])
    return ends, turn, beyond, (one, other)


def _aside(low: np.ndarray, high: np.ndarray) -> list[str]:
    middle, size = ((low + high) / 2.0)[:2], (high - low)[:2]
    if not (np.abs(middle) > np.maximum(MOST_ASIDE * size, ASIDE_MM)).any():
        return []
    return [
        f"its middle stands {np.hypot(*middle):.3g} mm beside the axis on which it is pressed (x {middle[0]:.3g}, y {middle[1]:.3g}):"
        " if it lies, turn it upright; if a corner is its origin, move its middle there in the program that exported it"
    ]


def _lying(mesh: Mesh, size: np.ndarray) -> list[str]:
    axis = int(size[:2].argmax())
    if size[axis] < LYING * size[2]:
        return []
    vertices, faces = mesh
    ends = []
    for sign in (-1.0, 1.0):
        # both rotations put the long axis along z, with one end or the other down
        turned = np.roll(vertices, 2 - axis, axis=1) * ([1.0, 1.0, 1.0] if sign < 0.0 else [1.0, -1.0, -1.0])
        turned = turned - [0.0, 0.0, turned[:, 2].min()]
        ends.append(cut_at((turned, faces), TIP_MM).area)
    height = float(size[2])
    low, middle, high = (cut_at(mesh, z).area for z in (TIP_MM, height / 2.0, height - TIP_MM))
    round_ = abs(high - low) < ALIKE * low and middle > BULGE * low
    if max(ends) < ENDS_DIFFER * min(ends) or not round_:
        return []
    name = "xy"[axis]
    return [
        f"it lies: {size[axis]:.3g} mm along {name}, {size[2]:.3g} mm high, and its two ends along {name} differ"
        f" ({ends[0]:.3g} and {ends[1]:.3g} mm2 {TIP_MM:g} mm from them): if it was modelled with {name} up, turn it so that its tip points down along z"
    ]


def _ridge(vertices: np.ndarray, faces: np.ndarray, normal: np.ndarray) -> list[str]:
    """A ridge between two rising sides that touches first and is sharper than elements can resolve."""
    ends, turn, beyond, (one, other) = _edges(vertices, faces, normal)
    level = normal[:, 2] > -LEVEL * np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    rising = level[one] & level[other]
    found = (ends[..., 2].max(axis=1) < TIP_MM) & (turn > SHARP_DEG) & (beyond < 0.0) & rising
    if not found.any():
        return []
    long = float(np.linalg.norm(np.diff(ends[found], axis=1), axis=2).sum())
    return [
        f"a ridge of {180.0 - turn[found].max():.0f} degrees, {long:.3g} mm long, touches first: it is sharper than elements can"
        " resolve, so forces of shallow presses are uncertain; give it the radius of the real edge"
    ]
