"""Scenes of the open benchmark, solved by GetFEM: python3 outside_getfem.py CHALLENGE OUT [SCENE …].

CHALLENGE: the folder that `make fea-challenge` writes. OUT: a submission for its score.py. Runs in Debian's own Python
with python3-getfem and python3-scipy, without gelforge. Hexahedra have 20 nodes. Contact uses multipliers that are
linear on their faces and GetFEM's augmented Lagrangian friction operator, with the scene's coefficient of friction `mu`,
or 10 as stick; the body is given by its signed distance. A point sticks to the body where its motion, extrapolated from the last load
step, closes the gap: plain incremental stick also counts motion before touch, so that the force depends on the number
of load steps.
"""

import csv
import json
import struct
import sys
import time
from pathlib import Path

import getfem as gf
import numpy as np
from scipy.interpolate import LinearNDInterpolator

# Size in mm of the hexahedra at the sides of the footprint and inside it; scenes with planes of symmetry are solved
# on a half or a quarter of the gel.
EDGES_MM = {
    "sphere_1mm": (0.45, 0.45),
    "cuboid_round": (0.55, 0.55),
    "cylinder": (0.65, 0.65),
    "pyramid": (0.5, 0.5),
    "cuboid_shear": (0.25, 0.9),
    "sloping_cuboid": (0.3, 0.9),
    "triple_triangle": (0.5, 0.5),
    "cuboid_sharp": (0.5, 0.5),
    "punch": (0.25, 0.25),
    "ball_dragged": (0.7, 0.7),
    "cuboid_slipping": (0.45, 1.2),
}
# Width in mm of the strip of small hexahedra along the footprint's sides, and growth of size per distance from it.
RIM, RIM_GROWTH = 0.6, 0.4
GROWTH, LARGEST = 1.6, 3.5  # factor from one hexahedron to the next away from the body, and largest size, mm
LAYERS = (1.4, 1.0, 0.7, 0.5, 0.4)  # relative heights of the layers from the base to the top
MARGIN = 0.7  # mm of small hexahedra beside the footprint
STEP = 0.125  # mm of travel in a load step
FRICTION, AUGMENTATION = 10.0, 5.0  # -, N/mm^3
RESIDUAL = 1e-5  # largest nodal residual, N
PARTS = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a Newton step that are tried under friction
PENALTY = 1e5  # N/mm^3, of the condition on planes of symmetry
SUBCELLS = 8  # per side of a face; forces are written at their centres
DEFORMED = "(Id(3)+Grad_u)"


# -- signed distance to bodies, mm, tip at the origin; the arguments are the table of scene.json and coordinates


def planar(side, z, fillet):
    """Distance to an extruded figure with a rounded lower edge, from the distance `side` in the plane."""
    a, b = side + fillet, fillet - z
    return np.hypot(np.maximum(a, 0), np.maximum(b, 0)) + np.minimum(np.maximum(a, b), 0) - fillet


def rectangle(size, fillet, x, y):
    """Distance to a rectangle with rounded corners in the plane."""
    qx, qy = abs(x) - size[0] / 2 + fillet, abs(y) - size[1] / 2 + fillet
    return np.hypot(np.maximum(qx, 0), np.maximum(qy, 0)) + np.minimum(np.maximum(qx, qy), 0) - fillet


def polygon(corners, x, y):
    """Distance to a convex polygon, corners (k, 2) counter-clockwise."""
    points = np.stack([x, y], axis=-1)
    along = np.roll(corners, -1, axis=0) - corners
    far = points[..., None, :] - corners
    part = np.clip((far * along).sum(-1) / (along**2).sum(-1), 0, 1)
    length = np.linalg.norm(far - part[..., None] * along, axis=-1).min(-1)
    outside = (far[..., 0] * along[:, 1] - far[..., 1] * along[:, 0]).max(-1) > 0
    return np.where(outside, length, -length)


def triangle(inradius, first_corner_deg):
    """Corners (3, 2) of a regular triangle about the origin."""
    turn = np.deg2rad(first_corner_deg) + 2 * np.pi / 3 * np.arange(3)
    return 2 * inradius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)


