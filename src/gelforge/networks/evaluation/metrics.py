"""Errors of force predictions: tables as the paper's, confidence intervals, what a control would reach, single contacts."""

import numpy as np

from gelforge.records.axes import CHANNELS

CONFIDENCE = 0.95
LEAST_CELL = 0.02  # of the strongest cell's normal force, below which a cell belongs to no contact
LEAST_FORCE = 0.5  # N below which what is pressed is no contact of its own
REACH = 2.0  # cells around a contact in which what a network predicts still belongs to it


def bootstrap_mean(values, rng, resamplings: int, alike=None) -> tuple[np.ndarray, np.ndarray]:
    """Interval of the mean of `values` (n, k) over groups drawn with replacement; low and high, (k,) each.

    Percentile bootstrap (Efron 1979) at 95 %. alike: (n,) the group of each value, such as its press: groups are drawn
    whole, because what belongs to one errs alike (cluster bootstrap, Davison and Hinkley 1997, section 3.8); None: each
    value is its own.
    """
    values = np.asarray(values, float)
    _, group = np.unique(np.arange(len(values)) if alike is None else alike, return_inverse=True)
    sizes = np.bincount(group)
    sums = np.stack([np.bincount(group, column) for column in values.T], axis=1)
    n = len(sizes)
    means = np.empty((resamplings, values.shape[1]))
    for i in range(resamplings):
        drawn = rng.integers(0, n, n)
        means[i] = sums[drawn].sum(0) / sizes[drawn].sum()
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], axis=0)
    return low, high


def error_table(error, rng, resamplings: int, force_range=None, alike=None) -> dict:
    """Summarise signed errors (n, 3) in N per component: MAE, its deviation and interval, bias, root mean square.

    `force_range` (3,) N adds the MAE in percent of it (None where there is no range); `alike` (n,) is as for `bootstrap_mean`.
    """
    size = np.abs(error)
    low, high = bootstrap_mean(size, rng, resamplings, alike)
    table: dict[str, dict[str, float | None]] = {}
    for i, axis in enumerate(CHANNELS):
        table[axis] = {
            "mae": float(size[:, i].mean()),
            "std": float(size[:, i].std()),
            "mae_low": float(low[i]),
            "mae_high": float(high[i]),
            "bias": float(error[:, i].mean()),
            "rms": float(np.sqrt((error[:, i] ** 2).mean())),
        }
        if force_range is not None:
            fraction = 100 * size[:, i].mean() / force_range[i] if force_range[i] > 0 else None
            table[axis]["mae_percent_of_range"] = None if fraction is None else float(fraction)
    return table


def cell_table(predicted, labels) -> dict:
    """Error per cell (n, 3, rows, cols) in N: mean over cells and images, and the deviation over images."""
    per_image = np.abs(predicted - labels).mean((2, 3), dtype=np.float64)
    return {
        axis: {"mae": float(per_image[:, i].mean()), "std": float(per_image[:, i].std())}
        for i, axis in enumerate(CHANNELS)
    }


def by_group(error, groups) -> dict:
    """MAE and bias per component for each value of `groups` (n,), with the count."""
    result = {}
    for name in sorted(set(groups)):
        part = error[np.asarray(groups) == name]
        result[str(name)] = {"n": len(part)} | {
            axis: {"mae": float(np.abs(part[:, i]).mean()), "bias": float(part[:, i].mean())}
            for i, axis in enumerate(CHANNELS)
        }
    return result


def slope(values, reference) -> dict:
    """By what factor values (n, 3) N differ from a reference (n, 3) N per component: least squares through zero."""
    squares = (np.asarray(reference) ** 2).sum(axis=0)
    factors = (np.asarray(values) * reference).sum(axis=0) / np.where(squares > 0, squares, np.nan)
    return {axis: float(factor) if np.isfinite(factor) else None for axis, factor in zip(CHANNELS, factors)}


def force_bins(normal_force, edges) -> list[str]:
    """Name of the bin of |f_z| that each press lies in, `low-high N`; from the last edge on `high+ N`.

    What is below the first edge has a bin from 0.
    """
    edges = sorted({0.0, *edges})
    names = [f"{low:04.1f}-{high:04.1f} N" for low, high in zip(edges, edges[1:])] + [f"{edges[-1]:04.1f}+ N"]
    place = np.searchsorted(edges, np.abs(normal_force), side="right") - 1
    return [names[i] for i in place]


def constant_guess(train_totals, n: int) -> np.ndarray:
    """The best constant for the absolute error: the median total force of the training presses, (n, 3)."""
    return np.tile(np.median(train_totals, axis=0), (n, 1))


def linear_on_means(train_means, train_totals, means) -> np.ndarray:
    """Total force by least squares on the mean colour of an image, (n, 3); fitted to the training presses."""

    def design(x):
        return np.column_stack([x, np.ones(len(x))])

    weights, *_ = np.linalg.lstsq(design(train_means), train_totals, rcond=None)
    return design(means) @ weights


def image_means(images, rows) -> np.ndarray:
    """Mean colour (k, 3) of some rows of images (n, h, w, 3), one image at a time."""
    return np.stack([images[row].mean((0, 1)) for row in rows])


def contacts_of(label: np.ndarray) -> np.ndarray:
    """Which contact each cell belongs to, (rows, cols) int, 0 for none; label: (3, rows, cols) N.

    Pressed cells that touch each other, corners too, are one contact; each takes the cells around it, up to REACH, that are
    nearer to it than to another.
    """
    from scipy import ndimage

    pressed = -label[2]
    found, count = ndimage.label(pressed > LEAST_CELL * max(pressed.max(), 0.0), np.ones((3, 3)))
    force = ndimage.sum_labels(pressed, found, np.arange(1, count + 1)) if count else np.zeros(0)
    number = np.zeros(count + 1, int)
    strong = np.flatnonzero(force >= LEAST_FORCE) + 1
    number[strong] = np.arange(1, len(strong) + 1)
    contact = number[found]
    if not len(strong):
        return contact
    away, nearest = ndimage.distance_transform_edt(contact == 0, return_indices=True)
    return np.where(away <= REACH, contact[tuple(nearest)], 0)


def contact_forces(labels: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Normal force of each contact by label and by network, (m, 2) N, of presses with several contacts.

    labels, forces: (n, 3, rows, cols) N per cell, compression negative; the forces returned are positive.
    """
    from scipy import ndimage

    pairs = []
    for label, predicted in zip(labels, forces, strict=True):
        contact = contacts_of(label)
        count = int(contact.max(initial=0))
        if count > 1:
            which = np.arange(1, count + 1)
            pairs.append(
                np.stack([-ndimage.sum_labels(part[2], contact, which) for part in (label, predicted)], axis=1)
            )
    return np.concatenate(pairs) if pairs else np.zeros((0, 2))


def contact_table(labels: np.ndarray, forces: np.ndarray) -> dict:
    """Contacts in presses with several (`n`), and a network's error of the force of each: N and per cent, in the mean."""
    pairs = contact_forces(labels, forces)
    if not len(pairs):
        return {"n": 0}
    off = np.abs(pairs[:, 1] - pairs[:, 0])
    return {"n": len(pairs), "mae": float(off.mean()), "percent": float(100 * (off / pairs[:, 0]).mean())}
