"""Shards: every sample has one, keeps it, and appending changes the last one only."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelforge.errors import BadInput
from gelforge.flow import params as config
from gelforge.flow.files import write_if_changed
from gelforge.stages.plan import assign_shards, write_shards

NAMES = st.lists(st.integers(0, 200).map(str), unique=True, max_size=60)


@given(NAMES, NAMES, st.integers(1, 9))
def test_a_sample_keeps_its_shard_when_the_log_grows(first, second, size):
    before = assign_shards(first, {}, size)
    after = assign_shards(first + second, before, size)
    assert {name: after[name] for name in first} == before
    assert set(after) == set(first) | set(second)


@given(NAMES, st.integers(1, 9))
def test_shards_hold_at_most_their_size_and_fill_in_order(names, size):
    counts = {}
    for shard in assign_shards(names, {}, size).values():
        counts[shard] = counts.get(shard, 0) + 1
    assert all(count <= size for count in counts.values())
    assert sorted(counts) == list(range(len(counts)))


def write_log(path, ids):
    path.write_text("sample_id,x0_mm\n" + "".join(f"{i},0.5\n" for i in ids), encoding="utf-8")


def test_appending_rewrites_only_the_last_shard(tmp_path):
    log = tmp_path / "log.csv"
    write_log(log, range(10))
    assert write_shards(log, tmp_path, 4) == ["0000", "0001", "0002"]
    before = {p.name: p.stat().st_mtime_ns for p in (tmp_path / "shards").glob("*.csv")}
    write_log(log, range(13))
    assert write_shards(log, tmp_path, 4) == ["0000", "0001", "0002", "0003"]
    after = {p.name: p.stat().st_mtime_ns for p in (tmp_path / "shards").glob("*.csv")}
    assert [name for name in before if after[name] != before[name]] == ["0002.csv"]


def test_a_log_that_lost_rows_leaves_no_shard_behind(tmp_path):
    log = tmp_path / "log.csv"
    write_log(log, range(10))
    write_shards(log, tmp_path, 4)
    write_log(log, range(4))
    assert write_shards(log, tmp_path, 4) == ["0000"]
    assert [path.name for path in (tmp_path / "shards").glob("*.csv")] == ["0000.csv"]


@pytest.mark.parametrize(
    ("text", "named"),
    [("", "sample_id"), ("a,b\n1,2\n", "sample_id"), ("sample_id,x0_mm\n", "no rows")],
)
def test_a_log_that_cannot_be_sharded_is_refused(tmp_path, text, named):
    log = tmp_path / "log.csv"
    log.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=named):
        write_shards(log, tmp_path, 4)


def test_a_log_that_is_not_text_is_refused(tmp_path):
    log = tmp_path / "log.csv"
    log.write_bytes(b"sample_id\n\xff\xfe\x00")
    with pytest.raises(BadInput, match="UTF-8"):
        write_shards(log, tmp_path, 4)


def test_a_misspelt_override_is_refused(tmp_path):
    (tmp_path / "params.toml").write_text("[fea]\nfidelity = 'hex'\n")
    dataset = tmp_path / "dataset.toml"
    dataset.write_text("[params.fea]\nfidelty = 'ccx'\n")
    with pytest.raises(BadInput, match="fidelty"):
        config.load_params(tmp_path, dataset)


def test_a_comment_does_not_touch_a_slice(tmp_path):
    params = {"poses": {"a": 1}}
    path = tmp_path / "poses.json"
    assert write_if_changed(path, config.canonical(config.cut_slice(params, "poses", 1)))
    assert not write_if_changed(path, config.canonical(config.cut_slice(dict(params), "poses", 1)))
    assert write_if_changed(path, config.canonical(config.cut_slice(params, "poses", 2)))
