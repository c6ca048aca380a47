"""What a cluster is asked for: workflow/slurm.toml, one profile per stage."""

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, get_type_hints

from gelforge.errors import BadInput
from gelforge.flow.params import read_toml

PUBLISHED = Path("workflow/slurm.toml")


@dataclass(frozen=True)
class Profile:
    """What one task of a stage may use, and how long to be patient; workflow/slurm.toml explains every field."""

    partition: str
    account: str
    constraint: str
    time_minutes: int
    memory_mb: int
    cores: int
    shards_per_task: int
    array_limit: int
    concurrent: int
    options: list
    setup: list
    retries: int
    memory_factor: float
    memory_max_mb: int
    time_factor: float
    time_max_minutes: int
    poll_seconds: float
    visible_seconds: float
    submit_seconds: float
    silence_seconds: float

    def more_memory(self, memory_mb: int) -> int:
        """Memory of the next run of a task that needed more than `memory_mb`; no more than that if at the limit."""
        return max(min(math.ceil(memory_mb * self.memory_factor), self.memory_max_mb), memory_mb)

    def more_time(self, minutes: int) -> int:
        """Time limit of the next run of a task that needed more than `minutes`."""
        return max(min(math.ceil(minutes * self.time_factor), self.time_max_minutes), minutes)

    def sbatch_options(self, memory_mb: int, minutes: int) -> list[str]:
        """What `sbatch` is asked for one array of tasks."""
        named = {"partition": self.partition, "account": self.account, "constraint": self.constraint}
        asked = [f"--{name}={value}" for name, value in named.items() if value]
        asked += ["--nodes=1", "--ntasks=1", f"--cpus-per-task={self.cores}"]
        return [*asked, f"--mem={memory_mb}M", f"--time={minutes}", *self.options]


KINDS = {str: "a text", int: "a whole number", float: "a number", list: "a list of texts"}
# The least value of each number; 0 means "no limit" or "at once" where it is allowed.
LEAST = {
    "time_minutes": 1,
    "memory_mb": 1,
    "cores": 1,
    "shards_per_task": 1,
    "memory_factor": 1.0,
    "time_factor": 1.0,
    "memory_max_mb": 1,
    "time_max_minutes": 1,
    "poll_seconds": 0.1,
}


def checked(table: dict, where: str) -> dict:
    """Return `table` if every key is a field of Profile with a value of its kind; BadInput otherwise."""
    known: dict[str, type] = get_type_hints(Profile)
    for key, value in table.items():
        if key not in known:
            raise BadInput(f"{where}.{key}: no such setting; known: {', '.join(known)}")
        kinds: Any = (int, float) if known[key] is float else known[key]
        if not isinstance(value, kinds) or isinstance(value, bool):
            raise BadInput(f"{where}.{key} = {value!r}: {KINDS[known[key]]} is needed")
        if known[key] is list and not all(isinstance(line, str) for line in value):
            raise BadInput(f"{where}.{key} = {value!r}: {KINDS[list]} is needed")
        if known[key] in (int, float) and value < LEAST.get(key, 0):
            raise BadInput(f"{where}.{key} = {value!r}: must be at least {LEAST.get(key, 0)}")
    return table


def read_profile(path: Path | str, stage: str) -> Profile:
    """Return the profile of `stage`: `30_fea` reads [default], then [fea]; BadInput names what is wrong.

    A file of one's own says only what differs from PUBLISHED.
    """
    name, values = stage.lstrip("0123456789_"), {}
    files = dict.fromkeys([PUBLISHED, Path(path)])
    tables = {file: read_toml(file) for file in files}
    for table in ("default", name):
        for file in files:
            values.update(checked(tables[file].get(table, {}), f"{file}: {table}"))
    missing = [field.name for field in fields(Profile) if field.name not in values]
    if missing:
        raise BadInput(f"{PUBLISHED}: [default] lacks {', '.join(missing)}; take them from the published file")
    return Profile(**values)
