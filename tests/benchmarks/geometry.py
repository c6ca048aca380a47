"""Indenters and gel against the published solids, and speed of their distance functions."""

import time
from argparse import Namespace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gelforge.errors import BadInput
from gelforge.flow.cli import command, option
from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import load_catalogue
from tests.support.figures import PUBLISHED_DATA, Figure, publish_figures
from tests.support.published import compare_gel_top, compare_indenter, published_names, step_file


def solid_figures(catalogue: dict, reference: Path) -> list[Figure]:
    """Largest deviations of all indenters from the published solids, and of the gel's top."""
    try:
        import gmsh  # noqa: F401
    except (ImportError, OSError) as error:
        raise BadInput(f"gmsh reads the STEP files and cannot be loaded ({error}); pip install gmsh") from None
    if not reference.is_dir():
        raise BadInput(f"{reference}: no reference data there; set GELFORGE_REFERENCE to their folder")
    found = {
        name: compare_indenter(body, step_file(reference, name), good_mm=0.01)
        for name, body in tqdm(catalogue.items(), "solids", len(catalogue))
    }
    volume = max(found, key=lambda n: abs(found[n]["volume_error"]))
    surface = max(found, key=lambda n: found[n]["surface_mm"])
    top = compare_gel_top(Gel(), reference / "feats" / "gelsight_mini.step")
    return [
        Figure(
            "indenters' volume against STEP",
            100.0 * abs(found[volume]["volume_error"]),
            "<=",
            2.0,
            "%",
            f"worst of {len(found)}: {volume}",
        ),
        Figure(
            "indenters' contact side against STEP",
            found[surface]["surface_mm"],
            "<=",
            0.05,
            "mm",
            f"worst of {len(found)}: {surface}",
        ),
        Figure("gel's top against STEP", top, "<=", 0.02, "mm"),
    ]


def speed_figures(catalogue: dict) -> list[Figure]:
    """The slowest indenter's time for 10 000 points, best of seven."""
    points = np.random.default_rng(1).uniform([-12, -12, -3], [12, 12, 3], (10_000, 3))
    seconds = {name: min(_timed(body.distance, points) for _ in range(7)) for name, body in catalogue.items()}
    slowest, usual = max(seconds, key=seconds.get), np.median(list(seconds.values()))
    return [
        Figure("distance at 10 000 points, slowest", 1e3 * seconds[slowest], "<=", 10.0, "ms", slowest),
        Figure("distance at 10 000 points, median", 1e3 * usual, "<=", 3.0, "ms"),
    ]


def _timed(function, argument) -> float:
    start = time.perf_counter()
    function(argument)
    return time.perf_counter() - start


@command(
    option("--catalogue", type=Path, default=Path("workflow/indenters.toml")),
    option("--solids", nargs="+", help="only these of the published ones", default=None),
    option("--reference", type=Path, default=PUBLISHED_DATA),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    catalogue = load_catalogue(args.catalogue)
    published = {name: catalogue[name] for name in args.solids or sorted(published_names(args.catalogue))}
    publish_figures(
        args.out, [*solid_figures(published, args.reference), *speed_figures(published if args.solids else catalogue)]
    )


if __name__ == "__main__":
    main.exit()
