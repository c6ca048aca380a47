"""One self-contained HTML page from sections of text, tables and pictures."""

import base64
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Section:
    """A titled part of the page; `items` are dicts that page.html knows."""

    title: str
    items: list[dict] = field(default_factory=list)

    def text(self, text: str, absent: bool = False) -> "Section":
        """A paragraph; `absent` marks what was not made."""
        self.items.append({"kind": "text", "text": text, "absent": absent})
        return self

    def picture(self, png: bytes, caption: str) -> "Section":
        """A PNG with its caption."""
        self.items.append({"kind": "picture", "data": base64.b64encode(png).decode(), "caption": caption})
        return self

    def table(self, columns: list[str], rows: list[list]) -> "Section":
        """A table; floats are shown with four significant digits."""
        self.items.append({"kind": "table", "columns": columns, "rows": [[show(c) for c in row] for row in rows]})
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


def render(dataset: str, lead: str, sections: list[Section]) -> str:
    """The page as text; everything that came from data is escaped."""
    from jinja2 import Environment

    template = (Path(__file__).parent / "page.html").read_text(encoding="utf-8")
    return Environment(autoescape=True).from_string(template).render(dataset=dataset, lead=lead, sections=sections)
