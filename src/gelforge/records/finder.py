"""Where a sample is: one answer for `look`, `deck`, `provenance` and `sample`. It imports only the standard library."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput
from gelforge.flow.files import read_csv
from gelforge.flow.layout import Layout, shard_name
from gelforge.flow.runs import rejections_of
from gelforge.records.solvestore import SolveStore

ONLY = shard_name(0)  # the only shard of a sample that `make sample` took through all stages


@dataclass(frozen=True)
class FoundSample:
    """A sample of the log: the layout and the shard of its files, and what stages know of it.

    of: of its dataset, or of `make sample`. rejected: why stage 10 rejected its row, and what to do. imported: file of
    its label if that came with the dataset. key: of its solve, "" if there is none. record: of its solve in the store.
    """

    name: str
    of: Layout
    shard: str
    rejected: list[str]
    imported: Path | None
    key: str
    record: dict[str, Any] | None

    @property
    def arrays(self) -> Path:
        """File of the solve's arrays."""
        return SolveStore(self.of.solves).arrays(self.key)

    def refuse_rejected(self) -> None:
        """BadInput with the reasons if stage 10 rejected the sample's row of the log."""
        if self.rejected:
            again = Layout(self.of.dataset_root).command("labels")
            raise BadInput(
                f"sample {self.name} was rejected and gets no label: {'. '.join(self.rejected)}; then run {again}"
            )


def find(results: Path, name: str, resolution: str = "") -> FoundSample:
    """A sample of results/DATASET; BadInput if the log has none of that name.

    resolution: of labels. The files of its shard count if it was solved there, else those of `make sample`.
    """
    of = Layout(results)
    shard = of.shard_of(name)
    folder = of.data / "labels"
    imported = folder / f"{resolution}.npz" if folder.is_dir() else None
    rejected = [] if imported else rejections_of(results, shard, name)
    for layout, at in ((of, shard), (of.sample(name), ONLY)):
        table = layout.fea(at)
        rows = read_csv(table) if table.exists() else []
        if row := next((row for row in rows if row.get("sample_id") == name), None):
            key = row.get("key") or ""
            return FoundSample(name, layout, at, rejected, imported, key, SolveStore(of.solves).record(key))
    return FoundSample(name, of, shard, rejected, imported, "", None)
