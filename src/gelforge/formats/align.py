"""Three recordings of a bench as one log: force gauge, path of the CNC and images, each on a clock of its own.

Every press bends the same force, depth and change of the image, so the clocks are matched by them: roughly by cross-correlation over
the whole recording, whose best offsets are all tried, then press by press, where force is a smooth function of depth (and of the image's change) only if
both are looked at for the same time. A line through the offsets of the presses is the clock's offset and drift; their scatter
about it, and a tenth of a sampling interval, is the error that is told. Of one press the drift is not known. What the gauge reads while nothing presses is taken off first.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gelforge.errors import BadInput

LAPSE = 2.5  # of the usual interval: beyond, samples were dropped, and nothing is interpolated
COARSE_S = 0.02  # step of the cross-correlation
REACH_S = 0.5  # around its best offset that the presses are looked at
MOST_TRIED = 6  # offsets of the cross-correlation
TOLERATED = 0.1  # of a force's variance within a press, that the other recording may leave unexplained
RIVAL = 0.9  # of what the best offset explains: another one that reaches it may be the right one as well
FEWEST = 12  # samples of a press that give its offset
ROUNDED = 0.1  # of a sampling interval: what corners between samples cost (five simulated benches: 0.07)
DEGREE = 3  # of force over depth within a press
MOST_DRIFT = 1.5e-3  # 5.4 s an hour, beyond what two clocks do
MOST_SCATTER_S = (
    0.025  # of the offsets of single presses: positions that were sent ahead scatter by tenths of a second
)
MOST_MISSING = 0.4  # of the presses, that another recording does not show
WINDOWS = 8  # of a gauge's recording, in each of which it reads one force most often
BEFORE_S, AFTER_S = 0.1, 0.3  # around a press, in which the gel is not at rest yet
PART_S = 2.0  # of a pause, over which what the gauge reads is one number
ROUNDS = 3  # in which presses and what the gauge reads between them are found by turns
NOISE = 4.0  # times the scatter at rest, below which nothing is a press


@dataclass(frozen=True)
class Recording:
    """Values (n, k) at rising times (n,) s of its own clock; name: in messages."""

    name: str
    times: np.ndarray
    values: np.ndarray

    def __post_init__(self) -> None:
        if len(self.times) < 2:
            raise BadInput(f"{self.name}: holds {len(self.times)} samples; two at least make a recording")
        back = np.flatnonzero(np.diff(self.times) <= 0)
        if len(back):
            raise BadInput(
                f"{self.name}: time does not go on after sample {back[0] + 1} ({self.times[back[0]]:.6g} s, then"
                f" {self.times[back[0] + 1]:.6g} s); sort it by time, and leave out what was written twice"
            )

    @property
    def interval(self) -> float:
        """Usual time from sample to sample, s."""
        return float(np.median(np.diff(self.times)))

    @property
    def lapses(self) -> np.ndarray:
        """Times (m,) s that are too long between two samples."""
        steps = np.diff(self.times)
        return np.asarray(steps[steps > LAPSE * self.interval])

    def at(self, times: np.ndarray) -> np.ndarray:
        """Values (m, k) at other times of its clock, linear between two samples; NaN where samples were dropped and outside."""
        after = np.clip(np.searchsorted(self.times, times), 1, len(self.times) - 1)
        known = (times >= self.times[0]) & (times <= self.times[-1])
        known &= self.times[after] - self.times[after - 1] <= LAPSE * self.interval
        found = np.stack([np.interp(times, self.times, value) for value in self.values.T], axis=1)
        found[~known] = np.nan
        return found


@dataclass(frozen=True)
class Levelled:
    """A gauge's recording without what it reads at rest. level (n, k): what was taken off. touch: N from which on the gel is pressed."""

    gauge: Recording
    level: np.ndarray
    touch: float


def without_level(gauge: Recording, touch: float) -> Levelled:
    """Take off what a gauge reads between presses, whose first value is the force that presses, N; a line from pause to pause.

    BadInput where forces are of the other sign, or where the gauge never rests.
    """
    force = gauge.values[:, 0]
    base = _usual(gauge.times, force)
    left = force - base
    low, high = np.quantile(left, [0.003, 0.997])
    if -low > max(high, touch):
        raise BadInput(
            f"{gauge.name}: its forces leave rest by {low:+.3g} N of pulling: give --sign -1 where the gauge counts pressing as positive,"
            " and let it rest between presses"
        )
    for _ in range(ROUNDS):
        rest = at_rest(gauge, left >= max(touch, 0.05 * float(np.quantile(left, 0.997))))
        pauses = [pause for pause in _runs(rest) if pause.stop - pause.start >= FEWEST]
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
    """Samples of a pause in parts of PART_S."""
    samples = np.arange(pause.start, pause.stop)
    return np.array_split(samples, max(1, int((times[samples[-1]] - times[samples[0]]) / PART_S)))


