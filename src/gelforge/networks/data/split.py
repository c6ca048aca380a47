"""Training, validation and test sets of presses, without leaks."""

from collections.abc import Hashable, Mapping, Sequence

import numpy as np

from gelforge.flow.params.tables import DatasetTable
from gelforge.records.press import PressRecord
from gelforge.records.samplefile import TEST, TRAINING, UNSEEN_BOTH, UNSEEN_INDENTER, UNSEEN_SENSOR, VALIDATION

CHANCE = 0.5  # samples by which chance may move the lag of a split


def group_presses(
    presses: Sequence[PressRecord],
    same_mm: float,
    same_deg: float,
    folds: Mapping[str, int],
    repeated: Sequence[Sequence[int]] = (),
) -> np.ndarray:
    """Group number (n,) of each sample: samples of one indenter at one position and angle share it, frames of a press too.

    repeated: numbers of samples that show one picture (records.press), which share a group, too. folds: by how many equal turns an indenter comes onto itself, 0: by any (geometry.indenters.fold); one that is not
    named, by a whole turn. Angles that differ by such a turn are one.

    Depths and shears of one touch, and the same touch on several sensors, are views of one press: were
    some trained on and others tested on, the test would be too easy. Closeness chains. Samples without
    a pose and a press_id stand alone.
    """
    by_indenter: dict[str, list[int]] = {}
    by_press: dict[str, list[int]] = {}
    for at, press in enumerate(presses):
        if press.posed:
            by_indenter.setdefault(press.indenter, []).append(at)
        if press.press_id:
            by_press.setdefault(press.press_id, []).append(at)
    linked = [np.column_stack([members[:-1], members[1:]]) for members in (*by_press.values(), *repeated)]
    for indenter, members in by_indenter.items():
        place = np.array([[presses[at].x0_mm, presses[at].y0_mm, presses[at].rot_deg] for at in members])
        order = folds.get(indenter, 1)
        turn = np.inf if order == 0 else 360.0 / order
        linked.append(np.array(members)[_close(place, (same_mm, same_mm, same_deg), turn)])
    return _clusters(len(presses), np.concatenate([np.empty((0, 2), int), *linked]))


def _close(places: np.ndarray, near: tuple[float, float, float], turn: float) -> np.ndarray:
    """Pairs (k, 2) of places (n, 3), x and y in mm and an angle in degrees, that are near along every axis.

    turn: degrees after which angles repeat themselves; infinity where no angle separates places.
    """
    from scipy.spatial import cKDTree

    scaled, period = places / near, turn / near[2]
    angle = np.zeros(len(scaled)) if np.isinf(period) else np.mod(scaled[:, 2], period)
    scaled[:, 2] = np.where(angle < period, angle, 0.0)  # a remainder may be rounded up to the whole
    boxes = (0.0, 0.0, 0.0 if np.isinf(period) else period)  # 0: without end
    return cKDTree(scaled, boxsize=boxes).query_pairs(1.0, p=np.inf, output_type="ndarray")


def _clusters(count: int, pairs: np.ndarray) -> np.ndarray:
    """Number (count,) of the cluster that each of `count` things belongs to by linked pairs, by first members."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    first = np.unique(label, return_index=True)[1][label]
    return np.unique(first, return_inverse=True)[1].reshape(-1)


def split_presses(
    presses: Sequence[PressRecord],
    force,
    unseen_indenters,
    folds: Mapping[str, int],
    settings: DatasetTable,
    repeated: Sequence[Sequence[int]] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Split name (n,) and group (n,) of samples.

    folds, repeated: as for `group_presses`. force: (n,) N. Unseen indenters and sensors make their own tests; a press that
    shows the picture of one of these goes there with all of its group. The groups of the others are dealt to training, validation and test as their first samples come. Whole presses that come
    later move none of them (but where they tie two groups together), so that a dataset may grow: what a network learnt
    from is no test of one that is fine-tuned from it.
    """
    group = group_presses(presses, settings.same_press_mm, settings.same_press_deg, folds, repeated)
    split = np.array(
        [_kept_apart(press, unseen_indenters, settings.unseen_sensors) for press in presses], dtype=object
    )
    for members in repeated:
        apart = set(split[members]) - {""}
        if apart:
            split[group == group[members[0]]] = min(apart)
    known = np.flatnonzero(split == "")
    strata = _strata(presses, np.abs(np.asarray(force)), settings.force_edges)
    fractions = {
        TRAINING: 1.0 - settings.validation - settings.test,
        VALIDATION: settings.validation,
        TEST: settings.test,
    }
    chosen = _deal(group[known], [strata[at] for at in known], fractions, settings.seed)
    split[known] = [chosen[name] for name in group[known]]
    return split.astype(str), group


def _kept_apart(press, unseen_indenters, unseen_sensors) -> str:
    indenter, sensor = press.indenter in unseen_indenters, press.sensor_id in unseen_sensors
    if indenter and sensor:
        return UNSEEN_BOTH
    return UNSEEN_INDENTER if indenter else UNSEEN_SENSOR if sensor else ""


def _strata(presses, force, edges) -> list[tuple[Hashable, ...]]:
    """What is to be shared out evenly around each sample: all, its range of force, its indenter within that.

    The force of a press is that of its strongest frame.
    """
    alone = [press.press_id or at for at, press in enumerate(presses)]
    strongest: dict[Hashable, float] = {}
    for press_id, one in zip(alone, force.tolist(), strict=True):
        strongest[press_id] = max(strongest.get(press_id, 0.0), one)
    ranges = [int(np.searchsorted(edges, strongest[press_id])) for press_id in alone]
    return [("all", at, (at, press.indenter)) for at, press in zip(ranges, presses, strict=True)]


def _deal(
    groups: np.ndarray, strata: Sequence[Sequence[Hashable]], fractions: Mapping[str, float], seed: int
) -> dict[int, str]:
    """Split by group; groups, strata: of samples in the order in which they came.

    The first groups go to one split each, so that few presses validate and test, too. Any other goes to the split that lags
    furthest behind its fraction of the samples so far, in all strata of its first one together; chance has a say in what is
    nearly even.
    """
    rng, names, fraction = np.random.default_rng(seed), list(fractions), np.array(list(fractions.values()))
    asked = np.flatnonzero(fraction > 0)
    behind: dict[Hashable, np.ndarray] = {}  # by stratum: samples that each split lacks of its fraction
    chosen: dict[int, int] = {}
    for group, around in zip(groups.tolist(), strata, strict=True):
        for stratum in around:
            behind[stratum] = behind.get(stratum, 0.0) + fraction
        if group not in chosen:
            lag = sum(behind[stratum] for stratum in around) + rng.uniform(0.0, CHANCE, len(fraction))
            first = len(chosen) < len(asked)
            chosen[group] = int(asked[len(chosen)] if first else asked[np.argmax(lag[asked])])
        for stratum in around:
            behind[stratum][chosen[group]] -= 1.0
    return {group: names[at] for group, at in chosen.items()}
