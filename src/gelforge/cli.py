"""The `gelforge` command, and how every module's `main` ends."""

import importlib
import os
import sys

from gelforge.errors import GelforgeError

COMMANDS = {
    "predict": "force maps and totals from images",
    "live": "force maps over a video or a camera, as it runs",
    "rig": "simulate presses and write a raw log with images",
    "status": "what of a dataset is done, failed, pending",
    "sample": "one sample through all stages, with its log",
    "projection": "fit a sensor's projection",
    "look": "pictures and .vtu of one sample",
}


def exit_with(main, argv=None) -> None:
    """Run `main(argv)` and leave the process with its code; 2 and one line for what a user can mend."""
    try:
        code = main(argv)
    except GelforgeError as error:
        print(f"error: {error}", file=sys.stderr)
        code = 2
    except KeyboardInterrupt:
        code = 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 141
    sys.exit(code)


def main(argv=None) -> None:
    """Dispatch `gelforge COMMAND …` to the module of that name."""
    argv = sys.argv[1:] if argv is None else argv
    if not argv or argv[0] not in COMMANDS:
        lines = [f"  gelforge {name:11s} {what}" for name, what in COMMANDS.items()]
        print("\n".join(["usage: gelforge COMMAND …", *lines, "Everything else is a make target: make help."]))
        sys.exit(0 if argv and argv[0] in ("-h", "--help") else 2)
    module = importlib.import_module(f"gelforge.{argv[0]}")
    sys.argv[0] = f"gelforge {argv[0]}"
    exit_with(module.main, argv[1:])
