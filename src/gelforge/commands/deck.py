"""Rebuild the deck of one sample from its stored solve, in a folder where stock CalculiX can run it."""

import shutil
from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.cli import RESULTS, command, option
from gelforge.flow.files import record_of, write_text
from gelforge.flow.layout import DECK, Layout, shard_name
from gelforge.flow.runs import refuse_rejected
from gelforge.geometry.gel import use_gels_of
from gelforge.mechanics.ccx.deck import press_deck
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.mechanics.mesh.basemesh import use_meshes_of
from gelforge.mechanics.mesh.names import load_mesh
from gelforge.records.forcefile import ForceFile
from gelforge.records.press import check_id
from gelforge.records.solvetable import corrupt

README = """\
`ccx {name}` in this folder solves press {name} of dataset {dataset} with stock CalculiX (mm, N, MPa), in the frame of the gel.
Its nodal forces on the gel are the last table "forces" of set NTOP in {name}.dat, together {total} N along x, y, z at C10 = {reference:g} MPa.
{labels}
"""


def solve_of(results: Path, sample_id: str) -> tuple[dict, Path, Path]:
    """Record of a sample's solve, the folder of solves, and the file of forces: of its shard, or of `make sample`."""
    of = Layout(results)
    shard = of.shard_of(sample_id)
    refuse_rejected(results, shard, sample_id)
    for own, name in ((of, shard), (of.sample(sample_id), shard_name(0))):
        if record := record_of(own.solve(name, sample_id)):
            return record, own.solves(name), own.forces(name)
    raise BadInput(f"sample {sample_id} was not solved yet; run {of.command(f'sample ID={sample_id}')}")


def of_labels(forces: Path) -> str:
    """How label forces differ from those of the deck, for the README."""
    if not forces.exists():
        return (
            "Labels hold these forces times the ratio of their C10 to that of the deck; this press has no label yet."
        )
    with ForceFile(forces) as found:
        ratio, c10, known = found.c10 / REFERENCE_C10, found.c10, "calibrated" if found.intervals else "as given"
    if ratio == 1.0:
        return "Labels hold these forces unchanged, because their C10 is that of the deck."
    return f"Labels hold these forces times {ratio:.6g}, because their C10 is {c10:.6g} MPa ({known}): forces are proportional to it."


def hand_out(results: Path, sample_id: str, out: Path) -> None:
    """Write deck and README of a sample to the folder `out`; BadInput where it has no deck."""
    record, folder, forces = solve_of(results, sample_id)
    if not record.get("deck"):
        how = record.get("reason") or f"it was solved by {record['method']}, without CalculiX"
        raise BadInput(
            f'sample {sample_id} has no deck: {how}; with [params.fea] method = "ccx" there is one, run'
            f" {Layout(results).command('fea')}"
        )
    if lost := corrupt(folder, record):
        again = f"remove {folder}.csv and run {Layout(results).command('fea')}, which solves the press again"
        raise BadInput(f"{lost[0]}: missing or changed since it was written; {again}")
    with np.load(folder / record["files"][0], allow_pickle=False) as kept:
        mesh, start = load_mesh(record["mesh"]), kept["start"]
        if len(start) != len(mesh.nodes):
            raise BadInput(
                f"{record['mesh']}: has {len(mesh.nodes)} nodes, but {sample_id} was solved on {len(start)}: the gel changed since;"
                f" run {Layout(results).command('fea')}"
            )
        text = press_deck(mesh, kept["prescribed"], start, **record["deck"])
    shutil.rmtree(out, ignore_errors=True)
    write_text(out / f"{sample_id}.inp", text)
    total = " ".join(f"{force:.6g}" for force in np.asarray(record["total"]))
    readme = README.format(
        name=sample_id, dataset=results.name, total=total, reference=REFERENCE_C10, labels=of_labels(forces)
    )
    write_text(out / "README", readme)


@command(
    RESULTS,
    option("--id", help="sample_id in the raw log"),
)
def main(args: Namespace) -> None:
    if not args.id:
        raise BadInput(f"no sample named; say {Layout(args.results).command('deck ID=SAMPLE_ID')}")
    of = Layout(args.results)
    use_gels_of(of.workflow)
    use_meshes_of(of.meshes)
    out = of.folder(DECK) / check_id(args.id)
    hand_out(args.results, args.id, out)
    print(f"deck: {out}")


if __name__ == "__main__":
    main.exit()
