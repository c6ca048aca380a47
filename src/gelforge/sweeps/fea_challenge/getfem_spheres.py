"""An example of taking part: the four scenes with balls, solved by GetFEM; python3 getfem_spheres.py FOLDER [SCENE].

Needs Debian's python3-getfem and python3-scipy. Quadratic hexahedra of 20 nodes; contact and stick are penalties, written
in GetFEM's own form language: a point that meets the ball is held at the place on it where it was at the end of that
load step.
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

HERE = Path(__file__).resolve().parent
SCENES = ("sphere_shallow", "sphere_1mm", "sphere_2mm", "sphere_off_centre")
EDGE, GROWTH, LARGEST = 0.6, 1.6, 3.5  # mm under the ball, and how they grow away from it
LAYERS = (1.9, 1.3, 0.9, 0.7, 0.6)  # from the base to the top, of the height
STEP = 0.05  # mm of travel in a load step
PRESS, STICK = 60.0, 30.0  # N/mm^3: the ball is entered by a thousandth of a millimetre
DEFORMED = "(Id(3)+Grad_u)"
FROM_CENTRE = "(X+u-centre)"
GAP = f"(Norm{FROM_CENTRE}-radius)"
SLID = f"({FROM_CENTRE}-anchor)"
TRACTION = (
    f"(press*neg_part({GAP})/Norm{FROM_CENTRE}*{FROM_CENTRE}"
    f"-stick*held*({SLID}-({SLID}.{FROM_CENTRE})/Norm_sqr{FROM_CENTRE}*{FROM_CENTRE}))"
)


def gel_top(path: Path):
    """Height of the undeformed top at points (x, y), from the gel's surface."""
    content = path.read_bytes()
    count = struct.unpack("<I", content[80:84])[0]
    triangles = np.frombuffer(content[84:], [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")], count)
    points = np.unique(triangles["v"][triangles["n"][:, 2] > 0.05].reshape(-1, 3), axis=0)
    return LinearNDInterpolator(points[:, :2], points[:, 2])


def lines(middle: float, half: float, low: float, high: float) -> np.ndarray:
    """Mesh lines from `low` to `high`: hexahedra of EDGE within `half` of the middle, larger ones outwards."""
    found = list(np.linspace(middle - half, middle + half, round(2 * half / EDGE) + 1))
    for side, end in ((-1, low), (1, high)):
        size, at = EDGE, middle + side * half
        while side * (end - at) > 1.6 * GROWTH * size:
            size = min(GROWTH * size, LARGEST)
            at += side * size
            found.append(at)
        found.append(end)
    return np.unique(np.round(found, 9))


def gel_mesh(gel: dict, top, start, half: float):
    """Mesh of the gel (its rounded corners left square), with region 1 on top near the ball and 2 at the base."""
    x = lines(start[0], half, -gel["width"] / 2, gel["width"] / 2)
    y = lines(start[1], half, -gel["length"] / 2, gel["length"] / 2)
    heights = np.concatenate([[0.0], np.cumsum(LAYERS)]) / sum(LAYERS)
    mesh = gf.Mesh("cartesian Q1", x, y, heights)
    points = mesh.pts()
    above = top(points[0], points[1])
    above[np.isnan(above)] = gel["rim"]
    points[2] = -gel["height"] + (above + gel["height"]) * points[2]
    mesh.set_pts(points)
    faces = mesh.outer_faces()
    normal = mesh.normal_of_faces(faces)
    middle = np.array([points[:, mesh.pid_in_faces(faces[:, [i]])].mean(axis=1) for i in range(faces.shape[1])])
    near = np.abs(middle[:, :2] - np.asarray(start)[:2]).max(axis=1) < half
    mesh.set_region(1, faces[:, (normal[2] > 0.3) & near])
    mesh.set_region(2, faces[:, normal[2] < -0.9])
    return mesh


def model_of(mesh, challenge: dict, start, radius: float):
    """Model of gel and ball, with the integration rule and its points on the ball's side."""
    fem, volume = gf.MeshFem(mesh, 3), gf.MeshIm(mesh, gf.Integ("IM_GAUSS_PARALLELEPIPED(3,4)"))
    contact = gf.MeshIm(mesh, gf.Integ("IM_GAUSS_PARALLELEPIPED(3,8)"))
    fem.set_fem(gf.Fem("FEM_Q2_INCOMPLETE(3)"))
    model = gf.Model("real")
    model.add_fem_variable("u", fem)
    numbers = {"c10": challenge["c10_mpa"], "d1": challenge["d1_per_mpa"], "press": PRESS, "stick": STICK}
    for name, value in (numbers | {"radius": radius}).items():
        model.add_initialized_data(name, [value])
    model.add_initialized_data("centre", [*start[:2], start[2] + radius])
    one, three = gf.MeshImData(contact, 1), gf.MeshImData(contact, 1, [3])
    model.add_im_data("held", one)
    model.add_im_data("anchor", three)
    model.set_variable("held", np.zeros(one.nbpts()))
    model.set_variable("anchor", np.zeros(3 * one.nbpts()))
    energy = f"c10*(pow(Det{DEFORMED},-2/3)*Norm_sqr{DEFORMED}-3)+(1/d1)*sqr(Det{DEFORMED}-1)"
    model.add_nonlinear_term(volume, energy)
    model.add_nonlinear_term(contact, f"-{TRACTION}.Test_u", 1)
    model.add_Dirichlet_condition_with_simplification("u", 2)
    return model, contact, one, three


def follow(model, one, three, start, radius: float, legs) -> None:
    """Move the ball along its legs; points that meet it stick from then on, those that leave it are released."""
    at = np.array([*start[:2], start[2] + radius])
    for leg in np.array(legs, float):
        steps = int(np.ceil(np.linalg.norm(leg) / STEP))
        for _ in range(steps):
            at = at + leg / steps
            model.set_variable("centre", at)
            _, converged = model.solve("max_res", 1e-6, "max_iter", 40)
            if not converged:
                raise RuntimeError(f"no equilibrium with the ball's centre at {at.tolist()}")
            gap = model.interpolation(GAP, one, 1).ravel()
            place = model.interpolation(FROM_CENTRE, three, 1).reshape(-1, 3)
            held, anchor = model.variable("held").ravel(), model.variable("anchor").reshape(-1, 3)
            met = (gap < 0) & (held == 0)
            anchor[met] = place[met]
            model.set_variable("anchor", anchor.ravel())
            model.set_variable("held", np.where(gap < 0, 1.0, 0.0))


def cell_forces(model, contact, challenge: dict, start, half: float) -> list[tuple]:
    """Row, column and force on the gel of each cell near the ball; the cells' sides lie along the gel's axes."""
    (rows, columns), (width, height) = challenge["cells"], challenge["image"]
    to_gel = np.linalg.inv(np.array(challenge["projection"]))
    found = []
    for row in range(rows):
        for column in range(columns):
            corners = np.array([[column + i, row + j, 1.0] for i in (0, 1) for j in (0, 1)])
            pixels = corners * [width / columns, height / rows, 1.0]
            low, high = (pixels @ to_gel.T)[:, :2].min(axis=0), (pixels @ to_gel.T)[:, :2].max(axis=0)
            if (np.maximum(low - start[:2], start[:2] - high) > half).any():
                continue
            within = "*".join(
                f"Heaviside(X({k + 1})-({low[k]:.9g}))*Heaviside(({high[k]:.9g})-X({k + 1}))" for k in (0, 1)
            )
            force = gf.asm("generic", contact, 0, f"{within}*{TRACTION}", 1, model)
            if np.abs(force).max() > 1e-9:
                found.append((row, column, *np.asarray(force).ravel()))
    return found


def solve(name: str, challenge: dict) -> list[tuple]:
    """Forces per cell of one scene."""
    scene = json.loads((HERE / "scenes" / name / "scene.json").read_text())
    start, radius = np.array(scene["start_mm"]), scene["indenter"]["diameter"] / 2
    depth = -scene["legs_mm"][0][2]
    half = round((np.sqrt(2.6 * radius * depth) + 0.9 + np.abs(scene["legs_mm"][1]).max()) / EDGE) * EDGE
    mesh = gel_mesh(challenge["gel"], gel_top(HERE / "gel.stl"), start, half)
    model, contact, one, three = model_of(mesh, challenge, start, radius)
    follow(model, one, three, start, radius, [leg for leg in scene["legs_mm"] if np.any(leg)])
    return cell_forces(model, contact, challenge, start, half)


def main() -> None:
    """Write a submission of the scenes named, or of all four."""
    out, names = Path(sys.argv[1]), sys.argv[2:] or SCENES
    out.mkdir(parents=True, exist_ok=True)
    gf.util_trace_level(0)
    challenge = json.loads((HERE / "challenge.json").read_text())
    seconds = {}
    for name in names:
        began = time.process_time()
        rows = solve(name, challenge)
        seconds[name] = time.process_time() - began
        with (out / f"{name}.csv").open("w", newline="") as stream:
            csv.writer(stream).writerows([("row", "column", "fx_n", "fy_n", "fz_n"), *rows])
        print(f"{name}: {np.sum([row[2:] for row in rows], axis=0).round(4)} N, {seconds[name]:.0f} s", flush=True)
    begun = (out / "seconds.csv").exists()
    with (out / "seconds.csv").open("a", newline="") as stream:
        csv.writer(stream).writerows([*[("scene", "seconds")] * (not begun), *seconds.items()])


if __name__ == "__main__":
    main()
