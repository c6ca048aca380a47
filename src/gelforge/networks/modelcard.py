"""Model card: what a network is, what it learnt from, and how wrong it is, in Markdown."""

from gelforge.networks.inputs import needs_untouched
from gelforge.records.axes import CHANNELS

AXIS_NOTE = (
    "Forces act on the gel, compression is negative z. Channels are FEATS': grid_x is the force along the "
    "image's columns (gel y, the long side), grid_y along its rows (gel x), grid_z along the gel's normal."
)


def table(header: list[str], rows: list[list[str]]) -> list[str]:
    """A Markdown table as lines."""
    return ["| " + " | ".join(line) + " |" for line in (header, ["---"] * len(header), *rows)]


def listing(values: dict) -> str:
    """Settings as text, one after another."""
    parts = (
        f"{key} ({listing(value)})" if isinstance(value, dict) else f"{key} {value}" for key, value in values.items()
    )
    return ", ".join(parts)


def error_rows(evaluation: dict) -> list[list[str]]:
    """One row per split: count, total MAE with its interval and per-cell MAE."""
    rows = []
    for name, split in evaluation["splits"].items():
        row = [name, f"{split['n']} of {split['presses']}"]
        for axis in CHANNELS:
            e = split["total"][axis]
            row.append(f"{e['mae']:.3f} ({e['mae_low']:.3f} to {e['mae_high']:.3f})")
        row.append(" / ".join(f"{split['cell'][axis]['mae']:.5f}" for axis in CHANNELS) if split["cell"] else "-")
        rows.append(row)
    return rows


def control_rows(evaluation: dict) -> list[list[str]]:
    """One row per split and control: the total MAE that it reaches."""
    return [
        [split_name, control.replace("_", " "), *(f"{values[axis]:.3f}" for axis in CHANNELS)]
        for split_name, split in evaluation["splits"].items()
        for control, values in split["controls"].items()
    ]


def write_card(about: dict, evaluation: dict) -> str:
    """Return the card of a model as Markdown, from its file's `about` and its evaluation."""
    data = about["data"]
    origin = (
        "**It learnt from the virtual rig: simulated presses and rendered images, no real sensor.** Expect larger "
        "errors on a real one."
        if data["simulated"]
        else "It learnt from recorded presses."
    )
    beside = ""
    if needs_untouched(about["normalisation"]["reads"]):
        beside = " beside a picture of the same sensor untouched"
    samples = ", ".join(f"{count} {name}" for name, count in data["samples"].items())
    lines = [
        f"# Model card: {about['name']}",
        "",
        f"Reads the contact forces on an optical tactile gel from one image of {about['image'][1]} x "
        f"{about['image'][0]} pixels (RGB){beside} as a grid of {about['grid'][0]} x {about['grid'][1]} cells in N. "
        f"{origin}",
        "",
        f"- Network: {listing(about['model'])}; {about['parameters']} parameters.",
        f"- Sensors seen: {', '.join(about['sensors'])}; in its dataset: {', '.join(about['known_sensors'])}.",
        f"- Indenters seen: {', '.join(about['indenters'])}.",
        f"- Data: {data['name']}, version {data['version']}; images: {samples}.",
        f"- Training: best of {len(about['curve'])} epochs was {about['best_epoch']}; {listing(about['train'])}.",
        f"- {AXIS_NOTE}",
        "",
        "## Error of total force (mean absolute, N; 95 % interval over presses) and per cell",
        "",
        *table(["split", "images of presses", *CHANNELS, f"per cell {' / '.join(CHANNELS)}"], error_rows(evaluation)),
        "",
        "## What knows less (mean absolute error, N)",
        "",
        *table(["split", "control", *CHANNELS], control_rows(evaluation)),
        "",
        "## Limits",
        "",
        f"- An image whose statistics lie further than {about['statistics']['threshold']:.2f} from the training "
        "images is flagged; the score sees colours, sharpness and dots, not whether a force is right.",
        "- Valid for the gel, the light and the range of forces it was trained on; forces beyond "
        + ", ".join(f"{axis} {span:.1f} N (span)" for axis, span in evaluation["force_range"].items())
        + " are extrapolation.",
    ]
    return "\n".join(lines) + "\n"
