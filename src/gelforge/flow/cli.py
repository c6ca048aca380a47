"""A module's command line: its arguments and options, its `main`, and the exit of its process.

A stage names the file of `Layout` that it writes; the words of that name become the stage's arguments:

    @stage(Layout.fea)
    def main(args):  # python -m gelforge.stages.fea results/demo 0000
        write_solves(args.out, solve(read_poses(args.of.poses(args.shard))))

    if __name__ == "__main__":
        main.exit()
"""

import argparse
import errno
import inspect
import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, NoReturn

from gelforge.errors import GelforgeError, printable, unwritable
from gelforge.flow.layout import File, Layout

# Errors of a disk or a folder that cannot be written to; they are no fault of the program.
UNWRITABLE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT)
# Extra of pyproject.toml that installs a package, by the name under which it is imported.
EXTRAS = {
    **dict.fromkeys(("scipy", "numba", "pydantic", "annotated_types"), "solve"),
    "pytetwild": "mesh",
    "matplotlib": "plot",
    **dict.fromkeys(("pymeshlab", "pyvista", "vtk", "vtkmodules"), "stl"),
    **dict.fromkeys(("pypardiso", "emcee", "arviz_stats", "corner", "jinja2"), "flow"),
    **dict.fromkeys(("torch", "safetensors", "tqdm"), "train"),
    **dict.fromkeys(("mcap_ros2", "mcap_protobuf", "av", "pyarrow", "h5py"), "exports"),
    **dict.fromkeys(("foxglove", "mcap", "rosbags"), "live"),
    "huggingface_hub": "hub",
}  # fmt: skip
MESHES = "GELFORGE_MESHES"  # environment variable with the folder of base meshes (`mechanics.mesh.basemesh`)
GELS = "GELFORGE_GELS"  # environment variable with the file of the user's gels (`geometry.gel`)
# Errors of a name that no file can have.
UNNAMEABLE = (errno.ENAMETOOLONG, errno.ELOOP)


@dataclass(frozen=True)
class Option:
    """One argument of a command line: names and keyword arguments of `argparse.add_argument`."""

    names: tuple[str, ...]
    about: dict[str, Any]


def option(*names: str, **about: Any) -> Option:
    """Return an argument from what `argparse.add_argument` takes; an option without a default is required."""
    if names[0].startswith("-") and not {"default", "action", "required"} & about.keys():
        about["required"] = True
    return Option(names, about)


RESULTS = option("results", type=Path, metavar="RESULTS", help="results/DATASET")
PART = option("--part", action="store_true", help="write TARGET.part, which flow.step publishes")


