"""Read forces from a film of a GelSight Mini with printed markers, frame by frame.

python workflow/examples/read_a_film.py [FILM] [IMAGE WITHOUT CONTACT]; without them the demo's film is read, and its first
frame, in which nothing touches the gel, is the image without contact.
"""

import sys
from pathlib import Path

import cv2

import gelforge

FILM = Path(__file__).parents[2] / "data" / "demo" / "film.avi"


def frames(film):
    """Images (h, w, 3) RGB of a film."""
    return (cv2.cvtColor(frame, cv2.COLOR_BGR2RGB) for _, frame in iter(cv2.VideoCapture(film).read, (False, None)))


film, still = (sys.argv[1:] + [str(FILM), None][len(sys.argv) - 1 :])[:2]
without = cv2.cvtColor(cv2.imread(still), cv2.COLOR_BGR2RGB) if still else next(frames(film))

read = gelforge.Reader(without)
for number, found in enumerate(read.stream(frames(film))):
    print(f"{number:4d}  {found}")  # forces on the gel along its x, y, z; pressing is negative
