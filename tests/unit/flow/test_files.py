"""Files are whole or absent, also on file systems without links and after a power cut."""

import errno
import os

import pytest

from gelforge.flow import files


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


def test_a_file_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    """After a power cut a file could be there and empty."""
    done = []
    sync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda number: done.append("sync") or sync(number))
    monkeypatch.setattr(os, "replace", lambda a, b: done.append("rename") or replace(a, b))
    files.write_text(tmp_path / "a", "content")
    assert done == ["sync", "rename"]
    with pytest.raises(ZeroDivisionError), files.publish(tmp_path / "b") as part:
        part.write_text("half")
        raise ZeroDivisionError
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a"]
