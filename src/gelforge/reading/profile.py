"""The profile of one sensor: its no-contact image, its marker pitch, and a factor on predicted forces.

A network is trained on gels of one stiffness. Force is proportional to the stiffness of the gel, so the error on a
softer, harder or thicker gel is, to first order, one factor. A few readings of a kitchen scale or a force sensor give
it.
"""

import datetime
import json
import math
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist
from typing import TypeGuard

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_toml, write_text
from gelforge.reading.frame import reduced
from gelforge.reading.markers import markers_in
from gelforge.reading.model import fingerprint
from gelforge.records.image import read_image, write_png

SPREAD = 0.3  # prior standard deviation of the factor's logarithm: gels, prints and cameras differ by a third
SCATTER, KNOWN = 0.15, 2.0  # prior scatter of a reading's logarithm, and the number of readings that it counts for
MAKE_IT = "make it with `gelforge sensor`"  # what to do where there is no profile
# A constant added to all readings of a scale: prior probability, standard deviation in N, and grid in N.
OFFSET_PROBABILITY, OFFSET_N = 0.3, 3.0
OFFSETS = np.concatenate([[0.0], np.linspace(-12.0, 12.0, 97)])
SLAB = np.exp(-0.5 * (OFFSETS[1:] / OFFSET_N) ** 2)
OFFSET_PRIOR = np.log(np.concatenate([[1.0 - OFFSET_PROBABILITY], OFFSET_PROBABILITY * SLAB / SLAB.sum()]))
FACTORS = np.linspace(-2.0, 2.0, 801)  # logarithms of factors
LEAST_FRACTION = 0.02  # of a reading that must remain without the constant
WEAK_N = 1.0  # readings of about this force and below have little weight
LEAST_N = 0.5  # predicted by the network: below, nothing touches the gel
FARTHEST = 5.0  # largest ratio between a reading and the prediction
ODD = 2.0  # ratio to the median proportion beyond which a reading is likely wrong
PROBABILITY = 0.9  # of an interval
# Half width of such an interval in standard deviations.
REACH = NormalDist().inv_cdf(0.5 + PROBABILITY / 2)
APART = 0.03  # fraction by which the marker pitch may differ from the profile's


@dataclass(frozen=True)
class Gain:
    """Factor on all forces of a sensor, an interval that holds it with probability 0.9, and the readings behind it."""

    value: float = 1.0
    low: float = math.exp(-REACH * SPREAD)
    high: float = math.exp(REACH * SPREAD)
    readings: int = 0

    @property
    def unsure(self) -> float:
        """Half of the interval as a fraction of the factor; 0 without readings, where no factor is applied."""
        return (self.high - self.low) / (2 * self.value) if self.readings else 0.0


AS_READ = Gain()  # of a sensor that has no profile


@dataclass(frozen=True)
class SensorProfile:
    """One sensor: name, date of the profile, no-contact image (h, w, 3) uint8 RGB, marker pitch, gain.

    pitch: px between neighbouring markers, 0 where the gel has none. model: name of the network whose predictions
    gave the gain, network: its identity (`fingerprint`).
    """

    name: str
    date: str
    nocontact: np.ndarray
    pitch: float
    gain: Gain
    model: str
    network: str


