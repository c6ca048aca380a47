"""Runs a benchmark: python -m tests.benchmarks NAME [words of the benchmark] [--out FILE]."""

import importlib
import sys
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.cli import exit_with
from tests.support.figures import refuse_changes


def main(argv: list[str]) -> int:
    """Run the benchmark that the first word names with all further ones."""
    known = sorted(path.stem for path in Path(__file__).parent.glob("[!_]*.py"))
    if not argv or argv[0] not in known:
        raise BadInput(f"name one benchmark of {', '.join(known)}")
    refuse_changes(argv[1:])
    return importlib.import_module(f"tests.benchmarks.{argv[0]}").main(argv[1:])


if __name__ == "__main__":
    exit_with(main, sys.argv[1:])
