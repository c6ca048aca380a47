"""Sizes, crops and orientations in which a camera of a GelSight Mini may give one image (h, w, 3)."""

import cv2
import numpy as np


def resized(image, width, height):
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_CUBIC)


def raw(image, aside=0):
    """A frame of 3280 x 2464 px as of the sensor's camera: the image, `aside` px off centre, with smooth margins."""
    height, width = 1757, 2343
    canvas = cv2.copyMakeBorder(
        resized(image, width, height), 353, 354, 468 + aside, 469 - aside, cv2.BORDER_REPLICATE
    )
    blurred = cv2.resize(cv2.GaussianBlur(cv2.resize(canvas, (328, 246)), (0, 0), 24), (3280, 2464))
    blurred[353 : 353 + height, 468 + aside : 468 + aside + width] = resized(image, width, height)
    return blurred


CROPS = {
    "as it is": lambda image: image,
    "640 x 480": lambda image: resized(image, 640, 480),
    "160 x 120": lambda image: resized(image, 160, 120),
    "raw": raw,
    "raw, mirrored": lambda image: np.ascontiguousarray(raw(image)[:, ::-1]),
    "raw, beside the middle": lambda image: raw(image, 90),
    "portrait": lambda image: np.ascontiguousarray(np.rot90(resized(image, 640, 480))),
    "portrait, the other way": lambda image: np.ascontiguousarray(np.rot90(image, -1)),
    "upside down": lambda image: np.ascontiguousarray(image[::-1, ::-1]),
    "wide": lambda image: raw(image)[308:2153],  # 16 : 9
}

FOUR = ["640 x 480", "raw, mirrored", "portrait", "wide"]
