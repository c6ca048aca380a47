"""From a displacement field to the image that the sensor's camera takes."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.records.image import as_jpeg
from gelforge.records.press import Press
from gelforge.virtualrig.appearance import HEIGHT, WIDTH, Appearance, Circumstances, normalised_pixels
from gelforge.virtualrig.fields import FAR, STEP, Field, RoughBody, body_position, unloaded
from gelforge.virtualrig.paint import MARGIN, printed, sample_position, wear_off

TOUCH = 0.05  # mm; gap below which the drawn surface follows the body instead of the computed surface
RIPPLE_MM = 0.2  # standard deviation of the blur that removes ripples of hexahedron size
RELAXATION, ROUNDS = 0.65, 9


@dataclass(frozen=True)
class Pressed:
    """The body in contact with the gel, and its path."""

    body: RoughBody
    press: Press


class Renderer:
    """Camera of one sensor; everything that is the same for all presses is computed once."""

    def __init__(self, appearance: Appearance, projection: np.ndarray, gel: Gel):
        self.appearance, self.projection, self.gel = appearance, np.asarray(projection, float), gel
        self.light = appearance.light_field()
        self.paint = printed(appearance, np.random.default_rng(appearance.seed))
        self.pixel_u, self.pixel_v = _pixels(0)
        wide_u, wide_v = _pixels(MARGIN)
        x, y = unproject(self.projection, wide_u, wide_v)
        empty = unloaded(gel)
        self.field_column = ((x - empty.x0) / STEP).astype(np.float32)
        self.field_row = ((y - empty.y0) / STEP).astype(np.float32)
        self.wide = wide_u, wide_v, x, y
        self.top = gel.top(x, y).astype(np.float32)
        self.axis = np.array(project(self.projection, 0.0, 0.0))
        self.scale = pixels_per_mm(self.projection)
        inner = np.s_[MARGIN : MARGIN + HEIGHT, MARGIN : MARGIN + WIDTH]
        self.inner_xy, self.inner_top = (x[inner], y[inner]), self.top[inner].copy()
        self.flat_shade = self._shade(self.inner_top)

    def image(self, field: Field | None = None, pressed: Pressed | None = None, rng=None) -> np.ndarray:
        """Image of a gel that is displaced by `field` and touched by `pressed`, (240, 320, 3) uint8 RGB.

        Without `rng` it has no noise and no drift.
        """
        source_u, source_v, height = (
            (self.pixel_u, self.pixel_v, self.inner_top) if field is None else self._trace(field)
        )
        if field is not None and self.appearance.normal_motion != 1.0:
            # a stiffer coat reduces the motion of the printed markers; the surface keeps the shape of the gel
            source_u, source_v, _ = self._trace(field.scaled(self.appearance.normal_motion))
        if pressed is not None:
            height = self._against(height, pressed)
        drift = self.appearance.drift
        taken = None if drift is None or rng is None else drift.draw(self.appearance.markers, rng)
        ink = cv2.remap(
            worn(self.paint, self.appearance.diameter, taken.worn)
            if taken is not None and taken.worn
            else self.paint,
            sample_position(source_u),
            sample_position(source_v),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REFLECT,
        )
        picture = self.light * (self._shade(height) / self.flat_shade)
        picture *= ink
        if self.appearance.shade is not None:
            sunk = float(np.maximum(self.inner_top - height, 0.0).mean())
            picture *= (1.0 + self.appearance.shade * sunk).astype(np.float32)
        if rng is not None:
            if taken is not None:
                picture = drifted(picture, taken)
            picture += self._noise(rng)
        levels = np.clip(np.rint(picture, out=picture), 0, 255, out=picture).astype(np.uint8)
        return as_jpeg(levels, self.appearance.jpeg) if self.appearance.jpeg else levels

    def seen(self, xy: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Pixels (n, 2) at which gel points xy (n, 2) mm appear after a displacement (n, 3) mm."""
        return np.stack(self._seen(xy[:, 0] + moved[:, 0], xy[:, 1] + moved[:, 1], moved[:, 2]), axis=1)

    def height(self, field: Field, pressed: Pressed) -> np.ndarray:
        """Height z in mm of the surface that each pixel shows, (240, 320) float32."""
        return self._against(self._trace(field)[2], pressed)

    def _seen(self, x, y, w):
        """Pixels of points at (x, y) that are displaced by w mm: parts pressed towards the pinhole look larger."""
        u, v = project(self.projection, x, y)
        nearer = self.appearance.camera_mm / (self.appearance.camera_mm + w)
        return self.axis[0] + (u - self.axis[0]) * nearer, self.axis[1] + (v - self.axis[1]) * nearer

    def _trace(self, field: Field):
        """For every pixel, the pixel (u, v) at which its gel point lies without load, and its height in mm."""
        moved = cv2.remap(
            field.values, self.field_column, self.field_row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        wide_u, wide_v, x, y = self.wide
        seen_u, seen_v = self._seen(x + moved[..., 0], y + moved[..., 1], moved[..., 2])
        shift = np.stack([seen_u - wide_u, seen_v - wide_v], axis=-1).astype(np.float32)
        source = np.stack([self.pixel_u, self.pixel_v], axis=-1)
        target = source.copy()
        nothing: Any = None  # a map of (u, v) pairs needs no second map, but OpenCV's type stubs do not allow None
        index = np.float32(MARGIN - 0.5)  # index of the image's corner in the arrays with margin
        for _ in range(ROUNDS):
            at = cv2.remap(shift, source + index, nothing, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            source += np.float32(RELAXATION) * (target - at - source)
        height = cv2.remap(
            self.top + moved[..., 2],
            source + index,
            nothing,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return source[..., 0].copy(), source[..., 1].copy(), height

    def _against(self, height: np.ndarray, pressed: Pressed) -> np.ndarray:
        """Height of a surface that follows the body where they touch, so that its edges and texture show.

        Hexahedra are larger than a print line or an edge fillet; where the gap is below TOUCH the gel follows the
        body.
        """
        # off the body the gel is smooth; ripples there are an artefact of the hexahedra
        height = cv2.GaussianBlur(height, (0, 0), RIPPLE_MM * self.scale)
        x, y = self.inner_xy
        # inverse of the magnification in `_seen`: true position of the point that appears at (x, y)
        farther = (self.appearance.camera_mm + height - self.inner_top) / self.appearance.camera_mm
        column, row, tip = body_position(pressed.body, pressed.press, x * farther, y * farther)
        body = tip + cv2.remap(
            pressed.body.height,
            column.astype(np.float32),
            row.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=FAR,
        )
        gap = np.maximum(body - height, 0.0)
        gap *= 1.0 - np.exp(-((gap / np.float32(TOUCH)) ** 2))
        return np.where(body < FAR + tip - 0.01, body - gap, height).astype(np.float32)

    def _shade(self, height: np.ndarray) -> np.ndarray:
        """Brightness due to surface slope, relative to a level surface, (240, 320, 3) float32."""
        smooth = cv2.GaussianBlur(height, (0, 0), max(self.appearance.blur, 0.5))
        slope_u = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=self.scale / 8)
        slope_v = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=self.scale / 8)
        # the gel's coating scatters light, so steep flanks are hardly brighter than moderate ones
        strength = 1.0 / np.sqrt(1.0 + (slope_u**2 + slope_v**2) / np.float32(self.appearance.slope_limit**2))
        gentle = strength**4
        shade = np.empty((HEIGHT, WIDTH, 3), np.float32)
        for colour, (towards, gain) in enumerate(zip(self.appearance.light, self.appearance.slope_gain, strict=True)):
            lit = strength * (float(gain * towards[0]) * slope_u + float(gain * towards[1]) * slope_v)
            steep = np.float32(self.appearance.brightening[colour])
            lit = np.where(lit > 0.0, (steep + (1 - steep) * gentle) * lit, lit)
            np.maximum(1.0 + lit, 0.2, out=shade[..., colour])
        return shade

    def _noise(self, rng: np.random.Generator) -> np.ndarray:
        noise: np.ndarray = rng.standard_normal((HEIGHT, WIDTH, 3), dtype=np.float32)
        sigma = self.appearance.noise_blur
        if sigma > 0:
            noise = cv2.GaussianBlur(noise, (0, 0), sigma)
            noise = noise * np.float32(1.0 / _blur_gain(sigma))
        return noise * self.appearance.noise.astype(np.float32)


def worn(paint: np.ndarray, diameter: float, markers: list[tuple[np.ndarray, float]]) -> np.ndarray:
    """`paint` (h, w, 3) with some markers worn off; markers: centre (2,) px and remaining fraction of ink of each."""
    left = paint.copy()
    for centre, ink in markers:
        wear_off(left, centre, diameter, ink)
    return left


def drifted(picture: np.ndarray, taken: Circumstances) -> np.ndarray:
    """An image (h, w, 3) under the gain, offset and light field of each colour, and with the blur, of `taken`."""
    s, t = normalised_pixels()
    shapes = np.stack([s, t, s * t, s**2, t**2], axis=-1) @ taken.field
    light = 1.0 + taken.gain + shapes
    if taken.relit is not None:
        gradient, vignette = taken.relit
        light *= 1.0 + np.stack([s, t], axis=-1) @ gradient
        light *= 1.0 - vignette * ((s**2 + t**2) / 2)[..., None]
    seen = picture * light.astype(np.float32) + taken.offset.astype(np.float32)
    return cv2.GaussianBlur(seen, (0, 0), taken.blur) if taken.blur > 0.1 else seen


def _pixels(margin: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres (u, v) of the pixels, measured from the image's corner like projections and label cells."""
    v, u = np.mgrid[-margin : HEIGHT + margin, -margin : WIDTH + margin].astype(np.float32) + np.float32(0.5)
    return u, v


def _blur_gain(sigma: float) -> float:
    """Standard deviation of white noise of unit standard deviation after a Gaussian blur."""
    impulse = np.zeros((41, 41), np.float32)
    impulse[20, 20] = 1.0
    return float(np.sqrt((cv2.GaussianBlur(impulse, (0, 0), sigma) ** 2).sum()))


def project(projection: np.ndarray, x, y):
    """Pixels (u, v) of gel points, by a homography (Hartley and Zisserman, section 2.3).

    Like `labelling.sensor.transform`, but by coordinate: the rounding of matrix products depends on the processor,
    and a plan that is repeated must give the same images.
    """
    w = projection[2, 0] * x + projection[2, 1] * y + projection[2, 2]
    u = projection[0, 0] * x + projection[0, 1] * y + projection[0, 2]
    v = projection[1, 0] * x + projection[1, 1] * y + projection[1, 2]
    return u / w, v / w


def unproject(projection: np.ndarray, u, v):
    """Gel points (x, y) in mm of pixels."""
    return project(np.linalg.inv(projection), u, v)


def pixels_per_mm(projection: np.ndarray) -> float:
    """Mean scale of the projection at the gel's apex."""
    u, v = project(projection, np.array([0.0, 1e-3, 0.0]), np.array([0.0, 0.0, 1e-3]))
    jacobian = np.array([[u[1] - u[0], u[2] - u[0]], [v[1] - v[0], v[2] - v[0]]]) / 1e-3
    return float(np.sqrt(abs(np.linalg.det(jacobian))))
