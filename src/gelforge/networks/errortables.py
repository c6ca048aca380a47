"""Tables of a network's errors for the report."""

from gelforge.records.axes import CHANNELS


def cell_text(table: dict | None, axis: str) -> str:
    """Mean and deviation as the paper prints them."""
    return "-" if table is None else f"{table[axis]['mae']:.4f} ± {table[axis]['std']:.4f}"


TOLD_COLUMNS = ["split", "images", *(f"total {a}" for a in CHANNELS), "intervals hold, %", "each of several contacts"]


def told_rows(result: dict) -> list[list]:
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
            "-" if e["mae_percent_of_range"] is None else f"{e['mae_percent_of_range']:.2f}",
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
    found: list[dict] = [
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
        found.append(
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
    if told := told_rows(result):
        found.append(
            {
                "title": "As `predict` tells it, with light, tare and dots: mean absolute error and its 95 % interval, N",
                "columns": TOLD_COLUMNS,
                "rows": told,
            }
        )
    if against:
        found.append(
            {
                "title": "Network and labels against the force sensor and against what a virtual rig knows, N",
                "columns": ["split", "reference", "who", "images", *CHANNELS],
                "rows": against,
            }
        )
    return found
