"""The part of an indenter that a gel can meet."""

from functools import lru_cache

import numpy as np

from gelforge.geometry.triangles import below


@lru_cache(maxsize=64)
def cropped(body, height: float) -> tuple[np.ndarray, np.ndarray]:
    """The closed part of an indenter's surface up to `height` mm above its tip: vertices (v, 3), faces (f, 3)."""
    vertices, faces = body.surface()
    return (vertices, faces) if height >= vertices[:, 2].max() else below(vertices, faces, height)
