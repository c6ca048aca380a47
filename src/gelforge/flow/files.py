"""Files that are either whole or absent, their digests and locks, and results kept under a key of their inputs."""

import contextlib
import csv
import errno
import fcntl
import hashlib
import io
import json
import os
import shutil
import stat
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, TypeVar

from gelforge.errors import BadInput

Value = TypeVar("Value")
# Errors that json, zipfile, zlib and numpy can raise when they read a missing, corrupt or hostile file.
DAMAGED = (
    OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, MemoryError, NotImplementedError, OverflowError,
    SyntaxError, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
# State of a file when it was read: digest, size in bytes and time stamp in ns. While size and time stamp stay, the
# digest is not computed again.
State = list


def listed(folder: Path, pattern: str, below: bool = False) -> list[Path]:
    """Sorted paths in a folder whose names match a pattern, none if there is no folder; below: in subfolders, too.

    Temporary files of `publish`, also those that a killed writer left, are left out.
    """
    found = folder.rglob(pattern) if below else folder.glob(pattern)
    return sorted(path for path in found if not path.name.startswith("."))


def names_in(folder: Path | str, suffix: str) -> list[str]:
    """Sorted names of a folder's files with a suffix, as `listed`, but faster for thousands: it makes no Path."""
    try:
        found = os.listdir(folder)
    except (FileNotFoundError, NotADirectoryError):
        return []
    return sorted(name for name in found if name.endswith(suffix) and not name.startswith("."))


def below(folder: Path | str, suffix: str) -> list[str]:
    """Sorted paths of files with a suffix in a folder and its subfolders, without temporary files, as `names_in`."""
    return sorted(f"{at}/{name}" for at, _, names in os.walk(folder) for name in names
                  if name.endswith(suffix) and not name.startswith("."))  # fmt: skip


def digest_of(path: Path) -> str:
    """SHA-256 of a file's content."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def state_of(path: str, known: State | None = None) -> State | None:
    """State of a file; None if there is none. known: earlier state, returned if size and time stamp are the same.

    A folder's digest covers only the names in it.
    """
    try:
        found = os.stat(path)
        if known and known[1:] == [found.st_size, found.st_mtime_ns]:
            return known
        if stat.S_ISDIR(found.st_mode):
            digest = hashlib.sha256("\n".join(sorted(os.listdir(path))).encode(errors="surrogateescape")).hexdigest()
        elif stat.S_ISREG(found.st_mode):
            digest = digest_of(Path(path))
        else:
            return None  # such as a pipe, from which reading would wait for ever
    except (OSError, ValueError):
        return None
    return [digest, found.st_size, found.st_mtime_ns]


def states_of(paths: Iterable[Path | str], known: Mapping[str, State | None]) -> dict[str, State | None]:
    """States by path. known: earlier ones."""
    return {path: state_of(path, known.get(path)) for path in map(str, paths)}


def changed(known: Mapping[str, State | None], now: Mapping[str, State | None]) -> list[str]:
    """Files whose content changed, and those that appeared or disappeared."""
    return [path for path, was in known.items() if (was and was[0]) != ((state := now[path]) and state[0])]


@contextmanager
def publish(path: Path | str, durable: bool = True) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` if the block succeeds.

    A killed or failing writer leaves nothing under the final name, and neither does a power cut if it is durable:
    the content is on the disk before the name is. The temporary name keeps the suffix, because numpy and OpenCV choose a format by it.
    durable: False for files of which a failed program writes all again, such as thousands of images.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield part
        if durable:
            sync(part)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def sync(path: Path) -> None:
    """Bring the content of a file to the disk (POSIX fsync); file systems that cannot are left to their own."""
    with contextlib.suppress(OSError), path.open("rb") as stream:
        os.fsync(stream.fileno())


def link_or_copy(source: Path, target: Path) -> None:
    """Make `target` a hard link of a file, or a copy where the file system has no links (exFAT, SMB)."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def write_text(path: Path | str, text: str) -> None:
    """Write `text` to `path`, whole or not at all."""
    with publish(path) as part:
        part.write_text(text, encoding="utf-8")


def write_if_changed(path: Path | str, text: str) -> bool:
    """Write `text` to `path` only where it differs; return whether it was written.

    An unchanged file keeps its time stamp, so make sees no reason to rebuild what follows.
    """
    try:
        with open(path, "rb") as stream:  # as bytes: a damaged file may be no text at all
            if stream.read() == text.encode():
                return False
    except FileNotFoundError:
        pass
    write_text(path, text)
    return True


def take(lock: IO[str], kind: int) -> None:
    """Take a lock of an open file, as fcntl.flock does; BadInput if the file system has no locks."""
    try:
        fcntl.flock(lock, kind)
    except BlockingIOError:
        raise
    except OSError as error:
        raise BadInput(
            f"{lock.name}: no file locks here ({error.strerror}), without which two makes would write one file; mount the"
            " file system with locks (Lustre: -o flock), or make results a link to a folder on another file system"
        ) from error


def need_room(folder: Path, size: int) -> None:
    """Raise OSError if a folder has less than `size` bytes free: some programs crash on a full disk, or hide it."""
    free = shutil.disk_usage(folder).free
    if free < size:
        raise OSError(errno.ENOSPC, f"the disk is full ({free} bytes left)", str(folder))


def bytes_of(path: Path) -> int:
    """Bytes of a file, or of all files of a folder."""
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def write_json(path: Path | str, value: Any) -> None:
    """Write `value` as indented JSON, whole or not at all."""
    write_text(path, json.dumps(value, indent=1, sort_keys=True, allow_nan=False) + "\n")


def read_json(path: Path | str) -> Any:
    """Read a JSON file."""
    return json.loads(Path(path).read_text(encoding="utf-8"))


def read_toml(
    path: Path | str,
    hint: str = "check the name (workflow/guide/your-data.md and workflow/README.md say what must be there)",
) -> dict:
    """Read a TOML file; a file that is missing, unreadable or not valid TOML raises BadInput with file and place.

    It may begin with a byte order mark, as Windows writes it.
    hint: what to do if the file is missing.
    """
    import tomllib  # every step imports this module, and few read TOML

    path = Path(path)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError as error:
        raise BadInput(f"{path}: not found; {hint}") from error
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); name a TOML file that can") from error
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: not UTF-8 text ({error}); save it as UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"{path}: not valid TOML: {error}") from error