def fit_gain(measured: np.ndarray, read: np.ndarray) -> Gain:
    """Factor from normal forces (n,) N, measured and predicted by the network, both positive where pressed.

    Posterior of the factor's logarithm on a grid; the scatter is estimated from the readings and a prior worth KNOWN
    readings (Gelman et al., Bayesian Data Analysis, 3rd ed., sections 2.6 and 3.2). A scale that was not tared adds a
    constant to all readings with probability OFFSET_PROBABILITY (spike and slab: Mitchell and Beauchamp 1988, J. Am.
    Stat. Assoc. 83, 1023-1032). Few readings do not show it, so the interval allows for it.
    """
    if not len(measured):
        return AS_READ
    known = np.maximum(np.asarray(measured, float) - OFFSETS[:, None], 1e-300)  # (offsets, n)
    weight = read**2 / (read**2 + WEAK_N**2)
    ratio = np.log(known / read)
    squares = ((weight * ratio**2).sum(axis=1)[:, None] - 2.0 * (weight * ratio).sum(axis=1)[:, None] * FACTORS
               + weight.sum() * FACTORS**2)  # fmt: skip
    freedom = KNOWN + len(read)
    likelihood = (
        -freedom / 2 * np.log(KNOWN * SCATTER**2 + np.maximum(squares, 0.0)) - np.log(known).sum(axis=1)[:, None]
    )
    likelihood[(known < LEAST_FRACTION * np.asarray(measured)).any(axis=1)] = -np.inf
    posterior = likelihood - 0.5 * (FACTORS / SPREAD) ** 2 + OFFSET_PRIOR[:, None]
    probability = np.exp(posterior - posterior.max()).sum(axis=0)
    held = np.cumsum(probability) - probability / 2
    low, value, high = np.exp(
        np.interp(np.array([0.5 - PROBABILITY / 2, 0.5, 0.5 + PROBABILITY / 2]) * probability.sum(), held, FACTORS)
    ).tolist()
    return Gain(value, low, high, len(read))


def check_readings(names: list[str], measured: np.ndarray, read: np.ndarray) -> None:
    """Raise BadInput for readings that cannot be of this sensor under these forces."""
    for name, force, seen in zip(names, measured, read, strict=True):
        if not (math.isfinite(force) and force > 0.0):
            raise BadInput(f"{name}: force_n = {force:g}: give the force that presses, above 0 N")
        if seen < LEAST_N:
            raise BadInput(
                f"{name}: {force:g} N were measured, but the image shows no contact ({seen:.1f} N are predicted)"
            )
        if not 1.0 / FARTHEST < force / seen < FARTHEST:
            raise BadInput(
                f"{name}: {force:g} N were measured, but about {seen:.1f} N are predicted; was the reading in newtons?"
                " (102 g, 0.225 lbf and 3.6 ozf are 1 N)"
            )


def odd_readings(names: list[str], measured: np.ndarray, read: np.ndarray) -> dict[str, str]:
    """Readings whose ratio to the prediction is more than ODD times off the median ratio: a sentence by name."""
    ratio = np.asarray(measured, float) / read
    usual = float(np.median(ratio))
    return {
        name: f"{force:g} N were measured, but about {seen:.1f} N are predicted; the usual ratio here is {usual:.2g}"
        for name, force, seen, one in zip(names, measured, read, ratio, strict=True)
        if max(one / usual, usual / one) > ODD
    }


def make_profile(name: str, nocontact: np.ndarray, pitch: float, gain: Gain, metadata: dict) -> SensorProfile:
    """The profile of a sensor, dated today. metadata: of the network whose readings gave the factor."""
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    return SensorProfile(name, today, nocontact, pitch, gain, metadata["name"], fingerprint(metadata))


def write_profile(path: Path, profile: SensorProfile) -> None:
    """Write a profile as TOML, and its picture beside it as PNG of the same name."""
    picture = path.with_suffix(".png")
    write_png(picture, profile.nocontact)
    gain = profile.gain
    write_text(path, "\n".join([
        f"name = {json.dumps(profile.name, ensure_ascii=False)}", f"date = {profile.date}", f"model = {json.dumps(profile.model, ensure_ascii=False)}",
        f"network = {json.dumps(profile.network, ensure_ascii=False)}",
        f"nocontact = {json.dumps(picture.name, ensure_ascii=False)}", f"pitch_px = {profile.pitch:.3f}", "",
        "# What forces are multiplied by, between `low` and `high` with probability 0.9.",
        "[gain]", f"value = {gain.value:.6f}", f"low = {gain.low:.6f}", f"high = {gain.high:.6f}", f"readings = {gain.readings}", "",
    ]))  # fmt: skip


