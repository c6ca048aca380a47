"""What of the parameters each stage reads, as a file of its own.

make makes a stage again when its file changes, and for no other change of workflow/params.toml. Keys of solves are
digests of these files' content, so a value is written as it was given: 2 stays 2, and 2.0 stays 2.0.
"""

import re
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput
from gelforge.flow.files import read_json
from gelforge.flow.layout import STAGES
from gelforge.flow.params.schema import plain, structured
from gelforge.flow.params.tables import Params


class StageParameters(Params):
    """What a stage is given: of all parameters those tables and keys that it reads (`flow.layout.STAGES`), and the version of its results."""

    version: int


def stage_version(folder: Path, name: str) -> int:
    """The version of a stage's results, read from its module's text so that nothing heavy is imported.

    Where it solves presses, stage 30's is added: both only ever rise.
    """
    path = folder / f"{name}.py"
    found = re.search(r"^VERSION = (\d+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    if not found:
        raise BadInput(f"{path}: has no line `VERSION = n`; a stage needs one, raised when its results change")
    return int(found.group(1)) + (stage_version(folder, "fea") if STAGES[name].solves else 0)


def written_for(params: Params, name: str, version: int) -> dict[str, Any]:
    """What is written for a stage of the parameters, as JSON has it."""
    every, found = plain(params), {"version": version}
    for words in STAGES[name].reads:
        table, _, key = words.partition(".")
        if not key:
            found[table] = every[table]
        elif key in every[table]:
            found[table] = found.get(table, {}) | {key: every[table][key]}
    return found


def parameters_of(params: Params, name: str, version: int) -> StageParameters:
    """What a stage is given of the parameters."""
    return structured(StageParameters, written_for(params, name, version))


def read_parameters(path: Path) -> StageParameters:
    """Read what the plan checked and wrote for a stage."""
    try:
        return structured(StageParameters, read_json(path))
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise BadInput(f"{path}: cannot be read ({error}); run make again, the plan writes it anew") from error
