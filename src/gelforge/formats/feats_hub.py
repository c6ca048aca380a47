"""FEATS' dataset from the Hugging Face hub, by the hub's own library: resumed where it was stopped, every file checked."""

import errno
import hashlib
import os
import shutil
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from gelforge.errors import BadInput, unwritable
from gelforge.flow.files import write_json
from gelforge.flow.main import UNWRITABLE
from gelforge.flow.progress import progress
from gelforge.formats.feats_folder import split_of

REPOSITORY = "erikhelmut/FEATS"
PATIENCE_S = 60.0  # that an answer of the hub may take
LISTING = "feats-hub.json"  # what was fetched: commit, and size and digest of each file
FULL = (*UNWRITABLE, errno.EFBIG)
LATER = (
    "check the connection and any proxy, then run it again (what was loaded is kept), or give FROM=folder of a copy"
)
Result = TypeVar("Result")


@dataclass(frozen=True)
class Listed:
    """A file of the hub: its size in bytes, and its digest (SHA-256, or git's SHA-1 of a small file)."""

    size: int
    digest: str

    def is_file(self, path: Path) -> bool:
        """Whether a file holds this, byte for byte."""
        if not path.is_file() or path.stat().st_size != self.size:
            return False
        digest = hashlib.sha256() if len(self.digest) == 64 else hashlib.sha1(b"blob %d\0" % self.size)
        with path.open("rb") as stream:
            while block := stream.read(2**20):
                digest.update(block)
        return digest.hexdigest() == self.digest


def fetch(folder: Path, splits: Iterable[str]) -> Path:
    """Bring the .npy files of some splits (all where none is named) to `folder`; return the folder that holds the splits.

    Files that are there and unchanged are not loaded again; those that changed, here or on the hub, are named. BadInput
    where the hub cannot be reached, has no such split, or the disk takes no more; what was loaded stays for the next time.
    """
    commit, listed = listing()
    base = base_of(listed)
    required = chosen(listed, base, list(splits))
    changed = forget_changed(folder, required)
    if changed:
        print(*(f"{path}: not as the hub lists it; loading it again" for path in changed), sep="\n", flush=True)
    patterns = sorted({f"{(base / Path(name).relative_to(base).parts[0]).as_posix()}/*" for name in required})
    ask(lambda hub: hub.snapshot_download(REPOSITORY, repo_type="dataset", revision=commit, local_dir=folder,
                                          allow_patterns=patterns, etag_timeout=PATIENCE_S))  # fmt: skip
    for path in (folder / ".cache" / "huggingface").rglob("*.incomplete"):
        path.unlink()  # of a fetch that was killed: the library begins such a file anew
    for name, file in progress(required.items(), "check", len(required)):
        if not file.is_file(folder / name):
            raise BadInput(f"{folder / name}: is not what the hub lists ({file.size} bytes); run it again")
    write_json(
        folder / LISTING, {"commit": commit, "files": {name: [f.size, f.digest] for name, f in required.items()}}
    )
    return folder / base


def listing() -> tuple[str, dict[str, Listed]]:
    """The hub's latest commit, and its .npy files by path."""

    def asked(hub) -> tuple[str, list]:
        api = hub.HfApi()
        commit = api.repo_info(REPOSITORY, repo_type="dataset", timeout=PATIENCE_S).sha
        return commit, list(api.list_repo_tree(REPOSITORY, repo_type="dataset", revision=commit, recursive=True))

    commit, entries = ask(asked)
    files = [entry for entry in entries if hasattr(entry, "blob_id") and entry.path.endswith(".npy")]
    found = {f.path: Listed(f.size, f.lfs.sha256 if f.lfs else f.blob_id) for f in files}
    if not found:
        raise BadInput(f"{REPOSITORY}: the hub lists no .npy files; give FROM=folder of a copy")
    return commit, found


def ask(question: Callable[[Any], Result]) -> Result:
    """The answer of the hub's library; BadInput where it has none."""
    try:
        import huggingface_hub
        from huggingface_hub.utils import disable_progress_bars
    except ModuleNotFoundError as error:
        raise BadInput("feats-fetch needs the package huggingface_hub: pip install '.[hub]' in a clone of gelforge, or give FROM=folder of a copy") from error  # fmt: skip
    if not sys.stderr.isatty():
        disable_progress_bars()
    try:
        return question(huggingface_hub)
    # connections, proxies and answers that are no JSON each raise errors of the library's own and of what it stands on
    except Exception as error:
        cause = next((e for e in causes(error) if isinstance(e, OSError) and e.errno in FULL), None)
        if cause:
            raise BadInput(f"{unwritable(cause)}, then run it again (what was loaded is kept)") from error
        endpoint = os.environ.get("HF_ENDPOINT", "the hub")
        said = " ".join(str(error).split())[:200] or type(error).__name__
        raise BadInput(
            f"{REPOSITORY}: {endpoint} gives no dataset ({type(error).__name__}: {said}); {LATER}"
        ) from error


def causes(error: BaseException | None) -> Iterable[BaseException]:
    """An error and those that led to it."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def base_of(listed: Iterable[str]) -> Path:
    """The folder below which splits lie: what all files have in common."""
    common = Path(os.path.commonpath([str(Path(name).parent) for name in listed]) or ".")
    return common.parent if split_of(common.name) else common


def chosen(listed: dict[str, Listed], base: Path, splits: list[str]) -> dict[str, Listed]:
    """Files of the splits that were asked for."""
    by_split: dict[str, dict[str, Listed]] = {}
    for name, file in listed.items():
        by_split.setdefault(Path(name).relative_to(base).parts[0], {})[name] = file
    missing = [split for split in splits if split not in by_split]
    if missing:
        raise BadInput(f"SPLIT={missing[0]}: {REPOSITORY} has no such split; it has {', '.join(sorted(by_split))}")
    return {name: file for split in splits or by_split for name, file in by_split[split].items()}


def forget_changed(folder: Path, required: dict[str, Listed]) -> list[Path]:
    """Remove files that are not as the hub lists them, for the library would keep some; return them.

    A fetch that was stopped leaves none such: the library gives a file its name when it is whole.
    """
    changed = [
        folder / name
        for name, file in required.items()
        if (folder / name).exists() and not file.is_file(folder / name)
    ]
    for path in changed:
        path.unlink()
    return changed


def is_imported(downloads: Path, data: Path) -> bool:
    """Whether a dataset holds what lies in a folder of downloads."""
    noted = data / LISTING
    return noted.exists() and noted.read_bytes() == (downloads / LISTING).read_bytes()


def note_imported(downloads: Path, data: Path) -> None:
    """Say in a dataset what it was made from."""
    shutil.copy(downloads / LISTING, data / LISTING)
