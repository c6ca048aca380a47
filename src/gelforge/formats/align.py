"""Match the clocks of a bench's three recordings: force gauge, path of the CNC and images, each on its own clock.

Force, depth and image change rise and fall together in every press, so they align the clocks. Cross-correlation of
whole recordings gives some rough offsets, all of which are tried. Each is refined press by press: force is a smooth
function of depth (or of image change) only if both are taken at the same time. A line through the offsets of the
presses gives the clock's offset and drift. The reported error combines their scatter about the line with a tenth of a
sampling interval. One press alone gives no drift. The gauge's reading at rest is subtracted first.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gelforge.errors import BadInput
from gelforge.records import series

LAPSE = 2.5  # median intervals: across a longer gap samples were dropped, and nothing is interpolated
COARSE_S = 0.02  # step of the cross-correlation
REACH_S = 0.5  # each press is searched this far around a rough offset
MOST_TRIED = 6  # peaks of the cross-correlation
TOLERATED = 0.1  # fraction of a force's variance within a press that the other recording may leave unexplained
RIVAL = 0.9  # another offset that explains this fraction of what the best one does may be the right one, too
FEW_DIGITS = 1e6  # s: six digits of larger times end before the point
FEWEST = 12  # samples that a press needs to give an offset
ROUNDED = 0.1  # sampling intervals: error of the offset by corners between samples (five simulated benches: 0.07)
DEGREE = 3  # of the polynomial of force over depth within a press
MOST_DRIFT = 1.5e-3  # 5.4 s an hour, more than two clocks ever drift
# Scatter of the offsets of single presses; positions logged when they were commanded scatter by tenths of a second.
MOST_SCATTER_S = 0.025
MOST_MISSING = 0.4  # fraction of the presses that another recording may not show
WINDOWS = 8  # parts of a gauge's recording; the mode of each estimates the reading at rest there
BEFORE_S, AFTER_S = 0.1, 0.3  # margins around a press in which the gel is not at rest
PART_S = 2.0  # parts of a pause; one median of each is the reading at rest
ROUNDS = 3  # of finding presses and the reading at rest in turn
NOISE = 4.0  # standard deviations at rest; no press is detected below


@dataclass(frozen=True)
class Recording:
    """Values (n, k) at strictly rising times (n,) s of its own clock; name: used in messages."""

    name: str
    times: np.ndarray
    values: np.ndarray

    def __post_init__(self) -> None:
        if len(self.times) < 2:
            raise BadInput(f"{self.name}: holds {len(self.times)} samples; two at least make a recording")
        back = np.flatnonzero(np.diff(self.times) <= 0)
        if len(back):
            raise BadInput(
                f"{self.name}: time does not increase after sample {back[0] + 1} ({self.times[back[0]]:.15g} s, then"
                f" {self.times[back[0] + 1]:.15g} s); {_mended(self.times)}"
            )

    @cached_property
    def interval(self) -> float:
        """Median time from sample to sample, s."""
        return float(np.median(np.diff(self.times)))

    @property
    def lapses(self) -> np.ndarray:
        """Lengths (m,) s of the gaps where samples were dropped."""
        steps = np.diff(self.times)
        return np.asarray(steps[steps > LAPSE * self.interval])

    def at(self, times: np.ndarray) -> np.ndarray:
        """Values (m, k) at times (m,) of its clock, interpolated linearly; NaN in gaps and outside the recording."""
        after = np.clip(np.searchsorted(self.times, times), 1, len(self.times) - 1)
        known = (times >= self.times[0]) & (times <= self.times[-1])
        known &= self.times[after] - self.times[after - 1] <= LAPSE * self.interval
        found = np.stack([np.interp(times, self.times, value) for value in self.values.T], axis=1)
        found[~known] = np.nan
        return found


def _mended(times: np.ndarray) -> str:
    """What to do about times (n,) s that do not increase."""
    steps = np.diff(times)
    if (times % 10.0 == 0.0).all() and times[0] >= FEW_DIGITS:
        return f"times were written with six digits ({times[0]:g}): write all of them, with milliseconds"
    if (times == np.round(times)).all() and (steps >= 0).all():
        return "times have whole seconds only: log them with milliseconds"
    back = steps[steps < 0]
    if len(back) and np.abs(back.min() + 3600.0) < 60.0:
        return "the clock was set back by an hour, as at the end of daylight saving time: log UTC"
    if len(back) == 1 and (steps > 0).sum() == len(steps) - 1:
        return "the clock was set back there, or two recordings follow each other: give one part of it"
    if (steps == 0).mean() > 0.1:
        return "many samples have the same time: log the time of each sample, with milliseconds"
    return "sort it by time and remove duplicates"


@dataclass(frozen=True)
class Levelled:
    """A gauge's recording after subtraction of its reading at rest.

    level (n, k): what was subtracted. touch: force from which on the gel is pressed, N.
    """

    gauge: Recording
    level: np.ndarray
    touch: float


def without_level(gauge: Recording, touch: float) -> Levelled:
    """Subtract the reading at rest, interpolated linearly between pauses. The gauge's first value is compression, N.

    BadInput where forces have the opposite sign, or where the gauge never rests.
    """
    force = gauge.values[:, 0]
    if series.triggered(gauge.times, force):
        raise BadInput(
            f"{gauge.name}: the gauge never rests: it recorded during presses only, so that what it reads without contact is unknown; switch off"
            " its trigger, and record a second without contact before and after each press"
        )
    base = _usual(gauge.times, force)
    left = force - base
    low, high = np.quantile(left, [0.003, 0.997])
    if -low > max(high, touch):
        raise BadInput(
            f"{gauge.name}: its forces pull by {-low:.3g} N relative to rest: give --sign -1 if the gauge counts pressing as positive,"
            " and let it rest between presses"
        )
    for _ in range(ROUNDS):
        rest = at_rest(gauge, left >= max(touch, 0.05 * float(np.quantile(left, 0.997))))
        pauses = [pause for pause in series.runs(rest, gauge.times) if pause.stop - pause.start >= FEWEST]
        if not pauses:
            raise BadInput(
                f"{gauge.name}: the gauge never rests; record a second without contact before and after each press"
            )
        parts = [part for pause in pauses for part in _parts(gauge.times, pause)]
        middles = [float(gauge.times[part].mean()) for part in parts]
        level = np.stack(
            [np.interp(gauge.times, middles, [np.median(value[part]) for part in parts]) for value in gauge.values.T],
            axis=1,
        )
        left = force - level[:, 0]
    scatter = 1.4826 * float(np.median(np.abs(left[rest])))
    levelled = Recording(gauge.name, gauge.times, gauge.values - level)
    return Levelled(levelled, level, max(touch, NOISE * scatter))


def _parts(times: np.ndarray, pause: slice) -> list[np.ndarray]:
    """Indices of the samples of a pause, in parts of about PART_S."""
    samples = np.arange(pause.start, pause.stop)
    return np.array_split(samples, max(1, int((times[samples[-1]] - times[samples[0]]) / PART_S)))


def _usual(times: np.ndarray, force: np.ndarray) -> np.ndarray:
    """First estimate (n,) N of the reading at rest: a robust line through the half-sample modes of WINDOWS parts."""
    parts = [part for part in np.array_split(np.arange(len(force)), WINDOWS) if len(part) >= FEWEST]
    if len(parts) < 2:
        return np.full(len(force), float(np.median(force)))
    middles, modes = (
        np.array([float(times[part].mean()) for part in parts]),
        np.array([_mode(force[part]) for part in parts]),
    )
    kept = np.ones(len(parts), bool)
    for _ in range(WINDOWS):
        slope = _slope(middles[kept], modes[kept])
        line = np.median(modes[kept] - slope * middles[kept]) + slope * middles
        now = modes <= line + 0.1 * np.ptp(force)
        if now.sum() < 2 or (now == kept).all():
            break
        kept = now
    return np.asarray(np.median(modes[kept] - slope * middles[kept]) + slope * times)


def _mode(values: np.ndarray) -> float:
    """The half-sample mode of values (n,) (Robertson and Cryer 1974, J. Am. Stat. Assoc. 69, 1012)."""
    ordered = np.sort(values)
    while len(ordered) > 2:
        half = (len(ordered) + 1) // 2
        at = int(np.argmin(ordered[half - 1 :] - ordered[: len(ordered) - half + 1]))
        ordered = ordered[at : at + half]
    return float(ordered.mean())


def at_rest(gauge: Recording, pressed: np.ndarray) -> np.ndarray:
    """Which samples (n,) lie outside every press, with the margins BEFORE_S and AFTER_S."""
    rest = ~pressed
    for press in series.runs(pressed):
        began, ended = gauge.times[press.start] - BEFORE_S, gauge.times[press.stop - 1] + AFTER_S
        rest &= (gauge.times < began) | (gauge.times > ended)
    return rest


@dataclass(frozen=True)
class MatchedClock:
    """A recording's clock relative to the gauge's: gauge time = time + offset_s + drift (time - middle_s).

    error_s: standard error of the offset, from the scatter of the presses and ROUNDED of the slower recording's
    interval. presses (k, 2): mean time of each used press on the gauge's clock, and its own offset, s. rival: whether
    another offset fits nearly as well. limit_s: scatter of the presses' offsets above which the clock is refused.
    """

    offset_s: float
    drift: float
    middle_s: float
    error_s: float
    presses: np.ndarray
    rival: bool
    limit_s: float

    def to_gauge(self, times: np.ndarray) -> np.ndarray:
        """Times (n,) s of the recording on the gauge's clock."""
        return np.asarray(times + self.offset_s + self.drift * (times - self.middle_s))

    def from_gauge(self, times: np.ndarray) -> np.ndarray:
        """Times (n,) s of the gauge on the recording's clock."""
        return np.asarray(self.middle_s + (times - self.offset_s - self.middle_s) / (1.0 + self.drift))