def sphere(of, x, y, z):
    """A ball."""
    return np.sqrt(x**2 + y**2 + (z - of["diameter"] / 2) ** 2) - of["diameter"] / 2


def cuboid(of, x, y, z):
    """A block whose vertical and lower edges are rounded."""
    return planar(rectangle(of["size"], of["fillet"], x, y), z, of["fillet"])


def cylinder(of, x, y, z):
    """An upright cylinder whose lower edge is rounded."""
    return planar(np.hypot(x, y) - of["diameter"] / 2, z, of["fillet"])


def triple_triangle(of, x, y, z):
    """A triangle with rounded corners, cut by an inverted sharp triangle that leaves its three corners."""
    inradius, turn = of["side"] / np.sqrt(12), of["first_corner_deg"]
    outer = polygon(triangle(inradius - of["fillet"], turn), x, y) - of["fillet"]
    inner = (inradius - of["wall"]) / 2  # the hole's corners are `wall` away from the sides of the triangle
    corners = triangle(inner, turn + 180)
    normals = -corners / np.linalg.norm(corners[0])  # each side lies opposite to a corner
    hole = (np.stack([x, y], axis=-1) @ normals.T).max(-1) - inner
    return planar(np.maximum(outer, -hole), z, of["fillet"])


def pyramid(of, x, y, z):
    """Four planes that meet in a point, rounded by a ball; the rim of the body is far from the gel."""
    slope, z = np.tan(np.deg2rad(of["slope_deg"])), z - of["fillet"]
    far, near = np.maximum(abs(x), abs(y)), np.minimum(abs(x), abs(y))
    plane = (slope * far - z) / np.hypot(slope, 1)
    foot = far - plane * slope / np.hypot(slope, 1)
    edge = np.array([1.0, 1.0, slope]) / np.sqrt(2 + slope**2)
    along = np.maximum(edge[0] * far + edge[1] * near + edge[2] * z, 0)
    off_edge = np.sqrt((far - along * edge[0]) ** 2 + (near - along * edge[1]) ** 2 + (z - along * edge[2]) ** 2)
    return np.where((plane > 0) & (near > foot), off_edge, plane) - of["fillet"]


def sloping_cuboid(of, x, y, z):
    """A block whose lower face slopes down towards -y, with all edges rounded except the upper ones."""
    if of["deepest_deg"] != -90:
        raise ValueError("a block whose lower face falls towards -y is all there is")
    fillet, slope, half = of["fillet"], np.tan(np.deg2rad(of["slope_deg"])), of["size"][1] / 2 - of["fillet"]
    # the core to be rounded, whose lowest corner lies `fillet` above the tip
    corners = [(-half, fillet), (half, fillet + 2 * slope * half), (half, of["height"]), (-half, of["height"])]
    across, beside = polygon(np.array(corners), y, z), abs(x) - of["size"][0] / 2 + fillet
    apart = np.hypot(np.maximum(across, 0), np.maximum(beside, 0))
    return apart + np.minimum(np.maximum(across, beside), 0) - fillet


KINDS = {body.__name__: body for body in (sphere, cuboid, cylinder, triple_triangle, pyramid, sloping_cuboid)}


