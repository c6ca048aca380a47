"""Training, validation and test sets of presses, without leaks."""

import hashlib
from collections.abc import Mapping, Sequence

import numpy as np

from gelforge.flow.tables import DatasetTable
from gelforge.records.press import PressRecord
from gelforge.records.samplefile import TEST, TRAINING, UNSEEN_BOTH, UNSEEN_INDENTER, UNSEEN_SENSOR, VALIDATION


def group_presses(
    presses: Sequence[PressRecord],
    same_mm: float,
    same_deg: float,
    folds: Mapping[str, int],
    repeated: Sequence[Sequence[int]] = (),
) -> np.ndarray:
    """Group number (n,) of each sample, shared by frames of a press and by presses of one indenter at one pose.

    folds: order of rotational symmetry by indenter, 0: any angle (geometry.indenters.fold), 1 if not named; angles
    that are equal by symmetry count as one. repeated: lists of samples that show the same image (records.press),
    which share a group, too.

    Depths and shears of one touch, and one touch on several sensors, are views of the same press: a test on some of
    them would be too easy after training on others. Closeness is transitive. A sample without pose and press_id is a
    group of its own.
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
    """Pairs (k, 2) of places (n, 3), x, y in mm and an angle in degrees, that differ by at most `near` on every axis.

    turn: period of the angle in degrees; infinity if the angle does not matter.
    """
    from scipy.spatial import cKDTree

    scaled, period = places / near, turn / near[2]
    angle = np.zeros(len(scaled)) if np.isinf(period) else np.mod(scaled[:, 2], period)
    scaled[:, 2] = np.where(angle < period, angle, 0.0)  # a remainder may be rounded up to the whole
    boxes = (0.0, 0.0, 0.0 if np.isinf(period) else period)  # 0: without end
    return cKDTree(scaled, boxsize=boxes).query_pairs(1.0, p=np.inf, output_type="ndarray")


def _clusters(count: int, pairs: np.ndarray) -> np.ndarray:
    """Cluster number (count,) of each of `count` items by linked pairs (k, 2), in the order of first members."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    first = np.unique(label, return_index=True)[1][label]
    return np.unique(first, return_inverse=True)[1].reshape(-1)


def split_presses(
    presses: Sequence[PressRecord],
    unseen_indenters,
    folds: Mapping[str, int],
    settings: DatasetTable,
    repeated: Sequence[Sequence[int]] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Split name (n,) and group (n,) of samples.

    folds, repeated: as for `group_presses`. Unseen indenters and sensors form test splits of their own; a press that
    shows the image of one of these joins it there with its whole group. Any other group goes to training, validation
    or test by a hash of its first sample's name. Presses added later therefore move no group (unless they join two),
    so a network that is fine-tuned later is not tested on presses that its start was trained on. The first groups go
    to one split each, so that a small dataset has validation and test presses, too.
    """
    group = group_presses(presses, settings.same_press_mm, settings.same_press_deg, folds, repeated)
    split = np.array(
        [_kept_apart(press, unseen_indenters, settings.unseen_sensors) for press in presses], dtype=object
    )
    for members in repeated:
        apart = set(split[members]) - {""}
        if apart:
            split[group == group[members[0]]] = min(apart)
    fractions = {
        TRAINING: 1.0 - settings.validation - settings.test,
        VALIDATION: settings.validation,
        TEST: settings.test,
    }
    names = [name for name, fraction in fractions.items() if fraction > 0]
    bounds = np.cumsum([fractions[name] for name in names])
    chosen: dict[int, str] = {}
    for at in np.flatnonzero(split == "").tolist():
        if group[at] not in chosen:
            by_hash = int(np.searchsorted(bounds, drawn(presses[at].sample_id, settings.seed), side="right"))
            chosen[group[at]] = names[min(len(chosen) if len(chosen) < len(names) else by_hash, len(names) - 1)]
        split[at] = chosen[group[at]]
    return split.astype(str), group


def drawn(name: str, seed: int) -> float:
    """Number from 0 to below 1 by hash of a name and a seed."""
    digest = hashlib.blake2b(f"{seed} {name}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "big") / 2**64


def _kept_apart(press, unseen_indenters, unseen_sensors) -> str:
    indenter, sensor = press.indenter in unseen_indenters, press.sensor_id in unseen_sensors
    if indenter and sensor:
        return UNSEEN_BOTH
    return UNSEEN_INDENTER if indenter else UNSEEN_SENSOR if sensor else ""
