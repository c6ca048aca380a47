"""Model card: what a network is, what it learnt from, and how wrong it is, in Markdown."""

from collections.abc import Sequence

from gelforge.records.axes import CHANNELS
from gelforge.records.networkkind import kind_of
from gelforge.reporting.errortables import contacts_text, control_rows

FEW = 12  # sensors that are named one by one
COLUMNS = [
    "split", "images of presses", *CHANNELS, f"per cell {' / '.join(CHANNELS)}", "90 % intervals hold, %",
    "each of several contacts",
]  # fmt: skip
AXIS_NOTE = (
    "Forces act on the gel. In an image fx, along gel x (the short side), is vertical and positive upwards, fy, along gel y (the "
    "long side), is horizontal and positive to the left; fz is along the normal (pressing is negative)."
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


def named(sensors: list[str]) -> str:
    """Names of sensors, or of many how many, the first and the last."""
    in_order = sorted(sensors, key=lambda name: (len(name), name))
    return ", ".join(sensors) if len(sensors) <= FEW else f"{len(sensors)} from {in_order[0]} to {in_order[-1]}"


def interval_lines(metadata: dict) -> list[str]:
    """How wide intervals are, where the model knows any."""
    known = metadata.get("intervals", {})
    if "total" not in known:
        return []
    widths = ", ".join(
        f"{name} {base:.2f} N + {100 * fraction:.1f} % of it + {100 * of_whole:.1f} % of the whole force"
        for name, (base, fraction, of_whole) in known["total"].items()
    )
    lines = [
        f"- 90 % prediction intervals of total force, set on {named(known['sensors'])} of dataset {known['data']}:"
        f" +- {widths}.",
    ]
    if real := known.get("real"):
        lines.append(
            f"- Beside that, of the force that is read: {100 * real['unprofiled']:.0f} % without a profile of the sensor and"
            f" {100 * real['profiled']:.0f} % with one, by what real sensors showed (`make benchmark-real`)."
        )
    return lines


def data_lines(metadata: dict) -> list[str]:
    """The datasets that the model learnt from, its own first."""
    lines = []
    for at, data in enumerate([metadata["data"], *metadata["also"]]):
        samples = ", ".join(f"{count} {name}" for name, count in data["samples"].items())
        what = "Also learnt from" if at else "Data"
        lines.append(f"- {what}: {data['name']}, version {data['version']}; images: {samples}.")
    return lines


def origin_of(metadata: dict) -> str:
    """Whether presses that the model learnt from were simulated."""
    simulated = [data["simulated"] for data in [metadata["data"], *metadata["also"]]]
    if all(simulated):
        return (
            "**It learnt from the virtual rig: simulated presses and rendered images, no real sensor.** Expect larger "
            "errors on a real one."
        )
    return (
        f"It learnt from recorded presses{', and from simulated ones of the virtual rig' if any(simulated) else ''}."
    )


def start_lines(metadata: dict) -> list[str]:
    """The network that it was fine-tuned from, where it was not trained from weights drawn at random."""
    start = metadata.get("start")
    if not start:
        return []
    digest = start.get("sha256", "unknown")
    learnt = "simulated presses" if start["simulated"] else "recorded presses"
    return [
        f"- Fine-tuned from the network {start['name']}, which learnt from {learnt} ({start['data']}), SHA-256"
        f" {digest[:16]}; what it saw before is not listed here. Its weights lie {100 * start['fraction']:.0f} % of"
        " the way from that network's to those learnt here."
    ]


def tta_lines(metadata: dict) -> list[str]:
    """Whether the network reads a picture twice."""
    return (
        ["- Test-time augmentation: it predicts the mean over a picture and the same rotated by 180 degrees."]
        if metadata["tta"]
        else []
    )


def error_rows(evaluation: dict) -> list[list[str]]:
    """One row per split: count, total MAE with its interval, MAE per cell, coverage, single contacts."""
    rows = []
    for name, split in evaluation["splits"].items():
        row = [name, f"{split['n']} of {split['presses']}"]
        for axis in CHANNELS:
            e = split["total"][axis]
            row.append(f"{e['mae']:.3f} ({e['mae_low']:.3f} to {e['mae_high']:.3f})")
        row.append(" / ".join(f"{split['cell'][axis]['mae']:.5f}" for axis in CHANNELS) if split["cell"] else "-")
        row.append(" / ".join(f"{100 * split['held'][axis]:.0f}" for axis in CHANNELS) if split["held"] else "-")
        row.append(contacts_text(split["contacts"]))
        rows.append(row)
    return rows


def measured_rows(figures: list[dict]) -> list[str]:
    """Figures of benchmarks as lines, none where nothing was measured."""
    if not figures:
        return []
    rows = [[f["name"], f"{f['value']:.3g} {f['unit']}".strip(), goal_of(f), f["note"]] for f in figures]
    title = ["## Benchmarks: units of the rig that it never saw, and real sensors", ""]
    terms = "Bare: the network alone, without photometric normalisation and tare."
    return [*title, terms, "", *table(["figure", "measured", "goal", "note"], rows), ""]


def goal_of(figure: dict) -> str:
    """The goal of a benchmark's figure; empty for none."""
    if not figure["compare"]:
        return ""
    return f"{figure['compare']} {figure['goal']:g}{'' if figure['met'] else ', **missed**'}"


def readings_rows(left: list[dict]) -> list[str]:
    """What readings of a force sensor leave of a gel's error, as lines, none where it was not measured."""
    if not left:
        return []
    rows = [
        [str(row["readings"]), between(row["factor_percent"], row["factor_between"], 1),
         between(row["force_n"], row["force_between"], 2), f"{row['held_percent']:.0f}"]
        for row in left
    ]  # fmt: skip
    title = ["## A gel up to 15 % softer or harder, by readings of a scale or force sensor (`gelforge sensor`)", ""]
    columns = ["readings", "error of its factor, %", "error of normal force, N", "intervals hold it, %"]
    return [
        *title,
        *table(columns, rows),
        "",
        "In brackets: the range of four of five random choices of readings.",
        "",
    ]


def between(mean: float, bounds: Sequence[float], digits: int) -> str:
    """A mean, and what four of five lie between."""
    low, high = bounds
    return f"{mean:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def about_lines(metadata: dict) -> list[str]:
    """What the network is and what it learnt from."""
    return [
        f"- Network: {listing(metadata['model'])}; {metadata['parameters']} parameters.",
        f"- Sensors seen: {named(metadata['sensors'])}; in its dataset: {named(metadata['known_sensors'])}.",
        f"- Indenters seen: {', '.join(metadata['indenters'])}.",
        *data_lines(metadata),
        f"- Training: best of {len(metadata['curve'])} epochs was {metadata['best_epoch']}; {listing(metadata['train'])}.",
        *start_lines(metadata),
        *interval_lines(metadata),
        *tta_lines(metadata),
        f"- {AXIS_NOTE}",
    ]


def limit_lines(metadata: dict) -> list[str]:
    """Where its forces hold, and what it flags."""
    return [
        f"- An image whose statistics lie further than {metadata['statistics']['threshold']:.2f} from the training "
        "images is flagged; the score sees colours, sharpness and markers, not whether a force is right.",
        "- Valid for the gel, the light and the forces it was trained on. From the least to the largest total these span "
        + ", ".join(
            f"{span:.1f} N ({axis})" for axis, span in zip(CHANNELS, metadata["normalisation"]["range"], strict=True)
        )
        + ": sideways about half of that either way. Forces beyond are extrapolation.",
    ]


def write_card(metadata: dict, evaluation: dict, figures: Sequence[dict] = (), readings: Sequence[dict] = ()) -> str:
    """Return the card of a model as Markdown, from its metadata, its evaluation, and figures of benchmarks.

    readings: what readings of a force sensor leave, of benchmark-unseen.
    """
    beside = ""
    if kind_of(metadata["model"]).pair:
        beside = ", and a no-contact image of the same sensor,"
    lines = [
        f"# Model card: {metadata['name']}",
        "",
        f"Reads one image of an optical tactile sensor, {metadata['image'][1]} x {metadata['image'][0]} pixels (RGB){beside} and "
        f"predicts the contact forces on its gel in N on a grid of {metadata['grid'][0]} x {metadata['grid'][1]} cells. "
        f"{origin_of(metadata)}",
        "",
        *about_lines(metadata),
        "",
        f"Errors are those on the images of dataset {evaluation['judged_on']}. Their intervals are bootstrapped over presses; in a"
        f" split of {evaluation['fewest_drawn']} sensors or more, none of which it learnt from, over sensors.",
        "",
        "## As `predict` uses it: error of total force (mean absolute, N; 95 % interval), per cell, and coverage of intervals",
        "",
        *table(COLUMNS, error_rows(evaluation)),
        "",
        "## Baselines (mean absolute error, N)",
        "",
        "A useful network must clearly beat these baselines, which see only the mean colours of an image.",
        "",
        *table(["split", "baseline", *CHANNELS], control_rows(evaluation)),
        "",
        *measured_rows(list(figures)),
        *readings_rows(list(readings)),
        "## Limits",
        "",
        *limit_lines(metadata),
    ]
    return "\n".join(lines) + "\n"
