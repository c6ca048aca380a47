"""Charts of a network: training curve, predictions against labels, error against latency."""

import numpy as np

from gelforge.records.axes import CHANNELS
from gelforge.records.networkkind import KINDS
from gelforge.records.samplefile import TEST
from gelforge.reporting.canvas import canvas, save_png
from gelforge.reporting.forcemaps import draw_pressure

SHOWN_PRESSES = 4
# Errors drawn against latency: keys of the rows of stages.pareto_models, and axis labels.
PANELS = {
    "percent": "total force, mean of components (% of range)",
    "cell_fz": "normal force per cell (N)",
}


def draw_curve(path, curve: list[dict], best_epoch: int, name: str) -> None:
    """Write the training curve: loss, and validation errors of total force in N."""
    figure = canvas(9, 3)
    left, right = figure.subplots(1, 2)
    epochs = [row["epoch"] for row in curve]
    left.semilogy(epochs, [row["loss"] for row in curve], color="tab:blue")
    left.set(xlabel="epoch", ylabel="training loss", title=name)
    rate = left.twinx()
    rate.semilogy(epochs, [row["learning_rate"] for row in curve], color="0.7")
    rate.set_ylabel("learning rate", color="0.5")
    for axis in CHANNELS:
        right.semilogy(epochs, [row[f"val_{axis}"] for row in curve], label=axis)
    right.axvline(best_epoch, color="0.6", linestyle=":", label="best")
    right.set(xlabel="epoch", ylabel="validation MAE of total force (N)")
    right.legend(fontsize=8)
    save_png(path, figure)


def draw_predictions(path, data, predictions: dict) -> None:
    """Write predicted against labelled totals, and normal-force maps of a few presses.

    :param predictions: split name to (rows of the dataset, forces (k, 3, rows, cols) in N).
    """
    has_cells = next(iter(predictions.values()))[1].shape[2:] == data.grid
    figure = canvas(11, 6.4 if has_cells else 3.4)
    parts = figure.subfigures(1 + has_cells, 1, squeeze=False)
    scatter, *maps = parts.ravel()
    for i, axis in enumerate(scatter.subplots(1, 3)):
        for name, (rows, forces) in predictions.items():
            axis.plot(data.totals(rows)[:, i], forces.sum((2, 3))[:, i], ".", markersize=4, label=name)
        low, high = np.array([axis.get_xlim(), axis.get_ylim()]).T
        axis.plot([low.min(), high.max()], [low.min(), high.max()], color="0.7", linewidth=0.8, zorder=0)
        axis.set(xlabel=f"label {CHANNELS[i]} (N)", ylabel=f"predicted {CHANNELS[i]} (N)")
    axis.legend(fontsize=7)
    if has_cells:
        draw_maps(maps[0], data, *predictions.get(TEST, next(iter(predictions.values()))))
    save_png(path, figure)


def draw_maps(figure, data, rows, forces) -> None:
    """Draw label and prediction of normal force for some presses, from weak to strong, into a (sub)figure."""
    order = np.argsort(np.abs(data.totals(rows)[:, 2]))
    picked = order[np.linspace(0, len(order) - 1, min(SHOWN_PRESSES, len(order))).astype(int)]
    axes = figure.subplots(2, len(picked), squeeze=False)
    for column, k in enumerate(picked):
        pair = (data.labels[rows[k], 2], forces[k, 2])
        most = max(float(-part.min()) for part in pair)
        for axis, part, what in zip(axes[:, column], pair, ("label", "network")):
            draw_pressure(axis, part, most)
            axis.set_title(f"{what}: {part.sum():.1f} N", fontsize=8)
            axis.set_axis_off()


def draw_networks(
    path,
    rows: list[dict],
    fronts: dict[str, set[str]],
    split: str,
    chosen: str | None,
) -> None:
    """Write the total error and the error per cell of networks against their latency.

    :param rows: rows of stages.pareto_models, one per network; panels leave out networks without their error.
    :param fronts: by key of PANELS, the names of the networks on the Pareto front of latency and error.
    """
    figure = canvas(11, 4.6)
    for axis, (key, label) in zip(figure.subplots(1, len(PANELS)), PANELS.items(), strict=True):
        _draw_latencies(axis, [row for row in rows if row[key] is not None], key, fronts[key], chosen)
        axis.set_ylabel(f"MAE, {label}")
    figure.suptitle(f"Networks on split {split}: line is the front, star the chosen one", fontsize=10)
    save_png(path, figure)


def _draw_latencies(axis, shown: list[dict], key: str, front: set[str], chosen: str | None) -> None:
    """Draw one error of networks against their latency with one thread, and the line through the front."""
    line = sorted((row["cpu1_median_ms"], row[key]) for row in shown if row["model"] in front)
    axis.plot(*zip(*line), color="0.7", zorder=1, drawstyle="steps-post")
    for place, row in enumerate(sorted(shown, key=lambda row: row[key])):
        # names alternate below and above, in order of error, so that neighbours do not overlap
        _draw_network(axis, row, key, 6 if place % 2 else -12, row["model"] == chosen)
    axis.set(xscale="log", yscale="log", xlabel="ms per image, batch 1, one CPU thread (bar: 10 to 90 %)")
    axis.margins(x=0.2, y=0.12)
    axis.grid(alpha=0.3, which="both")


def _draw_network(axis, row: dict, key: str, name_above: int, chosen: bool) -> None:
    """Draw one network as a point, with its name `name_above` typographic points above it."""
    x = row["cpu1_median_ms"]
    axis.errorbar(
        x,
        row[key],
        xerr=[[x - row["cpu1_p10_ms"]], [row["cpu1_p90_ms"] - x]],
        fmt="*" if chosen else "o",
        zorder=2,
        markersize=13 if chosen else 6,
        color=KINDS[row["kind"]].colour,
    )
    axis.annotate(row["model"], (x, row[key]), xytext=(5, name_above), textcoords="offset points", fontsize=8)
