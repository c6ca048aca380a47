"""The part of an indenter that a gel can meet."""

from functools import lru_cache

import numpy as np

from gelforge.geometry.triangles import boolean, stacked


@lru_cache(maxsize=64)
def cropped(body, height: float) -> tuple[np.ndarray, np.ndarray]:
    """The closed part of an indenter's surface up to `height` mm above its tip: vertices (v, 3), faces (f, 3)."""
    surface = body.surface()
    if height >= surface[0][:, 2].max():
        return surface
    r = 2.0 * body.radius() + 1.0
    square = np.array([[-r, -r], [r, -r], [r, r], [-r, r]])
    box = stacked([np.array([square, square])], np.array([-1.0, height]))
    return boolean(surface, box, "intersection")
