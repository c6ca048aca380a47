"""Order of force components: along gel x (the short side), y (the long side) and z (out of the gel): fx, fy, fz.

All maps, totals, intervals and tables of gelforge use it. FEATS' order occurs only in its files
(`formats.featsfile`).
"""

AXES = ("x", "y", "z")
CHANNELS = ("fx", "fy", "fz")
MOMENTS = ("mx", "my", "mz")  # about the gel's apex, the origin of the gel frame
TITLES = tuple(f"{name}: force along gel {axis}" for name, axis in zip(CHANNELS, AXES, strict=True))
