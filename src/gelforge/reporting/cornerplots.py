"""Charts of a posterior: corner plot, traces, posterior predictive."""

from pathlib import Path

import numpy as np

from gelforge.flow.files import publish
from gelforge.reporting.canvas import canvas, save_png, to_png

BAND = "#3b6ea5"
READABLE = 8  # most parameters of a corner plot that stays readable
FAR = 3.0  # readings beyond this many standard deviations are named


def _save(figure, path) -> None:
    with publish(path) as part:
        save_png(part, figure)


def most_correlated(values: np.ndarray) -> np.ndarray:
    """Columns (at most READABLE,) of draws (s, k), in order: the first, C10, and those that correlate most with it."""
    with_first = np.abs(np.atleast_2d(np.corrcoef(values, rowvar=False))[0])
    return np.sort(np.argsort(-with_first, kind="stable")[:READABLE])


def corner_plot(path, labels, values) -> None:
    """One- and two-dimensional marginals of parameters, with medians and 68 % intervals.

    labels: (k,), C10 first. values: draws (s, k). Axes span the central 99.5 % of the draws, so that a long tail does not
    set them.
    """
    import corner

    shown = most_correlated(values)
    data, hidden = values[:, shown], values.shape[1] - len(shown)
    figure = canvas(1.9 * len(shown), 1.9 * len(shown), None)
    corner.corner(
        data, labels=[labels[k].replace(" (", "\n(").replace(", ", ",\n") for k in shown], quantiles=[0.16, 0.5, 0.84],
        label_kwargs={"fontsize": 11}, color=BAND, fig=figure, range=[0.995] * len(shown), labelpad=0.15, max_n_ticks=3,
    )  # fmt: skip
    for axis in figure.axes:
        axis.tick_params(labelsize=9)
    for column, axis in enumerate(figure.axes[:: len(shown) + 1]):
        low, middle, high = np.quantile(data[:, column], [0.16, 0.5, 0.84])
        axis.set_title(f"${middle:.3g}^{{+{high - middle:#.2g}}}_{{-{middle - low:#.2g}}}$", fontsize=12)
    if hidden:
        figure.text(0.5, 0.9, f"{hidden} parameters that correlate less with C10:\nsee the trace", fontsize=13)
    with publish(path) as part:
        Path(part).write_bytes(to_png(figure))


def trace_plot(path, labels, values, steps, burn: int) -> None:
    """Trace of every walker, with the burn-in shaded. labels: (k,). values: (t, walkers, k) at the steps (t,)."""
    figure = canvas(9, 1.5 * len(labels))
    axes = np.atleast_1d(figure.subplots(len(labels), 1, sharex=True))
    for column, (axis, label) in enumerate(zip(axes, labels, strict=True)):
        axis.plot(steps, values[:, :, column], lw=0.3, alpha=0.4, color=BAND)
        axis.axvspan(0, burn, color="0.9", zorder=0)
        axis.set_ylabel(label.replace(" (", "\n("), fontsize=8)
        axis.margins(x=0)
    axes[-1].set_xlabel("step (grey: burn-in, not used)")
    _save(figure, path)


def predictive_plot(path, bands, observed, mean, scale, ids) -> None:
    """Force against depth with posterior predictive bands, and standardised residuals of the readings.

    bands: list of (name, depth (g,), force quantiles (5, g) at 2.5, 16, 50, 84, 97.5 %, N, measured
    depths, measured forces), normal force as compression. ids: (n,) str. Others as in summary.predictions.
    """
    figure = canvas(11, 4.6)
    left, right = figure.subplots(1, 2)
    for number, (name, grid, quantiles, at, measured) in enumerate(bands):
        colour = f"C{number % 10}"
        left.fill_between(grid, quantiles[0], quantiles[4], color=colour, alpha=0.15, lw=0)
        left.fill_between(grid, quantiles[1], quantiles[3], color=colour, alpha=0.3, lw=0)
        left.plot(grid, quantiles[2], color=colour, lw=1, label=name)
        left.plot(at, measured, "o", color=colour, ms=4, mec="k", mew=0.5)
    left.set(
        xlabel="commanded depth (mm)",
        ylabel="normal force, compression (N)",
        title="readings, with 68 % and 95 % posterior predictive bands",
    )
    left.legend(fontsize=7)
    left.set_ylim(bottom=0)
    for column, (name, marker) in enumerate(zip(("fx", "fy", "fz"), "v^o", strict=True)):
        used = np.isfinite(observed[:, column])
        if used.any():
            away = (observed[used, column] - mean[used, column]) / scale[used, column]
            force = -mean[used, 2]
            right.plot(force, away, marker, ms=4, label=name, alpha=0.8)
            for k in np.flatnonzero(np.abs(away) > FAR):
                side = "left" if force[k] < 0.5 * force.max() else "right"  # of the point, away from the axis
                right.annotate(f"  {ids[used][k]}  ", (force[k], away[k]), fontsize=7, ha=side, va="center")
    right.axhspan(-1, 1, color="0.92", zorder=0)
    right.axhline(0.0, color="0.6", lw=0.6)
    right.set_ylim(*np.array([-1.0, 1.0]) * max(2.5, 1.1 * np.abs(right.get_ylim()).max()))
    right.set(
        xlabel="predicted normal force, compression (N)",
        ylabel="measured - predicted (standard deviations)",
        title=f"{np.isfinite(observed).sum()} readings of {len(observed)} presses; grey: one standard deviation",
    )
    right.legend(fontsize=8)
    _save(figure, path)
