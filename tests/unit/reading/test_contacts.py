"""Contacts of a press, each for itself."""

import numpy as np
import pytest

from gelforge.learning.evaluate import REACH, contact_forces, contact_table, contacts_of


def pressed(*blocks) -> np.ndarray:
    """A label (3, 24, 32) N of blocks (row, column, size, N a cell) that press the gel."""
    label = np.zeros((3, 24, 32))
    for row, col, size, force in blocks:
        label[2, row : row + size, col : col + size] = -force
    return label


def test_each_contact_gets_its_own_force():
    label = pressed((3, 4, 4, 0.5), (12, 18, 3, 1.0))
    found = contact_forces(label[None], 1.1 * label[None])
    assert np.sort(found, axis=0) == pytest.approx(np.array([[8.0, 8.8], [9.0, 9.9]]))
    table = contact_table(label[None], 1.1 * label[None])
    assert table["n"] == 2
    assert table["percent"] == pytest.approx(10.0)
    assert table["mae"] == pytest.approx(0.85)


def test_what_is_reported_beside_a_contact_counts_for_the_nearest():
    label = pressed((4, 4, 4, 0.5), (4, 12, 4, 0.5))
    predicted = np.roll(label, 1, axis=2)
    assert contact_forces(label[None], predicted[None]) == pytest.approx(np.full((2, 2), 8.0))
    far = np.roll(label, 12, axis=1)
    assert contact_forces(label[None], far[None])[:, 1] == pytest.approx(np.zeros(2))


def test_one_contact_says_nothing_of_several():
    corner = pressed((3, 4, 4, 0.5), (7, 8, 4, 0.5))  # two blocks that meet at a corner are one contact
    faint = pressed((3, 4, 4, 0.5), (15, 20, 2, 0.03))
    still = np.zeros((3, 24, 32))
    labels = np.stack([corner, faint, still])
    assert contact_forces(labels, labels).shape == (0, 2)
    assert contact_table(labels, labels) == {"n": 0}


def test_contacts_are_those_of_the_shape_however_it_lies():
    rng = np.random.default_rng(0)
    label = pressed((3, 4, 4, 0.5), (12, 18, 3, 1.0)) * rng.uniform(0.9, 1.1, (3, 24, 32))
    forces = label * rng.uniform(0.9, 1.1, label.shape)
    expected = np.sort(contact_forces(label[None], forces[None]), axis=0)
    for turn in (lambda a: a[:, ::-1], lambda a: a[:, :, ::-1], lambda a: a.transpose(0, 2, 1)):
        found = contact_forces(turn(label)[None], turn(forces)[None])
        assert np.sort(found, axis=0) == pytest.approx(expected)
    assert set(np.unique(contacts_of(label))) == {0, 1, 2}
    assert (contacts_of(label) > 0).sum() > 25 * REACH / 2
