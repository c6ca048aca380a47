"""What each make asks before it reads its rules: whether a dataset must be planned anew, and which results are due again.

make goes by dates. Here stands what dates do not tell: files that an older one replaced (`dates`), results that were made of
another choice or that lost a part, and goals that cannot be reached, which are refused before anything is solved for them.
Only the standard library, because it runs at each make.
"""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.dates import refuse_ahead, unchanged
from gelforge.flow.files import names_in
from gelforge.flow.given import OF_RESULTS, needs_plan, read_words, refusal
from gelforge.flow.layout import EVALUATE, REPORT, Layout, metrics_of

SHIPPED = "shipped"  # the network that ships; it is never trained here
SHIPPED_RES = "24x32"
MOST_RESTARTS = 3  # of one make, whose plan is then taken as it is: a log that is being written to changes for ever
TRAINS = ("train", "ship")
READS_IMAGES = ("dataset", "evaluate", "report", "demo", "export", "feats-export", "pareto-models", *TRAINS)


class Asked:
    """What a make is asked, with the plan that there is of its dataset.

    :param given: text of the variables that a person set, of DATASET, RES and GOALS.
    """

    def __init__(self, given: dict[str, str]) -> None:
        self.given = given
        self.goals = given["GOALS"].split()
        self.dataset = given["DATASET"]
        self.data, self.of = Path("data") / self.dataset, Layout(Path("results") / self.dataset)
        self.resolutions = given["RES"].split()
        self.resolution = self.resolutions[0]
        self.lists = lists_of(self.of.plan())
        self.imported = (self.data / "labels").is_dir()

    @property
    def networks(self) -> list[str]:
        """Networks of workflow/models.toml."""
        return self.lists["MODELS"]

    @property
    def model(self) -> str:
        """The network by hand, or that of [params.report] where it has this resolution, or else the usual one."""
        reported = self.lists["REPORT_MODEL"]
        if self.resolution != SHIPPED_RES:
            reported = [name for name in reported if name not in (SHIPPED, *self.lists["TUNED"])]
        return self.given.get("MODEL") or [*reported, self.learner][0]

    @property
    def learner(self) -> str:
        """The network that is trained where none is named."""
        return self.lists["LEARNER"][0]

    @property
    def learnt(self) -> str:
        """The network that `make train` makes."""
        return self.learner if self.model == SHIPPED else self.model

    @property
    def charted(self) -> list[str]:
        """The networks on the chart of accuracy over latency."""
        learnable = [name for name in self.networks if name not in self.lists["TUNED"]]
        return self.given.get("CHARTED", "").split() or learnable

    def asks(self, *goals: str) -> bool:
        """Whether one of these goals is asked for."""
        return any(goal in self.goals for goal in goals)

    def needed(self) -> list[str]:
        """The networks that the goals need, trained or shipped."""
        found = [self.model] if self.asks("evaluate", "report", "demo") else []
        found += [self.learnt] if self.asks(*TRAINS) else []
        return found + (self.charted if self.asks("pareto-models") else [])

    # -- refusals

    def refuse(self) -> None:
        """BadInput where a goal cannot be reached with what was chosen, before anything is made for it."""
        self.check_networks()
        self.check_ship()
        if self.asks(*READS_IMAGES):
            self.check_data()

    def check_networks(self) -> None:
        """Refuse a network that there is not, that is not of this grid, or that is not trained here."""
        model, known = self.given.get("MODEL"), self.networks
        if model and model not in (*known, SHIPPED):
            raise BadInput(
                f"MODEL={model}: no such network; workflow/models.toml has: {' '.join(known)}, and shipped is the one that ships"
            )
        if model in self.lists["TUNED"] and self.resolution != SHIPPED_RES:
            raise BadInput(
                f"MODEL={model} fine-tunes the shipped network, whose grid is {SHIPPED_RES}: say RES={SHIPPED_RES}, or name"
                " another network"
            )
        trains = [goal for goal in self.goals if goal in TRAINS]
        if model == SHIPPED and trains:
            raise BadInput(
                f"MODEL=shipped: the shipped network was trained elsewhere; to {trains[0]}, name one of {' '.join(known)}"
            )
        if unknown := [name for name in self.charted if name not in known]:
            raise BadInput(
                f"CHARTED names {' '.join(unknown)}: no such network; workflow/models.toml has: {' '.join(known)}"
            )

    def check_ship(self) -> None:
        """Refuse to ship a network that nobody named, or of another grid."""
        if not self.asks("ship"):
            return
        if not self.given.get("MODEL"):
            raise BadInput(
                "ship: takes the place of the shipped network; name the one that shall, make ship MODEL=… DATASET=…"
            )
        if self.resolution != SHIPPED_RES:
            raise BadInput(
                f"ship RES={self.resolution}: the shipped network has a grid of {SHIPPED_RES}; train one of it, RES={SHIPPED_RES}"
            )

    def check_data(self) -> None:
        """Refuse a dataset without the images, labels or other datasets that its networks learn from."""
        if not self.imported and not self.lists["IMAGES"]:
            raise BadInput(
                f"{self.data}/log.csv: names no images, or [params.poses] images = false, so that its flow ends at labels and"
                f" calibrate: run {self.of.command('labels')}, or write each press's image into the column image"
            )
        absent = [res for res in self.resolutions if not (self.data / f"labels/{res}.npz").exists()]
        if self.imported and absent:
            came = [name.removesuffix(".npz") for name in names_in(self.data / "labels", ".npz")]
            raise BadInput(
                f"{self.data} was imported with labels of {' '.join(came)}, not of {absent[0]}: say RES={' '.join(came[:1])}"
            )
        needed = self.needed()
        pairs = [name for name in needed if name in (SHIPPED, *self.lists["NEED_NOCONTACT"])]
        if pairs and not (self.data / "nocontact").is_dir():
            raise BadInput(
                f"MODEL={pairs[0]} reads a picture beside a no-contact image, and {self.data}/nocontact is missing: add"
                " nocontact/SENSOR.png of each sensor, or name a network that reads the image alone, such as grid_16"
                f" ([params.report] model in {self.data}/dataset.toml)"
            )
        for name in self.lists["LEARN_ALSO"] if set(needed) - {SHIPPED} else []:
            table = Layout(self.of.root.parent / name).dataset(self.resolution) / "dataset.json"
            if not table.exists():
                raise BadInput(
                    f"{table} is missing, and [train] also asks for it: make DATASET={name} RES={self.resolution} dataset"
                )

    # -- results that are due

    def due(self) -> Iterator[Path]:
        """Results that are there and must be made again, whatever their dates."""
        shards = self.of.names()
        for resolution in self.resolutions:
            # a shard that was deleted, because it was corrupt say: the list of labels alone would hide the gap
            table = self.of.labelled(resolution)
            there = {name.removesuffix(".npz") for name in names_in(table.parent, ".npz")}
            if table.exists() and not there.issuperset(shards):
                yield table
        yield from self.of_other_choices()

    def of_other_choices(self) -> Iterator[Path]:
        """The report and the chart of networks, where they were made of other files than they would be now."""
        page = self.of.root / REPORT / "index.html"
        read = inputs_of(page)
        shown = str(self.of.evaluation(self.resolution, self.model))
        if read and (shown not in read or not all(map(os.path.exists, read))):
            yield page
        chart = self.of.root / f"pareto_models/{self.resolution}.json"
        read = inputs_of(chart)
        evaluations = {str(self.of.evaluation(self.resolution, name)) for name in self.charted}
        if read and {path for path in read if f"/{EVALUATE}/" in path} != evaluations:
            yield chart


