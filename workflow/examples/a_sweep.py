"""Sweep depth and diameter, keep a table, and see the law: force grows as a power of depth.

Sweeps of methods and meshes: make DATASET=feats_sphere15 pareto, stability.
"""

import csv

import numpy as np

import gelforge

DEPTHS = (0.3, 0.5, 0.8)
DIAMETERS = (6, 12)

rows = []
for diameter in DIAMETERS:
    sphere = {"kind": "sphere", "diameter": diameter, "height": 10}
    for depth in DEPTHS:
        force = -gelforge.solve(sphere, depth).total[2]
        rows.append({"diameter_mm": diameter, "depth_mm": depth, "force_n": round(force, 4)})
    forces = [row["force_n"] for row in rows if row["diameter_mm"] == diameter]
    power = np.polyfit(np.log(DEPTHS), np.log(forces), 1)[0]
    print(
        f"{diameter} mm: {', '.join(f'{f:.2f} N' for f in forces)}; grows as depth^{power:.2f} (Hertz, a half space: 1.5)"
    )

with open("sweep.csv", "w", newline="") as stream:
    table = csv.DictWriter(stream, list(rows[0]))
    table.writeheader()
    table.writerows(rows)
print("sweep.csv: one row a press")
