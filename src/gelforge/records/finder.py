"""Where a sample is: one answer for `look`, `deck`, `provenance` and `sample`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput
from gelforge.flow.layout import Layout, shard_name
from gelforge.flow.runs import rejections_of
from gelforge.records.solvestore import SolveStore
from gelforge.records.solvetable import Solved, read_solves

ONLY = shard_name(0)  # the only shard of a sample that `make sample` took through all stages


@dataclass(frozen=True)
class Sample:
    """A sample of the log: the layout and the shard of its files, and what stages know of it.

    of: of its dataset, or of `make sample`. rejected: why stage 10 rejected its row, and what to do. imported: file of
    its label if that came with the dataset. solve: its row of stage 30's table. record: of its solve in the store.
    """

    name: str
    of: Layout
    shard: str
    rejected: list[str]
    imported: Path | None
    solve: Solved | None
    record: dict[str, Any] | None

    @property
    def arrays(self) -> Path:
        """File of the solve's arrays."""
        return SolveStore(self.of.solves).arrays(self.solve.key if self.solve else "")

    def refuse_rejected(self) -> None:
        """BadInput with the reasons if stage 10 rejected the sample's row of the log."""
        if self.rejected:
            root = Layout(self.of.dataset_root)
            raise BadInput(
                f"sample {self.name} was rejected and gets no label: {'. '.join(self.rejected)}; then run {root.command('labels')}"
            )


def find(results: Path, name: str, resolution: str = "") -> Sample:
    """A sample of results/DATASET; BadInput if the log has none of that name.

    resolution: of labels. The files of its shard count if they hold it, else those of `make sample`.
    """
    of = Layout(results)
    shard = of.shard_of(name)
    imported = imported_labels(of, resolution)
    rejected = [] if imported else rejections_of(results, shard, name)
    for layout, at in ((of, shard), (of.sample(name), ONLY)):
        table = layout.fea(at)
        solve = next((one for one in (read_solves(table) if table.exists() else []) if one.sample_id == name), None)
        if solve:
            return Sample(name, layout, at, rejected, imported, solve, SolveStore(of.solves).record(solve.key))
    return Sample(name, of, shard, rejected, imported, None, None)


def imported_labels(of: Layout, resolution: str) -> Path | None:
    """Labels of a resolution that were imported in place of solves; None if the dataset solves its own."""
    folder = of.data / "labels"
    return folder / f"{resolution}.npz" if folder.is_dir() else None
