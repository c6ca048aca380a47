"""The page workflow/guide/parameters.md, from the tables of parameters and the comments of workflow/params.toml."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gelforge.flow.files import read_toml
from gelforge.flow.schema import allowed, is_table, kinds_of, split
from gelforge.flow.tables import Params

HEAD = """# Parameters

Made by `make format` from `src/gelforge/flow/tables.py` and `workflow/params.toml`. A dataset sets its own values in
`data/DATASET/dataset.toml`, under `[params.TABLE]`; an unknown key, or a value that is not allowed, is refused by name.
"""


def comments(text: str) -> dict[str, str]:
    """The comment above each key and table of a TOML file, by its full name; keys that follow at once share the one above."""
    found: dict[str, str] = {}
    table, said, complete = "", "", False
    for line in text.splitlines():
        if not line and not complete:
            said = ""  # of no key or table
        elif line.startswith("#"):
            said, complete = f"{'' if complete else said} {line.lstrip('# ')}".strip(), False
        elif head := re.fullmatch(r"\[([\w.]+)\]\s*(?:#.*)?", line):
            table = head[1]
            found[table], said = "" if complete else said, ""
        elif key := re.match(r"(\w+)\s*=", line):
            found[f"{table}.{key[1]}"], complete = said, True
    return found


def keys(kind: Any, name: str = "") -> Iterator[tuple[str, str, Any]]:
    """Table, key and kind of every key, tables within tables after their own keys."""
    inner = [(key, hint) for key, hint in kinds_of(kind).items() if is_table(split(hint)[0])]
    yield from ((name, key, hint) for key, hint in kinds_of(kind).items() if (key, hint) not in inner)
    for key, hint in inner:
        yield from keys(split(hint)[0], f"{name}.{key}".lstrip("."))


def page(params_toml: Path) -> str:
    """The page, as Markdown: each comment once, below it the keys that it is about."""
    given, why = read_toml(params_toml), comments(params_toml.read_text(encoding="utf-8"))
    blocks, last = [HEAD.strip()], ("", "")
    for table, key, hint in keys(Params):
        name = f"{table}.{key}"
        inner = next((said for one, said in why.items() if one.startswith(f"{name}.") and said), last[1])
        said = why[name] if why.get(name) else inner
        if table != last[0]:
            blocks += filter(None, [f"## [{table}]", why.get(table)])
        if (table, said) != last:
            blocks += [*[said] * bool(said and said != last[1]), ""]
        last = (table, said)
        values: Any = given
        for part in table.split("."):
            values = values[part]
        default = f" = {json.dumps(values[key], ensure_ascii=False)}" if key in values else ""
        blocks[-1] += f"\n- `{key}{default}`: {allowed(hint)}{'' if default else '; may be left out'}"
    return "\n\n".join(block.strip() for block in blocks) + "\n"