def lists_of(plan: Path) -> dict[str, list[str]]:
    """Lists of words that a plan names; none where there is no plan."""
    try:
        lines = plan.read_text(encoding="utf-8").splitlines()
    except OSError:
        return {}
    return {name: words.split() for name, words in (line.split(" :=", 1) for line in lines)}


def inputs_of(target: Path) -> list[str]:
    """What a target was made of, as its record tells; none where there is no target or no such record."""
    try:
        return json.loads(metrics_of(target).read_bytes())["inputs"] if target.exists() else []
    except (OSError, ValueError, KeyError, TypeError):
        return []


def answer(given: dict[str, str]) -> list[str]:
    """What make shall do, in words: `plan` where it needs one, `again` where that is out of date, MODEL=NAME, LEARNT=NAME, and what is due.

    BadInput where it cannot do what it is asked.
    """
    if said := refusal(given):
        raise BadInput(said)
    if not needs_plan(given):
        return []
    asked = Asked(given)
    first = not given.get("MAKE_RESTARTS")
    if first and set(asked.goals) - {*OF_RESULTS, "look"}:
        refuse_ahead(asked.of.root)
    planned_now = int(given.get("MAKE_RESTARTS") or 0) >= MOST_RESTARTS
    if not asked.lists or not (planned_now or unchanged(asked.of.plan_states)):
        return ["plan", "again"]
    asked.refuse()
    return ["plan", f"MODEL={asked.model}", f"LEARNT={asked.learnt}", *map(str, asked.due())]


def main() -> int:
    """Answer the variables on the command line, NAME=TEXT."""
    try:
        print(*answer(read_words(sys.argv[1:])))
    except BadInput as error:
        print(error)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
