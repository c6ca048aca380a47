"""Model card in Markdown (web/card.md): a network's architecture, training data and errors."""

from collections.abc import Sequence

from gelforge.records.axes import CHANNELS
from gelforge.records.networkkind import kind_of
from gelforge.reporting.errortables import contacts_text, control_rows
from gelforge.reporting.page import WEB

FEW = 12  # most sensors that are named one by one


def listing(values: dict) -> str:
    """Settings as text, one after another."""
    parts = (
        f"{key} ({listing(value)})" if isinstance(value, dict) else f"{key} {value}" for key, value in values.items()
    )
    return ", ".join(parts)


def named(sensors: list[str]) -> str:
    """Names of sensors; beyond FEW, their number, the first and the last."""
    in_order = sorted(sensors, key=lambda name: (len(name), name))
    return ", ".join(sensors) if len(sensors) <= FEW else f"{len(sensors)} from {in_order[0]} to {in_order[-1]}"


def template(name: str):
    """A template of web/ for Markdown."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    read = Environment(
        loader=FileSystemLoader(WEB),
        trim_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
        autoescape=False,
    )
    read.filters |= {"listing": listing, "named": named, "contacts": contacts_text}
    return read.get_template(name)


def measured(figures: Sequence[dict], readings: Sequence[dict]) -> str:
    """The card's sections of figures that benchmarks measured, as Markdown (web/measured.md)."""
    return template("measured.md").render(figures=figures, readings=readings)


def write_card(metadata: dict, evaluation: dict, figures: Sequence[dict] = (), readings: Sequence[dict] = ()) -> str:
    """Return the card of a model as Markdown, from its metadata, its evaluation, and figures of benchmarks.

    readings: rows of benchmark-unseen on the errors left after a few readings of a force sensor.
    """
    datasets = [metadata["data"], *metadata["also"]]
    return template("card.md").render(
        model={"start": None} | metadata,
        pair=kind_of(metadata["model"]).pair,
        datasets=datasets,
        simulated=[data["simulated"] for data in datasets],
        intervals={"total": None, "real": None} | metadata.get("intervals", {}),
        evaluation=evaluation,
        baselines=control_rows(evaluation),
        figures=figures,
        readings=readings,
        channels=CHANNELS,
    )