def last_line(path: Path) -> str:
    """The last non-blank line of a text file, such as a growing log; only the file's last 1000 bytes are read."""
    with path.open("rb") as text:
        text.seek(max(0, path.stat().st_size - 1000))
        lines = text.read().decode("utf-8", errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "")


def csv_text(columns: Collection[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Dict rows as CSV text; a missing cell is empty."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")  # DictWriter takes 1.5 times as long
    writer.writerow(columns)
    known = set(columns)
    for row in rows:
        if not row.keys() <= known:
            raise ValueError(f"no such columns: {sorted(row.keys() - known)}")
        writer.writerow([row.get(name, "") for name in columns])
    return text.getvalue()


def write_csv(path: Path | str, columns: Collection[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write dict `rows` under `columns` as CSV, whole or not at all."""
    write_text(path, csv_text(columns, rows))


def read_csv(path: Path | str) -> list[dict]:
    """Read a CSV file with a header as a list of dicts of strings."""
    with Path(path).open(newline="", encoding="utf-8-sig") as stream:
        return list(csv.DictReader(stream))


def canonical(value: Any) -> str:
    """JSON text that is the same for equal values: sorted keys, no comments, exact floats."""
    return json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def digest_of_value(value: Any) -> str:
    """SHA-256 of a value's canonical text, as hexadecimal digits."""
    return hashlib.sha256(canonical(value).encode()).hexdigest()


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold the lock of a file, so that one of several processes makes a missing file while the others wait."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_name(f".{path.name}.lock").open("a") as lock:
        take(lock, fcntl.LOCK_EX)
        yield


def kept(
    path: Path, read: Callable[[Path], Value], make: Callable[[], Value], write: Callable[[Path, Value], None]
) -> Value:
    """Read a file; if it is missing or corrupt, return what `make` returns and write that to the file."""
    with alone(path):
        try:
            return read(path)
        except DAMAGED:
            made = make()
            with publish(path) as part:
                write(part, made)
            return made


def record_of(path: Path, key: str | None = None) -> dict[str, Any] | None:
    """The table in a JSON file; None if it cannot be read, is no table, or has another "key" than a given `key`."""
    try:
        record = read_json(path)
    except DAMAGED:
        return None
    return record if isinstance(record, dict) and key in (None, record.get("key")) else None
