"""Checks before make reads its rules: texts that become names and paths, goals, and whether the plan is current.

make calls it first and takes the user's choices, DATASET, RES, MODEL …, from its answer. It also runs before anything
is set up, so it imports only the standard library.
"""

import json
import os
import re
import sys
from collections.abc import Iterable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.files import changed, names_in, record_of, states_of, write_if_changed, write_text
from gelforge.flow.layout import STAGES, Layout, metrics_of

# Pattern of each variable's text, and what to give. Texts of other variables are one line without characters that a
# shell or make interprets.
NAME = (
    r"[A-Za-z0-9_][A-Za-z0-9_.-]*",
    "one name of letters, digits, _ - and . that starts with a letter, a digit or _",
)
SIDE = r"0*[1-9][0-9]*"
RULES = {
    **dict.fromkeys(("DATASET", "SENSOR", "MODEL", "FORMAT", "EXECUTOR", "LIKE"), NAME),
    **dict.fromkeys(("CHARTED", "TESTS"), (r"[A-Za-z0-9_./:\[\], -]*", "names with blanks between them")),
    "JOBS": (r"[0-9]+", "a number of jobs"),
    "RES": (rf" *{SIDE}x{SIDE}( +{SIDE}x{SIDE})* *", 'resolutions as ROWSxCOLUMNS, such as RES="12x16 24x32"'),
}
TEXT = (r"[^$'\"`\\\n]*", "text of one line without $, quotes, ` and \\")
# Variables that the rules also take from the environment; make itself takes all of it.
READ = (*RULES, "ID", "FROM", "TOPICS", "SPLIT", "PLAN", "POINTS", "IMAGE", "REFERENCE", "MARKED", "SLURM_PROFILE",
        "GELFORGE_REFERENCE", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")  # fmt: skip
NEVER_EMPTY = ("DATASET", "MODEL", "JOBS", "RES")  # DATASET= would be the folder of all results, JOBS= no limit
EXECUTORS = ("local", "slurm")
FORMATS = ("mcap", "lerobot", "hdf5")

# Goals that need no dataset, and goals that show its results even if its log is gone.
NO_DATASET = (
    "help", "setup", "lint", "format", "test", "test-*", "rig", "rig-*", "benchmark-*",
    "lock", "clean-*", "fea-challenge", "feats-fetch", "feats-import", "mcap-import", "projection", "real-check",
    "*-env", "readme-pictures", "docs",
)  # fmt: skip
OF_RESULTS = ("status", "provenance")

SHIPPED = "shipped"  # the network that ships; it is never trained here
SHIPPED_RES = "24x32"
MOST_RESTARTS = 3  # of one make, whose plan is then taken as it is: a log that is being written keeps changing
TRAINS = ("train", "ship")
READS_IMAGES = ("dataset", "evaluate", "report", "demo", "export", "feats-export", "pareto-models", *TRAINS)
# Options of make that may take the next word.
WITH_WORD = ("-C", "--directory", "-f", "--file", "-I", "-o", "-W", "-l", "-j")


def given_to(words: Iterable[str], environment: dict[str, str]) -> dict[str, str]:
    """The user's choices by name: NAME=TEXT from make's command line or the environment, defaults, and GOALS.

    BadInput for a text that its pattern does not allow, so that nothing afterwards has to quote it.
    """
    given = {name: environment[name] for name in READ if name in environment}
    goals, before = [], ""
    for word in words:
        name, is_given, text = word.partition("=")
        if is_given and not word.startswith("-"):
            given[name.rstrip(":?+!")] = text
        elif not (word.startswith("-") or (before in WITH_WORD and (before != "-j" or word.isdecimal()))):
            goals.append(word)
        before = word
    for name, text in given.items():
        pattern, what = RULES.get(name, TEXT)
        if name in NEVER_EMPTY and not text.strip():
            raise BadInput(f"{name} is empty: give a value, or leave it out")
        if text and not re.fullmatch(pattern, text, re.DOTALL):
            raise BadInput(f"{name}={text}: give {what}")
    fetched = "feats" if any(goal.startswith("feats-fetch") for goal in goals) else "demo"
    usual = {
        "DATASET": fetched,
        "RES": SHIPPED_RES,
        "EXECUTOR": EXECUTORS[0],
        "JOBS": str(len(os.sched_getaffinity(0))),
    }
    return usual | given | {"GOALS": " ".join(goals)}


class Asked:
    """A request to make, with the current plan of its dataset. given: text by name, from `given_to`."""

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
        """The network of MODEL=, else that of [params.report] if it has this resolution, else the default one."""
        reported = self.lists["REPORT_MODEL"]
        if self.resolution != SHIPPED_RES:
            reported = [name for name in reported if name not in (SHIPPED, *self.lists["TUNED"])]
        return self.given.get("MODEL") or [*reported, self.learner][0]

    @property
    def learner(self) -> str:
        """The network that is trained if none is named."""
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

    @property
    def shown(self) -> list[str]:
        """Branches' results that the report shows, below results/DATASET: [report] branches, and others if made."""
        made = ("calibrate/summary.json", "pareto/pareto.json")
        return sorted({*self.lists["BRANCHES"], *(name for name in made if (self.of.root / name).exists())})

    def asks(self, *goals: str) -> bool:
        """Whether one of these goals is asked for."""
        return any(goal in self.goals for goal in goals)

    def needed(self) -> list[str]:
        """The networks that the goals need, trained or shipped."""
        found = [self.model] if self.asks("evaluate", "report", "demo") else []
        found += [self.learnt] if self.asks(*TRAINS) else []
        return found + (self.charted if self.asks("pareto-models") else [])

    # -- before there is a plan

    def refuse_goals(self) -> None:
        """BadInput if goals cannot be combined, or lack a choice that they need."""
        given = self.given
        if given["EXECUTOR"] not in EXECUTORS:
            raise BadInput(f"EXECUTOR={given['EXECUTOR']}: give {' or '.join(EXECUTORS)}")
        if self.asks("export") and given.get("FORMAT") not in FORMATS:
            raise BadInput(f"FORMAT={given.get('FORMAT', '')}: name one of {' '.join(FORMATS)}")
        if self.asks("sample") and not given.get("ID", "").strip():
            raise BadInput(f"no sample named; say make sample DATASET={self.dataset} ID=SAMPLE_ID")
        clean = [goal for goal in self.goals if goal.startswith("clean-")]
        other = [goal for goal in self.goals if goal not in clean]
        if clean and other:  # make would run both in parallel, and remove what it has just found up to date
            raise BadInput(
                f"clean together with another goal: say make {' '.join(clean)} first, then make {' '.join(other)}"
            )
        known = ["clean-all", "clean-STAGE", *(f"clean-{name}" for name in STAGES)]
        if unknown := [goal for goal in clean if goal not in known]:
            raise BadInput(f"{unknown[0]}: no such target; there are {' '.join(known)}")

    def needs_plan(self) -> bool:
        """Whether a goal needs the plan of the dataset; BadInput if it does and there is no log to plan."""
        goals = [goal for goal in self.goals if not any(fnmatchcase(goal, known) for known in NO_DATASET)]
        log = self.data / "log.csv"
        if not log.exists() and self.of.root.is_dir():
            goals = [goal for goal in goals if goal not in OF_RESULTS]
        if goals and not log.exists():
            raise BadInput(
                f"{log} not found: DATASET={self.dataset} needs a raw log and a dataset.toml, which"
                " workflow/guide/your-data.md describes; make rig writes simulated ones"
            )
        return bool(goals)

    # -- with a plan

    def refuse(self) -> None:
        """BadInput if a goal cannot be reached with the user's choices, before anything is made for it."""
        self.check_networks()
        self.check_ship()
        if self.asks(*READS_IMAGES):
            self.check_data()

    def check_networks(self) -> None:
        """Refuse a network that does not exist, that has another grid, or that is not trained here."""
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
        """Refuse to ship if no network is named, or if it has another grid."""
        if not self.asks("ship"):
            return
        if not self.given.get("MODEL"):
            raise BadInput("ship: replaces the shipped network; name the new one: make ship MODEL=… DATASET=…")
        if self.resolution != SHIPPED_RES:
            raise BadInput(
                f"ship RES={self.resolution}: the shipped network has a grid of {SHIPPED_RES}; train a network with that grid:"
                f" RES={SHIPPED_RES}"
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
                " nocontact/SENSOR.png of each sensor, or name a network that reads the image alone, such as unet"
                f" ([params.report] model in {self.data}/dataset.toml)"
            )
        for name in self.lists["LEARN_ALSO"] if set(needed) - {SHIPPED} else []:
            table = Layout(self.of.root.parent / name).lesson(self.resolution) / "dataset.json"
            if not table.exists():
                raise BadInput(
                    f"{table} is missing, and [train] also asks for it: make DATASET={name} RES={table.parent.name} dataset"
                )

    # -- changes that make cannot see from file dates

    def note_choices(self) -> None:
        """Write what the report and the chart of networks show: make sees a changed choice by the file's date."""
        chosen = {
            "report": [self.resolution, self.model, *self.shown],
            f"pareto_models-{self.resolution}": self.charted,
        }
        for name, words in chosen.items():
            write_if_changed(self.of.choice(name), "".join(f"{word}\n" for word in words))

    def date_gaps(self) -> None:
        """Date labels.json to 1970 if it names a shard's labels that are gone, so that make makes it again."""
        for resolution in self.resolutions:
            table = self.of.labelled(resolution)
            there = set(names_in(table.parent, ".npz"))
            named = (record_of(table) or {}).get("sha256", {})
            if not there.issuperset(named):
                os.utime(table, (0, 0))


def lists_of(plan: Path) -> dict[str, list[str]]:
    """Lists of words that a plan defines; none if there is no plan."""
    try:
        lines = plan.read_text(encoding="utf-8").splitlines()
    except OSError:
        return {}
    return {name: words.split() for name, words in (line.split(" :=", 1) for line in lines)}


def is_planned(of: Layout) -> bool:
    """Whether the plan was made from the current content of its input files."""
    record = metrics_of(of.plan())
    made = record_of(record) or {}
    known = made.get("inputs")
    if not isinstance(known, dict):
        return False
    now = states_of(known, known)
    if changed(known, now):
        return False
    if now != known:  # files that were only touched are not read again
        write_text(record, json.dumps(made | {"inputs": now}) + "\n")
    return True


def answer(given: dict[str, str]) -> Iterator[str]:
    """Words that make reads: `plan` if it needs one, and variables as NAME=WORD.

    BadInput if make cannot do what it is asked. An outdated plan is removed, so that make makes it again.
    """
    asked = Asked(given)
    asked.refuse_goals()
    yield from (f"{name}={word}" for name in ("DATASET", "RES", "EXECUTOR", "JOBS") for word in given[name].split())
    if not asked.needs_plan():
        return
    yield "plan"
    restarted = int(os.environ.get("MAKE_RESTARTS") or 0)
    if not asked.lists or not (restarted >= MOST_RESTARTS or is_planned(asked.of)):
        asked.of.plan().unlink(missing_ok=True)
        return
    asked.refuse()
    asked.note_choices()
    asked.date_gaps()
    yield from (f"MODEL={asked.model}", f"LEARNT={asked.learnt}", *(f"SHOWN={name}" for name in asked.shown))


def handed_down(flags: str) -> list[str]:
    """Words NAME=TEXT that make passes on to a make that it starts, from MAKEFLAGS."""
    words = re.split(r"(?<!\\) +", flags.partition("-- ")[2])
    return [word.replace("\\", "") for word in words if word]


def command_line(pid: int) -> list[str]:
    """The words of a process's command line after its name."""
    return Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="surrogateescape").split("\0")[1:-1]


def main() -> int:
    """Answer the make that runs this."""
    try:
        words = [*handed_down(os.environ.get("MAKEFLAGS", "")), *command_line(os.getppid())]
        print(*answer(given_to(words, dict(os.environ))), f"RUN={os.getppid()}-{os.getpid()}")
    except BadInput as error:
        print(error)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
