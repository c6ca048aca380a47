"""A network of one's own beside the shipped one: which is for which sensor."""

import numpy as np

from gelforge.reporting.networkchoice import beside, choices


def evaluation(sensors, **errors):
    """An evaluation with mean absolute errors of normal force by split, and how many images each has."""
    return {"splits": {
        name: {"n": n, "total": {"fx": {"mae": 0.1}, "fy": {"mae": 0.2}, "fz": {"mae": mae}}, "per_sensor": {sensors[name]: {}}}
        for name, (n, mae) in errors.items()
    }}  # fmt: skip


SENSORS = {"test": "a", "test_unseen_indenter": "b", "test_unseen_sensor": "c"}


def test_each_kind_of_sensor_has_its_network_by_the_error_over_all_its_images():
    own = evaluation(SENSORS, test=(6, 0.45), test_unseen_indenter=(2, 0.36), test_unseen_sensor=(4, 2.32))
    shipped = evaluation(SENSORS, test=(6, 0.80), test_unseen_indenter=(2, 0.84), test_unseen_sensor=(4, 1.37))
    known, other = choices(own, shipped, "tuned")
    mine, theirs = (np.average(of, weights=[6, 2]) for of in ((0.45, 0.36), (0.80, 0.84)))
    assert (
        "learnt from (a, b): use tuned" in known and f"off by {mine:.2f} N" in known and f"by {theirs:.2f} N" in known
    )
    assert "did not learn from (c): use the shipped network" in other and "On 4 images" in other


def test_without_a_sensor_left_out_nothing_is_said_of_others_but_to_be_careful():
    own, shipped = evaluation(SENSORS, test=(6, 0.9)), evaluation(SENSORS, test=(6, 0.8), test_unseen_sensor=(4, 1.0))
    known, other = choices(own, shipped, "tuned")
    assert "use the shipped network" in known and "was tried on no sensor" in other
    assert choices(own, {"splits": {}}, "tuned") == [] and beside(own, {"splits": {}}) == []
