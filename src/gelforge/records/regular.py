"""Input files: only regular files are read (no pipe, device or folder), and no output replaces one of them."""

import os
import stat
from collections.abc import Iterable
from pathlib import Path

from gelforge.errors import BadInput

KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
LFS = b"version https://git-lfs"
WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")  # first bytes of .xlsx and .ods, and of .xls
LFS_BYTES = 1024  # largest size of an LFS pointer
FOLDER = f"it is {KINDS[stat.S_IFDIR]}"  # what `file_fault` returns for a folder


def file_fault(path: Path) -> str | None:
    """Why a path is not a regular file with its content, in a few words, or None."""
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            return f"it is {KINDS.get(stat.S_IFMT(found.st_mode), 'no regular file')}"
        if len(LFS) <= found.st_size <= LFS_BYTES:
            with path.open("rb") as stream:
                if stream.read(len(LFS)) == LFS:
                    return "it is a Git LFS pointer whose content was not fetched: run `git lfs pull`"
    except OSError as error:
        return error.strerror or str(error)
    return None


def bytes_or_fault(path: Path, most: int) -> tuple[bytes, str | None]:
    """Bytes of a regular file of at most `most` bytes and None, or b"" and the reason in a few words."""
    try:
        fault = file_fault(path)
        if fault is None and path.stat().st_size > most:
            fault = f"it has more than {most} bytes"
        return (path.read_bytes(), None) if fault is None else (b"", fault)
    except OSError as error:
        return b"", error.strerror or str(error)


def read_bytes(path: Path, hint: str, most: int = 2**32) -> bytes:
    """Bytes of a regular file of at most `most` bytes; anything else raises BadInput with the hint at its end."""
    data, fault = bytes_or_fault(path, most)
    if fault is None:
        return data
    raise BadInput(
        f"{path}: {'not found' if fault.startswith('No such file') else f'cannot be read ({fault})'}; {hint}"
    )


def real_place(path: Path) -> Path:
    """Target of a path with all links followed; unlike `Path.resolve` it does not raise for a link loop."""
    return Path(os.path.realpath(path))


def refuse_to_replace(asked: str, written: Iterable[Path], read: Iterable[Path | None]) -> None:
    """BadInput if a file that is written would replace one that is read.

    asked: the option that names the written file, with its value, for the message. None in `read` is ignored.
    """
    kept = {real_place(path) for path in read if path is not None}
    for path in written:
        if real_place(path) in kept:
            raise BadInput(f"{asked}: {path} would overwrite an input file; choose another path")


def read_text(path: Path, hint: str) -> str:
    """Text of a regular file in UTF-8 without leading byte order marks, line endings kept; else BadInput."""
    data = read_bytes(path, hint)
    if data.startswith(WORKBOOKS):
        raise BadInput(f"{path}: is a workbook of Excel or LibreOffice, not text; save it there as CSV in UTF-8")
    try:
        return data.decode("utf-8").lstrip("\ufeff")
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: not UTF-8 text ({error}); save it as CSV in UTF-8") from None
