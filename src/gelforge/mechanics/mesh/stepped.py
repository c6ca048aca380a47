"""Hexahedra that are wider in the lower layers: which nodes hang between wide ones, and what each hexahedron is made of.

Near contact the displacement changes from cell to cell, deeper in the gel it no longer does, so every second mesh line ends
on its way down, and deeper every second of the rest. A plane's nodes on lines that have ended lie within the faces of wide
hexahedra: hanging nodes. They move as those faces do, so nothing gapes: constrained approximation (Demkowicz, Oden, Rachowicz,
Hardy 1989, Comput. Methods Appl. Mech. Eng. 77, 79-112). A small hexahedron that stands on such a face has the face's corners as
its lower nodes; its own lower corners move by shares of theirs. So no hexahedron is made of hanging nodes, and all are assembled
alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np


@dataclass(frozen=True)
class Hanging:
    """Nodes (h,) that move with the four nodes `masters` (h, 4), by `weights` (h, 4) that sum to one.

    No master hangs itself: one pass over a field sets all.
    """

    nodes: np.ndarray
    masters: np.ndarray
    weights: np.ndarray

    @classmethod
    def none(cls) -> "Hanging":
        """No node moves with others."""
        return cls(np.empty(0, np.int64), np.empty((0, 4), np.int64), np.empty((0, 4)))

    def hang(self, field: np.ndarray) -> None:
        """Set the rows of hanging nodes of a nodal field (n, k), in place."""
        if len(self.nodes):
            field[self.nodes] = np.einsum("hm,hmk->hk", self.weights, field[self.masters])


@dataclass(frozen=True)
class Cells:
    """The hexahedra that are solved: corners (e, 8) where they lie, and nodes (e, 8) whose motion deforms them.

    Both are the same but for the hexahedra `standing` (s,) on a wider face, whose lower corner c moves by the share
    `shares[:, c, n]` (s, 4, 4) of the motion of lower node n.
    """

    corners: np.ndarray
    nodes: np.ndarray
    standing: np.ndarray
    shares: np.ndarray

    @classmethod
    def plain(cls, elements: np.ndarray) -> "Cells":
        """Elements (e, k) of which none stands on a wider face."""
        return cls(elements, elements, np.empty(0, np.int64), np.empty((0, 4, 4)))


def fewer_lines(lines: np.ndarray, kept: np.ndarray, low: float, high: float) -> np.ndarray:
    """Of the indices `kept` of mesh lines, all outside of the fine part [low, high] mm and every second one in it."""
    within = kept[(lines[kept] > low - 1e-9) & (lines[kept] < high + 1e-9)]
    return np.setdiff1d(kept, within[1:-1:2])


def face_weights(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bilinear weights (..., 4) of a face's corners, counter-clockwise from the first, at places x, y from 0 to 1."""
    return np.stack([(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y], axis=-1)


class Sparse:
    """The lines that are left of mesh lines: the cells between them, and where any of the mesh lines lies in its cell.

    at: (k,) sorted indices of the lines that are left. left: (n,) bool, which these are.
    """

    def __init__(self, lines: np.ndarray, at: np.ndarray):
        """lines: (n,) places of all mesh lines, mm."""
        self.at, self._lines = at, lines
        self.left = np.zeros(len(lines), bool)
        self.left[at] = True

    def cell(self, line: np.ndarray) -> np.ndarray:
        """The cells (...) that begin at or before mesh lines, by their indices (...); the last line ends the last cell."""
        return np.clip(np.searchsorted(self.at, line, "right") - 1, 0, len(self.at) - 2)

    def place(self, line: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """Where lines lie in cells, from 0 to 1, by indices (...) of both."""
        start, end = self._lines[self.at[cell]], self._lines[self.at[cell + 1]]
        return (self._lines[line] - start) / (end - start)


class Planes:
    """Planes of nodes on a grid of mesh lines, from the base up.

    columns: nodes of a row, which run along x. lines: of each plane those that go through it, by their places along x and
    along y. Planes have all nodes of the grid, `size` of them; the hexahedra use those on lines that go through.
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
        """The nodes on lines that do not go through their plane; those of the base are held anyway."""
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
        """For lower corners (q, 4), by their places in a plane of fewer lines: shares (q, 4, 4), and the nodes (q, 4)."""
        x, y = self.lines[plane]
        i, j = lower % self.columns, lower // self.columns
        # the first corner lies at or after the start of its wide cell, the others at or before its end
        a, b = x.cell(i[:, :1]), y.cell(j[:, :1])
        return face_weights(x.place(i, a), y.place(j, b)), self._corners(plane, a[:, 0], b[:, 0])


def planes_of(
    xs: np.ndarray, ys: np.ndarray, layers: int, widened: Sequence[int], box: tuple[float, float, float, float]
) -> Planes:
    """Planes on mesh lines xs, ys (mm) of which, in the box (x_min, x_max, y_min, y_max), every second ends on the way down.

    widened: how many layers, counted from the base, have half of the lines; then how many of these half of those; and so on.
    """
    x, y = np.arange(len(xs)), np.arange(len(ys))
    planes = [(Sparse(xs, x), Sparse(ys, y))] * (layers + 1)
    for count in widened:
        x, y = fewer_lines(xs, x, *box[:2]), fewer_lines(ys, y, *box[2:])
        planes[: count + 1] = [(Sparse(xs, x), Sparse(ys, y))] * (count + 1)
    return Planes(len(xs), planes)
