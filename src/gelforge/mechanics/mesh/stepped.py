"""Hexahedra that are wider in the lower layers: hanging nodes, and the nodes of each hexahedron.

Displacement varies from cell to cell near contact, but not deeper in the gel. So every second mesh line ends on its
way down, and further down every second of the rest. Nodes on a line that has ended lie within the faces of wide
hexahedra: hanging nodes. They move with those faces, so that no gap opens: constrained approximation (Demkowicz,
Oden, Rachowicz, Hardy 1989, Comput. Methods Appl. Mech. Eng. 77, 79-112). A small hexahedron on such a face has the
face's corners as its lower nodes; the motion of its own lower corners is interpolated from them. So no hexahedron has
hanging nodes, and all are assembled alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np


@dataclass(frozen=True)
class Hanging:
    """Nodes (h,) that move with the four nodes `masters` (h, 4), with `weights` (h, 4) that sum to one.

    No master hangs itself, so one pass sets all.
    """

    nodes: np.ndarray
    masters: np.ndarray
    weights: np.ndarray

    @classmethod
    def none(cls) -> "Hanging":
        """No hanging nodes."""
        return cls(np.empty(0, np.int64), np.empty((0, 4), np.int64), np.empty((0, 4)))

    def hang(self, field: np.ndarray) -> None:
        """Interpolate the rows of hanging nodes of a nodal field (n, k), in place."""
        if len(self.nodes):
            field[self.nodes] = np.einsum("hm,hmk->hk", self.weights, field[self.masters])


@dataclass(frozen=True)
class Cells:
    """The hexahedra that are solved: corners (e, 8) for their geometry, and nodes (e, 8) whose motion deforms them.

    They differ only for hexahedra `standing` (s,) on a wider face: their lower corner c moves with the weights
    `shares[:, c, n]` (s, 4, 4) of the lower nodes n.
    """

    corners: np.ndarray
    nodes: np.ndarray
    standing: np.ndarray
    shares: np.ndarray

    @classmethod
    def plain(cls, elements: np.ndarray) -> "Cells":
        """Elements (e, k), none on a wider face."""
        return cls(elements, elements, np.empty(0, np.int64), np.empty((0, 4, 4)))


def fewer_lines(lines: np.ndarray, kept: np.ndarray, low: float, high: float) -> np.ndarray:
    """Of the mesh line indices `kept`, those outside the fine part [low, high] mm and every second one within it."""
    within = kept[(lines[kept] > low - 1e-9) & (lines[kept] < high + 1e-9)]
    return np.setdiff1d(kept, within[1:-1:2])


def face_weights(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bilinear weights (..., 4) of a face's corners, counter-clockwise from the first, at x, y in [0, 1]."""
    return np.stack([(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y], axis=-1)


class Sparse:
    """A subset of the mesh lines: the cells between its lines, and the position of any mesh line within its cell.

    at: (k,) sorted indices of the lines of the subset. left: (n,) bool, whether a mesh line belongs to it.
    """

    def __init__(self, lines: np.ndarray, at: np.ndarray):
        """lines: (n,) coordinates of all mesh lines, mm."""
        self.at, self._lines = at, lines
        self.left = np.zeros(len(lines), bool)
        self.left[at] = True

    def cell(self, line: np.ndarray) -> np.ndarray:
        """Indices (...) of the cells that start at or before mesh lines (...); the last line ends the last cell."""
        return np.clip(np.searchsorted(self.at, line, "right") - 1, 0, len(self.at) - 2)

    def place(self, line: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """Positions of lines within cells, from 0 to 1, by indices (...) of both."""
        start, end = self._lines[self.at[cell]], self._lines[self.at[cell + 1]]
        return (self._lines[line] - start) / (end - start)


class Planes:
    """Planes of nodes on a grid of mesh lines, from the base up.

    columns: nodes per row along x. lines: for each plane, the lines by x and by y that pass through it. Each
    plane has all `size` nodes of the grid; hexahedra use the nodes on lines that pass through it.
    """

    def __init__(self, columns: int, lines: Sequence[tuple[Sparse, Sparse]]):
        self.columns, self.lines = columns, lines
        self.size = len(lines[0][0].left) * len(lines[0][1].left)

    def _corners(self, plane: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Nodes (..., 4) of a plane around its cells a along x, b along y."""
        x, y = (kept.at for kept in self.lines[plane])
        node = [y[j] * self.columns + x[i] for i, j in ((a, b), (a + 1, b), (a + 1, b + 1), (a, b + 1))]
        return plane * self.size + np.stack(node, axis=-1)

    def hanging(self) -> Hanging:
        """The nodes on lines that do not pass through their plane, except on the base, which is fixed."""
        parts = []
        for k, (x, y) in enumerate(self.lines[1:], 1):
            j, i = np.nonzero(~(y.left[:, None] & x.left))
            a, b = x.cell(i), y.cell(j)
            weights = face_weights(x.place(i, a), y.place(j, b))
            parts.append((k * self.size + j * self.columns + i, self._corners(k, a, b), weights))
        return Hanging(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))

    def cells(self) -> Cells:
        """The hexahedra between the planes, layer by layer; a layer has the lines of the plane above it."""
        corners, nodes, standing, shares, count = [], [], [], [], 0
        for k, (below, (x, y)) in enumerate(pairwise(self.lines)):
            a, b = np.meshgrid(np.arange(len(x.at) - 1), np.arange(len(y.at) - 1), indexing="xy")
            upper = self._corners(k + 1, a.ravel(), b.ravel())
            lower = upper - self.size
            corners.append(np.concatenate([lower, upper], axis=1))
            if below != (x, y):
                share, lower = self._on_wider(k, lower - k * self.size)
                standing.append(count + np.arange(len(lower)))
                shares.append(share)
            nodes.append(np.concatenate([lower, upper], axis=1))
            count += len(lower)
        return Cells(
            np.concatenate(corners), np.concatenate(nodes),
            np.concatenate([np.empty(0, np.int64), *standing]), np.concatenate([np.empty((0, 4, 4)), *shares]),
        )  # fmt: skip

    def _on_wider(self, plane: int, lower: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights (q, 4, 4) and lower nodes (q, 4) for lower corners (q, 4), indices in a plane with fewer lines."""
        x, y = self.lines[plane]
        i, j = lower % self.columns, lower // self.columns
        # the first corner decides the wide cell, because the others may lie on its end
        a, b = x.cell(i[:, :1]), y.cell(j[:, :1])
        return face_weights(x.place(i, a), y.place(j, b)), self._corners(plane, a[:, 0], b[:, 0])


def planes_of(
    xs: np.ndarray, ys: np.ndarray, layers: int, widened: Sequence[int], box: tuple[float, float, float, float]
) -> Planes:
    """Planes on mesh lines xs, ys (mm); in `box` (x_min, x_max, y_min, y_max) every second line ends on its way down.

    widened: number of layers, from the base up, with half of the lines; of these, number with a quarter; and so on.
    """
    x, y = np.arange(len(xs)), np.arange(len(ys))
    planes = [(Sparse(xs, x), Sparse(ys, y))] * (layers + 1)
    for count in widened:
        x, y = fewer_lines(xs, x, *box[:2]), fewer_lines(ys, y, *box[2:])
        planes[: count + 1] = [(Sparse(xs, x), Sparse(ys, y))] * (count + 1)
    return Planes(len(xs), planes)
