"""Training, validation and test sets of presses, without leaks."""

from collections.abc import Mapping, Sequence

import numpy as np

from gelforge.flow.params.tables import DatasetTable
from gelforge.records.press import PressRecord
from gelforge.records.splits import TEST, TRAINING, UNSEEN_BOTH, UNSEEN_INDENTER, UNSEEN_SENSOR, VALIDATION


def group_presses(
    presses: Sequence[PressRecord], same_mm: float, same_deg: float, folds: Mapping[str, int]
) -> np.ndarray:
    """Group number (n,) of each sample: samples of one indenter at one position and angle share it, frames of a press too.

    folds: by how many equal turns an indenter comes onto itself, 0: by any (geometry.indenters.fold); one that is not
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
    linked = [np.column_stack([members[:-1], members[1:]]) for members in by_press.values()]
    for indenter, members in by_indenter.items():
        place = np.array([[presses[at].x0_mm, presses[at].y0_mm, presses[at].rot_deg] for at in members])
        order = folds.get(indenter, 1)
        turn = np.inf if order == 0 else 360.0 / order
        linked.append(np.array(members)[_close(place, (same_mm, same_mm, same_deg), turn)])
    return _clusters(len(presses), np.concatenate([np.empty((0, 2), int), *linked]))


def _close(places: np.ndarray, near: tuple[float, float, float], turn: float) -> np.ndarray:
    """Pairs (k, 2) of places (n, 3), x and y in mm and an angle in degrees, that are near along every axis.

    turn: degrees after which angles repeat themselves; infinity where no angle tells places apart.
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
    presses: Sequence[PressRecord], force, unseen_indenters, folds: Mapping[str, int], settings: DatasetTable
) -> tuple[np.ndarray, np.ndarray]:
    """Split name (n,) and group (n,) of samples.

    folds: of indenters, as for `group_presses`. force (n,) N decides the stratum by settings.force_edges. Unseen indenters and sensors make their
    own tests; the groups of the others, ordered by force range and indenter with ties shuffled by
    settings.seed, go one by one to the split that is furthest behind its share of samples.
    """
    group = group_presses(presses, settings.same_press_mm, settings.same_press_deg, folds)
    split = np.array(
        [_kept_apart(press, unseen_indenters, settings.unseen_sensors) for press in presses], dtype=object
    )
    known = np.flatnonzero(split == "")
    shares = {
        TRAINING: 1.0 - settings.validation - settings.test,
        VALIDATION: settings.validation,
        TEST: settings.test,
    }
    order = _order(presses, np.asarray(force), group, known, settings)
    chosen = dict(zip(order, _deal([int((group[known] == g).sum()) for g in order], shares), strict=True))
    for at in known:
        split[at] = chosen[group[at]]
    return split.astype(str), group


def _kept_apart(press, unseen_indenters, unseen_sensors) -> str:
    indenter, sensor = press.indenter in unseen_indenters, press.sensor_id in unseen_sensors
    if indenter and sensor:
        return UNSEEN_BOTH
    return UNSEEN_INDENTER if indenter else UNSEEN_SENSOR if sensor else ""


def _order(presses, force, group, known, settings) -> list[int]:
    """Groups of the known samples by force range, then indenter, ties in random order."""
    rng = np.random.default_rng(settings.seed)
    strongest: dict[int, float] = {}
    name: dict[int, str] = {}
    for at in known:
        strongest[group[at]] = max(strongest.get(group[at], 0.0), abs(force[at]))
        name[group[at]] = presses[at].indenter
    groups = sorted(strongest)
    tie = rng.permutation(len(groups))
    stratum = {g: int(np.searchsorted(settings.force_edges, strongest[g])) for g in groups}
    return [g for _, _, _, g in sorted((stratum[g], name[g], tie[k], g) for k, g in enumerate(groups))]


def _deal(sizes, shares: dict) -> list[str]:
    """Split of each group in order: the one that is furthest behind its share of what was dealt."""
    names = list(shares)
    dealt, total, chosen = dict.fromkeys(names, 0), 0, []
    for size in sizes:
        total += size
        best = max(names, key=lambda name: (shares[name] * total - dealt[name], -names.index(name)))
        dealt[best] += size
        chosen.append(best)
    for name in names[1:]:
        if shares[name] > 0 and name not in chosen and chosen.count(TRAINING) > 4:
            chosen[len(chosen) // 2 if chosen[len(chosen) // 2] == TRAINING else chosen.index(TRAINING)] = name
    return chosen