def presses_of(force: np.ndarray, touch: float) -> list[slice]:
    """Presses in order of time: runs of at least FEWEST samples with a force (n,) of `touch` N or more."""
    return [run for run in series.runs(force >= touch) if run.stop - run.start >= FEWEST]


def match_clock(gauge: Recording, other: Recording, touch: float) -> MatchedClock:
    """Match the clock of another recording, whose first value grows with the gauge's first value, the force in N.

    touch: force from which on the gel is pressed, N. Raises BadInput where the gauge shows no press, where the other
    recording shows too few of them, and where the offsets scatter or drift too much.
    """
    gauge, other = (Recording(one.name, one.times, one.values[:, :1]) for one in (gauge, other))
    presses = presses_of(gauge.values[:, 0], touch)
    if not presses:
        raise BadInput(
            f"{gauge.name}: no press of at least {FEWEST} samples with {touch:g} N or more; the largest force is"
            f" {gauge.values[:, 0].max():.3g} N: check its unit and sign (--sign -1), or lower --touch"
        )
    tried = [
        [
            (float(gauge.times[press].mean()), *one)
            for press in presses
            for one in _offset_of(gauge, other, press, rough)
        ]
        for rough in _correlated(gauge, other)
    ]
    explained = [sum(part for _, _, part in one) for one in tried]
    found = tried[int(np.argmax(explained))]
    if not found:
        raise BadInput(
            f"{other.name}: shows none of the {len(presses)} presses of {gauge.name}; are both of the same session?"
        )
    rival = sum(part >= RIVAL * max(explained) for part in explained) > 1
    if len(found) < (1.0 - MOST_MISSING) * len(presses):
        raise BadInput(
            f"{other.name}: shows only {len(found)} of the {len(presses)} presses of {gauge.name} at one clock offset: is the film"
            " slower or faster than its stated frame rate, or were commanded positions logged instead of measured ones?"
        )
    times, offsets, _ = np.array(found).T
    drift = _slope(times, offsets)
    middle = float(times.mean())
    left = offsets - drift * (times - middle)
    offset = float(np.median(left))
    scatter = 1.4826 * float(np.median(np.abs(left - offset)))
    rounding = ROUNDED * max(gauge.interval, other.interval)
    limit = MOST_SCATTER_S + rounding
    if scatter > limit:
        raise BadInput(
            f"{other.name}: the offset of its clock differs from press to press by {1e3 * scatter:.0f} ms: were commanded"
            " positions logged, ahead of the tip, or were images stamped on arrival? Log measured positions (the controller's"
            " reports), and the time at which each image was taken"
        )
    if abs(drift) > MOST_DRIFT:
        raise BadInput(
            f"{other.name}: its clock gains {1e6 * drift:.0f} ppm on that of {gauge.name}, more than any clock drifts; are its times in"
            " the unit that the header names, and, for a film, is its frame rate correct?"
        )
    error = math.hypot(scatter / math.sqrt(len(left)), rounding)
    return MatchedClock(offset, drift, middle - offset, error, np.column_stack([times, offsets]), rival, limit)


