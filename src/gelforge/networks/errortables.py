"""Tables of a network's errors for the report."""

from gelforge.records.axes import CHANNELS


def cell_text(table: dict | None, axis: str) -> str:
    """Mean and deviation as the paper prints them."""
    return "-" if table is None else f"{table[axis]['mae']:.4f} ± {table[axis]['std']:.4f}"


PREDICTED_COLUMNS = [
    "split",
    "images",
    *(f"total {a}" for a in CHANNELS),
    "intervals hold, %",
    "each of several contacts",
]


def predicted_rows(result: dict) -> list[list]:
    """What `predict` makes of a network that reads pairs, a row for each split; none for other networks."""
    rows = []
    for name, split in result["splits"].items():
        told = split["told"]
        if told is None:
            continue
        totals = [f"{e['mae']:.3f} ({e['mae_low']:.3f} to {e['mae_high']:.3f})" for e in told["total"].values()]
        held = " / ".join(f"{100 * told['held'][a]:.0f}" for a in CHANNELS) if told["held"] else "-"
        apart = told["contacts"]
        each = f"{apart['mae']:.2f} N, {apart['percent']:.1f} % ({apart['n']})" if apart["n"] else "-"
        rows.append([name, split["n"], *totals, held, each])
    return rows


def tables(result: dict) -> list[dict]:
    """Tables of an evaluation for the report: title, columns, rows of text. The last two only where there are any."""
    groups = (("per_indenter", "per indenter"), ("per_force", "per normal force"), ("per_sensor", "per sensor"))
    found = [
        _totals_and_cells(result),
        _intervals(result),
        _controls(result),
        *(_groups(result, key, title) for key, title in groups),
    ]
    return found + [table for table in (_as_predicted(result), _references(result)) if table["rows"]]


def _table(title: str, columns: list[str], rows: list[list]) -> dict:
    return {"title": title, "columns": columns, "rows": rows}


def _with_bias(errors: dict) -> list[str]:
    """Mean absolute error and bias of each component as text."""
    return [f"{errors[a]['mae']:.3f} (bias {errors[a]['bias']:+.3f})" for a in CHANNELS]


def _totals_and_cells(result: dict) -> dict:
    rows = [
        [
            name,
            split["n"],
            *(f"{split['total'][a]['mae']:.3f} ± {split['total'][a]['std']:.3f}" for a in CHANNELS),
            *(cell_text(split["cell"], a) for a in CHANNELS),
        ]
        for name, split in result["splits"].items()
    ]
    title = "Mean absolute error, N: total and per cell (± deviation over images)"
    return _table(
        title, ["split", "images", *(f"total {a}" for a in CHANNELS), *(f"cell {a}" for a in CHANNELS)], rows
    )


def _intervals(result: dict) -> dict:
    rows = [
        [
            name,
            axis,
            f"{e['mae_low']:.3f} to {e['mae_high']:.3f}",
            f"{e['bias']:+.3f}",
            "-" if e["mae_percent_of_range"] is None else f"{e['mae_percent_of_range']:.2f}",
        ]
        for name, split in result["splits"].items()
        for axis, e in split["total"].items()
    ]
    title = "Total force: 95 % interval of the mean absolute error and bias, N; error in % of the force range"
    return _table(title, ["split", "component", "95 % interval", "bias", "% of range"], rows)


def _controls(result: dict) -> dict:
    rows = [
        [name, what.replace("_", " "), *(f"{values[a]:.3f}" for a in CHANNELS)]
        for name, split in result["splits"].items()
        for what, values in split["controls"].items()
    ]
    title = "What knows less than the network: mean absolute error of total force, N"
    return _table(title, ["split", "control", *CHANNELS], rows)


def _groups(result: dict, key: str, title: str) -> dict:
    rows = [
        [name, group, values["n"], *_with_bias(values)]
        for name, split in result["splits"].items()
        for group, values in split[key].items()
    ]
    return _table(f"Total force, mean absolute error {title}, N", ["split", "group", "images", *CHANNELS], rows)


def _as_predicted(result: dict) -> dict:
    title = "As `predict` tells it, with light, tare and dots: mean absolute error and its 95 % interval, N"
    return _table(title, PREDICTED_COLUMNS, predicted_rows(result))


def _references(result: dict) -> dict:
    rows = [
        [name, kind, who, pair["n"], *_with_bias(pair[who])]
        for name, split in result["splits"].items()
        for kind, pair in split["against"].items()
        for who in ("network", "labels")
    ]
    title = "Network and labels against the force sensor and against what a virtual rig knows, N"
    return _table(title, ["split", "reference", "who", "images", *CHANNELS], rows)
