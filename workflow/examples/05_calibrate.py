"""Find the stiffness of a gel from presses with a force sensor: the four published presses of a 15 mm sphere.

`make DATASET=feats_sphere15 calibrate` does it with touch offset, compliance and friction unknown, and gives intervals.
"""

import csv
from pathlib import Path

import numpy as np

import gelforge

LOG = Path(__file__).parents[2] / "data" / "feats_sphere15" / "log.csv"
UNIT = 0.1  # MPa

with LOG.open() as stream:
    presses = [(-float(row["dz_mm"]), float(row["fz_n"])) for row in csv.DictReader(stream)]

measured = np.array([force for _, force in presses])
of_unit = np.array([gelforge.solve("sphere_15", depth, c10=UNIT).total[2] for depth, _ in presses])

# Force is proportional to C10, so that least squares are one division; relative, because large forces err more.
c10 = UNIT * np.mean(measured / of_unit)
for (depth, force), unit in zip(presses, of_unit):
    print(f"{depth:.1f} mm: measured {force:8.3f} N, solved {unit * c10 / UNIT:8.3f} N")
print(f"C10 = {c10:.4f} MPa; what is left are touch offset, compliance and slip, which `make calibrate` finds, too")
