"""A module's command line: what must be given, how errors end a process, what the help says."""

import importlib
import os
import pkgutil
import subprocess
import sys

import pytest

import gelforge.commands
import gelforge.stages
from gelforge.commands.gelforge import COMMANDS
from gelforge.commands.gelforge import main as dispatch
from gelforge.errors import BadInput
from gelforge.flow.cli import Command, command, group, option

NO_PROGRAMS = {"gelforge", "sensoroptions"}  # the dispatcher, and what others import
PROGRAMS = [
    module.name
    for package in (gelforge.stages, gelforge.commands)
    for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}.")
    if module.name.rpartition(".")[2] not in NO_PROGRAMS
]


def test_every_stage_and_command_has_a_command_line_with_help(capsys):
    for name in PROGRAMS:
        main = importlib.import_module(name).main
        assert isinstance(main, Command), name
        with pytest.raises(SystemExit) as ended:
            main(["--help"])
        assert ended.value.code == 0
        assert f"usage: python -m {name} " in capsys.readouterr().out, name


def test_the_help_of_a_command_names_the_word_that_chose_it(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["gelforge"])
    for word in COMMANDS:
        with pytest.raises(SystemExit):
            dispatch([word, "--help"])
        assert f"usage: gelforge {word} " in capsys.readouterr().out


def test_an_option_without_a_default_must_be_given(capsys):
    main = command(option("--out"), option("--jobs", type=int, default=1))(lambda args: args.jobs)
    assert main(["--out", "x", "--jobs", "3"]) == 3
    with pytest.raises(SystemExit):
        main([])
    assert "--out" in capsys.readouterr().err


def test_the_first_word_chooses_a_command_of_a_group():
    main = group(one=command()(lambda args: 1), two=command(option("--value", type=int))(lambda args: args.value))
    assert main(["one"]) == 1
    assert main(["two", "--value", "7"]) == 7


def test_a_mistake_of_the_user_is_one_line_and_code_2(capsys):
    @command()
    def main(args):
        raise BadInput("log.csv: row 3: no number")

    with pytest.raises(BadInput):
        main([])
    with pytest.raises(SystemExit) as ended:
        main.exit([])
    assert ended.value.code == 2
    assert capsys.readouterr().err == "error: log.csv: row 3: no number\n"


def test_gelforge_lists_its_commands(capsys):
    from gelforge.commands.gelforge import COMMANDS, main

    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    said = capsys.readouterr().out
    assert all(f"gelforge {name}" in said for name in COMMANDS)
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0 and capsys.readouterr().out == f"gelforge {gelforge.__version__}\n"
    with pytest.raises(SystemExit) as ended:
        main(["sample", "--id", "demo-000001"])
    assert ended.value.code == 2 and "'sample' is not a command of gelforge" in capsys.readouterr().err


@pytest.mark.processes
def test_a_reader_that_is_gone_is_no_error():
    """As `gelforge | head -1` leaves it."""
    for words in ([], ["status", "--help"]):
        read, write = os.pipe()
        os.close(read)
        with os.fdopen(write, "wb") as gone:
            command = [sys.executable, "-m", "gelforge.commands.gelforge", *words]
            ended = subprocess.run(command, stdout=gone, stderr=subprocess.PIPE, text=True)
        assert "Traceback" not in ended.stderr and "BrokenPipe" not in ended.stderr
        assert ended.returncode in (0, 2, 141)
