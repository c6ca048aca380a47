"""FEATS' film of its force maps: image and normal map of each press in it."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from gelforge.reading.light import match_light
from tests.support.films import frames_of

PANEL = 200  # px, width of each of the four panels of FEATS' film: x, y and normal map, image
CUT = 1  # px missing at the film's top: cells of its maps are 6.25 px high and wide, the first row's only 5.6 px high
NAME = np.s_[:32, :82]  # px of an image that the printed name covers


def map_of(panel: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Values 0 to 1 (24, 32) of a panel (h, w, 3) that shows cells in a colour map (256, 3)."""
    cells = cv2.resize(panel.astype(np.float32), (32, 24), interpolation=cv2.INTER_AREA).reshape(-1, 1, 3)
    return np.argmin(((cells - colours) ** 2).sum(axis=2), axis=1).reshape(24, 32) / 255.0


def film_panels(path: Path) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Image, with its name inpainted, and normal map (24, 32), larger for more pressure, of each press."""
    import matplotlib as mpl

    covered = np.zeros((240, 320), np.uint8)
    covered[NAME] = 255
    colours = 255.0 * mpl.colormaps["viridis"](np.arange(256))[:, :3]
    for image in frames_of(path):
        whole = cv2.copyMakeBorder(image, CUT, 0, 0, 0, cv2.BORDER_REPLICATE)
        shown = cv2.resize(whole[:, 3 * PANEL :], (320, 240), interpolation=cv2.INTER_CUBIC)
        yield (
            cv2.inpaint(shown, covered, 5, cv2.INPAINT_TELEA),
            1.0 - map_of(whole[:, 2 * PANEL : 3 * PANEL], colours),
        )


def feats_maps(path: Path, nocontact: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Image and normal map of each press from `film_panels`, the name replaced by the gel of the no-contact image."""
    return [(_named_over(picture, nocontact), normal) for picture, normal in film_panels(path)]


def _named_over(picture: np.ndarray, behind: np.ndarray) -> np.ndarray:
    """An image (h, w, 3) whose name is replaced by the same region of another image, matched in illumination."""
    light = match_light(picture, behind)
    whole = picture.copy()
    whole[NAME] = np.clip(np.rint(behind[NAME] * light.gain + light.offset), 0, 255)
    return whole
