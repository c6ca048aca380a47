"""WebDataset: shards of tar files, a sample being KEY.png (or .jpg), KEY.forces.npy and KEY.json.

https://github.com/webdataset/webdataset; `forces.npy` is float32 (3, rows, cols) in N per cell. `facts.json` beside the
shards says what the numbers mean.
"""

import json
from pathlib import Path

from gelforge.flow.files import write_text
from gelforge.formats.export.samples import Samples

SHARD = 1000
SUFFIX_OF = {"image/png": "png", "image/jpeg": "jpg"}


def write(folder: Path, samples: Samples) -> None:
    """Write SPLIT-NNNNNN.tar of each split into a folder."""
    import webdataset

    folder.mkdir(parents=True, exist_ok=True)
    splits: dict[str, list[int]] = {}
    for at, row in enumerate(samples.rows):
        splits.setdefault(row["split"], []).append(at)
    for split, rows in splits.items():
        with webdataset.ShardWriter(
            str(folder / f"{split}-%06d.tar"), maxcount=SHARD, maxsize=4e9, verbose=0
        ) as sink:
            for at in rows:
                sample = samples.sample(at)
                sink.write({
                    "__key__": f"{at:08d}", SUFFIX_OF[sample.media_type]: sample.picture, "forces.npy": sample.label,
                    "json": json.dumps(sample.cells).encode(),
                })  # fmt: skip
    write_text(folder / "facts.json", samples.facts_text())
