"""Recordings of benches, simulated from drawn presses: good ones, and ones with a single fault.

Force is a power of depth with relaxation; the gauge has noise, a resolution, a level at rest and a drift; each recording
has its own clock and rate. All draws come from the generator handed in.
"""

from dataclasses import dataclass, field

import numpy as np

DT = 0.002  # s, of the simulation


@dataclass
class Bench:
    """A simulated session: true times (m,), depth (m,) and height (m,) mm, force (m,) N, and presses (k, 2) s."""

    times: np.ndarray
    height: np.ndarray
    force: np.ndarray
    presses: np.ndarray
    places: np.ndarray  # (k, 2) mm, x and y of each press
    at: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (m, 2) x and y over time

    @property
    def depth(self) -> np.ndarray:
        return np.maximum(-self.height, 0.0)


def draw_bench(rng, presses=None, fine=False) -> Bench:
    """A session of 3 to 12 presses. fine: of a stiff contact, as in a slow, exact bench."""
    count = presses or int(rng.integers(3, 13))
    down, up = rng.uniform(0.3, 2.0), rng.uniform(0.4, 3.0)
    hold, over = rng.uniform(0.0, 2.0), rng.uniform(0.3, 1.5)
    stiffness, power = rng.uniform(1.5, 9.0), rng.uniform(1.0, 1.8)
    knots, heights, spans = [0.0, rng.uniform(1.5, 4.0)], [over, over], []
    for _ in range(count):
        depth = rng.uniform(0.35, 1.6)
        start = knots[-1]
        knots += [start + (over + depth) / down, start + (over + depth) / down + hold + 1e-3]
        knots += [knots[-1] + (over + depth) / up, knots[-1] + (over + depth) / up + rng.uniform(1.0, 5.0)]
        heights += [-depth, -depth, over, over]
        spans.append((start + over / down, knots[-2] - over / up))
    times = np.arange(0.0, knots[-1], DT)
    height = np.interp(times, knots, heights)
    local = 1.0 + rng.normal(0.0, 0.06, count)
    elastic = np.maximum(-height, 0.0) ** power * stiffness
    for (a, b), factor in zip(spans, local, strict=True):
        elastic[(times >= a) & (times <= b)] *= factor
    part, tau = rng.uniform(0.0, 0.08), rng.uniform(0.3, 3.0)
    force = elastic - part * low_passed(elastic, tau)
    places = rng.uniform(-3.0, 3.0, (count, 2))
    at = np.zeros((len(times), 2))
    for k, (a, _b) in enumerate(spans):
        at[(times >= (0.0 if k == 0 else 0.5 * (spans[k - 1][1] + a))) & (times <= knots[-1])] = places[k]
    return Bench(times, height, force, np.array(spans), places, at)


def low_passed(values, tau):
    from scipy.signal import lfilter

    share = DT / tau
    return lfilter([share], [1.0, share - 1.0], values)


def averaged(bench, seconds):
    """The force as a gauge shows it that averages over so many seconds before each reading."""
    total = np.concatenate([[0.0], np.cumsum(bench.force)])
    back = np.maximum(np.arange(len(bench.force)) + 1 - round(seconds / DT), 0)
    now = np.arange(len(bench.force)) + 1
    return (total[now] - total[back]) / (now - back)


@dataclass
class Gauge:
    """Readings of a gauge: times (n,) s of its clock and compression (n,) N; true: without any fault (n,)."""

    times: np.ndarray
    force: np.ndarray
    true: np.ndarray


FAULTS = ("clipped", "triggered", "averaged", "wild")


def draw_gauge(rng, bench, fault="") -> Gauge:
    """A gauge's recording, with a fault of FAULTS if one is named."""
    rate = float(np.exp(rng.uniform(np.log(12), np.log(200))))
    at = np.arange(rng.uniform(0, 1 / rate), bench.times[-1], 1 / rate)
    at = at + rng.uniform(-0.2, 0.2, len(at)) / rate
    noise, step = np.exp(rng.uniform(np.log(0.004), np.log(0.05))), rng.choice([1e-4, 0.001, 0.01, 0.02, 0.05, 0.1])
    level = rng.uniform(-2.0, 2.0) + rng.uniform(-0.3, 0.3) * at / bench.times[-1]
    if rng.random() < 0.3:
        level *= 0.0
    source = averaged(bench, rng.uniform(0.5, 1.5)) if fault == "averaged" else bench.force
    true = np.interp(at, bench.times, bench.force)
    read = np.interp(at, bench.times, source) + level + rng.normal(0, noise, len(at))
    if fault == "clipped":
        most = (bench.force.max() + level.mean()) * rng.uniform(0.3, 0.85)
        if rng.random() < 0.3:
            most -= step * (rng.random(len(at)) < 0.3)  # one count of jitter at the end
        read = np.minimum(read, most)
    if fault == "wild":
        share = np.exp(rng.uniform(np.log(0.001), np.log(0.03)))
        struck = rng.random(len(at)) < max(share, 3 / len(at))
        size = bench.force.max() * rng.uniform(1.5, 5.0)
        read[struck] = (
            size
            if rng.random() < 0.5
            else rng.choice([-1, 1], struck.sum()) * rng.uniform(0.4, 1.5, struck.sum()) * size
        )
    read = np.round(read / step) * step
    keep = np.ones(len(at), bool)
    if fault == "triggered":
        threshold = rng.uniform(0.05, 0.25) * bench.force.max()
        keep = true + rng.normal(0, 0.01, len(at)) > threshold
    elif rng.random() < 0.4:
        for start in rng.uniform(0, bench.times[-1], round(0.04 * bench.times[-1])):
            keep &= (at < start) | (at > start + 0.4)
    return Gauge(at[keep], read[keep], true[keep])


