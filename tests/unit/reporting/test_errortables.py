"""Tables of errors, of results whose every number is another: each cell shows those that its row and column name."""

import re
from collections import Counter

from gelforge.records.axes import CHANNELS, MOMENTS
from gelforge.records.samplefile import TEST, UNSEEN_SENSOR
from gelforge.reporting.errortables import tables
from gelforge.reporting.modelcard import write_card
from gelforge.reporting.networkchoice import WORDS, beside

ERRORS = ("mae", "std", "mae_low", "mae_high", "bias", "rms", "mae_percent_of_range")
# Paths of the numbers of each cell, by words of its table's title and a pattern of its column's name. {0}, {1}: what
# the pattern caught; others are the row's own cells.
SHOWN = {
    "total and per cell": {"images": "n", "(total|cell) (f.)": "{0}/{1}/mae {0}/{1}/std"},
    "95 % interval of": {
        "95 % interval": "total/{component}/mae_low total/{component}/mae_high", "bias": "total/{component}/bias",
        "% of range": "total/{component}/mae_percent_of_range", "coverage.*": "held/{component}",
    },
    "Baselines": {"(f.)": "controls/{baseline}/{0}"},
    **{
        f"error per {what}": {"images": f"{key}/{{group}}/n", "(f.)": f"{key}/{{group}}/{{0}}/mae {key}/{{group}}/{{0}}/bias"}
        for what, key in (("indenter", "per_indenter"), ("normal force", "per_force"), ("sensor", "per_sensor"))
    },
    "Moment": {"images": "{whose}/n", "(m.)": "{whose}/{0}/mae {whose}/{0}/bias"},
    "Network and labels": {
        "images": "against/{reference}/n", "(f.)": "against/{reference}/{who}/{0}/mae against/{reference}/{who}/{0}/bias",
    },
    "As `predict`": {
        "images of presses": "n presses", "(f.)": "total/{0}/mae total/{0}/mae_low total/{0}/mae_high", "per cell.*": "cell/*/mae",
        "coverage.*": "held/*", "each of.*": "contacts/mae contacts/percent contacts/n",
    },
}  # fmt: skip


NUMBER = re.compile(r"[+-]?\d{4}(?:\.\d+)?")
MODEL = {
    "data": {"simulated": True, "name": "lab", "version": "1", "samples": {}}, "also": [], "model": {"kind": "grid"}, "name": "mine",
    "image": (48, 64), "grid": (6, 8), "parameters": 1, "sensors": [], "known_sensors": [], "indenters": [], "curve": [],
    "best_epoch": 1, "train": {}, "tta": False, "normalisation": {"range": []},
}  # fmt: skip


def errors(names=CHANNELS, figures=ERRORS):
    return {name: dict.fromkeys(figures) for name in names}


def split():
    """All that `evaluate_split` gives, without its numbers."""
    grouped = {"n": None} | errors(figures=("mae", "bias"))
    turned = {"n": None} | errors(MOMENTS)
    who = {"network": errors(), "labels": errors(), "moment": {"network": turned, "labels": turned}}
    return {
        "n": None, "presses": None, "total": errors(), "held": dict.fromkeys(CHANNELS), "cell": errors(figures=("mae", "std")),
        "contacts": {"n": None, "mae": None, "percent": None}, "per_indenter": {"ball": grouped, "block": grouped},
        "per_force": {"00.0-05.0 N": grouped, "05.0+ N": grouped}, "per_sensor": {"mini_a": grouped, "mini_b": grouped},
        "controls": {name: dict.fromkeys(CHANNELS) for name in ("constant_guess", "shuffled_images")}, "moment": turned,
        "against": {kind: {"n": None} | who for kind in ("sensor", "truth")},
    }  # fmt: skip


def numbered(value, numbers, known, path=""):
    """A value whose every number is the next integer, whose path `known` gets; what is shown in % is its hundredth."""
    if isinstance(value, dict):
        return {key: numbered(each, numbers, known, f"{path}/{key}") for key, each in value.items()}
    known[number := next(numbers)] = path[1:]
    return number / (100 if "/held/" in path else 1)


def of_markdown(card):
    """The tables of a card as those of a report; the heading above is the title."""
    for part in card.split("\n## ")[1:]:
        title, *lines = part.splitlines()
        columns, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines if "|" in line)
        yield {"title": title, "columns": columns, "rows": rows}


def meant(title, row, column):
    """Paths of the numbers of a cell by SHOWN; none of a cell that names its row."""
    (columns,) = (columns for words, columns in SHOWN.items() if words in title)
    found = [(match, paths) for pattern, paths in columns.items() if (match := re.fullmatch(pattern, column))]
    assert found or column in ("split", "component", "baseline", "group", "reference", "who"), column
    names = {name: str(text).replace(" guess", "_guess").replace(" images", "_images") for name, text in row.items()}
    label = row.get("reference") == "label"
    names["whose"] = "moment" if label else f"against/{row.get('reference')}/moment/{row.get('who')}"
    for match, paths in found:
        for path in paths.split(" "):
            for axis in CHANNELS if "*" in path else ("",):
                yield f"{row['split']}/" + path.replace("*", axis).format(*match.groups(), **names)


def test_each_cell_shows_what_its_row_and_column_name_and_no_row_repeats_another():
    known: dict[int, str] = {}
    result = {"splits": numbered({TEST: split(), UNSEEN_SENSOR: split()}, iter(range(1000, 10_000)), known)}
    card = write_card(MODEL, result | {"judged_on": "lab", "fewest_drawn": 5}).partition("\n## Limits")[0]
    reported = tables(result)
    shown: Counter = Counter()
    for table in (*reported, *of_markdown(card)):
        once: Counter = Counter()
        for cells in table["rows"]:
            row = dict(zip(table["columns"], cells, strict=True))
            for column, text in row.items():
                paths = [*meant(table["title"], row, column)]
                found = [known.get(int(float(number))) for number in NUMBER.findall(str(text))] if paths else []
                assert found == paths, (table["title"], column)
                once.update(path for path in paths if not path.endswith("/n"))
        assert once.most_common(1)[0][1] == 1, table["title"]
        shown += once
    # all of them are there, but for what no table has
    assert {path for path in known.values() if path.endswith(("/mae", "/bias")) and path not in shown} == set()


def test_networks_stand_beside_each_other_and_the_paper_by_split_and_component():
    numbers, known = iter(range(1000, 10_000)), {}
    own, shipped = (
        {"splits": numbered(dict.fromkeys(WORDS, split()), numbers, known, f"/{who}")} for who in ("own", "shipped")
    )
    for split_name, (said, images, *errors_) in zip(WORDS, beside(own, shipped), strict=True):
        names = [f"{who}/{split_name}/total/{axis}/mae" for axis in CHANNELS for who in ("own", "shipped")]
        assert said == WORDS[split_name] and [known[number] for number in (images, *errors_)] == [
            f"own/{split_name}/n",
            *names,
        ]
