"""How far one result is from another, in total force and cell by cell."""

import numpy as np


def total_error(total, reference) -> float:
    """Norm of the difference of two resultants (3,) over the norm of the reference."""
    total, reference = np.asarray(total, float), np.asarray(reference, float)
    return float(np.linalg.norm(total - reference) / np.linalg.norm(reference))


def cell_error(cells, reference, total) -> float:
    """Sum over cells of the norm of the difference, over the norm of the total force.

    cells, reference: (3, rows, cols) N. total: (3,) N, of the reference.
    """
    difference = np.linalg.norm(np.asarray(cells, float) - np.asarray(reference, float), axis=0)
    return float(difference.sum() / np.linalg.norm(total))


def errors(record: dict, reference: dict) -> dict | None:
    """Errors {"total", "cells"} of a record against the reference; None if either has no cells or that no force."""
    if record.get("cells") is None or reference.get("cells") is None:
        return None
    if np.linalg.norm(reference["total"]) == 0.0:
        return None
    return {
        "total": total_error(record["total"], reference["total"]),
        "cells": cell_error(record["cells"], reference["cells"], reference["total"]),
    }


def frontier(points: list[tuple[float, float]]) -> list[bool]:
    """Which of the points (cost, error) are Pareto optimal."""

    def beaten(p):
        return any(q[0] <= p[0] and q[1] <= p[1] and q != p for q in points)

    return [not beaten(p) for p in points]