def read_profile(path: Path) -> SensorProfile:
    """Read a profile and its picture; BadInput names what is missing or has no meaning."""
    table = read_toml(path, MAKE_IT)
    found, pitch = _gain_of(table), table.get("pitch_px")
    words = all(isinstance(table.get(key), str) for key in ("name", "model", "network"))
    if not (found and words and _is_number(pitch) and 0 <= pitch < 1e4):
        raise BadInput(f"{path}: not a sensor's profile; {MAKE_IT}")
    picture = read_image(_picture_of(path, table), hint="make the profile again")
    date = str(table.get("date", ""))
    return SensorProfile(table["name"], date, picture, float(pitch), found, table["model"], table["network"])


def _gain_of(table: dict) -> Gain | None:
    """The factor that a profile's table states; none where it states none that has a meaning."""
    gain = table.get("gain")
    gain = gain if isinstance(gain, dict) else {}
    good = all(_is_number(gain.get(key)) and 0 < gain[key] < 1e3 for key in ("value", "low", "high"))
    readings = gain.get("readings")
    if not (good and type(readings) is int and readings >= 0):
        return None
    return Gain(float(gain["value"]), float(gain["low"]), float(gain["high"]), readings)


def gain_there(path: Path) -> Gain | None:
    """The factor of a profile's file, even if its image is lost; AS_READ without a file, None if it is no profile."""
    if not path.exists():
        return AS_READ
    try:
        return _gain_of(read_toml(path))
    except BadInput:
        return None


def _picture_of(path: Path, table: dict) -> Path:
    """Path of the no-contact image of a profile; BadInput where it is not named as a file beside the profile."""
    beside = table.get("nocontact")
    if not isinstance(beside, str) or not beside or "\0" in beside or Path(beside).name != beside:
        raise BadInput(f"{path}: nocontact = {beside!r}: name a picture that lies beside the profile")
    return path.with_name(beside)


def files_of(path: Path | None) -> list[Path]:
    """The files that a profile is made of, itself and its picture, which no output may replace; None: no profile."""
    return [] if path is None else [path, _picture_of(path, read_toml(path, MAKE_IT))]


def _is_number(value: object) -> TypeGuard[int | float]:
    """Whether a value of a TOML file is a number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def with_profile(
    profile: SensorProfile | None, picture: np.ndarray | None, metadata: dict
) -> tuple[np.ndarray | None, Gain]:
    """The no-contact image, the given one or the profile's, and the profile's factor on forces.

    metadata: of the network that reads; BadInput where the profile's factor was found with another one.
    """
    if profile is None:
        return picture, AS_READ
    check_same_network(profile, metadata)
    if picture is None:
        return profile.nocontact, profile.gain
    check_same_sensor(profile, markers_in(reduced(picture)).pitch)  # reduced as the profile's image
    return picture, profile.gain


def check_same_network(profile: SensorProfile, metadata: dict) -> None:
    """Raise BadInput where a profile's factor was found with another network than the one that reads."""
    if profile.gain.readings and profile.network != fingerprint(metadata):
        raise BadInput(
            f"profile {profile.name}: its factor was found with another network ({profile.model}) than the one that reads"
            f" ({metadata['name']}): make the profile again with `gelforge sensor`, or name that network with --model"
        )


def check_same_sensor(profile: SensorProfile, pitch: float) -> None:
    """Raise BadInput where markers `pitch` px apart in a no-contact image are not those of the profile."""
    if abs(pitch - profile.pitch) > APART * profile.pitch:
        raise BadInput(
            f"the markers of the no-contact image stand {pitch:.1f} px apart, those of profile {profile.name} {profile.pitch:.1f}:"
            " the image is of another sensor, or cropped or scaled differently; make a profile of this sensor with `gelforge sensor`"
        )
