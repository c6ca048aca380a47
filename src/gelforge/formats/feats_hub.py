"""Download FEATS' published dataset by the Hugging Face hub's own library, which resumes interrupted downloads."""

import errno
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from gelforge.errors import BadInput, unwritable
from gelforge.flow.cli import UNWRITABLE
from gelforge.formats.feats_folder import split_of

REPOSITORY = "erikhelmut/FEATS"
PATIENCE_S = 60.0  # timeout of a request to the hub
FULL = (*UNWRITABLE, errno.EFBIG)


def fetch(folder: Path, splits: Sequence[str]) -> Path:
    """Download the .npy files of some splits (all where none is named) to `folder`; return the folder of the splits.

    Unchanged files are not downloaded again. BadInput where the hub cannot be reached or has no such split, or the
    disk is full; what was downloaded is kept for the next call.
    """
    from huggingface_hub import HfApi, snapshot_download
    from huggingface_hub.utils import disable_progress_bars

    if not sys.stderr.isatty():
        disable_progress_bars()
    with said_by_the_hub():
        # ask for the commit separately: without a connection, snapshot_download would accept the local files
        info = HfApi().dataset_info(REPOSITORY, timeout=PATIENCE_S)
    names = [file.rfilename for file in info.siblings or [] if file.rfilename.endswith(".npy")]
    base = base_of(names)
    required = chosen(names, base, splits)
    patterns = sorted({f"{(base / Path(name).relative_to(base).parts[0]).as_posix()}/*.npy" for name in required})
    with said_by_the_hub():
        snapshot_download(
            REPOSITORY, repo_type="dataset", revision=info.sha, local_dir=folder, allow_patterns=patterns,
            etag_timeout=PATIENCE_S,
        )  # fmt: skip
        missing = [name for name in required if not (folder / name).is_file()]
        if missing:
            raise FileNotFoundError(f"{missing[0]} and {len(missing) - 1} more files are missing after the download")
    return folder / base


def base_of(names: Sequence[str]) -> Path:
    """The common folder of all files of the repository, which holds the splits; BadInput where there are no files."""
    if not names:
        raise BadInput(f"{REPOSITORY}: the hub lists no .npy files; give FROM=folder of a copy")
    common = Path(os.path.commonpath([str(Path(name).parent) for name in names]) or ".")
    return common.parent if split_of(common.name) else common


def chosen(names: Sequence[str], base: Path, splits: Sequence[str]) -> list[str]:
    """Files of the requested splits; BadInput for a split that does not exist."""
    split = {name: Path(name).relative_to(base).parts[0] for name in names}
    unknown = [asked for asked in splits if asked not in split.values()]
    if unknown:
        there = ", ".join(sorted(set(split.values())))
        raise BadInput(f"SPLIT={unknown[0]}: {REPOSITORY} has no such split; it has {there}")
    return [name for name in names if not splits or split[name] in splits]


@contextmanager
def said_by_the_hub() -> Iterator[None]:
    """Turn exceptions of the hub's library into BadInput."""
    try:
        yield
    # the library and those below it raise many kinds of errors for connections, proxies and invalid JSON
    except Exception as error:
        full = next((e for e in causes(error) if isinstance(e, OSError) and e.errno in FULL), None)
        if full:
            raise BadInput(f"{unwritable(full)}, then run it again (what was loaded is kept)") from error
        endpoint = os.environ.get("HF_ENDPOINT", "the hub")
        said = " ".join(str(error).split())[:200] or type(error).__name__
        raise BadInput(
            f"{REPOSITORY}: {endpoint} did not return the dataset ({type(error).__name__}: {said}); check the connection and any"
            " proxy, then run it again (what was loaded is kept), or give FROM=folder of a copy"
        ) from error


def causes(error: BaseException | None) -> Iterator[BaseException]:
    """An exception and its chain of causes."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
