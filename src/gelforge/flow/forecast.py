"""What a run will take before it starts: core hours, disk and time, from what a few presses of it take."""

import math
from dataclasses import dataclass

from gelforge.flow.layout import CALIBRATE, FEA, FORCES, LABELS, PARETO, POSES

PILOTS = 5


@dataclass(frozen=True)
class Cost:
    """What a stage takes: processor seconds and bytes of each press, and those that do not depend on their number.

    Of presses that were filmed each row counts as a press here: its moment is solved, labelled and learnt from like one.
    """

    stage: str
    cpu_each: float = 0.0
    cpu_once: float = 0.0
    bytes_each: float = 0.0
    bytes_once: float = 0.0

    def cpu(self, presses: int) -> float:
        """Processor seconds of so many presses."""
        return self.cpu_once + self.cpu_each * presses

    def disk(self, presses: int) -> float:
        """Bytes of so many presses."""
        return self.bytes_once + self.bytes_each * presses


def pilots(strength: list[float]) -> list[int]:
    """Presses that stand for all, by their numbers: the middles of equal shares of the presses, ordered by strength; each once.

    strength: (n,), what the cost rises with, such as the depth.
    """
    order = sorted(range(len(strength)), key=strength.__getitem__)
    count = min(PILOTS, len(order))
    return [order[int((k + 0.5) * len(order) / count)] for k in range(count)]


# Stages of many targets, and branches that run beside others. A calibration fills the cores by itself.
PARALLEL = (POSES, FEA, FORCES, PARETO)


def wall_seconds(costs: list[Cost], presses: int, cores: int, shards: int) -> float:
    """Time on so many cores: stages of shards and branches fill them, the others take one core one after the other."""
    beside = sum(cost.cpu(presses) for cost in costs if cost.stage in PARALLEL)
    own = sum(cost.cpu(presses) for cost in costs if cost.stage == CALIBRATE)
    alone = sum(cost.cpu(presses) for cost in costs if cost.stage not in (*PARALLEL, CALIBRATE))
    return beside / min(cores, max(shards, 1)) + own / cores + alone


LABELLED = (POSES, FEA, FORCES, LABELS)


def presses_an_hour(costs: list[Cost], cores: int) -> float:
    """Presses that so many cores bring from the log to a label in an hour."""
    each = sum(cost.cpu_each for cost in costs if cost.stage in LABELLED)
    return 3600.0 * cores / each if each > 0.0 else math.inf


def on_cores(count: int) -> str:
    """On which cores a time was forecast."""
    return f"on {count} cores like these" if count > 1 else "on 1 core like this one"


def table(costs: list[Cost], presses: int) -> list[str]:
    """The estimate as text."""
    text = [f"{'stage':20s} {'core hours':>12s} {'disk':>10s}"]
    text += [f"{c.stage:20s} {c.cpu(presses) / 3600:12.3f} {size(c.disk(presses)):>10s}" for c in costs]
    cpu, disk = sum(c.cpu(presses) for c in costs), sum(c.disk(presses) for c in costs)
    text.append(f"{'all':20s} {cpu / 3600:12.3f} {size(disk):>10s}")
    return text


def size(count: float) -> str:
    """Bytes as people say them, three digits of them: the next unit begins where these would be 1000."""
    power = next((p for p in range(5) if float(f"{count / 1000**p:.3g}") < 1000), 5)
    return f"{count / 1000**power:.3g} {('B', 'kB', 'MB', 'GB', 'TB', 'PB')[power]}"
