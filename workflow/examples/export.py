"""Write a solved press for other programs: FEATS' label file, a mesh for ParaView, arrays for NumPy.

A whole dataset: make DATASET=demo export FORMAT=lerobot (or mcap, hdf5); make feats-export.
"""

from pathlib import Path

import numpy as np

import gelforge
from gelforge.formats.featsfile import LabelSample, write_label
from gelforge.formats.vtu import write_vtu
from gelforge.records.image import read_image

IMAGE = Path(__file__).parents[2] / "data" / "demo" / "nocontact" / "mini_a.png"

press = gelforge.solve({"kind": "cylinder", "diameter": 8, "fillet": 1, "height": 10}, depth=0.5)
cells = gelforge.label(press, "24x32")

# One press per .npy file, a pickled dict: gs_img, grid_x, grid_y, grid_z, f_x, f_y, f_z.
write_label(Path("press.npy"), LabelSample(read_image(IMAGE), cells))

# In ParaView: Warp By Vector by `displacement`, colour by `force`.
known = np.ones(len(press.mesh.nodes), bool)
write_vtu(Path("press.vtu"), press.mesh, press.displacement, press.forces, known)

np.savez("press.npz", nodes=press.mesh.nodes, force=press.forces, displacement=press.displacement, cells=cells)
for path in sorted(Path().glob("press.*")):
    print(f"{path}: {path.stat().st_size} bytes")
