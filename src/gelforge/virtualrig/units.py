"""Virtual sensors drawn at random from ranges, so that a network learns what they have in common."""

import zlib
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_toml
from gelforge.flow.schema import SOME, Number, ParameterTable, Place, Span, Within, parse
from gelforge.labelling.sensor import Sensor
from gelforge.virtualrig import appearance as of
from gelforge.virtualrig.appearance import HEIGHT, WIDTH, Appearance, Drift, marker_centres, read_appearances, towards
from gelforge.virtualrig.rigplan import DrawnUnits

ROWS, COLS = 7, 9  # of the marker grid in a full view
AZIMUTH = np.array([90.0, 0.0, 270.0])  # degrees of the red, green and blue light


class UnitRanges(ParameterTable):
    """Ranges of what differs between units, each drawn uniformly; the file states the source of each range.

    Lengths are px unless named mm, light is in grey levels up to 255, angles in degrees. Names are those of
    `Appearance` and of workflow/rig/sensors.toml. backgrounds: appearances whose light is mixed. pitch_mm: distance
    of the markers on the gel. contrast: common factor of all colours, log-uniform; colour_contrast: a further factor
    of each. jpeg_fraction: fraction of units whose camera compresses, with jpeg_quality. relit_fraction: fraction of
    images under light from another direction. worn_fraction: fraction of images in which further markers are worn
    off.
    """

    example = "workflow/rig/units.toml"

    backgrounds: Annotated[tuple[str, ...], SOME]
    background_scatter: Span[of.Share]
    tilt: Span[of.Share]
    azimuth_deg: Span[of.Angle]
    contrast: Span[of.Contrast]
    colour_contrast: Span[of.Contrast]
    slope_limit: Span[of.Contrast]
    brightening: Span[of.Brightening]
    camera_mm: Span[of.CameraMm]
    gain: Span[of.Gain]
    white_balance: Span[of.Gain]
    vignette: Span[of.Fraction]
    blur_px: Span[of.Pixels]
    noise: Span[of.Levels]
    noise_blur_px: Span[of.Pixels]
    scale_px_per_mm: Span[Annotated[Number, Within(1, 1000, "px/mm")]]
    perspective: Span[Annotated[Number, Within(-0.01, 0.01)]]
    rotation_deg: Span[of.Angle]
    shift_px: Span[of.Position]
    pitch_mm: Span[Annotated[Number, Within(0.1, 100, "mm")]]
    grid_shift_px: Span[of.Position]
    grid_turn_deg: Span[of.Angle]
    spread: Span[of.Share]
    misprint_px: Span[of.Pixels]
    diameter_px: Span[of.Diameter]
    raggedness: Span[of.Fraction]
    ink: Span[of.Fraction]
    flecks: Span[of.Flecks]
    shadow_depth: Span[of.Fraction]
    shadow_px: Span[of.Shadow]
    missing_markers: Span[Annotated[Number, Within(0, ROWS * COLS - 1)]]
    specks: Span[Annotated[Number, Within(0, 10000)]]
    drift_gain: Span[of.Share]
    drift_offset: Span[Annotated[Number, Within(-255, 255)]]
    drift_field: Span[of.Share]
    relit_fraction: of.Fraction
    relit_gradient: Span[Annotated[Number, Within(-0.9, 0.9)]]
    relit_colour_gradient: Span[Annotated[Number, Within(-0.9, 0.9)]]
    relit_vignette: Span[Annotated[Number, Within(-0.9, 0.9)]]
    refocus_px: Span[of.Pixels]
    worn_fraction: of.Fraction
    worn_markers: Span[Annotated[Number, Within(0, ROWS * COLS - 1)]]
    worn_ink: Span[of.Fraction]
    normal_motion: Span[of.Motion]
    shade_per_mm: Span[Annotated[Number, Within(-10, 10, "1/mm")]]
    jpeg_fraction: of.Fraction
    jpeg_quality: Span[Annotated[Number, Within(1, 100)]]


def draw_units(units: DrawnUnits, gel: str, rig: Path, seed: int) -> tuple[dict[str, Appearance], dict[str, Sensor]]:
    """Appearances and sensors of a plan's drawn units, by name; each depends on the seed and its own name alone.

    gel: name of the gel of units for which `units` names none. rig: folder workflow/rig with the ranges and with
    sensors.toml, whose backgrounds are mixed. Raises BadInput for ranges that name an unknown background.
    """
    path = rig / units.ranges
    ranges, known = read_ranges(path), read_appearances(rig / "sensors.toml")
    unknown = [name for name in ranges.backgrounds if name not in known]
    if unknown:
        raise BadInput(f"{path}: backgrounds: no appearance {', '.join(unknown)} in {rig / 'sensors.toml'}")
    bases = np.array([known[name].background for name in ranges.backgrounds])
    appearances, sensors = {}, {}
    for name in units.names:
        draw = Draw(np.random.default_rng([seed, zlib.crc32(name.encode())]), ranges)
        sensors[name] = replace(draw.sensor(name), gel=units.gel_of(name) or gel)
        appearances[name] = draw.appearance(name, bases, sensors[name])
    return appearances, sensors


