"""What the parts of a recording say of each other: a series of readings over time, beside a path or pictures.

Each function compares a measure with a limit and returns one sentence, or None where there is nothing to say. `align`,
`mcap-import`, `gelforge sensor` and the diagnostics of a log ask the same functions. The limits come from simulated
recordings (tests/support/simulated_bench.py), none of whose good ones may be accused.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gelforge.errors import BadInput

# Samples of the running median, in turn, since wild samples hide each other; and the weight of its own changes there.
WINDOWS = ((5, 1.5), (5, 1.5), (9, 3.0))
WILD_NOISE, WILD_PART = 8.0, 0.02  # a wild sample is off by so many deviations, and this fraction of the range
SLOWEST_S = 0.09  # longest interval of readings whose neighbours say anything of them
MOST_WILD = 0.01  # fraction of wild samples above which a series is refused
AT_REST = 0.2  # least fraction of equal readings that shows a dead band
# A sensor that stands still: least readings and seconds of a run of equal ones, the probability below which it is no chance, and
# the fraction of equal neighbours elsewhere from which on its resolution is too coarse to tell.
FROZEN, FROZEN_S, CHANCE, MOST_EQUAL = 12, 0.25, 1e-9, 0.3
RENEWED = (
    0.6  # of the median number of equal readings, the least one of a sensor that is renewed at a rate of its own
)
ALTERNATE, ALTERNATE_PART = 12, 0.02  # readings in a row that alternate by this fraction of their range
STILL_PART, LEVEL_PART = 0.04, 0.08  # change of pictures without contact; force beside them, of the largest ones
JITTER = 0.003  # fraction of the range by which readings at its end may differ
PLATEAU = 5  # equal largest readings in a row that noise would have told apart
FEW_EQUAL = 3  # equal largest readings of separate presses
OVERSHOOT = 0.05  # fraction of the largest reading by which path or pictures exceed it at the end of the range
SHORT = 4.0  # standard errors by which readings at the end of the range fall short
LEAST_SCATTER = 0.08  # of the logarithm of predicted over measured force, for few readings
GAP_S, MARGIN_S = 0.3, 0.2  # a longer gap ends a part of a recording; time at its ends that shows whether force moves
MOVING = 0.6  # fraction of the ends of parts at which force moves, above which the gauge is triggered
STEP_S = 0.04  # of averaged series
MOST_LAG_S, LAG_STEP_S = 1.5, 0.02  # search for the lag of force behind pictures
LAGS_LEFT = 0.1  # fraction of the deviation of forces that pictures of another time leave unexplained at least
LAGS_S, LAGS_GAIN = (
    0.06,
    1.5,
)  # largest lag of forces and pictures on one clock; deviations without and with it, above which it is certain
WIDTHS_S = (0.0, 0.16, 0.32, 0.48, 0.64, 0.96, 1.28, 1.6)  # lengths of a moving average
LEAST_WIDTH_S, LEAST_GAIN = 0.45, 1.03  # shortest average that is named; ratio of the deviations without and with it
KNOTS = 6  # of the piecewise linear force over depth
MOST_PRESSES = 6  # enough to see an average
LEAST_HEIGHT_MM, LEAST_SHIFT_MM, SURE = 0.008, 0.05, 4.0  # least scatter of heights, least shift, standard errors
LEAST_MOVE, SAME = 0.1, 0.05  # of the largest move between pictures; of the usual change, for equal pictures
FEWEST = 8  # samples of a press in a fit


@dataclass(frozen=True)
class Quality:
    """Resolution and noise of readings (n,): smallest step between two values, deviation of one reading at rest."""

    step: float
    noise: float

    @classmethod
    def of(cls, values: np.ndarray) -> "Quality":
        levels = np.unique(values)
        steps = np.diff(levels)
        step = float(np.quantile(steps, 0.05)) if len(steps) else 0.0
        # second differences, because force moves during presses; the smaller half, because most samples are at rest
        bend = np.abs(np.diff(values, 2)) / np.sqrt(6.0)
        return cls(step, 1.4826 * float(np.median(bend)) if len(bend) else 0.0)


def wild(values: np.ndarray) -> np.ndarray:
    """Readings (n,) bool that their neighbours contradict; values: (n,) in order of time."""
    from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

    found = np.zeros(len(values), bool)
    if len(values) < 2 * WINDOWS[-1][0]:
        return found
    quality = Quality.of(values)
    for window, weight in WINDOWS:
        kept = np.flatnonzero(~found)
        usual = median_filter(values[kept], window, mode="mirror")
        moves = maximum_filter1d(usual, window) - minimum_filter1d(usual, window)
        low, high = np.quantile(usual, [0.01, 0.99])
        least = WILD_NOISE * quality.noise + 3.0 * quality.step + WILD_PART * (high - low)
        found[kept] = np.abs(values[kept] - usual) > least + weight * moves
    return found


def at_end(values: np.ndarray, other: np.ndarray | None = None) -> np.ndarray:
    """Readings (n,) bool at the end of the sensor's range: many equal largest ones (n,), in order of time.

    They are recognised where noise would have told them apart, or where `other` (n,), what force grows with, is larger
    there than the other readings explain; NaN in it is not used.
    """
    quality, top = Quality.of(values), float(values.max())
    nothing = np.zeros(len(values), bool)
    same, near = values >= top - 0.5 * quality.step, values >= top - 1.5 * quality.step
    for equal, seen in ((same, quality.noise > 1.0 * quality.step), (near, quality.noise > 2.0 * quality.step)):
        if seen and _longest(equal) >= PLATEAU and equal.sum() >= 2 * PLATEAU:
            return near
    low = float(np.median(values))
    near = values >= top - max(1.5 * quality.step, JITTER * (top - low))
    plateaus = [run for run in runs(near) if run.stop - run.start >= PLATEAU]
    if other is None or not plateaus:
        return nothing
    rising = (values > low + 0.3 * (top - low)) & ~near & np.isfinite(other)
    if rising.sum() < FEWEST or np.ptp(other[rising]) == 0.0:
        return nothing
    slope = np.polyfit(other[rising], values[rising], 1)[0]
    further = [
        np.nanquantile(other[run], 0.75) - np.nanmedian(other[run][:3])
        for run in plateaus
        if np.isfinite(other[run]).all()
    ]
    least = max(3.0 * quality.step + 4.0 * quality.noise, OVERSHOOT * (top - low))
    return near if slope > 0.0 and slope * max(further, default=0.0) > least else nothing


def _longest(where: np.ndarray) -> int:
    return max((run.stop - run.start for run in runs(where)), default=0)


def runs(where: np.ndarray, times: np.ndarray | None = None) -> list[slice]:
    """Runs of True in (n,) bool; a gap of GAP_S in times (n,) s ends a run, where they are given."""
    steps = np.diff(np.concatenate([[False], where, [False]]).astype(int))
    found = [
        slice(a, b)
        for a, b in zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True)
    ]
    if times is None:
        return found
    gaps = np.flatnonzero(np.diff(times) > max(GAP_S, 2.5 * float(np.median(np.diff(times))))) + 1
    parts = []
    for run in found:
        ends = [run.start, *(at for at in gaps.tolist() if run.start < at < run.stop), run.stop]
        parts += [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    return parts


def triggered(times: np.ndarray, values: np.ndarray) -> bool:
    """Whether a gauge records during presses only: force (n,) moves at most ends of its parts, at times (n,) s."""
    interval = float(np.median(np.diff(times)))
    noise, step = Quality.of(values).noise, Quality.of(values).step
    ends = np.flatnonzero(np.diff(times) > max(GAP_S, 2.5 * interval)) + 1
    moves = []
    for part in np.split(np.arange(len(times)), ends):
        for edge in (part, part[::-1]):
            near = np.abs(times[edge] - times[edge[0]])
            first, later = (
                values[edge[near <= max(0.5 * MARGIN_S, interval)]],
                values[edge[(near > MARGIN_S) & (near <= 2 * MARGIN_S + interval)]],
            )
            if len(part) >= FEWEST and len(later):
                error = 4.0 * max(noise, 0.3 * step) * np.sqrt(1.0 / len(first) + 1.0 / len(later))
                moves.append(float(later.mean() - first.mean()) > error + 2.0 * step)
    return len(moves) >= 2 and float(np.mean(moves)) > MOVING


@dataclass(frozen=True)
class Lag:
    """What best explains force by another series: force lags by `seconds` and is averaged over `width` seconds.

    gain: standard deviation left at no lag (or no averaging) over that at the best. left: that at the best; of the
    lag behind pictures, at none, as a fraction of that of force.
    """

    seconds: float
    width: float
    gain: float
    left: float

    @property
    def of_clocks(self) -> bool:
        """Whether it shows that forces and pictures have different clocks."""
        inside = abs(self.seconds) < MOST_LAG_S - 2 * LAG_STEP_S  # at its end the search found nothing
        return inside and abs(self.seconds) > LAGS_S and self.gain > LAGS_GAIN and self.left > LAGS_LEFT


def averaging(
    force: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray], spans: list[tuple[float, float]]
) -> Lag | None:
    """How long a gauge averages, from force (times, N) and what it follows (times, values) on one clock.

    spans: beginning and end of presses. An average rounds the corners and lowers the peaks of force against path; where
    its mean delay went into the match of the clocks, the lag is shifted by it.
    """
    parts = []
    low, high = np.inf, -np.inf
    for begin, end in spans[:MOST_PRESSES]:
        at = np.arange(begin - 1.0, end + 1.0, STEP_S)
        near = (at >= other[0][0] - 2 * STEP_S) & (at <= other[0][-1])
        if near.sum() < 4 * FEWEST:
            continue
        parts.append(at[near])
        inside = (other[0] >= begin) & (other[0] <= end)
        if inside.any():
            low, high = min(low, other[1][inside].min()), max(high, other[1][inside].max())
    if not parts or not low < high:
        return None
    knots = np.linspace(low, high, KNOTS)
    bases = []
    for at in parts:
        margin = round(3.0 / STEP_S)
        wide = np.concatenate(
            [at[0] - STEP_S * np.arange(margin, 0, -1), at, at[-1] + STEP_S * np.arange(1, margin + 1)]
        )
        value = np.interp(wide, *other)
        over = np.maximum(value[:, None] - knots[None, :-1], 0.0)
        bases.append(over)
    felt = [np.interp(at, *force) for at in parts]
    target = np.concatenate(felt)
    best, plain = None, np.inf
    for width in WIDTHS_S:
        count = max(1, round(width / STEP_S))
        smoothed = []
        for over in bases:
            total = np.concatenate([np.zeros((1, over.shape[1])), np.cumsum(over, axis=0)])
            smoothed.append((total[count:] - total[:-count]) / count)  # ends at index i + count - 1
        for lag in np.arange(-0.48, 0.481, 0.12):  # of the average's middle behind the other series
            rows = []
            for at, over in zip(parts, smoothed, strict=True):
                first = margin - (count - 1) // 2 - round(lag / STEP_S)
                rows.append(over[first : first + len(at)])
            terms = np.column_stack([np.concatenate(rows), np.ones(len(target))])
            square = terms.T @ terms  # its equations, because a decomposition of each takes ten times as long
            solved = np.linalg.lstsq(square, terms.T @ target, rcond=1e-10)[0]
            left = float(np.std(target - terms @ solved))
            if width == 0.0:
                plain = min(plain, left)
            if best is None or left < best.left:
                best = Lag(float(lag), width, 1.0, left)
    assert best is not None
    return Lag(best.seconds, best.width, plain / max(best.left, 1e-9), best.left)


def onsets(
    force: tuple[np.ndarray, np.ndarray],
    height: tuple[np.ndarray, np.ndarray],
    spans: list[tuple[float, float]],
    touch: float,
) -> np.ndarray:
    """Heights (k,) mm of the tip at which force passes `touch` N at the beginning of each press; NaN where unknown.

    force, height: times (n,) s on one clock, and values (n,). spans: beginning and end of each press, s.
    """
    found, interval = np.full(len(spans), np.nan), float(np.median(np.diff(force[0])))
    for k, (begin, end) in enumerate(spans):
        inside = (force[0] >= begin - 0.5) & (force[0] <= end)
        times, felt = force[0][inside], force[1][inside]
        if len(felt) < FEWEST:
            continue
        top = int(np.argmax(felt >= 0.8 * felt.max()))
        at, felt = np.interp(times[: top + 1], *height), felt[: top + 1]
        above, below = np.flatnonzero(felt >= touch), np.flatnonzero(felt < touch)
        near = (felt >= 0.5 * touch) & (felt <= 2.0 * touch)
        near[: int(np.flatnonzero(felt < 0.5 * touch)[-1:].sum())] = False  # noise before the contact
        if near.sum() >= 4 and np.ptp(felt[near]) > 0.5 * touch:
            slope, start = np.polyfit(felt[near], at[near], 1)
            found[k] = start + slope * touch
        elif len(above) and len(below) and below[-1] + 1 < len(felt):
            last = below[-1]
            if times[last + 1] - times[last] > 2.5 * interval:
                continue  # samples were dropped where force began
            part = (touch - felt[last]) / (felt[last + 1] - felt[last])
            found[k] = at[last] + part * (at[last + 1] - at[last])
    return found


def shifted_heights(heights: np.ndarray) -> tuple[float, np.ndarray]:
    """The largest shift of heights (k,) mm between earlier and later presses, and the numbers of the presses beyond it.

    A shift is a step between two presses, or a steady drift; 0 and no presses where there is none beyond the scatter.
    """
    known = np.flatnonzero(np.isfinite(heights))
    values, place = heights[known], np.linspace(0.0, 1.0, len(known))
    best, where = 0.0, np.zeros(0, int)
    if len(known) < 3:
        return best, where
    shapes = [(place > cut) * 1.0 for cut in 0.5 * (place[1:] + place[:-1])] + [place]
    left = []
    for shape in shapes:
        terms = np.column_stack([shape, np.ones(len(values))])
        (change, start), *_ = np.linalg.lstsq(terms, values, rcond=None)
        scatter = max(1.4826 * float(np.median(np.abs(terms @ [change, start] - values))), LEAST_HEIGHT_MM)
        error = scatter / np.sqrt(len(values)) / np.std(shape)
        left.append((float(np.abs(terms @ [change, start] - values).sum()), float(change), float(error), shape))
    _, change, error, shape = min(left, key=lambda one: one[0])
    if abs(change) <= max(SURE * error, LEAST_SHIFT_MM):
        return best, where
    later = shape > 0.5
    return change, known[later if 2 * later.sum() <= len(later) else ~later]


def lag_of_pictures(
    force: tuple[np.ndarray, np.ndarray], change: tuple[np.ndarray, np.ndarray], spans: list[tuple[float, float]]
) -> Lag | None:
    """The lag of force (times, N) behind the change of pictures (times, levels) that explains each press best.

    In each press, force is a smooth function of the change if both are of one moment. None where too few pictures show
    a press. spans: beginning and end of presses on force's clock, s.
    """
    lags = np.arange(-MOST_LAG_S, MOST_LAG_S + 1e-9, LAG_STEP_S)
    left, total, used = np.zeros(len(lags)), 0.0, 0
    for begin, end in spans:
        inside = (change[0] >= begin - MOST_LAG_S) & (change[0] <= end + MOST_LAG_S)
        if inside.sum() < FEWEST or np.ptp(change[1][inside]) == 0.0:
            continue
        at, seen = change[0][inside], change[1][inside]
        terms = np.vander((seen - seen.mean()) / np.ptp(seen), 4)
        felt = np.interp(at[:, None] + lags, *force)
        solved, *_ = np.linalg.lstsq(terms, felt, rcond=None)
        left += ((terms @ solved - felt) ** 2).sum(axis=0)
        total, used = total + float(((felt[:, len(lags) // 2] - felt[:, len(lags) // 2].mean()) ** 2).sum()), used + 1
    if not used or not total:
        return None
    best, plain = int(left.argmin()), float(left[len(lags) // 2])
    return Lag(float(lags[best]), 0.0, float(np.sqrt(plain / max(left[best], 1e-12))), float(np.sqrt(plain / total)))


def equal_largest(measured: np.ndarray, predicted: np.ndarray) -> str | None:
    """Equal largest readings (n,) N of separate presses whose predictions (n,) N are larger than at the others."""
    quality, used = Quality.of(np.sort(measured)), (measured > 0.0) & (predicted > 0.0)
    if used.sum() < 2 * FEW_EQUAL:
        return None
    ratio, top = np.log(predicted[used] / measured[used]), float(measured[used].max())
    equal = measured[used] >= top - min(1e-6 * top + 0.5 * quality.step, 0.01 * top)
    if equal.sum() < FEW_EQUAL or (~equal).sum() < FEW_EQUAL:
        return None
    usual = float(np.median(ratio[~equal]))
    scatter = max(1.4826 * float(np.median(np.abs(ratio[~equal] - usual))), LEAST_SCATTER)
    error = scatter * np.sqrt(1.0 / equal.sum() + 1.0 / (~equal).sum())
    short = float(np.median(ratio[equal])) - usual
    if short <= max(SHORT * error, 0.1):
        return None
    return (
        f"{equal.sum()} readings are {top:.3g} N, the largest, and about {np.exp(short):.2g} times that is expected there: the sensor is"
        " at the end of its range; leave these readings out, or use a larger sensor."
    )


def confirmed(name: str, times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Which readings (n,) of a series (n, k) can be believed, and notes on the others; BadInput where too few can.

    Not believed are readings that their neighbours contradict, and those of a sensor that repeats one reading although it
    has noise. times: (n,) s. Of a series slower than SLOWEST_S a single reading may be a whole press, so all are kept.
    """
    if len(times) < 2 or float(np.median(np.diff(times))) > SLOWEST_S:
        return np.ones(len(values), bool), []
    if len(values) >= FROZEN and (values == values[0]).all():
        raise BadInput(
            f"{name}: all {len(values)} readings are {values[0].max():.4g} N, to the last digit: a sensor has noise; is it connected and read?"
        )
    if alternating(values):
        raise BadInput(
            f"{name}: readings alternate between two levels during presses, as if two channels were in one column: record each"
            " channel in a column of its own"
        )
    moving = np.ptp(values, axis=0) > 0.0
    if any((one == other).all() for one, other in combinations(values.T[moving], 2)):
        raise BadInput(
            f"{name}: two channels hold the same numbers to the last digit: give each axis its own channel"
        )
    held = frozen(times, values)
    notes = [
        f"{name}: a channel never changes: where the sensor has no such axis, leave it out, because its number would be taken for a reading"
    ] * (not moving.all())
    notes += [
        f"{name}: repeats one reading from {times[run.start] - times[0]:.2f} to {times[run.stop - 1] - times[0]:.2f} s after its start,"
        f" {'to its end, ' if run.stop == len(times) else ''}{run.stop - run.start} times: it stands still there, and these readings"
        " are left out"
        for run in runs(held)
    ]
    if dead_band(values[~held, -1]):
        notes.append(
            f"{name}: reads exactly one value without contact and has noise in presses: it shows nothing below its zero, or it has a dead band;"
            " then forces are too small by as much as the band hides: check it with a known weight"
        )
    off = np.any([wild(each) for each in values.T], axis=0) & ~held
    if not off.any():
        return ~held, notes
    first = int(np.flatnonzero(off)[0])
    said = f"{name}: {off.sum()} of {len(off)} readings are contradicted by their neighbours, the first is reading {first + 1}"
    if off.mean() > MOST_WILD and off.sum() > 2:
        raise BadInput(
            f"{said}: so many single wild readings come from a loose cable or a disturbed line; mend it and record again"
        )
    return ~(off | held), [*notes, f"{said}; they are left out"]


