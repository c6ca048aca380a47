"""What the report shows of a network: its curve, and predictions beside labels; and its tables."""

import numpy as np

from gelforge.records.axes import CHANNELS

SHOWN_PRESSES = 4


def canvas(width: float, height: float):
    """A figure that needs no display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


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
    figure.savefig(path, dpi=110)


def draw_predictions(path, data, predictions: dict) -> None:
    """Write predicted against labelled totals, and normal-force maps of a few presses.

    :param predictions: split name to (rows of the dataset, forces (k, 3, rows, cols) in N).
    """
    has_cells = next(iter(predictions.values()))[1].shape[2:] == data.grid
    figure = canvas(11, 6.4 if has_cells else 3.4)
    scatter, *maps = np.atleast_1d(figure.subfigures(2 if has_cells else 1, 1, height_ratios=[1, 1][: 1 + has_cells]))
    for i, axis in enumerate(scatter.subplots(1, 3)):
        for name, (rows, forces) in predictions.items():
            axis.plot(data.totals(rows)[:, i], forces.sum((2, 3))[:, i], ".", markersize=4, label=name)
        low, high = np.array([axis.get_xlim(), axis.get_ylim()]).T
        axis.plot([low.min(), high.max()], [low.min(), high.max()], color="0.7", linewidth=0.8, zorder=0)
        axis.set(xlabel=f"label {CHANNELS[i]} (N)", ylabel=f"predicted {CHANNELS[i]} (N)")
    axis.legend(fontsize=7)
    if has_cells:
        draw_maps(maps[0], data, *predictions.get("test", next(iter(predictions.values()))))
    figure.savefig(path, dpi=110)


def draw_maps(figure, data, rows, forces) -> None:
    """Draw label and prediction of normal force for some presses, from weak to strong, into a (sub)figure."""
    order = np.argsort(np.abs(data.totals(rows)[:, 2]))
    picked = order[np.linspace(0, len(order) - 1, min(SHOWN_PRESSES, len(order))).astype(int)]
    axes = figure.subplots(2, len(picked), squeeze=False)
    for column, k in enumerate(picked):
        pair = (data.labels[rows[k], 2], forces[k, 2])
        low = min(float(part.min()) for part in pair)
        for axis, part, what in zip(axes[:, column], pair, ("label", "network")):
            axis.imshow(part, cmap="inferno_r", vmin=low, vmax=0)
            axis.set_title(f"{what}: {part.sum():.1f} N", fontsize=8)
            axis.set_axis_off()


def cell_text(table: dict | None, axis: str) -> str:
    """Mean and deviation as the paper prints them."""
    return "-" if table is None else f"{table[axis]['mae']:.4f} ± {table[axis]['std']:.4f}"


def tables(result: dict) -> list[dict]:
    """Tables of an evaluation for the report: title, columns, rows of text."""
    splits = result["splits"]
    main = [
        [
            name,
            split["n"],
            *(f"{split['total'][a]['mae']:.3f} ± {split['total'][a]['std']:.3f}" for a in CHANNELS),
            *(cell_text(split["cell"], a) for a in CHANNELS),
        ]
        for name, split in splits.items()
    ]
    detail = [
        [
            name,
            axis,
            f"{e['mae_low']:.3f} to {e['mae_high']:.3f}",
            f"{e['bias']:+.3f}",
            f"{e['mae_percent_of_range']:.2f}",
        ]
        for name, split in splits.items()
        for axis, e in split["total"].items()
    ]
    control = [
        [name, what.replace("_", " "), *(f"{values[a]:.3f}" for a in CHANNELS)]
        for name, split in splits.items()
        for what, values in split["controls"].items()
    ]
    against = [
        [
            name,
            kind,
            who,
            pair["n"],
            *(f"{pair[who][a]['mae']:.3f} (bias {pair[who][a]['bias']:+.3f})" for a in CHANNELS),
        ]
        for name, split in splits.items()
        for kind, pair in split["against"].items()
        for who in ("network", "labels")
    ]
    result = [
        {
            "title": f"Mean absolute error of {result['model']}, N: total and per cell (± deviation over images)",
            "columns": ["split", "images", *(f"total {a}" for a in CHANNELS), *(f"cell {a}" for a in CHANNELS)],
            "rows": main,
        },
        {
            "title": "Total force: 95 % interval of the mean absolute error and bias, N; error in % of the force range",
            "columns": ["split", "component", "95 % interval", "bias", "% of range"],
            "rows": detail,
        },
        {
            "title": "What knows less than the network: mean absolute error of total force, N",
            "columns": ["split", "control", *CHANNELS],
            "rows": control,
        },
    ]
    for key, title in (
        ("per_indenter", "per indenter"),
        ("per_force", "per normal force"),
        ("per_sensor", "per sensor"),
    ):
        result.append(
            {
                "title": f"Total force, mean absolute error {title}, N",
                "columns": ["split", "group", "images", *CHANNELS],
                "rows": [
                    [
                        name,
                        group,
                        values["n"],
                        *(f"{values[a]['mae']:.3f} (bias {values[a]['bias']:+.3f})" for a in CHANNELS),
                    ]
                    for name, split in splits.items()
                    for group, values in split[key].items()
                ],
            }
        )
    if against:
        result.append(
            {
                "title": "Network and labels against the force sensor and against what a virtual rig knows, N",
                "columns": ["split", "reference", "who", "images", *CHANNELS],
                "rows": against,
            }
        )
    return result
