"""Tables of a network's errors for the report."""

from collections.abc import Sequence

from gelforge.records.axes import CHANNELS, MOMENTS


def cell_text(table: dict | None, axis: str) -> str:
    """Mean absolute error ± standard deviation, as the paper prints them."""
    return "-" if table is None else f"{table[axis]['mae']:.4f} ± {table[axis]['std']:.4f}"


def contacts_text(found: dict) -> str:
    """Error per contact of images with several contacts."""
    return f"{found['mae']:.2f} N, {found['percent']:.1f} % ({found['n']})" if found["n"] else "-"


def tables(result: dict) -> list[dict]:
    """Tables of an evaluation for the report: title, columns, rows of text. Moments and references are last, if there are any."""
    groups = (("per_indenter", "per indenter"), ("per_force", "per normal force"), ("per_sensor", "per sensor"))
    found = [
        _totals_and_cells(result),
        _intervals(result),
        _controls(result),
        *(_groups(result, key, title) for key, title in groups),
    ]
    return found + [table for table in (_moments(result), _references(result)) if table["rows"]]


def _table(title: str, columns: list[str], rows: list[list]) -> dict:
    return {"title": title, "columns": columns, "rows": rows}


def _with_bias(errors: dict, names: Sequence[str] = CHANNELS) -> list[str]:
    """Mean absolute error and bias of each component as text."""
    return [f"{errors[a]['mae']:.3f} (bias {errors[a]['bias']:+.3f})" for a in names]


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
            f"{100 * split['held'][axis]:.0f}" if split["held"] else "-",
        ]
        for name, split in result["splits"].items()
        for axis, e in split["total"].items()
    ]
    title = "Total force: 95 % interval of the mean absolute error and bias, N; error in % of the force range"
    return _table(
        title, ["split", "component", "95 % interval", "bias", "% of range", "coverage of 90 % intervals, %"], rows
    )


def _moments(result: dict) -> dict:
    """Moments against the labels, the force sensor and the true moments of a virtual rig, of all images that have them."""
    rows = []
    for name, split in result["splits"].items():
        pairs = [("label", "network", split["moment"])]
        pairs += [
            (kind, who, pair["moment"][who])
            for kind, pair in split["against"].items()
            for who in ("network", "labels")
        ]
        rows += [
            [name, reference, who, found["n"], *_with_bias(found, MOMENTS)]
            for reference, who, found in pairs
            if found["n"]
        ]
    title = "Moment about the gel's apex, mean absolute error, N mm"
    return _table(title, ["split", "reference", "who", "images", *MOMENTS], rows)


def control_rows(result: dict) -> list[list[str]]:
    """One row per split and baseline, with the baseline's mean absolute error of total force."""
    return [
        [name, what.replace("_", " "), *(f"{values[a]:.3f}" for a in CHANNELS)]
        for name, split in result["splits"].items()
        for what, values in split["controls"].items()
    ]


def _controls(result: dict) -> dict:
    title = "Baselines: mean absolute error of total force, N"
    return _table(title, ["split", "baseline", *CHANNELS], control_rows(result))


def _groups(result: dict, key: str, title: str) -> dict:
    rows = [
        [name, group, values["n"], *_with_bias(values)]
        for name, split in result["splits"].items()
        for group, values in split[key].items()
    ]
    return _table(f"Total force, mean absolute error {title}, N", ["split", "group", "images", *CHANNELS], rows)


def _references(result: dict) -> dict:
    rows = [
        [name, kind, who, pair["n"], *_with_bias(pair[who])]
        for name, split in result["splits"].items()
        for kind, pair in split["against"].items()
        for who in ("network", "labels")
    ]
    title = "Network and labels against the force sensor and against the virtual rig's true forces, N"
    return _table(title, ["split", "reference", "who", "images", *CHANNELS], rows)
