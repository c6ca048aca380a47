"""Model card: what a network is, what it learnt from, and how wrong it is, in Markdown."""

from collections.abc import Sequence

from gelforge.networks.dotreader import MEMBERS
from gelforge.networks.errortables import PREDICTED_COLUMNS, predicted_rows
from gelforge.networks.evaluation import FEWEST_DRAWN
from gelforge.networks.inputs import needs_untouched
from gelforge.networks.modelfile import datasets_of
from gelforge.networks.stacking import MEMBERS as STACKED
from gelforge.records.axes import CHANNELS
from gelforge.records.splits import TRAINING

FEW = 12  # sensors that are named one by one
AXIS_NOTE = (
    "Forces act on the gel. Channels are FEATS': grid_x is the force along gel y (the long side, horizontal in the picture, "
    "positive to the left), grid_y along gel x (vertical, positive upwards), grid_z along the normal (pressing is negative)."
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


def interval_lines(about: dict) -> list[str]:
    """How wide intervals are, where the model knows any."""
    known = about.get("intervals", {})
    if "total" not in known:
        return []
    widths = ", ".join(
        f"{name} {base:.2f} N + {100 * share:.1f} % of it + {100 * of_whole:.1f} % of the whole force"
        for name, (base, share, of_whole) in known["total"].items()
    )
    return [
        f"- Intervals of total force that hold nine of ten, set on {named(known['sensors'])} of dataset {known['data']}:"
        f" +- {widths}.",
    ]


def data_lines(about: dict) -> list[str]:
    """The datasets that the model learnt from, its own first."""
    lines = []
    for at, data in enumerate(datasets_of(about)):
        samples = ", ".join(f"{count} {name}" for name, count in data["samples"].items())
        what = "Also learnt from" if at else "Data"
        lines.append(f"- {what}: {data['name']}, version {data['version']}; images: {samples}.")
    return lines


def origin_of(about: dict) -> str:
    """Whether presses that the model learnt from were simulated."""
    simulated = [data["simulated"] for data in datasets_of(about)]
    if all(simulated):
        return (
            "**It learnt from the virtual rig: simulated presses and rendered images, no real sensor.** Expect larger "
            "errors on a real one."
        )
    return (
        f"It learnt from recorded presses{', and from simulated ones of the virtual rig' if any(simulated) else ''}."
    )


def start_lines(about: dict) -> list[str]:
    """The network that it went on from, where it was not trained from weights drawn at random."""
    start = about.get("start")
    if not start:
        return []
    learnt = "simulated presses" if start["simulated"] else "recorded presses"
    return [
        f"- Began as the network {start['name']}, which learnt from {learnt} ({start['data']}), SHA-256 of its weights"
        f" {start['sha256'][:16]}; what it saw before is not listed here. Its weights lie {100 * start['share']:.0f} % of"
        " the way from that network's to those learnt here, as validation chose."
    ]


def way_lines(about: dict) -> list[str]:
    """How often the network reads a picture, where that is not once."""
    if not about.get("both_ways"):
        return []
    return [
        "- In `predict`, `live` and `gelforge.Reader` it reads a picture as it lies and turned by half; the mean counts."
    ]


def dot_lines(about: dict) -> list[str]:
    """How much the reader of dots has to say, where the model has one."""
    if not about.get("dots"):
        return []
    shares = " / ".join(f"{100 * weight:.0f} %" for weight in about["dots"]["weight"])
    return [
        f"- Beside it {MEMBERS} small networks read total force from the motion of the printed dots alone, which light cannot"
        f" move, as it is and turned by half. In `predict`, `live` and `gelforge.Reader` totals are a mean in which theirs has"
        f" {shares} ({' / '.join(CHANNELS)}).",
    ]


def place_lines(about: dict) -> list[str]:
    """That pictures of a gel that sits otherwise are put right, where the model has a reader of that."""
    places = about.get("places")
    if not places:
        return []
    return [
        "- A picture whose gel sits otherwise than in its untouched picture, shifted, turned or zoomed, is laid onto that"
        " before it is read: another small network tells by the printed dots, in all mirror images of their motion, how it"
        f" sits, whatever touches it. It learnt from {places['pictures']} pictures ({places['data']}).",
    ]


def stacking_lines(about: dict) -> list[str]:
    """That normal force is corrected by what stands above both readers, where the model has that."""
    above = about.get("stacking")
    if not above:
        return []
    learnt = " and from ".join(
        f"{one['presses']} presses that {'were new to the network' if one['new'] else 'it knew'}"
        f" ({one['name']}, version {one['version']}, {one['samples'][TRAINING]} pictures)"
        for one in sorted([above, *above["also"]], key=lambda one: not one["new"])
    )
    return [
        f"- Above both stand {STACKED} small networks, which tell by what factor the normal force that they tell together is"
        f" off. They learnt from {learnt}.",
    ]


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


def predicted_lines(evaluation: dict) -> list[str]:
    """What `predict` makes of the network, as lines; none for a network that reads one image alone."""
    rows = [[str(value) for value in row] for row in predicted_rows(evaluation)]
    title = "## As `predict` tells it: light, tare and dots included (mean absolute error, N; 95 % interval)"
    about = (
        "Tare: what the network reads in the untouched picture is taken off. Each of several contacts: mean error of one"
        " contact where a picture shows several, and the number of contacts."
    )
    return [title, "", about, "", *table(PREDICTED_COLUMNS, rows), ""] if rows else []


def control_rows(evaluation: dict) -> list[list[str]]:
    """One row per split and control: the total MAE that it reaches."""
    return [
        [split_name, control.replace("_", " "), *(f"{values[axis]:.3f}" for axis in CHANNELS)]
        for split_name, split in evaluation["splits"].items()
        for control, values in split["controls"].items()
    ]


def measured_rows(figures: list[dict]) -> list[str]:
    """Figures of benchmarks as lines, none where nothing was measured."""
    if not figures:
        return []
    rows = [
        [f["name"], f"{f['value']:.3g} {f['unit']}".strip(), f"{f['compare']} {f['goal']:g}", f["note"]]
        for f in figures
    ]
    title = ["## Elsewhere: units of the rig that it never saw, and real sensors", ""]
    about = "Aim: what the project wants; not every aim is met. Bare: the network alone, without correction of light and place and without the readers of dots."
    return [*title, about, "", *table(["figure", "measured", "aim", "note"], rows), ""]


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
    return [*title, *table(columns, rows), "", "In brackets: what four of five draws of readings lie between.", ""]


def between(mean: float, bounds: Sequence[float], digits: int) -> str:
    """A mean, and what four of five lie between."""
    low, high = bounds
    return f"{mean:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def about_lines(about: dict) -> list[str]:
    """What the network is and what it learnt from."""
    return [
        f"- Network: {listing(about['model'])}; {about['parameters']} parameters.",
        f"- Sensors seen: {named(about['sensors'])}; in its dataset: {named(about['known_sensors'])}.",
        f"- Indenters seen: {', '.join(about['indenters'])}.",
        *data_lines(about),
        f"- Training: best of {len(about['curve'])} epochs was {about['best_epoch']}; {listing(about['train'])}.",
        *start_lines(about),
        *interval_lines(about),
        *way_lines(about),
        *dot_lines(about),
        *stacking_lines(about),
        *place_lines(about),
        f"- {AXIS_NOTE}",
    ]


def limit_lines(about: dict) -> list[str]:
    """Where its forces hold, and what it flags."""
    return [
        f"- An image whose statistics lie further than {about['statistics']['threshold']:.2f} from the training "
        "images is flagged; the score sees colours, sharpness and dots, not whether a force is right.",
        "- Valid for the gel, the light and the forces it was trained on. From the least to the largest total these span "
        + ", ".join(
            f"{span:.1f} N ({axis})" for axis, span in zip(CHANNELS, about["normalisation"]["range"], strict=True)
        )
        + ": sideways about half of that either way. Forces beyond are extrapolation.",
    ]


def write_card(about: dict, evaluation: dict, figures: Sequence[dict] = (), readings: Sequence[dict] = ()) -> str:
    """Return the card of a model as Markdown, from its file's `about`, its evaluation, and figures of benchmarks.

    readings: what readings of a force sensor leave, of benchmark-unseen.
    """
    beside = ""
    if needs_untouched(about["normalisation"]["reads"]):
        beside = ", and a picture of the same sensor untouched,"
    lines = [
        f"# Model card: {about['name']}",
        "",
        f"Reads one image of an optical tactile sensor, {about['image'][1]} x {about['image'][0]} pixels (RGB){beside} and "
        f"tells the contact forces on its gel in N on a grid of {about['grid'][0]} x {about['grid'][1]} cells. "
        f"{origin_of(about)}",
        "",
        *about_lines(about),
        "",
        f"Errors are those on the pictures of dataset {evaluation['judged_on']}. Their intervals come from drawing"
        f" presses anew; in a split of {FEWEST_DRAWN} sensors or more, none of which it learnt from, from drawing sensors anew.",
        "",
        *predicted_lines(evaluation),
        "## The network alone: error of total force (mean absolute, N; 95 % interval) and per cell",
        "",
        *table(["split", "images of presses", *CHANNELS, f"per cell {' / '.join(CHANNELS)}"], error_rows(evaluation)),
        "",
        "## What knows less (mean absolute error, N)",
        "",
        "Guesses that know no more of a picture than its mean colours; a network must be far better.",
        "",
        *table(["split", "control", *CHANNELS], control_rows(evaluation)),
        "",
        *measured_rows(list(figures)),
        *readings_rows(list(readings)),
        "## Limits",
        "",
        *limit_lines(about),
    ]
    return "\n".join(lines) + "\n"
