"""A network on unseen units of the rig: forces, faults of an image pair, drift, calibration by few force readings.

Presses are solved here, with another seed than any plan's, and seen by the units that train.toml keeps from training.
The true force of a press is that of `hex` at label quality on its real path, because the rig's own hexahedra are
twice as wide and too stiff: by up to a tenth on shapes with edges, by 3 % in the mean.
"""

from argparse import Namespace
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from gelforge.flow.cli import command, option
from gelforge.geometry.gel import Gel, load_gel
from gelforge.geometry.indenters import load_catalogue
from gelforge.labelling.sensor import Sensor
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.material import REFERENCE_C10, Material
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.reading.interval import half_widths
from gelforge.reading.model import ForceModel, fingerprint, load_model
from gelforge.reading.profile import fit_gain
from gelforge.reading.reader import Reader
from gelforge.records.axes import CHANNELS
from gelforge.stages.rig import units_of
from gelforge.sweeps.trial import cells_of
from gelforge.virtualrig import streams
from gelforge.virtualrig.bench import Bench
from gelforge.virtualrig.fields import field_of, surface_of
from gelforge.virtualrig.render import Pressed, Renderer
from gelforge.virtualrig.rigplan import Order, generator, orders, read_plan
from tests.support.figures import Figure, publish_figures
from tests.support.pictures import moved

RANGE = {"fy": 10.0, "fx": 10.0, "fz": 40.0}  # N, of the FEATS paper
SOFTER_HARDER = 0.15  # largest relative difference in stiffness between gels of one kind
READ_NOISE = 0.03  # N, noise of a force sensor
COUNTS = (0, 1, 2, 5, 10, 20)  # numbers of force readings for a calibration
PRESSES = 28
DRAWS = 40  # random draws of the readings per unit
WRONG = 0.15  # fraction of the range; a prediction with a larger error must be flagged
HOUR = 360  # no-contact frames in an hour, one between every two presses


@dataclass(frozen=True)
class Seen:
    """One press seen by one unit: image, true total (3,) N in the labels' channels, total of the rig's hexahedra."""

    unit: str
    image: np.ndarray
    total: np.ndarray
    rig_total: np.ndarray


@dataclass(frozen=True)
class Units:
    """The plan's dataset, cameras of its unseen units, their no-contact images, and their views of presses."""

    dataset: str
    cameras: dict[str, Renderer]
    nocontact: dict[str, np.ndarray]
    seen: list[Seen]


def press_units(plan_path: Path, count: int, most: int | None, seed: int | None) -> Units:
    """Press `count` times; the plan's unseen units, at most `most` of them, see every press.

    seed: draws other units and other presses than the plan's, such as the limits of faults.py were not set on.
    """
    plan = read_plan(plan_path)
    if seed is not None:
        plan = replace(plan, seed=seed, dataset=f"{plan.dataset} drawn by {seed}")
    appearances, sensors = units_of(plan, plan_path.parents[1])
    names = plan.held_out_sensors[:most]
    gel = Gel()
    cameras = {name: Renderer(appearances[name], sensors[name].projection, gel) for name in names}
    nocontact = {
        name: camera.image(rng=np.random.default_rng([7, k])) for k, (name, camera) in enumerate(cameras.items())
    }
    fresh = replace(plan, seed=plan.seed + 1, kinds=plan.kinds[-1:], presses=count)
    bodies = load_catalogue(plan_path.parents[1] / plan.catalogue, fresh.indenters)
    seen: list[Seen] = []
    bench = Bench(fresh, bodies, gel)
    for order in tqdm([order for order in orders(fresh) if order.unit == 0], "presses", count):
        seen += see(bench, order, cameras, sensors)
    return Units(plan.dataset, cameras, nocontact, seen)


