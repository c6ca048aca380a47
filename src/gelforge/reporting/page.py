"""One self-contained HTML page from sections of text, tables and pictures."""

import base64
from dataclasses import dataclass, field
from pathlib import Path

from gelforge.reporting.parts import script_json

WEB = Path(__file__).parent / "web"
LOOK, COLOURS = WEB / "look.css", WEB / "colours.js"  # of this page and of a running sensor's


@dataclass
class Section:
    """A titled part of the page; `items` are dicts that page.html knows."""

    title: str
    items: list[dict] = field(default_factory=list)

    def text(self, text: str, absent: bool = False) -> "Section":
        """A paragraph; `absent` marks what was not made."""
        self.items.append({"kind": "text", "text": text, "absent": absent})
        return self

    def picture(self, png: bytes, caption: str, folded: bool = False) -> "Section":
        """A PNG with its caption, folded away under it where few look at it."""
        data = base64.b64encode(png).decode()
        self.items.append({"kind": "picture", "data": data, "caption": caption, "folded": folded})
        return self

    def table(self, columns: list[str], rows: list[list], folded: str = "") -> "Section":
        """A table, floats with four significant digits; `folded` is the caption it is folded away under."""
        cells = [[show(c) for c in row] for row in rows]
        self.items.append({"kind": "table", "columns": columns, "rows": cells, "caption": folded})
        return self

    def code(self, text: str, caption: str) -> "Section":
        """Text folded away under its caption."""
        self.items.append({"kind": "code", "text": text, "caption": caption})
        return self


def show(value) -> str:
    """A cell of a table as text."""
    if isinstance(value, float):
        return f"{value:.4g}"
    return "" if value is None else str(value)


@dataclass(frozen=True)
class Explored:
    """What the explorer of presses is given: its data, and the parts that the page itself holds."""

    data: dict
    parts: list[str]


def render(dataset: str, lead: str, sections: list[Section], explored: Explored | None = None) -> str:
    """The page as text, one file that asks for nothing from outside; everything that came from data is escaped."""
    from jinja2 import Environment
    from markupsafe import Markup

    def asset(name: str) -> Markup:
        return Markup((WEB / name).read_text(encoding="utf-8"))

    scripts = [asset("tables.js")]
    if explored is not None:
        data = Markup(f"const DATA = {script_json(explored.data)};")
        scripts += [
            data,
            *map(asset, ("three.js", COLOURS.name, "explore.js", "charts.js")),
            *map(Markup, explored.parts),
        ]
    template = Environment(autoescape=True, trim_blocks=True).from_string(asset("page.html"))
    return template.render(
        dataset=dataset,
        lead=lead,
        sections=sections,
        explorer=explored is not None,
        scripts=scripts,
        style=Markup(LOOK.read_text(encoding="utf-8")),
    )
