"""Charts of `make pareto` and `make stability`, as PNG bytes."""

from gelforge.flow.tables import METHODS
from gelforge.reporting.canvas import canvas_with_axes, to_png

COLOURS = {"hex": "#2a7f9e", "ccx": "#d1603d", "ccx-contact": "#7a7a7a", "auto": "#6a4c93"}
MARKERS = {"hex": "o", "ccx": "s", "ccx-contact": "D", "auto": "*"}
FLOOR = 1e-5  # smaller errors are drawn here
KINDS = {"total": "error of total force", "cells": "error per cell at 24 x 32, sum over cells / total force"}


def _shown(row, kind, which):
    value = row[f"{kind}_{which}"]
    return None if value is None else 100 * max(value, FLOOR)


def _spot(axis, row, kind, slowest):
    """Draw one method at its median, hollow where a scene has no result, with a line up to its worst scene."""
    middle, worst = _shown(row, kind, "median"), _shown(row, kind, "worst")
    colour, x = COLOURS[row["solver"]], row["cpu_seconds_median"]
    ship = row["method"] in ("label", "ccx", "auto")
    axis.plot([x, x], [middle, worst], color=colour, lw=0.8, alpha=0.5, zorder=1)
    axis.plot([x], [worst], "_", color=colour, ms=7, zorder=2)
    size = 11 if row["solver"] == "auto" else 8 if ship else 5
    inside, edge = colour if row["whole"] else "white", "black" if ship else colour
    # auto coincides with the solver that it chooses and is drawn over it; names of label settings go to the right
    auto = row["solver"] == "auto"
    left = auto or not ship or x > slowest / 2
    above = 4 if auto else 3
    axis.plot([x], [middle], MARKERS[row["solver"]], ms=size, mfc=inside, mec=edge, mew=1.2, zorder=above)
    if row["method"] in METHODS:
        place = {"xytext": (-7, 5 if auto else -9), "ha": "right"} if left else {"xytext": (6, -9)}
        axis.annotate(row["method"], (x, middle), textcoords="offset points", fontsize=7, **place)


def _frontier(axis, rows, kind):
    line = sorted((r["cpu_seconds_median"], _shown(r, kind, "worst")) for r in rows if r[f"frontier_{kind}"])
    if line:
        axis.plot(*zip(*line, strict=True), color="0.35", lw=1.0, drawstyle="steps-post", zorder=0,
                  label="frontier of the worst scene")  # fmt: skip


