"""Training, validation and test sets of presses, without leaks."""

import numpy as np

UNSEEN_INDENTER, UNSEEN_SENSOR, UNSEEN_BOTH = "test_unseen_indenter", "test_unseen_sensor", "test_unseen_both"
POSE = ("x0_mm", "y0_mm", "rot_deg")


def group_presses(rows: list[dict], same_mm: float, same_deg: float) -> np.ndarray:
    """Group number (n,) of each sample: samples of one indenter at one position and angle share it.

    Depths and shears of one touch, and the same touch on several sensors, are views of one press: were
    some trained on and others tested on, the test would be too easy. Closeness chains. Samples without
    a pose stand alone.
    """
    group = np.arange(len(rows))
    by_indenter = {}
    for at, row in enumerate(rows):
        if all(row.get(name) not in ("", None) for name in POSE):
            by_indenter.setdefault(row["indenter"], []).append(at)
    for members in by_indenter.values():
        place = np.array([[float(rows[at][name]) for name in POSE] for at in members])
        group[members] = np.array(members)[_clusters(place / (same_mm, same_mm, same_deg))]
    return np.unique(group, return_inverse=True)[1].reshape(-1)


def _clusters(points: np.ndarray) -> np.ndarray:
    """First member of each point's cluster, (n,); points within 1 along every axis are linked."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(1.0, p=np.inf, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    label = connected_components(graph, directed=False)[1]
    return np.unique(label, return_index=True)[1][label]


def split_presses(rows: list[dict], force, unseen_indenters, settings: dict) -> tuple[np.ndarray, np.ndarray]:
    """Split name (n,) and group (n,) of samples with `indenter`, `sensor_id` and a pose.

    force (n,) N decides the stratum by settings["force_edges"]. Unseen indenters and sensors make their
    own tests; the groups of the others, ordered by force range and indenter with ties shuffled by
    settings["seed"], go one by one to the split that is furthest behind its share of samples.
    """
    group = group_presses(rows, settings["same_press_mm"], settings["same_press_deg"])
    split = np.array([_kept_apart(row, unseen_indenters, settings["unseen_sensors"]) for row in rows], dtype=object)
    known = np.flatnonzero(split == "")
    shares = {
        "train": 1.0 - settings["validation"] - settings["test"],
        "val": settings["validation"],
        "test": settings["test"],
    }
    order = _order(rows, np.asarray(force), group, known, settings)
    chosen = dict(zip(order, _deal([int((group[known] == g).sum()) for g in order], shares), strict=True))
    for at in known:
        split[at] = chosen[group[at]]
    return split.astype(str), group


def _kept_apart(row, unseen_indenters, unseen_sensors) -> str:
    indenter, sensor = row["indenter"] in unseen_indenters, row["sensor_id"] in unseen_sensors
    if indenter and sensor:
        return UNSEEN_BOTH
    return UNSEEN_INDENTER if indenter else UNSEEN_SENSOR if sensor else ""


def _order(rows, force, group, known, settings) -> list[int]:
    """Groups of the known samples by force range, then indenter, ties in random order."""
    rng = np.random.default_rng(settings["seed"])
    strongest, name = {}, {}
    for at in known:
        strongest[group[at]] = max(strongest.get(group[at], 0.0), abs(force[at]))
        name[group[at]] = rows[at]["indenter"]
    groups = sorted(strongest)
    tie = rng.permutation(len(groups))
    stratum = {g: int(np.searchsorted(settings["force_edges"], strongest[g])) for g in groups}
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
        if shares[name] > 0 and name not in chosen and chosen.count("train") > 4:
            chosen[len(chosen) // 2 if chosen[len(chosen) // 2] == "train" else chosen.index("train")] = name
    return chosen
