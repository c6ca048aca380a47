"""Files of others, opened only where they are what they should be: no pipe that never ends, no device, no folder.

And never written over.
"""

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
WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")  # how .xlsx and .ods begin, and .xls
LFS_BYTES = 1024  # of a pointer at most
FOLDER = f"it is {KINDS[stat.S_IFDIR]}"  # what `file_fault` says of one


def file_fault(path: Path) -> str | None:
    """Why a path is no file that can be read whole, in a few words, or None."""
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
    """Bytes of a regular file of at most `most` bytes and None, or none and why there are none, in a few words."""
    try:
        fault = file_fault(path)
        if fault is None and path.stat().st_size > most:
            fault = f"it has more than {most} bytes"
        return (path.read_bytes(), None) if fault is None else (b"", fault)
    except OSError as error:
        return b"", error.strerror or str(error)


def read_bytes(path: Path, hint: str, most: int = 2**32) -> bytes:
    """Bytes of a regular file of at most `most` bytes; anything else raises BadInput that ends with the hint."""
    data, fault = bytes_or_fault(path, most)
    if fault is None:
        return data
    raise BadInput(
        f"{path}: {'not found' if fault.startswith('No such file') else f'cannot be read ({fault})'}; {hint}"
    )


def real_place(path: Path) -> Path:
    """Where a path leads, links followed as far as they go; `Path.resolve` raises for one that leads to itself."""
    return Path(os.path.realpath(path))


def refuse_to_replace(asked: str, written: Iterable[Path], read: Iterable[Path | None]) -> None:
    """BadInput where a file that is written would take the place of one that is read.

    asked: the option that names what is written, with its value, for the message. None among what is read is no file.
    """
    kept = {real_place(path) for path in read if path is not None}
    for path in written:
        if real_place(path) in kept:
            raise BadInput(f"{asked}: {path} would take the place of a file that is read; name another place")


def read_text(path: Path, hint: str) -> str:
    """Text of a regular file in UTF-8, whatever byte order marks it begins with; line endings stay as they are."""
    data = read_bytes(path, hint)
    if data.startswith(WORKBOOKS):
        raise BadInput(f"{path}: is a workbook of Excel or LibreOffice, not text; save it there as CSV in UTF-8")
    try:
        return data.decode("utf-8").lstrip("\ufeff")
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: not UTF-8 text ({error}); save it as CSV in UTF-8") from None
