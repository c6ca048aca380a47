"""What a cluster is asked for: workflow/slurm.toml, one profile per stage."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from gelforge.errors import BadInput
from gelforge.flow.files import read_toml
from gelforge.flow.params.schema import Number, ParameterTable, Place, Within, parse
from gelforge.flow.params.tables import Line

PUBLISHED = Path("workflow/slurm.toml")

FromNone = Annotated[int, Within(0, 1e9)]
FromOne = Annotated[int, Within(1, 1e9)]
Factor = Annotated[Number, Within(1.0, 1e3)]
Pause = Annotated[Number, Within(0.0, 1e9, "s")]


@dataclass(frozen=True)
class Profile(ParameterTable):
    """What one task of a stage may use, and how long to be patient; workflow/slurm.toml explains every field."""

    partition: Line
    account: Line
    constraint: Line
    time_minutes: FromOne
    memory_mb: FromOne
    memory_per_core: bool
    cores: FromOne
    shards_per_task: FromOne
    array_limit: FromNone
    concurrent: FromNone
    options: tuple[Line, ...]
    setup: tuple[Line, ...]
    retries: FromNone
    memory_factor: Factor
    memory_max_mb: FromOne
    time_factor: Factor
    time_max_minutes: FromOne
    poll_seconds: Annotated[Number, Within(0.1, 1e9, "s")]
    visible_seconds: Pause
    submit_seconds: Pause
    silence_seconds: Pause

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
        of_core = f"--mem-per-cpu={math.ceil(memory_mb / self.cores)}M"
        memory = of_core if self.memory_per_core else f"--mem={memory_mb}M"
        return [*asked, memory, f"--time={minutes}", *self.options]


def read_profile(path: Path | str, stage: str) -> Profile:
    """Return the profile of `stage`: `30_fea` reads [default], then [fea]; BadInput names what is wrong and its file.

    A file of one's own says only what differs from PUBLISHED.
    """
    files = dict.fromkeys([PUBLISHED, Path(path)])
    tables = {file: read_toml(file) for file in files}
    values: dict[str, Any] = {}
    for table in ("default", stage.lstrip("0123456789_")):
        for file in files:
            own = tables[file].get(table, {})
            values |= own if isinstance(own, dict) else {table: own}
            profile = parse(Profile, values, Place(str(file), (table,)))
            for option in profile.options:
                if re.match(r"-M|--cl", option):
                    raise BadInput(
                        f"{file}: [{table}] options: {option!r} sends work where squeue does not look for it; work on that"
                        " cluster by its own SLURM_CONF"
                    )
    return profile
