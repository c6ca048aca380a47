"""A network of one's own beside the shipped one, on presses that neither learnt from: which is for which sensor."""

from collections.abc import Mapping
from typing import Any

from gelforge.records.axes import CHANNELS
from gelforge.records.samplefile import TEST, UNSEEN_BOTH, UNSEEN_INDENTER, UNSEEN_SENSOR

COLUMNS = ["presses", "images", *(f"{axis}, {who} (N)" for axis in CHANNELS for who in ("own", "shipped"))]
KNOWN, NEW = (TEST, UNSEEN_INDENTER), (UNSEEN_SENSOR, UNSEEN_BOTH)  # by sensor
WORDS = {
    TEST: "left out, sensors that it learnt from",
    UNSEEN_INDENTER: "shapes left out, sensors that it learnt from",
    UNSEEN_SENSOR: "sensors left out",
    UNSEEN_BOTH: "sensors and shapes left out",
}


def beside(own: Mapping[str, Any], shipped: Mapping[str, Any]) -> list[list]:
    """Rows under COLUMNS: mean absolute errors of total force of both evaluations, for the splits that both have."""
    rows = []
    for split in (*KNOWN, *NEW):
        pair = [of["splits"].get(split) for of in (own, shipped)]
        if all(pair):
            errors = [of["total"][axis]["mae"] for axis in CHANNELS for of in pair]
            rows.append([WORDS[split], pair[0]["n"], *errors])
    return rows


def choices(own: Mapping[str, Any], shipped: Mapping[str, Any], name: str) -> list[str]:
    """Sentences on which of the two to use for which sensors, by their error of normal force. name: of the own one."""
    said = []
    for kind, splits in (("that it learnt from", KNOWN), ("that it did not learn from", NEW)):
        pairs = [(own["splits"][split], shipped["splits"][split]) for split in splits
                 if split in own["splits"] and split in shipped["splits"]]  # fmt: skip
        count = sum(mine["n"] for mine, _ in pairs)
        if not count:
            continue
        mine, theirs = (
            sum(of["n"] * of["total"]["fz"]["mae"] for of in each) / count for each in zip(*pairs, strict=True)
        )
        sensors = sorted({sensor for of, _ in pairs for sensor in of["per_sensor"]})
        better = name if mine < theirs else "the shipped network"
        said.append(
            f"Sensors {kind} ({', '.join(sensors)}): use {better}. On {count} images of presses left out, the normal force of"
            f" {name} is off by {mine:.2f} N in the mean, that of the shipped network by {theirs:.2f} N."
        )
    if said and not any(split in own["splits"] for split in NEW):
        said.append(
            f"{name} was tried on no sensor that it did not learn from. Another sensor has other optics and another gel: use the"
            " shipped network there, until one is left out ([params.dataset] unseen_sensors) and says otherwise."
        )
    return said
