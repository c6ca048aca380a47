"""Measured figures in README.md and in the shipped network's card, from the JSON of the benchmarks: make benchmark-tables."""

import re
from pathlib import Path

from gelforge.flow.files import read_json, write_text
from gelforge.reading.model import SHIPPED, fingerprint, load_model
from gelforge.reporting.modelcard import measured
from tests.support.figures import ROOT, digest_of_sources

PAGE, CARD = ROOT / "README.md", SHIPPED.with_suffix(".md")
KEPT = ROOT / "results" / "benchmarks"
SECTIONS = re.compile(r"(?<=\n)## Benchmarks: .*?(?=## Limits\n)", re.DOTALL)  # of the card
BLOCK = re.compile(r"(<!-- figures: (.+?) -->\n)(.*?)(<!-- end of figures -->)", re.DOTALL)
FIELD = re.compile(r"\{(\w+): (.+?)\|(\.\d[fg])\}")  # {benchmark: name of a figure|format}

# Tables of chosen figures: what stands between { and } is taken from the JSON.
CHOSEN = {
    "ten figures that decide use": """
| figure | value | limit |
| --- | --- | --- |
| total force by `ccx`, error: median, worst | {exact: ccx, total, median|.2g} %, {exact: ccx, total, worst|.2g} % | 58 presses of known force, from 0.1 mm deep, that stick or have no friction |
| total force by `label`, the same | {exact: label, total, median|.2g} %, {exact: label, total, worst|.2g} % | hexahedra in process, no CalculiX |
| force per cell by `ccx`, error: median, worst | {fea: ccx, 16 scenes, cells, median|.2g} %, {fea: ccx, 16 scenes, cells, worst|.2g} % | summed over cells, 16 presses, against the finest meshes; `label`: {fea: label, 16 scenes, cells, worst|.2g} % at worst |
| presses whose stated error holds, `ccx` | {exact: ccx, presses within their stated error|.2g} % | it is of the mesh, not of your gel, friction, zero or tilt |
| time of a press: `ccx`, `label` | {fea: ccx, 16 scenes, median processor time|.2g}, {fea: label, 16 scenes, median processor time|.2g} s | one core, median; presses that slide take longer |
| stiffness C10, error | {calibration: demo, C10, difference from the hidden one|.2g} % | 12 presses of a simulated bench, solved by the same mechanics |
| read force of real balls over that of finite elements: median; eight of ten, over this median | {real: real balls, read over finite elements, median: at least|.2f}; {real: real balls, read over finite elements: over the median, 10 %|.2f} to {real: real balls, read over finite elements: over the median, 90 %|.2f} | one sensor, little range of force (correlation {real: real balls, read over finite elements: correlation|.2f}) |
| the same with a factor from every other press | {real: real balls, factor of every other press, median: at least|.2f}; {real: real balls, factor of every other press: over the median, 10 %|.2f} to {real: real balls, factor of every other press: over the median, 90 %|.2f} | a profile corrects the level, not the scatter |
| read force over the consensus of 28 of FEATS' presses: median; deviation of its natural logarithm | {real: totals over the consensus, median: at least|.2f}; {real: totals over the consensus, deviation of the logarithm|.2f} | one sensor; mean of two estimates, by shading and by markers, which themselves differ by 0.31 |
| bad image pairs that are flagged | {unseen: pairs that are read wrong by over 15 % of the range and flagged|.2g} % | drawn sensors, pairs read wrong by over 15 % of the range; {unseen: good pairs that are flagged|.2g} % of good drawn pairs and {real: good FEATS' presses flagged|.2g} % of FEATS' presses are, too |
""",
}  # fmt: skip


def read_figures(name: str) -> list[dict]:
    """Figures of a benchmark, as its JSON keeps them; none where there is no such file."""
    path = KEPT / f"{name}.json"
    return read_json(path)["figures"] if path.exists() else []


def number(figure: dict, form: str) -> str:
    """A figure's value without its unit; "low to high" where it was measured on several machines."""
    ends = [figure["value"], *([figure["highest"]] if figure.get("highest") is not None else [])]
    return " to ".join(f"{float(format(end, form)):g}" if form[-1] == "g" else format(end, form) for end in ends)


def chosen(text: str) -> str:
    """A table with the values in the place of the fields."""

    def value(field: re.Match) -> str:
        found = {figure["name"]: figure for figure in read_figures(field[1])}
        return number(found[field[2]], field[3])

    return FIELD.sub(value, text).strip()


def rendered_card(text: str) -> str:
    """The shipped network's card with the figures that were measured of it."""
    model = fingerprint(load_model(SHIPPED).metadata)
    of = [found for name in ("unseen", "real") if (found := read_json(KEPT / f"{name}.json"))["model"] == model]
    figures, readings = ([row for found in of for row in found.get(key, [])] for key in ("figures", "readings"))
    return SECTIONS.sub(lambda _: measured(figures, readings), text)


def rendered(text: str) -> str:
    """A page with its tables made anew."""

    def block(found: re.Match) -> str:
        return f"{found[1]}{chosen(CHOSEN[found[2]])}\n{found[4]}"

    return BLOCK.sub(block, text)


def generated() -> dict[Path, str]:
    """Files with measured figures, and their text."""
    return {path: make(path.read_text(encoding="utf-8")) for path, make in ((PAGE, rendered), (CARD, rendered_card))}


def outdated() -> list[str]:
    """Benchmarks with figures of other sources than those that lie here."""
    names = sorted(path.stem for path in KEPT.glob("*.json"))
    return [name for name in names if {f["sources"] for f in read_figures(name)} != {digest_of_sources(name)}]


if __name__ == "__main__":
    for path, text in generated().items():
        write_text(path, text)
    print("measured on other sources than today's:", ", ".join(outdated()) or "none")
