"""Read forces from a film of a GelSight Mini with printed markers, frame by frame.

python workflow/examples/06_read_a_film.py [FILM] [IMAGE WITHOUT CONTACT]; with neither, pictures of the demo are read.
"""

import sys
from pathlib import Path

import cv2

import gelforge

DEMO = Path(__file__).parents[2] / "data" / "demo"


def frames(film):
    """Images (h, w, 3) RGB of a film, or of the demo's first presses on sensor mini_a."""
    pictures = (
        iter(cv2.VideoCapture(film).read, (False, None)) if film else ((True, cv2.imread(str(p))) for p in demo())
    )
    return (cv2.cvtColor(picture, cv2.COLOR_BGR2RGB) for _, picture in pictures)


def demo():
    return sorted((DEMO / "images").glob("*.png"))[:6]


film, still = (sys.argv[1:] + [None, None])[:2]
without = cv2.cvtColor(cv2.imread(still or str(DEMO / "nocontact" / "mini_a.png")), cv2.COLOR_BGR2RGB)

read = gelforge.Reader(without)
for number, found in enumerate(read.stream(frames(film))):
    x, y, z = found.total  # N along gel x, y, z; pressing is negative
    width = "" if found.half_width is None else f" +- {found.half_width[2]:.2f}"
    print(f"{number:4d}  x {x:+6.2f}  y {y:+6.2f}  z {z:+7.2f}{width} N  {found.reason if found.flag else ''}")