def _correlated(gauge: Recording, other: Recording) -> list[float]:
    """Offsets in s at the MOST_TRIED highest peaks of the cross-correlation of two recordings.

    Both are resampled at steps of COARSE_S, across gaps as well; no label uses these values.
    """
    from scipy.signal import correlate, correlation_lags, find_peaks

    each = []
    for one in (gauge, other):
        steps = np.arange(one.times[0], one.times[-1], COARSE_S)
        value = np.interp(steps, one.times, one.values[:, 0])
        each.append((value - value.mean()) / (value.std() or 1.0))
    alike = np.pad(correlate(*each, mode="full", method="fft"), 1, constant_values=-np.inf)
    lags = np.pad(correlation_lags(*map(len, each), mode="full"), 1) * COARSE_S
    peaks, _ = find_peaks(alike, distance=round(2 * REACH_S / COARSE_S))
    best = peaks[np.argsort(-alike[peaks])][:MOST_TRIED]
    return [float(lags[at] + gauge.times[0] - other.times[0]) for at in best]


def _offset_of(gauge: Recording, other: Recording, press: slice, rough: float) -> Iterator[tuple[float, float]]:
    """Find the offset in s at which the force of a press is a smooth function of the other recording.

    Yields it with the quality of the fit: 1 for a perfect fit, 0 where TOLERATED of the force's variance is left.
    Yields nothing where the other recording shows no press there.
    """
    from scipy.optimize import minimize_scalar

    times, force = gauge.times[press], gauge.values[press, 0]
    slow = (other.times + rough >= times[0]) & (other.times + rough <= times[-1])

    def both(shift: float) -> tuple[np.ndarray, np.ndarray]:
        """Samples of both at the times of the slower one: interpolating that one would round off its corners."""
        if other.interval > gauge.interval:
            return other.values[slow, 0], gauge.at(other.times[slow] + rough + shift)[:, 0]
        return other.at(times - rough - shift)[:, 0], force

    def left(shift: float) -> float:
        seen, felt = both(shift)
        known = np.isfinite(seen) & np.isfinite(felt)
        if known.sum() < max(FEWEST, 0.8 * len(seen)) or np.ptp(seen[known]) == 0.0:
            return math.inf
        terms = np.vander((seen[known] - seen[known].mean()) / np.ptp(seen[known]), DEGREE + 1)
        fit, *_ = np.linalg.lstsq(terms, felt[known], rcond=None)
        return float(((terms @ fit - felt[known]) ** 2).mean())

    shifts = np.arange(-REACH_S, REACH_S + 1e-9, 2 * COARSE_S)
    rest = np.array([left(shift) for shift in shifts])
    best = int(rest.argmin())
    if not 0 < best < len(shifts) - 1 or not np.isfinite(rest[best - 1 : best + 2]).all():
        return
    found = minimize_scalar(left, bounds=(shifts[best - 1], shifts[best + 1]), method="bounded")
    explained = 1.0 - float(found.fun) / (TOLERATED * float(force.var()))
    if explained > 0.0:
        yield rough + float(found.x), explained


def _slope(times: np.ndarray, offsets: np.ndarray) -> float:
    """Theil-Sen slope: the median over all pairs of points (n,), robust to outliers; 0 for one point (Sen 1968)."""
    one, two = np.triu_indices(len(times), 1)
    return float(np.median((offsets[two] - offsets[one]) / (times[two] - times[one]))) if len(one) else 0.0