class RigidBody:
    """The rigid body in the gel's frame, its tip at `at`."""

    def __init__(self, scene: dict):
        self.table, turn = scene["indenter"], np.deg2rad(scene["rot_deg"])
        self.turn = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        self.at = np.array(scene["start_mm"], float)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distance (n,) mm at points (n, 3)."""
        return KINDS[self.table["kind"]](self.table, *((points - self.at) @ self.turn).T)

    def normal(self, points: np.ndarray, h=1e-5) -> np.ndarray:
        """Outward normal (n, 3)."""
        ways = h * np.eye(3)
        found = np.stack([self.distance(points + way) - self.distance(points - way) for way in ways], axis=1)
        return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12)

    def curvature(self, points: np.ndarray, h=1e-4) -> np.ndarray:
        """Derivative (n, 3, 3) of the normal, 1/mm."""
        ways = h * np.eye(3)
        found = np.stack([self.normal(points + way) - self.normal(points - way) for way in ways], axis=2) / (2 * h)
        return (found + found.transpose(0, 2, 1)) / 2

    def mirrored(self, legs: np.ndarray, axis: int) -> bool:
        """Whether body and path are symmetric about the plane normal to an axis."""
        points = np.random.default_rng(1).uniform(-8, 8, (2000, 3)) + self.at
        image = points * np.where(np.arange(3) == axis, -1, 1)
        still = self.at[axis] == 0 and not np.any(legs[:, axis])
        return bool(still and np.allclose(self.distance(points), self.distance(image), atol=1e-9))


# -- gel


def gel_top(path: Path):
    """Height of the undeformed top at points (x, y), from the gel's surface."""
    content = path.read_bytes()
    count = struct.unpack("<I", content[80:84])[0]
    triangles = np.frombuffer(content[84:], [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")], count)
    points = np.unique(triangles["v"][triangles["n"][:, 2] > 0.05].reshape(-1, 3), axis=0)
    return LinearNDInterpolator(points[:, :2], points[:, 2])


def fine_lines(low: float, high: float, sides: list[float], edge: float, inside: float) -> np.ndarray:
    """Mesh lines from `low` to `high`: hexahedra of `edge` near `sides` of the footprint, up to `inside` away from them."""
    x = np.linspace(low, high, 4001)
    away = np.abs(x[:, None] - sides).min(axis=1)
    size = np.clip(edge + RIM_GROWTH * (away - RIM), edge, inside)
    count = np.concatenate([[0.0], np.cumsum(np.diff(x) * (1 / size[1:] + 1 / size[:-1]) / 2)])
    return np.interp(np.linspace(0.0, count[-1], max(1, round(count[-1])) + 1), count, x)


def lines(fine: np.ndarray, low: float, high: float, edge: float) -> np.ndarray:
    """Mesh lines from `low` to `high`: those of the fine part, and hexahedra larger than `edge` outwards."""
    found = list(fine)
    for way, start, end in ((-1, fine[0], low), (1, fine[-1], high)):
        size, at = edge, start
        while way * (end - at) > 1.6 * GROWTH * size:
            size = min(GROWTH * size, LARGEST)
            at += way * size
            found.append(at)
        found.append(end)
    return np.unique(np.round(found, 9))


def footprint(body: RigidBody, legs: np.ndarray, top) -> np.ndarray:
    """Lowest and highest x and y (2, 2) mm of the gel's top where the body meets it at the ends of its legs."""
    x, y = np.meshgrid(np.arange(-10, 10.01, 0.1), np.arange(-12, 12.01, 0.1))
    points = np.stack([x, y, top(x, y)], axis=-1).reshape(-1, 3)
    met = np.concatenate([points[body.distance(points - leg) < 0, :2] for leg in np.cumsum(legs, axis=0)])
    return np.stack([met.min(axis=0), met.max(axis=0)])


def gel_mesh(gel: dict, top, near: np.ndarray, halved: list[bool], edge: float, inside: float):
    """Mesh of the gel, or of its half or quarter, and its lines along x and y. near: the fine part (2, 2) mm.

    edge, inside: size of the hexahedra at the footprint's sides and within them, mm. Corners of the outline are left
    square. Regions: 1 top near the body, 2 base, 3 and 4 the planes of symmetry.
    """
    ends, sides = np.array([gel["width"], gel["length"]]) / 2, []
    for k in (0, 1):
        low, fine_low = (0.0, 0.0) if halved[k] else (-ends[k], near[0, k])
        rims = [near[0, k] + MARGIN, near[1, k] - MARGIN]
        sides.append(lines(fine_lines(fine_low, near[1, k], rims, edge, inside), low, ends[k], edge))
    mesh = gf.Mesh("cartesian Q1", *sides, np.concatenate([[0.0], np.cumsum(LAYERS)]) / sum(LAYERS))
    points = mesh.pts()
    above = top(points[0], points[1])
    above[np.isnan(above)] = gel["rim"]
    points[2] = -gel["height"] + (above + gel["height"]) * points[2]
    mesh.set_pts(points)
    faces = mesh.outer_faces()
    normal = mesh.normal_of_faces(faces)
    middle = np.array([points[:, mesh.pid_in_faces(faces[:, [i]])].mean(axis=1) for i in range(faces.shape[1])])
    within = ((middle[:, :2] > near[0]) & (middle[:, :2] < near[1])).all(axis=1)
    mesh.set_region(1, faces[:, (normal[2] > 0.3) & within])
    mesh.set_region(2, faces[:, normal[2] < -0.9])
    for k in (0, 1):
        if halved[k]:
            mesh.set_region(3 + k, faces[:, (normal[k] < -0.9) & (abs(middle[:, k]) < 1e-9)])
    return mesh, sides


class PressedGel:
    """The gel, the body, and the load steps of one scene. folder: the open benchmark's. edges: (edge, inside), mm."""

    def __init__(self, folder: Path, name: str, edges: tuple[float, float]):
        challenge = json.loads((folder / "challenge.json").read_text())
        scene = json.loads((folder / "scenes" / name / "scene.json").read_text())
        self.body, self.legs = RigidBody(scene), np.array(scene["legs_mm"], float)
        self.halved = [self.body.mirrored(self.legs, axis) for axis in (0, 1)]
        top = gel_top(folder / "gel.stl")
        self.near = footprint(self.body, self.legs, top) + [[-MARGIN], [MARGIN]]
        mesh, self.sides = gel_mesh(challenge["gel"], top, self.near, self.halved, *edges)
        self.traction, displacement = gf.MeshFem(mesh, 3), gf.MeshFem(mesh, 3)
        displacement.set_fem(gf.Fem("FEM_Q2_INCOMPLETE(3)"))
        self.traction.set_fem(gf.Fem("FEM_QK(3,1)"))
        volume = gf.MeshIm(mesh, gf.Integ("IM_GAUSS_PARALLELEPIPED(3,4)"))
        contact = gf.MeshIm(mesh, gf.Integ("IM_GAUSS_PARALLELEPIPED(3,6)"))
        self.model = model = gf.Model("real")
        model.add_fem_variable("u", displacement)
        model.add_filtered_fem_variable("t", self.traction, 1)
        self.mu = scene.get("mu")
        numbers = {
            "c10": challenge["c10_mpa"],
            "d1": challenge["d1_per_mpa"],
            "r": AUGMENTATION,
            "f": self.mu or FRICTION,
        }
        for name, value in numbers.items():
            model.add_initialized_data(name, [value])
        self.scalar, self.vector = gf.MeshImData(contact, 1), gf.MeshImData(contact, 1, [3])
        data = {"gap0": (self.scalar, 1), "curve0": (gf.MeshImData(contact, 1, [3, 3]), 9)}
        for name, (of, size) in (data | dict.fromkeys(("place0", "normal0", "anchor"), (self.vector, 3))).items():
            model.add_im_data(name, of)
            model.set_variable(name, np.zeros(size * of.nbpts()))
        self.add_terms(volume, contact)

    def add_terms(self, volume, contact) -> None:
        """Energy of the gel, contact, base, and planes of symmetry.

        The body enters by distance, normal and curvature at the current points, so that Newton's steps are exact.
        """
        energy = f"c10*(pow(Det{DEFORMED},-2/3)*Norm_sqr{DEFORMED}-3)+(1/d1)*sqr(Det{DEFORMED}-1)"
        self.model.add_nonlinear_term(volume, energy)
        off = "(X+u-place0)"
        gap, normal = f"(gap0+normal0.{off})", f"(normal0+curve0*{off})"  # the normal points out of the body
        stick = f"Coulomb_friction_coupled_projection(t,-{normal},X+u-anchor,{gap},f,r)"
        self.model.add_nonlinear_term(contact, "-t.Test_u", 1)
        self.model.add_nonlinear_term(contact, f"(1/r)*({stick}-t).Test_t", 1)
        self.model.add_Dirichlet_condition_with_simplification("u", 2)
        for k in (0, 1):
            if self.halved[k]:
                self.model.add_linear_term(volume, f"{PENALTY}*u({k + 1})*Test_u({k + 1})", 3 + k)

    def places(self) -> np.ndarray:
        """Current places of the integration points of the contact, (n, 3) mm."""
        return self.model.interpolation("X+u", self.vector, 1).reshape(-1, 3)

    def see_body(self) -> None:
        """Tell the model where the body is at the current places of the integration points."""
        places = self.places()
        self.model.set_variable("place0", places.ravel())
        self.model.set_variable("gap0", self.body.distance(places))
        self.model.set_variable("normal0", self.body.normal(places).ravel())
        self.model.set_variable("curve0", self.body.curvature(places).ravel())

    def equilibrium(self, most: int = 25) -> bool:
        """Newton's iterations with the body at rest; False if they do not converge."""
        for iteration in range(most):
            self.see_body()
            self.model.assembly("build_all")
            residual = self.model.rhs()
            size = abs(residual).max()
            if not size < 1e3:
                return False
            if iteration and size < RESIDUAL:
                return True
            change = np.asarray(gf.linsolve_mumps(self.model.tangent_matrix(), residual)).ravel()
            start = self.model.from_variables()
            self.model.to_variables(start + change)
            if self.mu:
                self.shorten(start, change, np.linalg.norm(residual))
        return False

    def shorten(self, start: np.ndarray, change: np.ndarray, size: float) -> None:
        """Shorten a step until the residual is less than `size`: points that slip and stick by turns need that."""
        for part in PARTS:
            self.model.to_variables(start + part * change)
            self.see_body()
            self.model.assembly("build_rhs")
            if np.linalg.norm(self.model.rhs()) < (1 - 1e-3 * part) * size:
                return

    def follow(self) -> None:
        """Move the body along its legs, and halve a load step if Newton's iterations do not converge.

        Places are in the body's frame. Points in contact keep their stick points, or take them along where they slip; all
        others get the one where they would meet the body.
        """
        before = self.places() - self.body.at
        anchor, held = before.copy(), np.zeros(len(before), bool)
        for leg in self.legs[np.any(self.legs != 0, axis=1)]:
            length, done = np.linalg.norm(leg), 0.0
            step = length / np.ceil(length / STEP - 1e-9)
            speed, rate = -leg / length, np.zeros_like(self.model.from_variables())
            while done < length - 1e-9:
                step = min(step, length - done)
                kept, start = self.model.from_variables(), self.body.at
                self.body.at = start + leg * step / length
                met = before + self.touch(before, step * speed)[:, None] * step * speed
                anchor[~held] = met[~held]
                self.model.set_variable("anchor", (anchor + self.body.at).ravel())
                self.model.to_variables(kept + step * rate)
                if not self.equilibrium():
                    self.model.to_variables(kept)
                    self.body.at, step = start, step / 2
                    if step < STEP / 30:
                        raise RuntimeError(f"no equilibrium with the tip at {self.body.at.tolist()}")
                    continue
                done += step
                now = self.places() - self.body.at
                speed, rate = (now - before) / step, (self.model.from_variables() - kept) / step
                before, held = now, self.pressed()
                if self.mu:
                    slips = held & self.slips()
                    anchor[slips] = now[slips]

    def pressed(self) -> np.ndarray:
        """Which points (n,) are in contact with the body."""
        return self.model.interpolation("r*gap0-t.normal0", self.scalar, 1).ravel() < 0

    def slips(self) -> np.ndarray:
        """Which points (n,) pull at the limit of friction."""
        pull = self.model.interpolation("t-r*(X+u-anchor)", self.vector, 1).reshape(-1, 3)
        normal = np.reshape(self.model.variable("normal0"), (-1, 3))
        pressure = -self.model.interpolation("r*gap0-t.normal0", self.scalar, 1).ravel()
        along = np.linalg.norm(pull - (pull * normal).sum(axis=1)[:, None] * normal, axis=1)
        return along > self.mu * pressure

    def touch(self, places: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Fraction (n,) of a motion in the body's frame at which each point's gap closes, at most 1."""
        low, high = np.zeros(len(places)), np.ones(len(places))
        for _ in range(20):
            middle = (low + high) / 2
            apart = self.body.distance(places + middle[:, None] * moved + self.body.at) > 0
            low, high = np.where(apart, middle, low), np.where(apart, high, middle)
        return high

    def nodal_tractions(self) -> tuple[np.ndarray, np.ndarray]:
        """Traction (nx, ny, 3) MPa and height (nx, ny) mm at the nodes of the top's grid."""
        x, y = self.sides
        nodes = self.traction.basic_dof_nodes()[:, ::3]
        found = self.model.mesh_fem_of_variable("t").extend_vector(self.model.variable("t"))
        traction, height = np.zeros((len(x), len(y), 3)), np.full((len(x), len(y)), -np.inf)
        for (px, py, pz), force in zip(nodes.T, np.reshape(found, (-1, 3)), strict=True):
            at = int(np.searchsorted(x, px - 1e-6)), int(np.searchsorted(y, py - 1e-6))
            if pz > height[at]:
                traction[at], height[at] = force, pz
        return traction, height

    def forces(self) -> np.ndarray:
        """Rows (n, 5) of x, y mm and force N at points of the undeformed surface, mirrored at planes of symmetry."""
        (x, y), (traction, height) = self.sides, self.nodal_tractions()
        inner = (np.arange(SUBCELLS) + 0.5) / SUBCELLS
        s, t = (v.ravel() for v in np.meshgrid(inner, inner, indexing="ij"))
        weight = np.stack([(1 - s) * (1 - t), (1 - s) * t, s * (1 - t), s * t], axis=1)
        rows = []
        for i, j in np.ndindex(len(x) - 1, len(y) - 1):
            middle = np.array([x[i] + x[i + 1], y[j] + y[j + 1]]) / 2
            if (middle < self.near[0]).any() or (middle > self.near[1]).any():
                continue
            (dx, dy), z = (x[i + 1] - x[i], y[j + 1] - y[j]), height[i : i + 2, j : j + 2]
            zx = ((z[1, 0] - z[0, 0]) * (1 - t) + (z[1, 1] - z[0, 1]) * t) / dx
            zy = ((z[0, 1] - z[0, 0]) * (1 - s) + (z[1, 1] - z[1, 0]) * s) / dy
            area = np.sqrt(1 + zx**2 + zy**2) * dx * dy / SUBCELLS**2
            force = weight @ traction[i : i + 2, j : j + 2].reshape(4, 3)
            rows.append(np.column_stack([x[i] + s * dx, y[j] + t * dy, force * area[:, None]]))
        found = np.concatenate(rows)
        for k in (0, 1):
            if self.halved[k]:
                image = found.copy()
                image[:, [k, 2 + k]] *= -1
                found = np.concatenate([found, image])
        return found


def main() -> None:
    """Write a submission of the named scenes, or of all; scenes that exist already are kept."""
    folder, out = Path(sys.argv[1]), Path(sys.argv[2])
    names = sys.argv[3:] or [name for name in EDGES_MM if (folder / "scenes" / name).exists()]
    out.mkdir(parents=True, exist_ok=True)
    gf.util_trace_level(0)
    for name in names:
        path = out / f"{name}.csv"
        if path.exists():
            continue
        began = time.process_time()
        press = PressedGel(folder, name, EDGES_MM[name])
        press.follow()
        rows = press.forces()
        seconds = time.process_time() - began
        part = path.with_suffix(".part")
        with part.open("w", newline="") as stream:
            csv.writer(stream).writerows([("x_mm", "y_mm", "fx_n", "fy_n", "fz_n"), *rows.round(9).tolist()])
        part.replace(path)
        times = out / "seconds.csv"
        begun = times.exists()
        with times.open("a", newline="") as stream:
            csv.writer(stream).writerows([*[("scene", "seconds")] * (not begun), (name, round(seconds, 1))])
        print(f"{name}: {rows[:, 2:].sum(axis=0).round(4)} N, {seconds:.0f} s", flush=True)


if __name__ == "__main__":
    main()
