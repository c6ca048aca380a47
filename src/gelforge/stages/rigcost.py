"""What a plan of the virtual bench will take before it starts: core hours, disk, memory and time, from a few of its presses."""

import os
import resource
import tempfile
import time
from argparse import Namespace
from pathlib import Path

from gelforge.flow.files import bytes_of
from gelforge.flow.forecast import Cost, on_cores, pilots, table
from gelforge.flow.main import command, option, positive
from gelforge.flow.running import duration
from gelforge.stages.rig import Worker, by_press, check, contents_of, units_of
from gelforge.sweeps.methods import warm_up
from gelforge.virtualrig.rigplan import Order, orders
from gelforge.virtualrig.writer import Dataset


def measured(worker: Worker, presses: list[list[Order]], indenters: int) -> list[Cost]:
    """What presses and new indenters take, from pressing those given; their files lie in the worker's folder.

    indenters: how many the plan has. Each is made once: its surface with texture, and the factor on its forces.
    """
    warm_up()
    made: dict[str, float] = {}
    pressed = 0.0
    for of_press in presses:
        name, began = of_press[0].indenter, time.process_time()
        if name not in made:
            worker.bench.body(name)
            worker.bench.factor(name)
            made[name] = time.process_time() - began
            began = time.process_time()
        worker.carry_out(of_press, solved=False)
        pressed += time.process_time() - began
    written = bytes_of(worker.folder)
    return [
        Cost("indenters", cpu_once=indenters * sum(made.values()) / len(made)),
        Cost("presses", pressed / len(presses), bytes_each=written / len(presses)),
    ]


@command(
    option("--plan", help="workflow/rig/NAME.toml"),
    option("--data", default="data", help="folder of the datasets"),
    option("--workflow", default="workflow", help="folder of sensors.toml and rig/sensors.toml"),
    option("--cores", type=positive, default=os.cpu_count(), help="cores that make rig may use"),
)
def main(given: Namespace) -> None:
    workflow = Path(given.workflow)
    plan = check(given.plan, workflow)
    dataset = Dataset(Path(given.data) / plan.dataset, plan)
    dataset.check_same_plan(*contents_of(plan, workflow, *units_of(plan, workflow)))
    todo = by_press(dataset, orders(plan))
    left = [of_press for of_press, solved in todo if not solved]
    drawn = sum(len(of_press) for of_press, solved in todo if solved)
    if drawn:
        print(f"{drawn} pictures of presses that are solved are drawn again, some 50 a second")
    if not left:
        print(f"{dataset.folder}: every press of the plan is there")
        return
    chosen = [left[k] for k in pilots([of_press[0].depth for of_press in left])]
    print(f"pressing {len(chosen)} of {len(left)} presses to see what they take", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        costs = measured(Worker(plan, workflow, Path(folder)), chosen, len(plan.indenters))
    seconds = sum(cost.cpu(len(left)) for cost in costs)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print("\n".join(table(costs, len(left))))
    print(f"{sum(map(len, left))} pictures; {memory:.0f} MiB of memory for each core")
    print(f"about {duration(seconds / given.cores)} {on_cores(given.cores)}")


if __name__ == "__main__":
    main.exit()
