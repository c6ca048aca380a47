"""Each contact of a press for itself: where a label shows several, and what a network predicts of each of them."""

import numpy as np

LEAST_CELL = 0.02  # of the strongest cell's normal force, below which a cell belongs to no contact
LEAST_FORCE = 0.5  # N below which what is pressed is no contact of its own
REACH = 2.0  # cells around a contact in which what a network predicts still belongs to it


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