def renewed(values: np.ndarray) -> np.ndarray:
    """Readings (n,) bool to keep of a series (n, k) whose driver repeats each one until its slower sensor renews it.

    All, unless hardly ever two changes follow each other: readings of coarse resolution change at random. A run longer
    than the sensor's interval is kept at that interval, so that a sensor that stands still is seen.
    """
    new = np.concatenate([[True], (np.diff(values, axis=0) != 0.0).any(axis=1)])
    gaps = np.diff(np.flatnonzero(new))
    if len(gaps) < FEWEST or np.quantile(gaps, 0.05) < max(2.0, RENEWED * float(np.median(gaps))):
        return np.ones(len(values), bool)
    place = np.arange(len(values))
    age = place - np.maximum.accumulate(np.where(new, place, 0))
    return np.asarray(age % int(np.quantile(gaps, 0.9)) == 0)


def frozen(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Readings (n,) bool of runs in which all channels (n, k) repeat one value for FROZEN_S s or more, at times (n,) s.

    Only where that is no chance: readings equal to the one before are so rare elsewhere that a run as long has a probability
    below CHANCE. A sensor of coarse resolution repeats readings at rest, and is not accused.
    """
    equal = np.concatenate([[False], (np.diff(values, axis=0) == 0.0).all(axis=1)])
    found = np.zeros(len(values), bool)
    for run in runs(equal):
        count = run.stop - run.start
        if count < FROZEN or times[run.stop - 1] - times[run.start - 1] < FROZEN_S:
            continue
        elsewhere = max((equal.sum() - count) / max(len(equal) - count, 1), 1e-3)
        found[run] = elsewhere < MOST_EQUAL and count * np.log(elsewhere) < np.log(CHANCE)
    return found


def dead_band(values: np.ndarray) -> bool:
    """Whether readings (n,) are all equal at rest, though they have noise elsewhere that is larger than their resolution."""
    levels, counts = np.unique(values, return_counts=True)
    rest = values == levels[counts.argmax()]
    bend = np.diff(values, 2)
    loaded = ~(rest[:-2] | rest[1:-1] | rest[2:])
    if counts.max() < AT_REST * len(values) or loaded.sum() < 4 * FEWEST:
        return False
    noise = 1.4826 * float(np.median(np.abs(bend[loaded]))) / np.sqrt(6.0)
    turns = bend[1:] * bend[:-1] < 0.0
    # bends of noise change their sign in two of three samples, those of a smooth force hardly ever
    return (
        noise > 3.0 * float(np.quantile(np.diff(levels), 0.05))
        and float(turns[loaded[1:] & loaded[:-1]].mean()) > 0.55
    )


def alternating(values: np.ndarray) -> bool:
    """Whether readings (n, k) alternate between two levels for ALTERNATE samples or more."""
    for each in values.T:
        quality, bend = Quality.of(each), each[1:-1] - (each[:-2] + each[2:]) / 2.0
        large = np.abs(bend) > 6.0 * quality.noise + 3.0 * quality.step + ALTERNATE_PART * np.ptp(each)
        if _longest((bend[1:] * bend[:-1] < 0.0) & large[1:] & large[:-1]) >= ALTERNATE:
            return True
    return False


def end_told(name: str, top: float, count: int) -> str:
    """A note on readings at the end of a sensor's range; top: N."""
    return f"{name}: {count} readings are {top:.4g} N, the largest, while the press goes on: the sensor is at the end of its range"


def repeats(small: np.ndarray, states: np.ndarray, pressed: np.ndarray) -> np.ndarray:
    """Pictures (n,) bool that show the one before them again although what they show has moved.

    small: (n, …) pictures, reduced in size. states: (n, k) of what they show, such as the tip's position in mm.
    pressed: (n,) bool, whether something is in contact.
    """
    again = np.zeros(len(small), bool)
    flat = small.reshape(len(small), -1)
    both = pressed[1:] & pressed[:-1] & np.isfinite(states[1:]).all(axis=1) & np.isfinite(states[:-1]).all(axis=1)
    if both.sum() < FEWEST:
        return again
    change = np.array(
        [
            np.abs(after.astype(np.float32) - before).mean() if here else np.nan
            for before, after, here in zip(flat[:-1], flat[1:], both, strict=True)
        ]
    )
    step = np.linalg.norm(np.diff(states, axis=0), axis=1)
    least = LEAST_MOVE * float(np.quantile(step[both], 0.9))
    moved = both & (step > least) & (change > 0.0)
    if moved.sum() < FEWEST:
        return again
    equal = both & (change <= SAME * float(np.median(change[moved])))
    first = 0  # equal pictures show the moment of the first of them
    for k in range(1, len(small)):
        if not equal[k - 1]:
            first = k
        again[k] = first < k and np.linalg.norm(states[k] - states[first]) > least
    return again


def level_without_contact(force: np.ndarray, change: np.ndarray, touch: float) -> str | None:
    """Force (n,) N beside pictures that show no contact; change (n,): how much the pictures differ from those at rest."""
    known = np.isfinite(change) & np.isfinite(force)
    if known.sum() < 4 * FEWEST:
        return None
    force, change = force[known], change[known]
    low, high = np.quantile(change, [0.02, 0.98])
    still = change <= low + STILL_PART * (high - low)
    largest = float(np.abs(force).max())
    level = float(np.quantile(np.abs(force[still]), 0.9))
    if still.sum() < FEWEST or level <= max(3.0 * touch, LEVEL_PART * largest):
        return None
    return f"reads up to {level:.2g} N beside pictures that show no contact: it drifts, or was not tared; tare it before each press, or subtract what it reads"
