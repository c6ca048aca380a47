"""A flow on disk that was never run, with the records that the wrapper would have written."""

import numpy as np

from gelforge.flow.files import write_csv, write_json
from gelforge.records.solvestore import SolveStore


def lay(results, count, size=100):
    """Write a flow of `count` presses in shards of `size`, with the wrapper's records."""
    names = [f"{k:04d}" for k in range(-(-count // size))]
    rows = [{"sample_id": f"s{k:05d}", "shard": k // size} for k in range(count)]
    write_csv(results / "00_plan/shards.csv", ["sample_id", "shard"], rows)
    cost = {"seconds": 2.0, "cpu_seconds": 1.5, "peak_mib": 80.0, "started": 1.0e9, "programs": {"numpy": "2.4.6"}}
    params = results / "00_plan/params"
    write_json(params / "poses.json", {"version": 1})
    write_json(params / "indenters.json", {"ball": {"radius": 3}, "other": {"radius": 4}})
    for name in names:
        of_shard = [row for row in rows if row["shard"] == int(name)]
        write_csv(results / f"00_plan/shards/{name}.csv", ["sample_id", "shard"], of_shard)
        pose, fea = results / f"10_poses/{name}.csv", results / f"30_fea/{name}.csv"
        write_csv(
            pose,
            ["sample_id", "indenter"],
            [{"sample_id": f"s{int(name) * size + k:05d}", "indenter": "ball"} for k in range(size)],
        )
        inputs = [str(params / "poses.json"), str(params / "indenters.json")]
        write_json(results / f"metrics/10_poses/{name}.json", cost | {"inputs": inputs})
        write_json(results / f"metrics/30_fea/{name}.json", cost | {"inputs": [str(pose)]})
        write_json(results / f"metrics/40_forces/{name}.json", cost | {"inputs": [str(fea)]})
        forces = str(results / f"40_forces/{name}.npz")
        write_json(results / f"metrics/50_labels/24x32/{name}.json", cost | {"inputs": [forces]})
        table = [{"sample_id": row["sample_id"], "key": f"key-of-{row['sample_id']}"} for row in of_shard]
        write_csv(fea, ["sample_id", "key"], table)
    solve = {"status": "OK", "reason": "", "method": "label", "mesh": "hex@a",
             "evidence": {"seconds": 3.25, "peak_mib": 77.0}}  # fmt: skip
    SolveStore(results.parent / "solves").publish("key-of-s00123", solve, {"force": np.zeros((2, 3))})
