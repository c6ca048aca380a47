"""Tables of measured figures in README.md, rendered from the JSON of the benchmarks: make benchmark-tables."""

import re

from gelforge.flow.files import read_json, write_text
from tests.support.figures import ROOT, digest_of_sources

PAGE = "README.md"
KEPT = ROOT / "results" / "benchmarks"
BLOCK = re.compile(r"(<!-- figures: (.+?) -->\n)(.*?)(<!-- end of figures -->)", re.DOTALL)
FIELD = re.compile(r"\{(\w+): (.+?)\|(\.\d[fg])\}")  # {benchmark: name of a figure|format}

# Tables of chosen figures: what stands between { and } is taken from the JSON.
CHOSEN = {
    "accuracy of labels": """
| `method` | seconds a press | 16 presses, total force: median, worst | force per cell: median, worst | 58 presses of known force, at least 0.1 mm deep: median, worst |
| --- | --- | --- | --- | --- |
| `ccx` (CalculiX), the default | {fea: ccx, 16 scenes, median processor time|.2g} | {fea: ccx, 16 scenes, total force, median|.2g} %, {fea: ccx, 16 scenes, total force, worst|.2g} % | {fea: ccx, 16 scenes, cells, median|.2g} %, {fea: ccx, 16 scenes, cells, worst|.2g} % | {exact: ccx, total, median|.2g} %, {exact: ccx, total, worst|.2g} % |
| `label` (hexahedra in process) | {fea: label, 16 scenes, median processor time|.2g} | {fea: label, 16 scenes, total force, median|.2g} %, {fea: label, 16 scenes, total force, worst|.2g} % | {fea: label, 16 scenes, cells, median|.2g} %, {fea: label, 16 scenes, cells, worst|.2g} % | {exact: label, total, median|.2g} %, {exact: label, total, worst|.2g} % |
""",
    "accuracy on real sensors": """
| measured | value |
| --- | --- |
| presses of a ball, predicted force divided by that of finite elements: median; 10 % and 90 % quantile divided by the median; correlation of both forces | {real: real balls, read over finite elements, median: at least|.2f}; {real: real balls, read over finite elements: over the median, 10 %|.2f} to {real: real balls, read over finite elements: over the median, 90 %|.2f}; {real: real balls, read over finite elements: correlation|.2f} |
| the same, factor of a profile from every other press | {real: real balls, factor of every other press, median: at least|.2f}; {real: real balls, factor of every other press: over the median, 10 %|.2f} to {real: real balls, factor of every other press: over the median, 90 %|.2f}; {real: real balls, factor of every other press: correlation|.2f} |
| FEATS' 51 images, predicted force divided by that of FEATS' map: median; standard deviation of its natural logarithm | {real: the same at 0.30 N a cell, median: at least|.2f}; {real: totals over FEATS' maps, deviation of the logarithm|.2f} |
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


def rendered(text: str) -> str:
    """A page with its tables made anew."""

    def block(found: re.Match) -> str:
        return f"{found[1]}{chosen(CHOSEN[found[2]])}\n{found[4]}"

    return BLOCK.sub(block, text)


def outdated() -> list[str]:
    """Benchmarks with figures of other sources than those that lie here."""
    names = sorted(path.stem for path in KEPT.glob("*.json"))
    return [name for name in names if {f["sources"] for f in read_figures(name)} != {digest_of_sources(name)}]


if __name__ == "__main__":
    write_text(ROOT / PAGE, rendered((ROOT / PAGE).read_text(encoding="utf-8")))
    print("measured on other sources than today's:", ", ".join(outdated()) or "none")
