"""The part of an indenter that a gel can meet."""

from functools import lru_cache

import numpy as np

from gelforge.geometry.triangles import below


@lru_cache(maxsize=64)
def cropped(body, height: float) -> tuple[np.ndarray, np.ndarray]:
    """The closed part of an indenter's surface up to `height` mm above its tip: vertices (v, 3), faces (f, 3)."""
    surface = body.surface()
    return surface if height >= surface[0][:, 2].max() else below(*surface, height)