def _usual(times: np.ndarray, force: np.ndarray) -> np.ndarray:
    """A line (n,) N through what a gauge reads most often: per window the middle of the shortest interval that holds half of it."""
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
    """Which samples (n,) lie well before and well after each press."""
    rest = ~pressed
    for press in _runs(pressed):
        began, ended = gauge.times[press.start] - BEFORE_S, gauge.times[press.stop - 1] + AFTER_S
        rest &= (gauge.times < began) | (gauge.times > ended)
    return rest


def _runs(where: np.ndarray) -> list[slice]:
    """Runs of True in (n,) bool."""
    steps = np.diff(np.concatenate([[False], where, [False]]).astype(int))
    return [
        slice(a, b)
        for a, b in zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True)
    ]


@dataclass(frozen=True)
class MatchedClock:
    """How a recording's clock goes beside the gauge's: gauge time = time + offset_s + drift (time - middle_s).

    error_s: of the offset: the scatter of the presses, and ROUNDED of the slower recording's interval. presses (k, 2): middle of
    each press that it was found from on the gauge's clock, and its own offset, s. rival: whether another offset fits nearly as well.
    """

    offset_s: float
    drift: float
    middle_s: float
    error_s: float
    presses: np.ndarray
    rival: bool

    def to_gauge(self, times: np.ndarray) -> np.ndarray:
        """Times (n,) s of the recording on the gauge's clock."""
        return np.asarray(times + self.offset_s + self.drift * (times - self.middle_s))

    def from_gauge(self, times: np.ndarray) -> np.ndarray:
        """Times (n,) s of the gauge on the recording's clock."""
        return np.asarray(self.middle_s + (times - self.offset_s - self.middle_s) / (1.0 + self.drift))


def presses_of(force: np.ndarray, touch: float) -> list[slice]:
    """Samples of each press: where a force (n,) N is at least `touch`, in the order of time."""
    return [run for run in _runs(force >= touch) if run.stop - run.start >= FEWEST]


def match_clock(gauge: Recording, other: Recording, touch: float) -> MatchedClock:
    """The clock of another recording, whose first value grows with the force that is the gauge's first value, N.

    touch: N from which on something is pressed. Raises BadInput where no press is found, or none that both show.
    """
    gauge, other = (Recording(one.name, one.times, one.values[:, :1]) for one in (gauge, other))
    presses = presses_of(gauge.values[:, 0], touch)
    if not presses:
        raise BadInput(
            f"{gauge.name}: no press of {FEWEST} samples or more with {touch:g} N; the largest force is"
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
            f"{other.name}: shows none of the {len(presses)} presses of {gauge.name}; are they of one session?"
        )
    rival = sum(part >= RIVAL * max(explained) for part in explained) > 1
    if len(found) < (1.0 - MOST_MISSING) * len(presses):
        raise BadInput(
            f"{other.name}: shows {len(found)} of the {len(presses)} presses of {gauge.name} at one offset of its clock: was the film"
            " slower or faster than its frame rate says, or were positions logged when they were sent, not where the tip was?"
        )
    times, offsets, _ = np.array(found).T
    drift = _slope(times, offsets)
    middle = float(times.mean())
    left = offsets - drift * (times - middle)
    offset = float(np.median(left))
    scatter = 1.4826 * float(np.median(np.abs(left - offset)))
    if scatter > MOST_SCATTER_S + ROUNDED * max(gauge.interval, other.interval):
        raise BadInput(
            f"{other.name}: the offset of its clock differs from press to press by {1e3 * scatter:.0f} ms: were positions logged when"
            " they were sent, ahead of the tip, or were images stamped when they arrived? Log where the tip is (the controller's"
            " reports), and when each image was taken"
        )
    if abs(drift) > MOST_DRIFT:
        raise BadInput(
            f"{other.name}: its clock gains {1e6 * drift:.0f} ppm on that of {gauge.name}, which no clock does; are its times in"
            " the unit that the header names, and is a film's frame rate the true one?"
        )
    error = math.hypot(scatter / math.sqrt(len(left)), ROUNDED * max(gauge.interval, other.interval))
    return MatchedClock(offset, drift, middle - offset, error, np.column_stack([times, offsets]), rival)


def _correlated(gauge: Recording, other: Recording) -> list[float]:
    """Offsets in s at which two recordings are alike, the MOST_TRIED best.

    Both are compared at steps of COARSE_S, dropped samples filled linearly; only here, and nothing of it is written.
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
    """The offset in s at which the force of a press is a smooth function of the other recording, and how much of it that explains.

    1 for all of the force, 0 where TOLERATED of its variance is left; none where the other recording shows no press there.
    """
    from scipy.optimize import minimize_scalar

    times, force = gauge.times[press], gauge.values[press, 0]
    slow = (other.times + rough >= times[0]) & (other.times + rough <= times[-1])

    def both(shift: float) -> tuple[np.ndarray, np.ndarray]:
        """Samples of both at the times of the slower one: to interpolate it would round off its corners."""
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
    """Median slope between pairs of points (n,), which single wrong ones do not change; 0 for one point (Sen 1968)."""
    one, two = np.triu_indices(len(times), 1)
    return float(np.median((offsets[two] - offsets[one]) / (times[two] - times[one]))) if len(one) else 0.0
