"""What the edge of a contact says, without a solve."""

import numpy as np
import pytest

from gelforge.geometry.indenters import build
from gelforge.mechanics import extrapolate
from gelforge.mechanics.contact.penalty import FREE, TOUCHING, ContactState
from gelforge.mechanics.extrapolate import edge_of
from gelforge.mechanics.pose import Pose

BLOCK = build("block", {"kind": "cuboid", "size": [7, 7], "fillet": 0.5, "height": 10})
HERE = Pose(np.eye(3), np.zeros(3))


def half_pressed(order: str) -> ContactState:
    """A block that touches with its left half alone, as a tilted one does; points in rows, one order or another."""
    x, y = np.meshgrid(np.arange(-5.0, 5.0, 0.1) + 0.05, np.arange(-5.0, 5.0, 0.1) + 0.05, indexing="ij")
    places = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    way = {
        "x": places[:, 0],
        "-x": -places[:, 0],
        "y": places[:, 1],
        "any": np.random.default_rng(1).random(len(places)),
    }
    places = places[np.argsort(way[order], kind="stable")]
    on = (places[:, 0] > -3.4) & (places[:, 0] < 0.0) & (np.abs(places[:, 1]) < 3.4)
    none = np.zeros_like(places)
    return ContactState(
        face=np.zeros(len(places), int), shape=np.ones((len(places), 1)), reference=places, weights=np.full(len(places), 0.01),
        status=np.where(on, TOUCHING, FREE), stick_point=none, normal=none, goal=none, fading=none, multiplier=none, carried=none,
        share=none[:, 0], position=places, traction=np.where(on[:, None], [0.0, 0.0, -0.01], 0.0),
    )  # fmt: skip


@pytest.mark.parametrize("order", ["x", "-x", "y", "any"])
def test_the_bend_is_that_all_around_the_contact(monkeypatch, order):
    """Three sides lie at the rounded edge of the body, the fourth on its level face: some points stand for all of them."""
    found = edge_of(half_pressed(order), BLOCK, HERE, 0.4, 4.0)
    monkeypatch.setattr(extrapolate, "POINTS", 10**6)
    whole = edge_of(half_pressed("x"), BLOCK, HERE, 0.4, 4.0)
    assert 0.2 < whole.bend < 1.8
    assert found.bend == pytest.approx(whole.bend, rel=0.06)
    turned = half_pressed("x")
    turned.position = turned.position[:, [1, 0, 2]]
    assert edge_of(turned, BLOCK, HERE, 0.4, 4.0).bend == pytest.approx(whole.bend, rel=0.02)
    assert found.area == pytest.approx(whole.area) and found.near == pytest.approx(whole.near)
