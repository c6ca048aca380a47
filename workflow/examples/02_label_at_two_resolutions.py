"""Label one solved press at two resolutions: both hold the same force, on other cells."""

import numpy as np

import gelforge

press = gelforge.solve("cuboid_7", depth=0.5)

for resolution in ("12x16", "24x32"):
    cells = gelforge.label(press, resolution)  # (3, rows, cols) N: along gel x, y, z
    normal = cells[2]
    row, col = np.unravel_index(normal.argmin(), normal.shape)
    print(
        f"{resolution}: {np.count_nonzero(normal)} cells touched, {normal.sum():.3f} N in all, {normal[row, col]:.4f} N in the fullest"
    )
    np.save(f"label_{resolution}.npy", cells)

# Another camera: a Sensor of its own says where gel mm fall in its picture (15.77 px/mm here, rows of a homography).
camera = gelforge.Sensor("mine", (320, 240), np.array([[0.0, -12.0, 160.0], [-12.0, 0.0, 120.0], [0.0, 0.0, 1.0]]))
wider = gelforge.label(press, "24x32", camera)
print(f"a camera that sees more: {np.count_nonzero(wider[2])} cells touched, {wider[2].sum():.3f} N in all")