def plain_ticks(axis):
    """Log axes with plain ticks 1, 2, 5, 10, and margins for the names of points."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set(xscale="log", yscale="log")
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        side.set_minor_formatter(NullFormatter())
    axis.margins(x=0.15, y=0.08)


def pareto_chart(rows: list[dict], scenes: list[dict]) -> bytes:
    """Seconds against error, log-log, one panel per kind of error; medians over scenes with a line to the worst."""
    from matplotlib.lines import Line2D

    usable = [row for row in rows if row["total_median"] is not None]
    slowest = max((row["cpu_seconds_median"] for row in usable), default=0.0)
    figure, axes = canvas_with_axes(1, 2, 12, 5.2)
    for axis, (kind, label) in zip(axes[0], KINDS.items(), strict=True):
        for row in usable:
            _spot(axis, row, kind, slowest)
        _frontier(axis, usable, kind)
        plain_ticks(axis)
        axis.set(xlabel="processor seconds per press, one thread (median over scenes)", ylabel=f"{label}, %")
        axis.grid(alpha=0.25, which="both")
    solvers = dict.fromkeys(row["solver"] for row in usable)
    handles = [Line2D([], [], ls="", marker=MARKERS[f], color=COLOURS[f], label=f) for f in solvers]
    handles += [Line2D([], [], color="0.35", label="frontier of the worst scene"),
                Line2D([], [], ls="", marker="o", mfc="white", color="0.3", label="hollow: not solved on some scene"),
                Line2D([], [], ls="", marker="_", color="0.3", label="worst scene")]  # fmt: skip
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8)
    reference = scenes[0]["reference"]
    figure.suptitle(f"{len(scenes)} scenes; error against {reference}", fontsize=10)
    return to_png(figure)


PANELS = {"depth": "depth of the press, mm", "shear": "sideways travel, fraction of the depth", "place": "where on the gel",
          "tilt": "slope of a tilted block, degrees", "ridge": "width of a ridge, mm", "friction": "friction coefficient",
          "nu": "Poisson's ratio of the gel", "size": "size of elements, mm", "steps": "load steps",
}  # fmt: skip
VERDICTS = {"good": "#9bc995", "drifts": "#f0c05a", "failed": "#c8553d", "not run": "#d9d9d9"}


def stability_map(table: list[dict]) -> bytes:
    """One panel per row of the map: levels against solver and kind of indenter, coloured by verdict.

    A black frame marks the base press, of which one factor at a time is varied.
    """
    from matplotlib.patches import Patch

    rows = list(dict.fromkeys(line["row"] for line in table))
    columns = 2
    height = -(-len(rows) // columns)
    figure, axes = canvas_with_axes(height, columns, 11, 3.2 * height)
    shared = _shared(table)
    for axis, row in zip(axes.ravel(), rows, strict=False):
        lines = [line for line in table if line["row"] == row]
        if row == "random":
            _scatter(axis, lines)
        else:
            _grid(axis, row, lines, shared)
    for axis in axes.ravel()[len(rows) :]:
        axis.set_axis_off()
    figure.suptitle("Error of total force, %, at label setting against the finest hexahedra; for size and steps against the "
                    "finest of the same solver", fontsize=11)  # fmt: skip
    named = {"drifts": "drifts: error above 5 %"}
    handles = [Patch(color=colour, label=named.get(verdict, verdict)) for verdict, colour in VERDICTS.items()]
    frame = Patch(facecolor="white", edgecolor="black", label="base press, of which one factor at a time is varied")
    figure.legend(handles=[*handles, frame], loc="outside lower center", ncols=5)
    return to_png(figure)


def _case(line):
    """The case that a line of the map solves; lines of different rows may share one."""
    return tuple(line[name] for name in ("solver", "kind", "shape", "depth", "shear", "place", "nu", "friction", "size",
                                    "steps"))  # fmt: skip


def _shared(table):
    """Cases that are in several one-factor rows: the base press that they vary."""
    rows: dict[tuple, set] = {}
    for line in table:
        if line["row"] != "random":
            rows.setdefault(_case(line), set()).add(line["row"])
    return {case for case, found in rows.items() if len(found) > 1}


def _grid(axis, row, lines, shared):
    """Cells of levels by solver and kind: error in per cent, status of a failed solve, or "finest", the reference."""
    from matplotlib.patches import Rectangle

    levels = list(dict.fromkeys(line["level"] for line in lines))
    levels = levels if row == "place" else sorted(levels, reverse=row == "size")
    groups = list(dict.fromkeys((line["solver"], line["kind"]) for line in lines))
    for line in lines:
        x, y = levels.index(line["level"]), groups.index((line["solver"], line["kind"]))
        axis.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, facecolor=VERDICTS[line["verdict"]], edgecolor="white"))
        if line["verdict"] == "failed":
            axis.text(x, y, line["status"].lower().replace("_", " "), ha="center", va="center", fontsize=8)
        elif line["solver"] == "fine":
            axis.text(x, y, "finest", ha="center", va="center", fontsize=8, color="0.35")
        elif line["error"] is not None:
            axis.text(x, y, f"{100 * line['error']:.1f}", ha="center", va="center", fontsize=10)
    for level in {line["level"] for line in lines if _case(line) in shared}:
        corner = levels.index(level) - 0.5, -0.5
        axis.add_patch(Rectangle(corner, 1, len(groups), fill=False, edgecolor="black", lw=2, clip_on=False))
    axis.set(xlim=(-0.5, len(levels) - 0.5), ylim=(len(groups) - 0.5, -0.5), xticks=range(len(levels)),
             yticks=range(len(groups)), title=PANELS[row])  # fmt: skip
    axis.set_xticklabels([str(level) for level in levels])
    axis.set_yticklabels([" ".join(group) for group in groups], fontsize=10)


def _scatter(axis, lines):
    """Scatter plot of random combinations over depth and shear; circles hex, squares ccx."""
    for solver, shift in (("hex", -0.012), ("ccx", 0.012)):
        own = [line for line in lines if line["solver"] == solver]
        x, y = [line["depth"] + shift for line in own], [line["shear"] for line in own]
        colours = [VERDICTS[line["verdict"]] for line in own]
        axis.scatter(x, y, s=34, marker=MARKERS[solver], c=colours, edgecolors="0.2", lw=0.5)
    axis.set(xlabel="depth, mm", ylabel="shear, fraction of depth")
    axis.set_title("random combinations: circles hex, squares ccx")
