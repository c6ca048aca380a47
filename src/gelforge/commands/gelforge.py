"""The `gelforge` command: one word names a module of this folder."""

import importlib
import sys

from gelforge import __version__
from gelforge.flow.cli import exit_with

COMMANDS = {
    "predict": "force maps and totals from images",
    "live": "force maps of a video or a camera, frame by frame",
    "camera": "modes of a camera, and the one to use",
    "solve": "force and label of one press, by finite elements",
    "rig": "simulate presses and write a raw log with images",
    "sensor": "a profile of your sensor, from a no-contact image and force readings",
    "status": "samples of a dataset that are done, failed, pending",
    "projection": "fit a sensor's projection",
    "provenance": "every file, parameter and cost behind one label",
    "export": "a dataset as MCAP, LeRobot or HDF5",
    "look": "images and .vtu of one sample",
    "feats": "datasets in the files of FEATS, read and written",
    "align": "gauge log, path log and images of a bench as one log",
    "mcap": "MCAP recordings of images and forces as a dataset",
    "background": "illumination of a sensor, from its no-contact image",
}

# Commands whose module is a stage.
HOMES = {"rig": "gelforge.stages.rig"}


def usage(argv) -> int:
    """Print the version or the list of commands; return 0 if that was requested, else 2."""
    if argv and argv[0] == "--version":
        print(f"gelforge {__version__}")
        return 0
    asked = bool(argv) and argv[0] in ("-h", "--help")
    wrong = [f"error: {argv[0]!r} is not a command of gelforge; choose one of these"] if argv and not asked else []
    listed = [f"  gelforge {name:11s} {what}" for name, what in COMMANDS.items()]
    lines = [*wrong, "usage: gelforge COMMAND …", *listed, "Everything else is a make target: make help."]
    print("\n".join(lines), file=sys.stdout if asked else sys.stderr)
    return 0 if asked else 2


def main(argv=None) -> None:
    """Dispatch `gelforge COMMAND …` to the module of that name."""
    argv = sys.argv[1:] if argv is None else argv
    if not argv or argv[0] not in COMMANDS:
        exit_with(usage, argv)
    sys.argv[0] = f"gelforge {argv[0]}"
    home = HOMES.get(argv[0], f"gelforge.commands.{argv[0]}")
    exit_with(lambda words: importlib.import_module(home).main(words), argv[1:])


if __name__ == "__main__":
    main()
