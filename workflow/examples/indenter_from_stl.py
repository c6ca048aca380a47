"""Press an indenter of your own from an STL file: a closed surface in mm, its tip at the bottom."""

import numpy as np

import gelforge
from gelforge.geometry.triangles import write_stl

# A roof, 8 mm long with a ridge of 4 mm, as a stand-in for what your CAD program exports.
corners = np.array([[-4, -3, 5], [4, -3, 5], [4, 3, 5], [-4, 3, 5], [-2, 0, 0], [2, 0, 0]], float)
faces = np.array([[0, 1, 2], [0, 2, 3], [0, 4, 5], [0, 5, 1], [2, 5, 4], [2, 4, 3], [0, 3, 4], [1, 5, 2]])
write_stl("roof.stl", corners, faces)

# The path starts at the folder that Python runs in. spacing: mm of the distance grid, reach: mm above the tip it covers.
roof = {"kind": "stl", "file": "roof.stl", "spacing": 0.25, "reach": 3.0}

for rot_deg in (0.0, 90.0):
    press = gelforge.solve(roof, depth=0.8, rot_deg=rot_deg)
    touched = press.mesh.nodes[press.forces[:, 2] < 0]
    wide, long = np.ptp(touched[:, :2], axis=0)
    print(
        f"turned by {rot_deg:2.0f} degrees: {press.total[2]:.3f} N, touches {wide:.1f} x {long:.1f} mm of the gel (x, y)"
    )
