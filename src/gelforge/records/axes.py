"""The one order of forces: along gel x (the short side), y (the long side) and z (out of the gel), named fx, fy, fz.

All maps, totals, intervals and tables of gelforge have it. FEATS' order exists in its files alone (`formats.featsfile`).
"""

AXES = ("x", "y", "z")
CHANNELS = ("fx", "fy", "fz")
TITLES = tuple(f"{name}: force along gel {axis}" for name, axis in zip(CHANNELS, AXES, strict=True))
