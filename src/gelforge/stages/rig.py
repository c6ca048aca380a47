"""Source `rig`: carry out a plan on the virtual bench and write data/DATASET as a real bench would."""

import hashlib
import json
import os
from argparse import Namespace
from collections import deque
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from gelforge.flow.cli import command, option, positive
from gelforge.flow.files import publish
from gelforge.flow.jobs import pool
from gelforge.flow.params import overlaid, with_content
from gelforge.geometry.gel import load_gel, use_gels_of
from gelforge.geometry.indenters import load_catalogue, read_catalogue
from gelforge.labelling.sensor import Sensor, load_sensors
from gelforge.virtualrig import streams
from gelforge.virtualrig.appearance import Appearance, read_appearances
from gelforge.virtualrig.rigplan import Order, Plan, check_names, generator, orders, read_plan, with_indenters
from gelforge.virtualrig.units import draw_units
from gelforge.virtualrig.writer import (
    Dataset,
    image_name,
    logged,
    nocontact_name,
    save_image,
    surface_name,
    truth_row,
    write_sensors,
)

FILM, RATE, QUALITY = "film.avi", 15, 90  # name, images a second, JPEG's quality
CAMERAS = 64  # cameras that a process keeps, 20 MB each; making one costs as much as about three images


class Worker:
    """The bench and the cameras of one process."""

    def __init__(self, plan: Plan, workflow: Path, folder: Path):
        import cv2

        from gelforge.virtualrig.bench import Bench

        cv2.setNumThreads(1)
        gel = load_gel(plan.gel)
        self.plan, self.folder, self.gel = plan, folder, gel
        indenters = load_catalogue(workflow / plan.catalogue, plan.indenters, workflow)
        self.bench = Bench(plan, indenters, gel)
        self.appearances, self.sensors = units_of(plan, workflow)
        self.camera = lru_cache(CAMERAS)(self._camera)

    def _camera(self, sensor: str):
        from gelforge.virtualrig.render import Renderer

        return Renderer(self.appearances[sensor], self.sensors[sensor].projection, self.gel)

    def picture_nocontact(self, sensor: str) -> None:
        """Take the no-contact image of a unit, from which its markers and projection can be found."""
        chance = of_nocontact(self.plan, self.appearances[sensor])
        save_image(self.folder / nocontact_name(sensor), self.camera(sensor).image(rng=chance))

    def carry_out(self, orders: list[Order], solved: bool) -> list[tuple]:
        """Press once and take every image of `orders`, which are the frames of one press by one or more sensors.

        Returns (order, row of the log or None, row of the truth) of each. If the press is `solved` already, it only
        draws the images from the stored surface and returns an empty list.
        """
        from gelforge.virtualrig.fields import Surface, surface_of

        by_frame: dict[int, list[Order]] = {}
        for order in orders:
            by_frame.setdefault(order.frame, []).append(order)
        if solved:
            for seen in by_frame.values():
                self._take_pictures(seen, Surface.load(self.folder / surface_name(seen[0])))
            return []
        pressings = self.bench.press(orders[0])
        for frame, seen in by_frame.items():
            pressing = pressings[frame]
            if not pressing.result.status.valid:
                continue
            result = pressing.result
            surface = surface_of(result.solved_mesh, result.displacement, pressing.real, pressing.down)
            surface.save(self.folder / surface_name(seen[0]))
            self._take_pictures(seen, surface)
        of_each = [(order, replace(pressings[order.frame], order=order)) for order in orders]
        return [
            (order, logged(seen) if seen.result.status.valid else None, truth_row(seen)) for order, seen in of_each
        ]

    def take_film(self) -> None:
        """Film the presses of [film]: 1 s without contact, then each press down and up, and 0.2 s without contact."""
        from gelforge.virtualrig.bench import Bench
        from gelforge.virtualrig.fields import field_of, surface_of
        from gelforge.virtualrig.render import Pressed

        film, every = self.plan.film, orders(self.plan)
        assert film is not None, "a plan without a film"
        bench = Bench(replace(self.plan, frames=film.frames), self.bench.indenters, self.gel)
        camera, chance = self.camera(film.sensor), of_nocontact(self.plan, self.appearances[film.sensor])
        images = [camera.image(rng=chance) for _ in range(RATE)]
        for number in film.presses:
            pressings = bench.press(next(order for order in every if order.index == number))
            done = [one for one in pressings if one.result.status.valid]
            seen = [surface_of(one.result.solved_mesh, one.result.displacement, one.real, one.down) for one in done]
            body = self.bench.body(done[-1].order.indenter)
            for surface in [*seen, *seen[-2::-1]]:
                images.append(camera.image(field_of(self.gel, surface), Pressed(body, surface.press), chance))
            images += [camera.image(rng=chance) for _ in range(RATE // 5)]
        write_film(self.folder / FILM, images)

    def _take_pictures(self, orders: list[Order], surface) -> None:
        from gelforge.virtualrig.fields import field_of
        from gelforge.virtualrig.render import Pressed

        body, field = Pressed(self.bench.body(orders[0].indenter), surface.press), field_of(self.gel, surface)
        for order in orders:
            camera = self.camera(order.sensor)
            save_image(self.folder / image_name(order), camera.image(field, body, of_picture(self.plan, order)))


def write_film(path: Path, images: list[np.ndarray]) -> None:
    """Write RGB images as a film of JPEGs, whole or not at all."""
    import cv2

    with publish(path) as part:
        named = Path(f"{part}{path.suffix}")  # OpenCV chooses the container by the suffix
        writer = cv2.VideoWriter(
            str(named), cv2.CAP_OPENCV_MJPEG, cv2.VideoWriter.fourcc(*"MJPG"), RATE, images[0].shape[1::-1]
        )
        writer.set(cv2.VIDEOWRITER_PROP_QUALITY, QUALITY)
        for image in images:
            writer.write(image[..., ::-1])
        writer.release()
        named.replace(part)


def of_nocontact(plan: Plan, appearance: Appearance) -> np.random.Generator:
    """Random generator of a unit's no-contact image."""
    return np.random.default_rng([plan.seed, appearance.seed])


def of_picture(plan: Plan, order: Order) -> np.random.Generator:
    """Random generator of an order's image."""
    return generator(plan, order.index, streams.camera(order.unit, order.frame))


@lru_cache(maxsize=1)
def worker_of(plan: Plan, workflow: Path, folder: Path) -> Worker:
    """The bench and cameras of this process, made once because making them costs more than a press."""
    return Worker(plan, workflow, folder)


def _work(plan: Plan, workflow: Path, folder: Path, what: Callable, task: tuple) -> Any:
    return what(worker_of(plan, workflow, folder), *task)


def run(plan_path, data="data", workflow="workflow", jobs: int = 1) -> Path:
    """Carry out what is missing of a plan; returns the dataset's folder."""
    workflow = Path(workflow)
    plan = check(plan_path, workflow)
    folder = Path(data) / plan.dataset
    dataset = Dataset(folder, plan)
    appearances, sensors = units_of(plan, workflow)
    contents = contents_of(plan, workflow, appearances, sensors)
    dataset.check_same_plan(*contents)
    dataset.begin(*contents)
    if plan.units is not None:
        write_sensors(folder / "sensors.toml", {name: sensors[name] for name in plan.units.names})
    unseen = [(name,) for name in plan.sensors if not (folder / nocontact_name(name)).exists()]
    todo = by_press(dataset, orders(plan))
    new, drawn, failed = 0, 0, []
    try:
        with _pool(min(jobs, max(len(unseen), len(todo))), plan, workflow, folder) as done_by_all:
            pictures = done_by_all(Worker.picture_nocontact, unseen)
            deque(tqdm(pictures, "no-contact images", total=len(unseen)), maxlen=0)
            presses = tqdm(done_by_all(Worker.carry_out, todo), "rig", total=len(todo))
            for (of_press, solved), rows in zip(todo, presses, strict=True):
                if solved:
                    drawn += len(of_press)
                    continue
                new += len(of_press)
                dataset.add(rows)
                failed += [(order, truth["status"]) for order, log, truth in rows if log is None]
            if plan.film and not (folder / FILM).exists():
                deque(done_by_all(Worker.take_film, [()]), maxlen=0)
    finally:
        if new:
            dataset.publish()
    counts = {"new": new, "with images drawn again": drawn, "failed": len(failed)}
    counted = "".join(f", {count} {what}" for what, count in counts.items() if count or what == "new")
    print(f"{folder}: {len(dataset.log)} samples{counted}")
    for order, status in failed:
        print(f"  no equilibrium, left out: {order.sample_id} ({order.indenter}, {order.depth:.2f} mm: {status})")
    return folder


def by_press(dataset: Dataset, every: list[Order]) -> list[tuple[list[Order], bool]]:
    """Missing orders by press, and for each press whether only its images are missing."""
    found: dict[tuple[int, bool], list[Order]] = {}
    for order in dataset.missing(every):
        found.setdefault((order.index, dataset.solved(order)), []).append(order)
    return [(of_press, solved) for (_, solved), of_press in found.items()]


def check(plan_path, workflow: Path) -> Plan:
    """Read a plan and check all that can be checked before a file is written; BadInput if anything is wrong."""
    use_gels_of(workflow)
    plan = read_plan(plan_path)
    catalogue = read_catalogue(workflow / plan.catalogue)
    plan = with_indenters(plan, catalogue)
    appearances, sensors = units_of(plan, workflow)
    check_names(plan, catalogue, sensors, appearances, plan_path)
    load_catalogue(workflow / plan.catalogue, plan.indenters, workflow)
    overlaid(workflow, plan.params, str(plan_path))
    return plan


def units_of(plan: Plan, workflow: Path) -> tuple[dict[str, Appearance], dict[str, Sensor]]:
    """Appearances and sensors by name: those of workflow/, and those that the plan draws at random."""
    appearances, sensors = (
        read_appearances(workflow / "rig" / "sensors.toml"),
        load_sensors(workflow / "sensors.toml"),
    )
    if plan.units is None:
        return appearances, sensors
    drawn_appearances, drawn_sensors = draw_units(plan.units, plan.gel, workflow / "rig", plan.seed)
    return appearances | drawn_appearances, sensors | drawn_sensors


def contents_of(
    plan: Plan, workflow: Path, appearances: dict[str, Appearance], sensors: dict[str, Sensor]
) -> tuple[dict[str, str], dict[str, str]]:
    """Digests of the indenters and sensors of a plan: tables and STL files, appearances and projections."""
    every = read_catalogue(workflow / plan.catalogue)
    tables = with_content({name: every[name] for name in plan.indenters}, workflow)
    seen = {name: [asdict(appearances[name]), asdict(sensors[name])] for name in plan.sensors}
    return digests(tables), digests(seen)


def digests(of: dict[str, Any]) -> dict[str, str]:
    """Short digest of each named value; arrays are rounded to six decimals."""
    texts = {
        name: json.dumps(what, sort_keys=True, default=lambda a: np.round(a, 6).tolist()) for name, what in of.items()
    }
    return {name: hashlib.sha256(text.encode()).hexdigest()[:16] for name, text in texts.items()}


@contextmanager
def _pool(jobs: int, plan: Plan, workflow: Path, folder: Path):
    """Yield a function that maps a method of Worker over tasks, tuples of arguments, with results in their order."""

    def work(what: Callable) -> Callable[[tuple], Any]:
        return partial(_work, plan, workflow, folder, what)

    if jobs <= 1:
        try:
            yield lambda what, tasks: map(work(what), tasks)
        finally:
            worker_of.cache_clear()  # in a later run of this process the names may mean other appearances and shapes
        return
    # spawned, because numerical libraries' threads hang after a fork
    executor = pool(jobs, get_context("spawn"))
    try:
        yield lambda what, tasks: executor.map(work(what), tasks)
    finally:
        executor.shutdown(cancel_futures=True)


@command(
    option("--plan", help="workflow/rig/NAME.toml"),
    option("--data", default="data", help="folder of the datasets"),
    option("--workflow", default="workflow", help="folder of sensors.toml and rig/sensors.toml"),
    option("--jobs", type=positive, default=1, help="presses at a time, one core each"),
)
def main(given: Namespace) -> None:
    """Carry out a plan, or refuse it with the reason."""
    # one thread per press, whatever the user has set: presses run in parallel, and sums keep their order
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    os.environ.setdefault("MKL_CBWR", "AUTO")  # the same digits whatever the memory alignment of an array
    run(given.plan, given.data, given.workflow, given.jobs)


if __name__ == "__main__":
    main.exit()
