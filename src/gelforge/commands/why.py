"""The reasons why make would make a target again."""

import os
import re
import subprocess
from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput, last_words
from gelforge.flow.layout import PLAN
from gelforge.flow.ledger import named
from gelforge.flow.main import command, option

# What GNU make says under -n --debug=b of each target that is out of date; v would add every one that is not.
NEWER = re.compile(r"Prerequisite '(.+)' is newer than target '(.+)'\.")
ABSENT = re.compile(r"File '(.+)' does not exist\.")
NO_FILE = re.compile(r"Prerequisite '(.+)' of target '(.+)' does not exist\.")
MUST = re.compile(r"Must remake target '(.+)'\.")
# What a rule asks for by a word instead of a file, in sentences: flow/asked.py says which results are due.
ASKED = {
    "due": "it was made with another choice (MODEL, RES, CHARTED or branches), lost labels of a shard, or STRICT=1 judges it again"
}
NAMELESS = "something that it reads is made again"
UNKNOWN = re.compile(r"No rule to make target '(.+?)'")


def ask_make(target: str, settings: list[str]) -> str:
    """What make says of a target without making it."""
    env = {k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "MAKEOVERRIDES")}
    asked = subprocess.run(
        ["make", "-n", "--debug=b", "--no-print-directory", *settings, target],
        capture_output=True, text=True, check=False, env=env | {"LC_ALL": "C"},
    )  # fmt: skip
    if asked.returncode and (unknown := UNKNOWN.search(asked.stderr)):
        raise BadInput(
            f"TARGET={unknown[1]}: make knows no such target; name a stage (make help) or a file below results/"
        )
    if asked.returncode:
        raise BadInput(f"make {target} cannot be planned: {last_words(asked.stderr, asked.returncode)}")
    return asked.stdout


def reasons(said: str) -> dict[str, list[str]]:
    """Why each file must be made, from what make said, in the order it would be made; phony targets are left out."""
    must = dict.fromkeys(name for name in MUST.findall(said) if "/" in name and not name.endswith(f"/{PLAN}/plan.mk"))
    newer: dict[str, list[str]] = {name: [] for name in must}
    for before, after in NEWER.findall(said):
        newer.get(after, []).append(before)
    asked = {target: ASKED[word] for word, target in NO_FILE.findall(said) if word in ASKED}
    absent, found = set(ABSENT.findall(said)), {}
    for name in must:
        remade = [before for before in newer[name] if before in must]
        fresh = [before for before in newer[name] if before not in must]
        found[name] = (
            ["it does not exist"] if name in absent
            else [in_words(before) for before in fresh] + [f"{before} is made again" for before in remade]
        ) or [asked.get(name, NAMELESS)]  # fmt: skip
    return found


def in_words(path: str) -> str:
    """Why a changed prerequisite matters."""
    if f"/{PLAN}/params/" in path:
        return f"{named(path)} changed since ({path}, from workflow/ and dataset.toml, or a new version of the stage)"
    return f"{named(path)} changed since" + (f" ({path})" if named(path) != path else "")


def lines(target: str, found: dict[str, list[str]], most: int = 12) -> list[str]:
    """The answer: causes first, what only follows from them after."""
    if not found:
        return [f"{target}: nothing would be made again; it is up to date"]
    causes = {name: why for name, why in found.items() if not all(text.endswith("is made again") for text in why)}
    causes = causes or {name: why for name, why in found.items() if NAMELESS in why}
    text = [f"{target}: {len(found)} files would be made, because"]
    stages: dict[str, list[str]] = {}
    for name in causes:
        stages.setdefault(str(Path(name).parent), []).append(name)
    for names in list(stages.values())[:most]:
        others = f" and {len(names) - 1} more there" if len(names) > 1 else ""
        text.append(f"  {names[0]}{others}: {'; '.join(causes[names[0]][:3])}")
    follows = [name for name in found if name not in causes]
    if follows:
        text.append(f"and {len(follows)} that read them: {', '.join(follows[:4])}{' …' if len(follows) > 4 else ''}")
    return text


@command(
    option("--target", help="stage or file"),
    option("settings", nargs="*", help="variables for make, such as DATASET=…"),
)
def main(args: Namespace) -> None:
    if not args.target:
        dataset = [setting for setting in args.settings if setting.startswith("DATASET=")]
        command = " ".join(["make why TARGET=report", *dataset])
        raise BadInput(f"no target named; say {command}, or a file below results/")
    if args.target.startswith("-") or "=" in args.target:
        raise BadInput(f"TARGET={args.target}: name a stage (make help) or a file below results/")
    print("\n".join(lines(args.target, reasons(ask_make(args.target, args.settings)))))


if __name__ == "__main__":
    main.exit()