def see(bench: Bench, order: Order, cameras: dict[str, Renderer], sensors: dict[str, Sensor]) -> list[Seen]:
    """Each unit's view of one press, with the force inside its image; empty if the press has no equilibrium."""
    truth, gel = bench.plan.truth, load_gel(order.gel)
    pressing = bench.press(order)[-1]
    scene = Scene(gel, Material(truth.nu), bench.indenters[order.indenter], pressing.real, Interface())
    solved = HexSolver(quality("label")).solve(scene)
    if not (pressing.result.status.valid and solved.status.valid):
        return []
    field = field_of(
        gel, surface_of(pressing.result.mesh, pressing.result.displacement, pressing.real, pressing.down)
    )
    body = Pressed(bench.body(order.indenter), pressing.real)
    stiffness, found = truth.c10_mpa / REFERENCE_C10, []
    for k, (name, camera) in enumerate(cameras.items()):
        noise = generator(bench.plan, order.index, streams.camera(98 + k, 0))  # far from the plan's own cameras
        image = camera.image(field, body, noise)
        # force outside the image does not count
        cells, outside = cells_of(solved.mesh, solved.forces, sensors[name])
        total, rig_total = stiffness * cells.sum(axis=(1, 2)), pressing.force - stiffness * outside
        found.append(Seen(name, image, total, rig_total))
    return found


def totals(predictor: Reader, image: np.ndarray) -> np.ndarray:
    """Predicted total force (3,) N of an image."""
    return predictor(image).total


def error_figures(units: Units, read: np.ndarray) -> list[Figure]:
    """Mean error of total force on unseen units."""
    true = np.array([seen.total for seen in units.seen])
    mae = np.abs(read - true).mean(axis=0)
    rig = np.abs(read - np.array([seen.rig_total for seen in units.seen])).mean(axis=0)
    note = f"{len(true)} images of {len(true) // len(units.nocontact)} presses by {len(units.nocontact)} units; "
    note += f"against the rig's own forces {', '.join(f'{value:.2f}' for value in rig)} N"
    return [
        Figure(f"unseen units, total {name}", 100 * value / RANGE[name], "<=", 2.5 if name == "fz" else 1.2,
               "% of range", f"{value:.2f} N of {RANGE[name]:g}; {note}")
        for name, value in zip(CHANNELS, mae, strict=True)
    ]  # fmt: skip


def interval_figure(units: Units, model: ForceModel, read: np.ndarray) -> list[Figure]:
    """Coverage of the intervals of total force, on units that did not set these intervals."""
    known = model.metadata.get("intervals", {})
    if "total" not in known:
        return []
    # units of two datasets may have the same names
    set_on = known["sensors"] if known["data"] == units.dataset else []
    others = np.array([seen.unit not in set_on for seen in units.seen])
    if not others.any():
        return []
    true = np.array([seen.total for seen in units.seen])
    half = np.array([half_widths(model.metadata, one) for one in read])
    held = 100 * (np.abs(read - true) <= half)[others].mean(axis=0)
    note = ", ".join(f"{name} {value:.0f}" for name, value in zip(CHANNELS, held, strict=True))
    return [Figure("totals that their 90 % intervals hold, farthest from it", float(held[np.abs(held - 90).argmax()]), ">=", 87.0,
                   "%", f"{note}; {others.sum()} images of other units than the intervals were set on")]  # fmt: skip


# -- disturbances of an image pair


def scaled(image: np.ndarray, factor: float) -> np.ndarray:
    """An image with all grey levels multiplied by a factor."""
    return np.clip(np.rint(image * factor), 0, 255).astype(np.uint8)


def less_red(image: np.ndarray) -> np.ndarray:
    """An image with red lowered by two levels."""
    return np.clip(image.astype(int) - [2, 0, 0], 0, 255).astype(np.uint8)


SUFFERED: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "red -2 levels": less_red,
    "all x 0.90": lambda image: scaled(image, 0.9),
    "a zoom of 4 thousandths": partial(moved, zoom=1.004),
    "a shift of 0.5 px": partial(moved, shift=(0.4, 0.3)),
}


def sensitivity_figures(units: Units, readers: dict[str, Reader], read: np.ndarray) -> list[Figure]:
    """Effect of changes of light and place: predicted force on no-contact images, change of force on pressed ones."""
    figures = []
    for what, suffer in SUFFERED.items():
        rest = [np.abs(totals(readers[name], suffer(picture))).max() for name, picture in units.nocontact.items()]
        after = np.array([totals(readers[seen.unit], suffer(seen.image)) for seen in units.seen])
        figures.append(
            Figure(f"{what}, no contact, worst unit", max(rest), "<=", 0.3, "N", f"median {np.median(rest):.2f}")
        )
        figures.append(change_figure(f"{what}, pressed, mean change", units, read, after))
    return figures


