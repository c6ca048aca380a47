"""Files that are either whole or absent; their digests and locks; what is found again by what it was made of."""

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
# What reading a file that is not there, corrupt or hostile can raise in json, zipfile, zlib and numpy.
DAMAGED = (
    OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, MemoryError, NotImplementedError, OverflowError,
    SyntaxError, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
# What a file was when it was read: its digest, size in bytes and time stamp in ns. The latter two spare reading it again.
State = list


def listed(folder: Path, pattern: str, below: bool = False) -> list[Path]:
    """Paths of a folder whose names match a pattern, in order, none where there is no folder; below: of all folders in it.

    Files that `publish` is still writing, or that a killed writer left, are none of them.
    """
    found = folder.rglob(pattern) if below else folder.glob(pattern)
    return sorted(path for path in found if not path.name.startswith("."))


def names_in(folder: Path | str, suffix: str) -> list[str]:
    """Names of a folder's files with a suffix, in order, as `listed`: of thousands a Path each would take longer."""
    try:
        found = os.listdir(folder)
    except (FileNotFoundError, NotADirectoryError):
        return []
    return sorted(name for name in found if name.endswith(suffix) and not name.startswith("."))


def below(folder: Path | str, suffix: str) -> list[str]:
    """Paths of the files with a suffix in all folders of a folder, in order, as `names_in`."""
    return sorted(f"{at}/{name}" for at, _, names in os.walk(folder) for name in names
                  if name.endswith(suffix) and not name.startswith("."))  # fmt: skip


def digest_of(path: Path) -> str:
    """SHA-256 of a file's content."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def state_of(path: str, known: State | None = None) -> State | None:
    """What a file is now; None where there is none. known: what it was, whose digest holds where size and time do.

    Of a folder its names alone count.
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
            return None  # a pipe, say, from which reading would wait for ever
    except (OSError, ValueError):
        return None
    return [digest, found.st_size, found.st_mtime_ns]


def states_of(paths: Iterable[Path | str], known: Mapping[str, State | None]) -> dict[str, State | None]:
    """States by path. known: earlier ones."""
    return {path: state_of(path, known.get(path)) for path in map(str, paths)}


def changed(known: Mapping[str, State | None], now: Mapping[str, State | None]) -> list[str]:
    """Those files whose content is another one now, that came or that went."""
    return [path for path, was in known.items() if (was and was[0]) != ((state := now[path]) and state[0])]


@contextmanager
def publish(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` if the block succeeds.

    A killed or failing writer leaves nothing under the final name. The temporary name keeps
    the suffix, because numpy and OpenCV choose a format by it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield part
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def write_text(path: Path | str, text: str) -> None:
    """Write `text` to `path`, whole or not at all."""
    with publish(path) as part:
        part.write_text(text, encoding="utf-8")


def write_if_changed(path: Path | str, text: str) -> bool:
    """Write `text` to `path` only where it differs; return whether it was written.

    An unchanged file keeps its time stamp, so make sees no reason to rebuild what follows.
    """
    try:
        with open(path, "rb") as stream:  # what lies there may be damaged, and no text at all
            if stream.read() == text.encode():
                return False
    except FileNotFoundError:
        pass
    write_text(path, text)
    return True


def take(lock: IO[str], kind: int) -> None:
    """Take a lock of an open file, as fcntl.flock does; BadInput where the file system has none."""
    try:
        fcntl.flock(lock, kind)
    except BlockingIOError:
        raise
    except OSError as error:
        raise BadInput(
            f"{lock.name}: no file locks here ({error.strerror}), without which two makes would write one file; mount the"
            " file system with them (Lustre: -o flock), or let results be a link to a folder on another one"
        ) from error


def need_room(folder: Path, size: int) -> None:
    """OSError where less than `size` bytes are free in a folder: beside programs that say nothing of it, or crash."""
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
    """Read a TOML file; one that is not there, cannot be read or is no TOML raises BadInput with file and place.

    It may begin with a byte order mark, as Windows writes it.
    hint: what to do where there is none of that name.
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
    """The last line of a text file, such as a log that is being written, that is not blank; of a long one its end."""
    with path.open("rb") as text:
        text.seek(max(0, path.stat().st_size - 1000))
        lines = text.read().decode("utf-8", errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "")


def csv_text(columns: Collection[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Dict rows as CSV text; a missing cell is empty."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")  # DictWriter takes half as long again
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
    """One text per value: sorted keys, no comments, exact floats."""
    return json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def digest_of_value(value: Any) -> str:
    """SHA-256 of a value's canonical text, as hexadecimal digits."""
    return hashlib.sha256(canonical(value).encode()).hexdigest()


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold the lock of a file: of several processes that miss it one makes it, and the others wait."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_name(f".{path.name}.lock").open("a") as lock:
        take(lock, fcntl.LOCK_EX)
        yield


def kept(
    path: Path, read: Callable[[Path], Value], make: Callable[[], Value], write: Callable[[Path, Value], None]
) -> Value:
    """What a file holds; where there is none that can be read, what `make` makes, which is then kept in it."""
    with alone(path):
        try:
            return read(path)
        except DAMAGED:
            made = make()
            with publish(path) as part:
                write(part, made)
            return made


def record_of(path: Path, key: str | None = None) -> dict[str, Any] | None:
    """The table of a JSON file, one made under `key` where that is given; None where there is no such."""
    try:
        record = read_json(path)
    except DAMAGED:
        return None
    return record if isinstance(record, dict) and key in (None, record.get("key")) else None
