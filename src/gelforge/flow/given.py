"""What people give to make, judged before make reads its rules: names that become paths, and goals that go together.

It also runs before anything is set up, by any Python 3: `python3 given.py NAME=TEXT…` needs the standard library alone.
"""

import re
import sys
from fnmatch import fnmatchcase
from pathlib import Path

# A pattern of each variable's text, and what to give.
NAME = (
    r"[A-Za-z0-9_][A-Za-z0-9_.-]*",
    "one name of letters, digits, _ - and . that starts with a letter, a digit or _",
)
NAMES = r"[A-Za-z0-9_./:\[\], -]*", "names with blanks between them"
SIDE = r"0*[1-9][0-9]*"
RULES = {
    **dict.fromkeys(("DATASET", "SENSOR", "MODEL", "FORMAT", "EXECUTOR"), NAME),
    **dict.fromkeys(("CHARTED", "TESTS"), NAMES),
    "JOBS": (r"[0-9]+", "a number of jobs"),
    "RES": (rf" *{SIDE}x{SIDE}( +{SIDE}x{SIDE})* *", 'resolutions as ROWSxCOLUMNS, such as RES="12x16 24x32"'),
}
NEVER_EMPTY = ("DATASET", "MODEL", "JOBS", "RES")  # DATASET= would be the folder of all results, JOBS= no limit
EXECUTORS = ("local", "slurm")
FORMATS = ("mcap", "rerun", "lerobot", "webdataset", "hdf5")

# Goals that need no dataset, and those that show what was made of one, also where its log is gone.
NO_DATASET = (
    "help", "setup", "lint", "format", "test", "test-*", "rig", "rig-*", "benchmark-*",
    "lock", "clean-*", "fea-challenge", "feats-fetch", "feats-import", "mcap-import", "projection", "real-check",
    "*-env",
)  # fmt: skip
OF_RESULTS = ("status", "provenance")


def refusal(given: dict[str, str]) -> str:
    """Why make cannot do what it is asked, in a sentence; empty where nothing speaks against it.

    :param given: text of the variables that a person set, of DATASET, and of GOALS.
    """
    for name, text in given.items():
        if name in NEVER_EMPTY and not text.strip():
            return f"{name} is empty: give a value, or leave it out"
        pattern, what = RULES.get(name, (".*", ""))
        if text and not re.fullmatch(pattern, text, re.DOTALL):
            return f"{name}={text}: give {what}"
    goals = given["GOALS"].split()
    if given.get("EXECUTOR", EXECUTORS[0]) not in EXECUTORS:
        return f"EXECUTOR={given['EXECUTOR']}: give {' or '.join(EXECUTORS)}"
    if "export" in goals and given.get("FORMAT") not in FORMATS:
        return f"FORMAT={given.get('FORMAT', '')}: name one of {' '.join(FORMATS)}"
    if "sample" in goals and not given.get("ID", "").strip():
        return f"no sample named; say make sample DATASET={given['DATASET']} ID=SAMPLE_ID"
    clean = [goal for goal in goals if goal.startswith("clean-")]
    other = [goal for goal in goals if goal not in clean]
    if clean and other:  # make would do both at a time, and remove what it has just found up to date
        return f"clean together with another goal: say make {' '.join(clean)} first, then make {' '.join(other)}"
    if needs_plan(given) and not Path(f"data/{given['DATASET']}/log.csv").exists():
        return (
            f"data/{given['DATASET']}/log.csv not found: DATASET={given['DATASET']} needs a raw log and a dataset.toml, which"
            " workflow/guide/your-data.md describes; make rig writes simulated ones"
        )
    return ""


def needs_plan(given: dict[str, str]) -> bool:
    """Whether a goal needs the plan of the dataset."""
    goals = [goal for goal in given["GOALS"].split() if not any(fnmatchcase(goal, known) for known in NO_DATASET)]
    log, results = Path("data") / given["DATASET"] / "log.csv", Path("results") / given["DATASET"]
    if not log.exists() and results.is_dir():
        goals = [goal for goal in goals if goal not in OF_RESULTS]
    return bool(goals)


def read_words(words: list[str]) -> dict[str, str]:
    """Variables from words NAME=TEXT."""
    return dict(word.split("=", 1) for word in words)


def main() -> int:
    """Print why make cannot go on, or `plan` where a goal needs a dataset's plan."""
    given = read_words(sys.argv[1:])
    said = refusal(given)
    print(said or ("plan" if needs_plan(given) else ""))
    return 2 if said else 0


if __name__ == "__main__":
    sys.exit(main())