def change_figure(name: str, units: Units, read: np.ndarray, after: np.ndarray) -> Figure:
    """Relative change of predicted totals (n, 3) N of pressed images by a disturbance."""
    full = np.abs(np.array([seen.total[2] for seen in units.seen])) > 2.0
    off = 100 * np.abs(after - read)[full].max(axis=1) / np.abs(read[full, 2])
    note = f"median {np.median(off):.1f}, nine of ten below {np.percentile(off, 90):.1f}"
    return Figure(name, float(off.mean()), "<=", 2.0, "%", note)


# -- an hour of drifting light


def drift_figure(units: Units, readers: dict[str, Reader]) -> Figure:
    """Force on no-contact frames, as 90 % quantile over an hour in which each colour's light drifts."""
    worst = {}
    for k, (name, camera) in enumerate(units.cameras.items()):
        rng, found = np.random.default_rng([9, k]), []
        still = Renderer(replace(camera.appearance, drift=None), camera.projection, camera.gel)
        rest = still.image(rng=rng)
        one = Reader(rest, model=readers[name].model)
        phase, period = rng.uniform(0, 2 * np.pi, (2, 3)), rng.uniform(60, 400, (2, 3))
        for frame in range(0, HOUR, 12):
            wave = np.sin(2 * np.pi * frame / period + phase) - np.sin(phase)
            picture = still.image(rng=rng) * (1.0 + 0.05 * wave[0]) + 3.0 * wave[1]
            found.append(np.abs(totals(one, np.clip(np.rint(picture), 0, 255).astype(np.uint8))).max())
        worst[name] = float(np.percentile(found, 90))
    name = max(worst, key=worst.get)
    return Figure("an hour of drifting light, no-contact frames, worst unit", worst[name], "<=", 0.3, "N",
                  f"{name}; median {np.median(list(worst.values())):.2f}")  # fmt: skip


# -- calibration by force readings


def readings_left(units: Units, read: np.ndarray) -> list[dict]:
    """Errors of a gel's factor and of forces after calibration by force readings, and coverage of the factor.

    One row for each of COUNTS: means, and 10 % and 90 % quantiles over the draws.
    """
    rng = np.random.default_rng(3)
    true, normal = -np.array([seen.total[2] for seen in units.seen]), -read[:, 2]
    left = {count: [] for count in COUNTS}
    for name in units.nocontact:
        own = np.array([seen.unit == name for seen in units.seen]) & (normal > 1.0) & (true > 1.0)
        for _ in range(DRAWS):
            stiffness = 1.0 + rng.uniform(-SOFTER_HARDER, SOFTER_HARDER)
            rows = rng.permutation(np.flatnonzero(own))
            measured = stiffness * true[rows] + rng.normal(0.0, READ_NOISE, len(rows))
            expected = float(np.exp(np.median(np.log(stiffness * true[rows] / normal[rows]))))
            for count in COUNTS:
                if count >= len(rows):
                    continue
                gain = fit_gain(measured[:count], normal[rows[:count]])
                rest = rows[count:]
                force = np.abs(gain.value * normal[rest] - stiffness * true[rest]).mean()
                left[count].append((abs(gain.value / expected - 1.0), force, gain.low <= expected <= gain.high))
    rows = []
    for count, values in left.items():
        if values:
            off, force, held = np.array(values, float).T
            rows.append({
                "readings": count, "factor_percent": 100 * off.mean(), "force_n": force.mean(), "held_percent": 100 * held.mean(),
                "factor_between": (100 * np.quantile(off, [0.1, 0.9])).tolist(),
                "force_between": np.quantile(force, [0.1, 0.9]).tolist(),
            })  # fmt: skip
    return rows


def gain_figures(left: list[dict]) -> list[Figure]:
    """Errors after five readings, and coverage of the factor's intervals; empty if there are too few presses."""
    five = next((row for row in left if row["readings"] == 5), None)
    if five is None:
        print(f"readings of a scale: no unit has more than five presses of over 1 N; give more, such as {PRESSES}")
        return []
    held = np.mean([row["held_percent"] for row in left if row["readings"]])
    return [
        Figure("error of a gel's factor after five readings", five["factor_percent"], "<=", 3.0, "%"),
        Figure("normal force after five readings", 100 * five["force_n"] / RANGE["fz"], "<=", 1.5, "% of range"),
        Figure("intervals of the factor that hold it, mean", held, ">=", 87.0, "%"),
    ]


