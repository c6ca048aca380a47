"""On a robot: close a gripper until the sensor in its finger reads a force, by the newest frame of its camera alone.

python workflow/examples/grip_by_force.py [CAMERA OR FILM]; else the demo's film is read. The first frame shows the free gel.
"""

import sys
from pathlib import Path
from queue import SimpleQueue
from threading import Thread

import cv2

import gelforge

FILM, GRIP_N = Path(__file__).parents[2] / "data" / "demo" / "film.avi", 3.0


def watch(camera, came):
    """Put every frame of a camera into a queue, None at its end."""
    while (frame := camera.read()[1]) is not None:
        came.put(frame)
    came.put(None)


camera, came = (sys.argv[1:] + [str(FILM)])[0], SimpleQueue()
Thread(target=watch, args=(cv2.VideoCapture(int(camera) if camera.isdigit() else camera), came), daemon=True).start()

frame = came.get()
read = gelforge.Reader(frame[..., ::-1])  # OpenCV's images are BGR
while frame is not None:
    found = read(frame[..., ::-1])
    if found.flag:
        sys.exit(f"{found.reason}: no force to rely on, so nothing moves")
    if found.total[2] <= -GRIP_N:  # along the normal; pressing is negative
        print(f"{found.total[2]:+.2f} N: gripped")
        break
    print(f"{found.total[2]:+.2f} N: close further")  # here your robot's driver closes the gripper by a small step
    frame = came.get()
    while camera.isdigit() and frame is not None and not came.empty():  # of a running camera only the newest
        frame = came.get()