@dataclass(frozen=True)
class Command:
    """A function with a command line: call it with a list of arguments, or let the process end with its code."""

    run: Callable[[argparse.Namespace], int | None]
    options: tuple[Option, ...]

    def __call__(self, argv: Sequence[str] | None = None) -> int:
        """Parse `argv` (by default the process's own) and run; return the exit code, and let exceptions pass."""
        home = inspect.getmodule(self.run)
        parser = argparse.ArgumentParser(
            prog=program(home), description=home.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        self.extend(parser)
        args = parser.parse_args(joined(sys.argv[1:] if argv is None else argv))
        return args.run(args) or 0

    def extend(self, parser: argparse.ArgumentParser) -> None:
        """Add this command's options to a parser."""
        for each in self.options:
            parser.add_argument(*each.names, **each.about)
        parser.set_defaults(run=self.run)

    def exit(self, argv: Sequence[str] | None = None) -> NoReturn:
        """Run and leave the process; an error that a user can correct is printed as one line."""
        exit_with(self, argv)


def joined(argv: Sequence[str]) -> list[str]:
    """Join an option and a list of numbers that begins with a minus by "=": argparse takes that for an option."""
    words: list[str] = []
    for word in map(str, argv):
        if re.match(r"-[\d.]+,", word) and words and words[-1].startswith("--") and "=" not in words[-1]:
            words[-1] += f"={word}"
        else:
            words.append(word)
    return words


@dataclass(frozen=True)
class Group(Command):
    """Several commands of one module, chosen by their first word."""

    members: dict[str, Command]

    def extend(self, parser: argparse.ArgumentParser) -> None:
        """Add one sub-parser per member."""
        words = parser.add_subparsers(required=True, metavar="COMMAND")
        for word, member in self.members.items():
            about = inspect.getdoc(member.run)
            member.extend(words.add_parser(word, help=about, description=about))


def positive(text: str) -> int:
    """A whole number above 0, as the `type` of an option."""
    return _whole(text, 1, "above 0")


def from_zero(text: str) -> int:
    """A whole number from 0 on, as the `type` of an option."""
    return _whole(text, 0, "from 0 on")


def _whole(text: str, least: int, which: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number {which}")
    return value


JOBS = option(
    "--jobs", type=positive, help="processes at a time; under make, within its job slots",
    default=int(os.environ.get("GELFORGE_JOBS") or os.environ.get("SLURM_CPUS_PER_TASK", "1")),
)  # fmt: skip


def command(*options: Option) -> Callable[[Callable[[argparse.Namespace], int | None]], Command]:
    """Give a function `main(args)` a command line; the module's docstring is its help."""
    return lambda run: Command(run, options)


def stage(target: File, *options: Option) -> Callable[[Callable[[argparse.Namespace], int | None]], Command]:
    """Give a function `main(args)` a stage's command line: results/DATASET, the words of `target`, and options.

    target: a file of `Layout`. args.of is the Layout, args.out the file to write: the target, or TARGET.part.
    """
    words = target.words

    def give(run: Callable[[argparse.Namespace], int | None]) -> Command:
        @wraps(run)
        def at_place(args: argparse.Namespace) -> int | None:
            args.of = Layout(args.results)
            if (gels := args.of.workflow / "gels.toml").exists():
                os.environ[GELS] = str(gels.absolute())
            os.environ[MESHES] = str(args.of.meshes.absolute())
            args.out = target(args.of, *(getattr(args, word) for word in words))
            args.out.parent.mkdir(parents=True, exist_ok=True)
            if args.part:
                args.out = args.out.with_name(f"{args.out.name}.part")
            return run(args)

        given = [option(word, metavar=word.upper()) for word in words]
        return Command(at_place, (RESULTS, *given, *options, PART))

    return give


def group(**members: Command) -> Group:
    """Join commands of one module into one `main`; the first word of the command line chooses."""
    first = next(iter(members.values()))
    return Group(first.run, (), members)


def program(home: Any) -> str:
    """Return how a module was started: `gelforge NAME`, which the dispatcher of commands sets, or `python -m …`."""
    name = home.__spec__.name if home.__spec__ else home.__name__
    return sys.argv[0] if sys.argv[0].startswith("gelforge ") else f"python -m {name}"


def exit_with(main: Callable[[Sequence[str] | None], int], argv: Sequence[str] | None = None) -> NoReturn:
    """Run `main(argv)` and exit with its code; an error that a user can correct gives code 2 and one line."""
    try:
        code = code_of(main, argv)
        sys.stdout.flush()  # here, because a broken pipe, as of `head`, could not be caught at interpreter exit
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 141
    except OSError as error:
        if error.errno not in (*UNWRITABLE, *UNNAMEABLE):
            raise
        named = error.errno in UNNAMEABLE
        said = f"{printable(error.filename)}: {error.strerror}; give another name" if named else unwritable(error)
        print(f"error: {said}, then run it again", file=sys.stderr)
        code = 2
    sys.exit(code)


def missing_extra(error: ModuleNotFoundError) -> str | None:
    """A sentence that names the extra which installs the missing package; None if no extra does."""
    package = (error.name or "").partition(".")[0]
    if package not in EXTRAS:
        return None
    hint = f"pip install '.[{EXTRAS[package]}]' in a clone of gelforge"
    return f"this needs the package {package}, which is not installed: {hint}"


def code_of(main: Callable[[Sequence[str] | None], int], argv: Sequence[str] | None) -> Any:
    """Run `main(argv)`; return its exit code, or the code that stands for the exception which ended it."""
    try:
        return main(argv)
    except SystemExit as ended:  # raised by argparse after its help and its usage
        return ended.code
    except GelforgeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        said = missing_extra(error)
        if said is None:
            raise
        print(f"error: {said}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