# -- the flag


def faulty_pairs(units: Units, readers: dict[str, Reader]) -> Iterator[tuple[str, Reader, np.ndarray, np.ndarray]]:
    """Name of a fault, predictor with its no-contact image, image, true total (3,) N, for each press and fault."""
    names = list(readers)
    for k, seen in enumerate(tqdm(units.seen, "presses with faults")):
        rest = readers[seen.unit]
        other = readers[names[(names.index(seen.unit) + 1 + k % (len(names) - 1)) % len(names)]]
        touched = Reader(units.seen[(k + len(names) * 5) % len(units.seen)].image, model=rest.model)
        yield "none", rest, seen.image, seen.total
        yield "another unit's no-contact image", other, seen.image, seen.total
        yield "contact in the no-contact image", touched, seen.image, seen.total
        yield "a shift of 8 px", rest, moved(seen.image, (6.4, 4.8)), seen.total
        yield "a turn of 4 degrees", rest, moved(seen.image, turn=-4.0), seen.total
        yield "a zoom of 10 %", rest, moved(seen.image, zoom=1.1), seen.total
        yield "colours in reverse order", rest, seen.image[..., ::-1], seen.total
        yield "dark", rest, scaled(seen.image, 0.4), seen.total
        yield "overexposed", rest, scaled(seen.image, 2.0), seen.total
        yield "out of focus", rest, cv2.GaussianBlur(seen.image, (0, 0), 5.0), seen.total
        yield "mirrored", rest, np.ascontiguousarray(seen.image[:, ::-1]), seen.total


def flag_figures(units: Units, readers: dict[str, Reader]) -> list[Figure]:
    """Fraction of wrongly predicted pairs that are flagged, by fault, and fraction of good pairs that are flagged."""
    found: dict[str, list[tuple[float, bool]]] = {}
    for fault, reader, image, true in faulty_pairs(units, readers):
        read = reader(np.ascontiguousarray(image))
        off = np.abs(read.total - true) / [RANGE[name] for name in CHANNELS]
        # what is said once of a no-contact image is said of a fault, and flags no good pair
        found.setdefault(fault, []).append((float(off.max()), read.flag or bool(fault != "none" and reader.doubt)))
    bad = [flag for pairs in found.values() for off, flag in pairs if off > WRONG]
    good = [flag for off, flag in found["none"] if off <= WRONG]
    note = ", ".join(
        f"{fault} {sum(flag for off, flag in pairs if off > WRONG)} of {sum(off > WRONG for off, _ in pairs)}"
        for fault, pairs in found.items()
    )
    return [
        Figure("pairs that are read wrong by over 15 % of the range and flagged", 100 * np.mean(bad), ">=", 95.0, "%", note),
        Figure("good pairs that are flagged", 100 * np.mean(good), "<=", 5.0, "%", f"of {len(good)}"),
    ]  # fmt: skip


@command(
    option("--plan", type=Path, default=Path("workflow/rig/train.toml")),
    option("--model", type=Path, default=None, help="model file; the one that ships if not named"),
    option("--presses", type=int, default=PRESSES),
    option("--units", type=int, default=None, help="of the plan's unseen units; fewer only to try it out"),
    option("--seed", type=int, default=None, help="draws other units and presses than the plan's"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    model, units = load_model(args.model), press_units(args.plan, args.presses, args.units, args.seed)
    readers = {name: Reader(picture, model=model) for name, picture in units.nocontact.items()}
    read = np.array([totals(readers[seen.unit], seen.image) for seen in units.seen])
    left = readings_left(units, read)
    figures = error_figures(units, read) + interval_figure(units, model, read)
    figures += sensitivity_figures(units, readers, read)
    figures += [drift_figure(units, readers), *gain_figures(left), *flag_figures(units, readers)]
    publish_figures(args.out, figures, fingerprint(model.metadata), readings=left)


if __name__ == "__main__":
    main.exit()
