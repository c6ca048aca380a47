"""Render a self-contained HTML page from sections of text, tables and pictures."""

import base64
from dataclasses import dataclass, field
from pathlib import Path

from gelforge.reporting.parts import script_json

WEB = Path(__file__).parent / "web"
LOOK, COLOURS = WEB / "look.css", WEB / "colours.js"  # shared with the page of `gelforge live`


@dataclass
class Section:
    """A titled part of the page; `items` are dicts in the form that page.html expects."""

    title: str
    items: list[dict] = field(default_factory=list)

    def text(self, text: str, absent: bool = False) -> "Section":
        """Add a paragraph; `absent` marks missing results."""
        self.items.append({"kind": "text", "text": text, "absent": absent})
        return self

    def picture(self, png: bytes, caption: str, folded: bool = False) -> "Section":
        """Add a PNG with its caption; `folded` hides it under the caption."""
        data = base64.b64encode(png).decode()
        self.items.append({"kind": "picture", "data": data, "caption": caption, "folded": folded})
        return self

    def table(self, columns: list[str], rows: list[list], folded: str = "") -> "Section":
        """Add a table, floats with four significant digits; `folded` is a caption that hides it."""
        cells = [[show(c) for c in row] for row in rows]
        self.items.append({"kind": "table", "columns": columns, "rows": cells, "caption": folded})
        return self

    def code(self, text: str, caption: str) -> "Section":
        """Add text that is hidden under its caption."""
        self.items.append({"kind": "code", "text": text, "caption": caption})
        return self


def show(value) -> str:
    """A cell of a table as text."""
    if isinstance(value, float):
        return f"{value:.4g}"
    return "" if value is None else str(value)


@dataclass(frozen=True)
class Explored:
    """Input of the explorer of presses: its data, and the parts embedded in the page."""

    data: dict
    parts: list[str]


def render(dataset: str, lead: str, sections: list[Section], explored: Explored | None = None) -> str:
    """The page as text; apart from parts of presses beside it, it loads nothing, and all data is escaped."""
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
