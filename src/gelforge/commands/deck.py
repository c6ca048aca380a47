"""Rebuild the deck of one sample from its stored solve, in a folder where stock CalculiX can run it."""

import shutil
from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.cli import RESULTS, command, option
from gelforge.flow.files import write_text
from gelforge.flow.layout import DECK, Layout
from gelforge.geometry.gel import use_gels_of
from gelforge.mechanics.ccx.deck import press_deck
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.mechanics.mesh.basemesh import use_meshes_of
from gelforge.mechanics.mesh.names import load_mesh
from gelforge.records.finder import find
from gelforge.records.forcefile import ForceFile
from gelforge.records.press import check_id

README = """\
`ccx {name}` in this folder solves press {name} of dataset {dataset} with stock CalculiX (mm, N, MPa), in the frame of the gel.
Its nodal forces on the gel are the last table "forces" of set NTOP in {name}.dat, together {total} N along x, y, z at C10 = {reference:g} MPa.
{labels}
"""


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
    of, found = Layout(results), find(results, sample_id)
    found.refuse_rejected()
    if not found.key:
        raise BadInput(f"sample {sample_id} was not solved yet; run {of.command(f'sample ID={sample_id}')}")
    record = found.record
    if record is None:
        again = f"remove {found.of.fea(found.shard)} and run {of.command('fea')}, which solves the press again"
        raise BadInput(f"{found.arrays}: missing or changed since it was written; {again}")
    if not record.get("deck"):
        how = record.get("reason") or f"it was solved by {record['method']}, without CalculiX"
        raise BadInput(
            f'sample {sample_id} has no deck: {how}; with [params.fea] method = "ccx" there is one, run {of.command("fea")}'
        )
    with np.load(found.arrays, allow_pickle=False) as kept:
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
        name=sample_id,
        dataset=results.name,
        total=total,
        reference=REFERENCE_C10,
        labels=of_labels(found.of.forces(found.shard)),
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
