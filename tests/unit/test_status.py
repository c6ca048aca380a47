"""Status counts what is on disk, and names why samples are missing."""

from gelforge.commands.status import lines
from gelforge.flow.files import write_csv


def test_counts_add_up_and_reasons_are_named(tmp_path):
    results = tmp_path / "lab"
    assert "nothing planned" in lines(results)[0]
    write_csv(
        results / "00_plan/shards.csv", ["sample_id", "shard"], [{"sample_id": k, "shard": k // 3} for k in range(6)]
    )
    for name in ("0000", "0001"):
        write_csv(results / f"00_plan/shards/{name}.csv", ["sample_id"], [])
    write_csv(results / "10_poses/0000.csv", ["sample_id"], [{"sample_id": k} for k in range(2)])
    rejected = [{"row": 4, "column": c, "reason": "not a number"} for c in ("x0_mm", "y0_mm")]
    write_csv(results / "10_poses/0000.rejected.csv", ["row", "column", "reason"], rejected)
    write_csv(
        results / "30_fea/0000.csv", ["sample_id", "status", "reason"],
        [{"sample_id": 0, "status": "OK", "reason": ""}, {"sample_id": 1, "status": "DIVERGED", "reason": "too deep"}],
    )  # fmt: skip
    text = lines(results)
    table = {line.split()[0]: line.split()[1:] for line in text[2:] if not line.startswith(" ")}
    assert table["10_poses"] == ["2", "1", "3"]
    assert table["30_fea"] == ["1", "1", "3"]
    assert table["40_forces"] == ["0", "0", "4"]
    for stage in ("40_forces", "50_labels/24x32"):
        (results / stage).mkdir(parents=True)
        (results / stage / "0000.npz").touch()
    table = {line.split()[0]: line.split() for line in lines(results)}
    # of shard 0000 one row was rejected and one press not solved; the three of shard 0001 are to come
    assert table["40_forces"][1:] == ["1", "0", "3"] and table["50_labels"][2:] == ["1", "0", "3"]
    assert any("not a number" in line for line in text) and any("too deep" in line for line in text)
