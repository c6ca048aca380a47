"""FEATS' published dataset from the Hugging Face hub, by the hub's own library, which resumes where it was stopped."""

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
PATIENCE_S = 60.0  # that an answer of the hub may take
FULL = (*UNWRITABLE, errno.EFBIG)


def fetch(folder: Path, splits: Sequence[str]) -> Path:
    """Bring the .npy files of some splits (all where none is named) to `folder`; return the folder that holds the splits.

    Files that are there and unchanged are not loaded again. BadInput where the hub cannot be reached, has no such split, or
    the disk takes no more; what was loaded stays for the next time.
    """
    from huggingface_hub import HfApi, snapshot_download
    from huggingface_hub.utils import disable_progress_bars

    if not sys.stderr.isatty():
        disable_progress_bars()
    with said_by_the_hub():
        # of one commit, asked for by itself: without a connection the library would be content with what there is
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
            raise FileNotFoundError(f"{missing[0]} and {len(missing) - 1} more files did not come")
    return folder / base


def base_of(names: Sequence[str]) -> Path:
    """The folder of the repository below which splits lie: what all files have in common."""
    if not names:
        raise BadInput(f"{REPOSITORY}: the hub lists no .npy files; give FROM=folder of a copy")
    common = Path(os.path.commonpath([str(Path(name).parent) for name in names]) or ".")
    return common.parent if split_of(common.name) else common


def chosen(names: Sequence[str], base: Path, splits: Sequence[str]) -> list[str]:
    """Files of the splits that were asked for; BadInput for a split that there is not."""
    split = {name: Path(name).relative_to(base).parts[0] for name in names}
    unknown = [asked for asked in splits if asked not in split.values()]
    if unknown:
        there = ", ".join(sorted(set(split.values())))
        raise BadInput(f"SPLIT={unknown[0]}: {REPOSITORY} has no such split; it has {there}")
    return [name for name in names if not splits or split[name] in splits]


@contextmanager
def said_by_the_hub() -> Iterator[None]:
    """Turn what the hub's library raises into BadInput."""
    try:
        yield
    # connections, proxies and answers that are no JSON each raise errors of the library's own and of what it stands on
    except Exception as error:
        full = next((e for e in causes(error) if isinstance(e, OSError) and e.errno in FULL), None)
        if full:
            raise BadInput(f"{unwritable(full)}, then run it again (what was loaded is kept)") from error
        endpoint = os.environ.get("HF_ENDPOINT", "the hub")
        said = " ".join(str(error).split())[:200] or type(error).__name__
        raise BadInput(
            f"{REPOSITORY}: {endpoint} gives no dataset ({type(error).__name__}: {said}); check the connection and any"
            " proxy, then run it again (what was loaded is kept), or give FROM=folder of a copy"
        ) from error


def causes(error: BaseException | None) -> Iterator[BaseException]:
    """An error and those that led to it."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
