"""Pictures of a posterior."""

import numpy as np

from gelforge.calibration.parameters import label_of
from gelforge.files import publish

BAND = "#3b6ea5"


def _figure(size):
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout="constrained")


def _save(figure, path) -> None:
    with publish(path) as part:
        figure.savefig(part, dpi=110)


def corner_plot(path, chain, model) -> None:
    """One and two-dimensional marginals of the parameters, with medians and 68 % intervals."""
    import corner
    from matplotlib.figure import Figure

    values = model.values(chain.flat(20000))
    data = np.stack([values[name] for name in model.names], axis=1)
    figure = Figure(figsize=(2.1 * len(model.names),) * 2)
    corner.corner(
        data, labels=[label_of(n) for n in model.names], quantiles=[0.16, 0.5, 0.84], show_titles=True,
        title_fmt=".3g", label_kwargs={"fontsize": 9}, title_kwargs={"fontsize": 9}, color=BAND, fig=figure,
        labelpad=0.12,
    )  # fmt: skip
    for axis in figure.axes:
        axis.tick_params(labelsize=7)
    with publish(path) as part:
        figure.savefig(part, dpi=90, bbox_inches="tight")


def trace_plot(path, coordinates, burn: int, model) -> None:
    """Every walker's path (steps, walkers, k), thinned, the burn-in shaded."""
    figure = _figure((9, 1.5 * len(model.names)))
    axes = np.atleast_1d(figure.subplots(len(model.names), 1, sharex=True))
    thin = max(1, len(coordinates) // 1500)
    steps = np.arange(0, len(coordinates), thin)
    for column, (axis, name) in enumerate(zip(axes, model.names, strict=True)):
        axis.plot(steps, model.free[name].value(coordinates[::thin, :, column]), lw=0.3, alpha=0.4, color=BAND)
        axis.axvspan(0, burn, color="0.9", zorder=0)
        axis.set_ylabel(label_of(name).replace(" (", "\n("), fontsize=8)
        axis.margins(x=0)
    axes[-1].set_xlabel("step (grey: burn-in, not used)")
    _save(figure, path)


def autocorrelation_plot(path, chain, model) -> None:
    """Autocorrelation of every parameter, averaged over walkers, against lag."""
    from emcee.autocorr import function_1d

    figure = _figure((7, 4))
    axis = figure.subplots()
    lags = min(len(chain.coordinates) // 2, int(8 * chain.figures.tau))
    for column, name in enumerate(model.names):
        walkers = chain.coordinates[:, :, column].T
        axis.plot(np.mean([function_1d(w)[:lags] for w in walkers], axis=0), label=label_of(name), lw=1.2)
    axis.axvline(chain.figures.tau, color="0.6", ls=":", label=f"longest time, {chain.figures.tau:.0f} steps")
    axis.axhline(0.0, color="0.7", lw=0.6)
    axis.set(xlabel="lag (steps)", ylabel="autocorrelation")
    axis.legend(fontsize=8)
    _save(figure, path)


def predictive_plot(path, bands, depth, observed, mean, scale, indenters) -> None:
    """Force against depth with predictive bands, and every reading's distance from its prediction.

    bands: list of (name, depth (g,), force quantiles (5, g) at 2.5, 16, 50, 84, 97.5 %, N, measured
    depths, measured forces), normal force as compression. Other arrays as in summary.predictions.
    """
    figure = _figure((11, 4.6))
    left, right = figure.subplots(1, 2)
    for number, (name, grid, quantiles, at, measured) in enumerate(bands):
        colour = f"C{number % 10}"
        left.fill_between(grid, quantiles[0], quantiles[4], color=colour, alpha=0.15, lw=0)
        left.fill_between(grid, quantiles[1], quantiles[3], color=colour, alpha=0.3, lw=0)
        left.plot(grid, quantiles[2], color=colour, lw=1, label=name)
        left.plot(at, measured, "o", color=colour, ms=4, mec="k", mew=0.5)
    left.set(
        xlabel="commanded depth (mm)", ylabel="normal force, compression (N)", title="measured, 68 % and 95 % bands"
    )
    left.legend(fontsize=7)
    left.set_ylim(bottom=0)
    for column, (name, marker) in enumerate(zip(("fx", "fy", "fz"), "v^o", strict=True)):
        used = np.isfinite(observed[:, column])
        if used.any():
            away = (observed[used, column] - mean[used, column]) / scale[used, column]
            right.plot(np.hypot(*mean[used, ::2].T), away, marker, ms=4, label=name, alpha=0.8)
    right.axhspan(-1, 1, color="0.9", zorder=0)
    right.axhline(0.0, color="0.6", lw=0.6)
    right.set(
        xlabel="predicted force (N)",
        ylabel="measured - predicted (standard deviations)",
        title=f"{len(observed)} presses",
    )
    right.legend(fontsize=8)
    _save(figure, path)
