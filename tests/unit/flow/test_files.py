"""Files are published whole: what another process, a kill or a power cut may find."""

import errno
import os

import pytest

from gelforge.flow import files
from gelforge.flow.files import publish, write_json, write_text


def test_after_a_power_cut_a_file_is_whole_or_absent(tmp_path, monkeypatch):
    """Its content is on the disk before it gets its name."""
    steps, named, synced = [], os.replace, os.fsync

    def note_sync(number):
        where = os.readlink(f"/proc/self/fd/{number}")
        steps.append(("synced", where, os.path.getsize(where)))
        synced(number)

    def note_name(before, after):
        steps.append(("named", str(before), str(after)))
        named(before, after)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(os, "replace", note_name)
    path = tmp_path / "result.json"
    for write, what in ((write_text, "whole"), (write_json, {"whole": 1})):
        steps.clear()
        write(path, what)
        (content, part, size), (name, before, after) = steps
        assert (content, name) == ("synced", "named") and part == before and after == str(path)
        assert size == path.stat().st_size > 0


def test_a_writer_that_fails_leaves_what_was_there(tmp_path):
    path = tmp_path / "result.txt"
    path.write_text("before")
    with pytest.raises(ValueError, match="half-way"), publish(path) as part:
        part.write_text("half")
        raise ValueError("half-way")
    assert path.read_text() == "before" and [one.name for one in tmp_path.iterdir()] == ["result.txt"]


def test_where_a_link_is_refused_the_file_is_copied(tmp_path, monkeypatch):
    """exFAT, SMB and s3fs have no hard links: stage 60 always failed."""
    (tmp_path / "a").write_text("content")
    files.link_or_copy(tmp_path / "a", tmp_path / "b")
    assert (tmp_path / "b").stat().st_ino == (tmp_path / "a").stat().st_ino

    def refused(*_args, **_named):
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", refused)
    files.link_or_copy(tmp_path / "a", tmp_path / "c")
    assert (tmp_path / "c").read_text() == "content"
    assert (tmp_path / "c").stat().st_ino != (tmp_path / "a").stat().st_ino
