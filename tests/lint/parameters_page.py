"""The page workflow/guide/parameters.md, from the tables of parameters and the comments of workflow/params.toml."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gelforge.flow.files import read_toml
from gelforge.flow.schema import allowed, is_table, kinds_of, split
from gelforge.flow.tables import USUAL, Params

HEAD = """# Parameters

Made by `make format` from `src/gelforge/flow/tables.py` and `workflow/params.toml`. A dataset sets its own values in
`data/DATASET/dataset.toml`, under `[params.TABLE]`; an unknown key, or a value that is not allowed, is refused by name.
"""
PARTS = (
    """## What people set

One dial decides how fast and how accurate labels are: `method` of `[fea]`. With `method = "auto"` each press is solved by
the fastest method that states an error of at most `tolerance`, a fraction of its force.""",
    """## For experts

Defaults that suit a GelSight Mini on a desktop CNC frame. Other values of the flow are constants, which stand with their
reasons in `src/gelforge/flow/tables.py`.""",
)

PRIORS = "calibrate.priors"


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
    """The page, as Markdown: the usual keys in the order of `USUAL`, then all others in that of their tables."""
    given, why = read_toml(params_toml), comments(params_toml.read_text(encoding="utf-8"))
    every = {f"{table}.{key}": (table, key, hint) for table, key, hint in keys(Params)}
    chosen = [every[name] for name in USUAL], [each for name, each in every.items() if name not in USUAL]
    blocks = [HEAD.strip()]
    for title, part in zip(PARTS, chosen, strict=True):
        blocks += [title, *listed(part, given, why)]
    return "\n\n".join(block.strip() for block in blocks) + "\n"


def priors(given: dict[str, Any]) -> str:
    """The priors of a calibration as one table, because all have the same keys."""
    rows = ["| parameter | prior | reason |", "| --- | --- | --- |"]
    for name, prior in given["calibrate"]["priors"].items():
        numbers = ", ".join(f"{key} {value:g}" for key, value in prior.items() if key not in ("kind", "reason"))
        rows.append(f"| `{name}` | {prior['kind']}, {numbers} | {prior['reason']} |")
    return "\n".join(rows)


def listed(chosen: list[tuple[str, str, Any]], given: dict[str, Any], why: dict[str, str]) -> list[str]:
    """Blocks of Markdown about some keys: each comment once, below it the keys that it is about."""
    blocks: list[str] = []
    last = ("", "")
    for table, key, hint in chosen:
        if table.startswith(f"{PRIORS}."):
            if not last[0].startswith(PRIORS):
                blocks += [f"### [{PRIORS}.PARAMETER]", why[table], priors(given)]
            last = (table, "")
            continue
        name = f"{table}.{key}"
        inner = next((said for one, said in why.items() if one.startswith(f"{name}.") and said), last[1])
        said = why[name] if why.get(name) else inner
        if table != last[0]:
            blocks += filter(None, [f"### [{table}]", why.get(table)])
        if (table, said) != last:
            blocks += [*[said] * bool(said and said != last[1]), ""]
        last = (table, said)
        values: Any = given
        for word in table.split("."):
            values = values[word]
        default = f" = {json.dumps(values[key], ensure_ascii=False)}" if key in values else ""
        blocks[-1] += f"\n- `{key}{default}`: {allowed(hint)}{'' if default else '; may be left out'}"
    return blocks
