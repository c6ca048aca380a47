"""What made a dataset: the cost of every target, and which stage reads which, from the records of the flow."""

from contextlib import suppress
from pathlib import Path

from gelforge.flow.files import listed, read_json
from gelforge.flow.layout import PLAN, Layout

COST = ("seconds", "cpu_seconds", "peak_mib")


def target_costs(results: Path) -> dict[str, dict]:
    """Record of every target that was made, by its path below results/DATASET (without suffix).

    Corrupt ones, and those that do not say what it cost and when, are left out.
    """
    folder, found = Layout(results).metrics, {}
    for path in listed(folder, "*.json", below=True):
        with suppress(ValueError):
            record = read_json(path)
            if isinstance(record, dict) and all(
                isinstance(record.get(name), (int, float)) for name in ("started", *COST)
            ):
                found[str(path.relative_to(folder).with_suffix(""))] = record
    return found


def stage_of(path: str, results: Path) -> str:
    """Stage that a file belongs to, by its folder; nothing for files that no stage made."""
    try:
        parts = Path(path).resolve().relative_to(results.resolve()).parts
    except ValueError:
        return ""
    return parts[0] if len(parts) > 1 and parts[0] != PLAN else ""


def stages(results: Path, costs: dict[str, dict]) -> list[dict]:
    """Stages in the order they ran: name, targets, seconds, cpu_seconds, peak_mib, and the stages they read."""
    found: dict[str, dict] = {}
    for target, cost in sorted(costs.items(), key=lambda item: item[1]["started"]):
        name = target.split("/")[0]
        stage = found.setdefault(
            name, {"name": name, "targets": 0, "seconds": 0.0, "cpu_seconds": 0.0, "peak_mib": 0.0, "reads": set()}
        )
        stage["targets"] += 1
        stage["seconds"] += cost["seconds"]
        stage["cpu_seconds"] += cost["cpu_seconds"]
        stage["peak_mib"] = max(stage["peak_mib"], cost["peak_mib"])
        stage["reads"] |= {stage_of(path, results) for path in cost.get("inputs", [])} - {"", name}
    return [stage | {"reads": sorted(stage["reads"])} for stage in found.values()]