def read_ranges(path: Path) -> UnitRanges:
    """Read a file of ranges; one that is incomplete or has unknown keys raises BadInput."""
    return parse(UnitRanges, read_toml(path), Place(str(path)))


class Draw:
    """Draws one unit's values by name; the order of the draws is fixed."""

    def __init__(self, rng: np.random.Generator, ranges: UnitRanges):
        self.rng, self.ranges = rng, ranges

    def of(self, name: str, shape=None):
        """Values between the bounds of a range."""
        low, high = getattr(self.ranges, name)
        return self.rng.uniform(low, high, shape)

    def whole(self, name: str) -> int:
        """A whole number between the bounds, both included."""
        low, high = getattr(self.ranges, name)
        return int(self.rng.integers(round(low), round(high) + 1))

    def sensor(self, name: str) -> Sensor:
        """Sensor of the unit: projection of the gel into its camera, and the printed marker grid."""
        scale, angle = self.of("scale_px_per_mm"), np.deg2rad(self.of("rotation_deg"))
        centre = np.array([WIDTH, HEIGHT]) / 2 + self.of("shift_px", 2)
        cos, sin = scale * np.cos(angle), scale * np.sin(angle)
        tilt = self.of("perspective", 2)
        projection = np.array([[sin, -cos, centre[0]], [-cos, -sin, centre[1]], [0.0, 0.0, 1.0]])
        projection[:2, :2] += np.outer(centre, tilt)  # the apex stays where it is
        projection[2, :2] = tilt
        markers = {
            "rows": ROWS,
            "cols": COLS,
            "pitch_px": [float(round(scale * self.of("pitch_mm"), 3)) for _ in range(2)],
            "centre_px": [float(round(value, 3)) for value in centre + self.of("grid_shift_px", 2)],
            "rotation_deg": float(round(np.rad2deg(angle) + self.of("grid_turn_deg"), 3)),
            "diameter_px": float(round(self.of("diameter_px"), 3)),
        }
        return Sensor(name, (WIDTH, HEIGHT), projection, markers=markers)

    def appearance(self, name: str, bases: np.ndarray, sensor: Sensor) -> Appearance:
        """Appearance of the unit: illumination, camera, ink; bases: (k, 15, 3) backgrounds to mix."""
        weight = self.rng.dirichlet(np.ones(len(bases)))
        background = np.einsum("k,kij->ij", weight, bases) * (1.0 + self.of("background_scatter", bases[0].shape))
        azimuth = AZIMUTH + self.of("azimuth_deg") + self.of("azimuth_deg", 3)
        weakest, strongest = np.log(self.ranges.contrast)
        contrast = np.exp(self.rng.uniform(weakest, strongest))
        markers = dict(sensor.markers) | {
            "spread": self.of("spread", 2),
            "jitter_px": self.of("misprint_px"),
            "seed": self.rng.integers(2**31),
            "missing": self.rng.choice(ROWS * COLS, self.whole("missing_markers"), replace=False),
        }
        return Appearance(
            name=name,
            background=background,
            tilt=self.of("tilt", (3, 2)),
            white_balance=self.of("white_balance", 3),
            gain=self.of("gain"),
            vignette=self.of("vignette"),
            light=towards(azimuth),
            slope_gain=contrast * self.of("colour_contrast", 3),
            slope_limit=self.of("slope_limit"),
            brightening=self.of("brightening", 3),
            camera_mm=self.of("camera_mm"),
            blur=self.of("blur_px"),
            noise=self.of("noise", 3),
            noise_blur=self.of("noise_blur_px"),
            markers=marker_centres(markers),
            diameter=sensor.markers["diameter_px"],
            raggedness=self.of("raggedness"),
            ink=self.of("ink", 3),
            flecks=self.of("flecks", 3),
            shadow_depth=self.of("shadow_depth"),
            shadow_length=self.of("shadow_px", 3),
            seed=int(self.rng.integers(2**31)),
            specks=self.whole("specks"),
            drift=Drift(
                **{part: getattr(self.ranges, f"drift_{part}") for part in ("gain", "offset", "field")},
                relit=self.ranges.relit_fraction,
                **{
                    part: getattr(self.ranges, f"relit_{part}")
                    for part in ("gradient", "colour_gradient", "vignette")
                },
                refocus=self.ranges.refocus_px,
                worn=self.ranges.worn_fraction,
                worn_markers=self.ranges.worn_markers,
                worn_ink=self.ranges.worn_ink,
            ),
            shade=self.of("shade_per_mm", 3),
            jpeg=self.whole("jpeg_quality") if self.rng.random() < self.ranges.jpeg_fraction else 0,
            normal_motion=self.of("normal_motion"),
        )
