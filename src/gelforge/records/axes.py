"""Which axis of the gel each channel of a label is, and what the channels are called: the only map between the two.

A name of an axis means that axis: fx_n is force along gel x (the short side), fy_n along gel y (the long side), fz_n
along z, out of the gel. FEATS' channels are called otherwise: its grid_x holds the force along the image's columns,
which is gel y, its grid_y the force along gel x (feats-ai/feats, label_generation.py). Whatever is in the order of its
channels bears their names: grid_x, grid_y, grid_z.
"""

from gelforge.records.press import FORCE

CHANNELS = ("grid_x", "grid_y", "grid_z")
AXIS_OF_CHANNEL = (1, 0, 2)
CHANNEL_OF_AXIS = (1, 0, 2)  # the map is its own inverse
AXES = ("x", "y", "z")
# What each channel holds, for sentences that people read: there a channel's name would be taken for an axis.
MEANINGS = tuple(f"force along gel {AXES[axis]}" for axis in AXIS_OF_CHANNEL)
TITLES = tuple(f"{name}: {meaning}" for name, meaning in zip(CHANNELS, MEANINGS, strict=True))
# The column of a log or a table that holds each channel's total force.
FORCE_OF_CHANNEL = tuple(FORCE[axis] for axis in AXIS_OF_CHANNEL)