@dataclass
class Other:
    """A path's depth or the change of images: times (n,) s of its own clock, values (n,), true times (n,) s."""

    times: np.ndarray
    values: np.ndarray
    true: np.ndarray


def draw_path(rng, bench, shift="") -> tuple[Other, np.ndarray]:
    """The path's depth below the apex as logged, mm, and its error (n,) mm; shift: "", "step" or "drift"."""
    rate = float(np.exp(rng.uniform(np.log(15), np.log(120))))
    at = np.arange(rng.uniform(0, 1 / rate), bench.times[-1], 1 / rate) + rng.uniform(-5.0, 5.0) * 0
    error = np.zeros(len(at))
    if shift == "step":
        last = bench.presses[-1, 0]
        first = bench.presses[0, 1]
        error = (at > rng.uniform(first, last)) * rng.uniform(0.05, 0.4) * rng.choice([-1, 1])
    elif shift == "drift":
        error = at * rng.choice([-1, 1]) * rng.uniform(0.05, 0.4) / bench.times[-1] * 1.3
    z = np.round(np.interp(at, bench.times, bench.height) + error + rng.normal(0, 0.001, len(at)), 3)
    gains = 1.0 + rng.uniform(-60e-6, 60e-6)
    return Other((at - rng.uniform(-3, 3)) * gains, -z, at), error


def draw_change(rng, bench, late=0.0, rate=None) -> Other:
    """How much images differ from the no-contact image, in levels; late: by how much stamps are later than images, s."""
    rate = rate or rng.uniform(12, 30)
    at = np.arange(rng.uniform(0, 1 / rate), bench.times[-1], 1 / rate)
    size, power = rng.uniform(4.0, 25.0), rng.uniform(0.5, 1.2)
    depth = np.interp(at, bench.times, bench.depth)
    change = size * (depth + 0.0) ** power + np.abs(rng.normal(0.4, rng.uniform(0.02, 0.2), len(at)))
    return Other(at + late, change, at)


@dataclass
class Outcome:
    """What `align` makes of a simulated session: a refusal or notes, and the largest errors of its rows, N and mm."""

    refusal: str
    notes: list
    force_n: float
    depth_mm: float
    rows: int

    @property
    def doubts(self) -> list:
        """Notes on faults of the recordings."""
        marks = ("contradicted by", "end of its range", "height at which force begins", "repeat the one before")
        return [note for note in self.notes if any(mark in note for mark in marks)]


def aligned(rng, fault="", shift="", film="", presses=None) -> Outcome:
    """Simulate a session with a fault of the gauge, the path or the film ("repeats", "stands still"), and align it."""
    from pathlib import Path
    from types import SimpleNamespace

    from gelforge.errors import BadInput
    from gelforge.formats.align import Recording
    from gelforge.formats.benchfiles import Images
    from gelforge.formats.benchlog import Setup, align

    bench = draw_bench(rng, presses)
    gauge, (path, _), change = (
        draw_gauge(rng, bench, fault),
        draw_path(rng, bench, shift),
        draw_change(rng, bench),
    )
    true, shown = change.true, np.arange(len(change.true))
    small = (100.0 + change.values[:, None, None, None] + rng.normal(0.0, 0.3, (len(true), 6, 8, 3))).astype(
        np.float32
    )
    if film == "repeats":
        shown[1:][rng.random(len(shown) - 1) < 0.2] -= 1
    elif film:
        begin = rng.choice(bench.presses[:, 0]) + rng.uniform(0.0, 0.5)
        frozen = np.flatnonzero((true > begin) & (true < begin + rng.uniform(0.5, 2.0)))
        shown[frozen] = frozen[0]
    small = small[shown]
    images = Images(Path("film"), [str(k) for k in range(len(true))], change.times, small)
    columns = [
        path.values,
        *(np.interp(path.true, bench.times, bench.at[:, k]) for k in (0, 1)),
        -path.values,
        0.0 * path.values,
    ]
    try:
        found = align(
            Recording("gauge", gauge.times, np.column_stack([gauge.force, -gauge.force])), ("fz_n",),
            Recording("path", path.times, np.column_stack(columns)), images,
            Setup(SimpleNamespace(name="sensor", gel="gel"), "ball", "gel"), 0.1, 1,
        )  # fmt: skip
    except BadInput as refusal:
        return Outcome(str(refusal), [], 0.0, 0.0, 0)
    moments = np.array([true[shown[at]] for at in found.rows])
    force = np.interp(moments, bench.times, bench.force) + np.array([row.fz_n for row in found.rows.values()])
    depth = np.interp(moments, bench.times, bench.height) - np.array([row.dz_mm for row in found.rows.values()])
    return Outcome("", found.notes, float(np.abs(force).max()), float(np.abs(depth).max()), len(found.rows))
