"""Solve one press by finite elements and print the force on the gel."""

import numpy as np

import gelforge

# A name of workflow/indenters.toml, or a table as there: {"kind": "sphere", "diameter": 10, "height": 10}; lengths are mm.
press = gelforge.solve("sphere_10", depth=0.6, at=(2.0, -3.0), shear=(0.1, 0.0))

x, y, z = press.total  # N on the gel; z points out of it, so pressing is negative
print(f"total force: x {x:+.3f}  y {y:+.3f}  z {z:+.3f} N")

touched = press.forces.any(axis=1)
middle = np.average(press.mesh.nodes[touched], axis=0, weights=np.abs(press.forces[touched, 2]))
print(f"centre of pressure: x {middle[0]:.2f}, y {middle[1]:.2f} mm, over {touched.sum()} nodes")

deepest = press.displacement[:, 2].min()
print(f"the surface goes down by {-deepest:.2f} mm at most")
