"""The wrapper publishes whole files, keeps logs, and leaves nothing behind when killed."""

import errno
import json
import os
import pty
import select
import shlex
import signal
import subprocess
import sys
from importlib.metadata import version

import pytest

from gelforge.flow.layout import mirror
from gelforge.flow.ledger import last_runs
from tests.support.limited import limited
from tests.support.no_locks import without_locks
from tests.support.waiting import HANG, heed_interrupts, wait_until

FOR_EVER = f"exec sleep {2 * HANG:g}"  # what is waited for to be ended must not end by itself meanwhile


def start(target, *command, reads=(), every=None):
    options = ["--every", str(every)] if every else []
    wrapper = [sys.executable, "-m", "gelforge.flow.step", *options, str(target), *map(str, reads), "--", *command]
    return subprocess.Popen(wrapper, stdout=subprocess.PIPE, text=True)


def wrapped(target, *command):
    child = start(target, *command)
    said = child.communicate(timeout=HANG)[0]
    return child.returncode, said


def test_success_publishes_target_log_and_metrics(tmp_path):
    target = tmp_path / "results/d/30_fea/0000.csv"
    code, said = wrapped(target, "bash", "-c", f"echo working; echo made > {target}.part")
    assert code == 0 and str(target) in said
    assert target.read_text() == "made\n" and not target.with_name("0000.csv.part").exists()
    assert "working" in mirror(target, "logs", ".log").read_text()
    cost = json.loads(mirror(target, "metrics", ".json").read_text())
    assert cost["exit_code"] == 0
    assert cost["programs"] == {name: version(name) for name in ("gelforge", "numpy", "scipy", "numba", "torch")}
    assert mirror(target, "logs", ".log") == tmp_path / "results/d/logs/30_fea/0000.log"


def test_failure_removes_the_part_and_shows_the_log(tmp_path):
    target = tmp_path / "results/d/30_fea/0000.csv"
    code, said = wrapped(target, "bash", "-c", f"echo half > {target}.part; echo the reason; exit 3")
    assert code == 3 and "the reason" in said and "0000.log" in said
    assert not target.exists() and not target.with_name("0000.csv.part").exists()


def test_success_without_a_file_is_a_failure(tmp_path):
    code, said = wrapped(tmp_path / "results/d/30_fea/0000.csv", "true")
    assert code == 1 and "wrote no" in said


def test_killing_the_wrapper_ends_its_command(tmp_path):
    target = tmp_path / "results/d/30_fea/0000.csv"
    mark = tmp_path / "pid"
    child = start(target, "bash", "-c", f"echo $$ > {mark}; {FOR_EVER}")
    wait_until(lambda: mark.exists() and mark.read_text().strip())
    inner = int(mark.read_text())
    child.send_signal(signal.SIGKILL)
    child.wait()
    wait_until(lambda: not alive(inner))
    assert not alive(inner) and not target.exists()


POOL = """
import multiprocessing, os, signal, sys
from gelforge.flow.orphans import pool
if __name__ == "__main__":
    workers = pool(2, multiprocessing.get_context(sys.argv[1]))
    list(workers.map(abs, range(4)))
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("way", ["fork", "spawn"])
def test_a_command_that_is_killed_beside_its_pool_fails_its_target(tmp_path, way):
    """As one that memory was short for: what its workers hold open must not keep make waiting for more of its output."""
    target, script = tmp_path / "results/d/calibrate/summary.json", tmp_path / "pool.py"
    script.write_text(POOL)
    code, said = wrapped(target, sys.executable, str(script), way)
    assert code == 1 and "FAILED" in said


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat", encoding="utf-8") as stat:
        return stat.read().rsplit(")", 1)[1].split()[0] != "Z"


def test_two_wrappers_of_one_target_work_once(tmp_path):
    """Whatever clock stamps the file: a file server's may be far behind."""
    target = tmp_path / "results/d/30_fea/0000.csv"
    count = tmp_path / "count"
    go = tmp_path / "go"
    stamp = f"echo made > {target}.part; touch -d 2001-01-01 {target}.part"
    text = f"echo ran >> {count}; while ! test -e {go}; do sleep 0.1; done; {stamp}"
    target.parent.mkdir(parents=True)
    target.write_text("old\n")
    first = start(target, "bash", "-c", text)
    wait_until(count.exists, of=first)
    second = start(target, "bash", "-c", text)
    assert "another make is at it" in second.stdout.readline()
    go.touch()
    assert first.wait(HANG) == 0 and second.wait(HANG) == 0
    assert count.read_text() == "ran\n" and target.read_text() == "made\n"


def test_what_was_made_of_an_input_that_changed_meanwhile_is_due_again(tmp_path):
    """By its date, as make sees it; also for a make that waited: the file it finds is of the input as it was."""
    source, target, go = tmp_path / "source", tmp_path / "results/d/30_fea/0000.csv", tmp_path / "go"
    source.write_text("old\n")
    text = f"cat {source} > {target}.part; touch {target}.read; while ! test -e {go}; do sleep 0.1; done"
    first = start(target, "bash", "-c", text, reads=[source])
    wait_until(target.with_name("0000.csv.read").exists, of=first)
    source.write_text("new\n")
    second = start(target, "bash", "-c", text, reads=[source])
    assert "another make is at it" in second.stdout.readline()
    go.touch()
    said = first.communicate(timeout=HANG)[0]
    assert first.returncode == 0 and str(target) in said
    assert second.wait(HANG) == 0 and target.read_text() == "new\n"


def test_a_record_names_its_target_and_what_that_was_made_of(tmp_path):
    """By which `make status` says what is outdated."""
    target, source = tmp_path / "results/d/10_poses/0000.csv", tmp_path / "source"
    source.touch()
    assert start(target, "cp", str(source), f"{target}.part", reads=[source]).wait(HANG) == 0
    (run,) = last_runs(tmp_path / "results/d")
    assert (run.target, run.inputs) == (str(target), [str(source)])


def test_nothing_is_made_of_an_input_that_is_not_as_it_was_made(tmp_path):
    """Its own bytes, its record, and the files that a table names with their digests; removed, it is made anew by make."""
    table, last = tmp_path / "results/d/60_dataset/dataset.json", tmp_path / "results/d/70_train/net.pt"
    array, record = table.with_name("labels.npy"), mirror(table, "metrics", ".json")
    making = (
        f"echo labels > {array}; d=$(sha256sum < {array} | cut -d' ' -f1);"
        f' echo "{{\\"sha256\\": {{\\"labels.npy\\": \\"$d\\"}}}}" > {table}.part'
    )

    def read() -> tuple[int, str]:
        child = start(last, "cp", str(array), f"{last}.part", reads=[table])
        said = child.communicate(timeout=HANG)[0]
        return child.returncode, said

    harms = {
        "cut off": (table, lambda: table.write_text(table.read_text()[:-4])),
        "one byte changed": (table, lambda: table.write_text(table.read_text().replace("labels", "Labels"))),
        "record lost": (table, lambda: record.write_text('{"exit_code": 0, "by')),
        "file beside it gone": (array, array.unlink),
        "file beside it changed": (array, lambda: array.write_text("Labels\n")),
    }
    for harm, (named, do) in harms.items():
        assert wrapped(table, "bash", "-c", making)[0] == 0 and read()[0] == 0, harm
        last.unlink()
        do()
        code, said = read()
        gone = table if named == table else f"{table} {named}"
        assert code == 2 and said.startswith(f"{last}: {named}: is not as it was made; remove it (rm {gone})"), harm
        assert not last.exists()
    # a run that failed since left the file of the one before
    assert wrapped(table, "bash", "-c", making)[0] == 0 and wrapped(table, "false")[0] == 1
    assert read()[0] == 0


def test_killing_what_started_the_wrapper_ends_wrapper_and_command(tmp_path):
    """kill -9 of make: nothing goes on to the end of its shard."""
    target, mark = tmp_path / "results/d/30_fea/0000.csv", tmp_path / "pid"
    inner = f"echo $$ > '{mark}'; {FOR_EVER}"
    words = [sys.executable, "-m", "gelforge.flow.step", str(target), "--", "bash", "-c", inner]
    outer = subprocess.Popen(["bash", "-c", f"{shlex.join(words)}; true"])
    wait_until(lambda: mark.exists() and mark.read_text().strip())
    command = int(mark.read_text())
    with open(f"/proc/{command}/stat", encoding="utf-8") as stat:
        wrapper = int(stat.read().rsplit(")", 1)[1].split()[1])
    assert wrapper != outer.pid
    outer.kill()
    outer.wait()
    wait_until(lambda: not (alive(command) or alive(wrapper)))
    assert not alive(command) and not alive(wrapper) and not target.exists()


def test_a_full_disk_is_a_sentence_and_leaves_no_part(tmp_path):
    """Files may grow to 64 KiB only, as if the disk ended there: the command fails, and what it half wrote goes."""
    target = tmp_path / "results/d/30_fea/0000.csv"
    words = ["gelforge.flow.step", str(target), "--", "bash", "-c", f"head -c 100000 /dev/zero > '{target}.part'"]
    done = limited(64, *words)
    assert done.returncode and "Traceback" not in done.stdout + done.stderr
    assert "File size limit" in done.stdout + done.stderr or "too large" in done.stdout + done.stderr
    assert not target.exists() and not target.with_name("0000.csv.part").exists()


def test_a_file_system_without_locks_is_named_and_nothing_is_made(tmp_path):
    """Not as a lack of space, which was looked for in vain."""
    target = tmp_path / "results/d/30_fea/0000.csv"
    words = ["-m", "gelforge.flow.step", target, "--", "bash", "-c", f"echo made > '{target}.part'"]
    done = without_locks(errno.ENOLCK, sys.executable, *words)
    assert done.returncode == 2 and f"no file locks here ({os.strerror(errno.ENOLCK)})" in done.stdout, done.stderr
    assert "mount the file system with them" in done.stdout and "space" not in done.stdout
    assert not target.exists() and not target.with_name("0000.csv.part").exists()


@pytest.fixture
def typed_to():
    """A terminal as a person's: the name of its device, and the end where what is written to it comes out."""
    master, slave = pty.openpty()
    yield os.ttyname(slave), master
    os.close(master)
    os.close(slave)


def test_a_terminal_shows_one_line_that_goes_away(tmp_path, typed_to):
    device, master = typed_to
    target, mark = tmp_path / "results/d/30_fea/0000.csv", tmp_path / "seen"
    waits = f"echo press s7; while ! test -e {mark}; do sleep 0.1; done; echo made > {target}.part"
    child = subprocess.Popen(
        [sys.executable, "-m", "gelforge.flow.step", "--every", "0.1", str(target), "--", "bash", "-c", waits],
        stdout=subprocess.PIPE, text=True,
        env=os.environ | {"MAKE_TERMERR": device, "COLUMNS": "200"},
    )  # fmt: skip
    shown = b""
    while b"press s7" not in shown and select.select([master], [], [], HANG)[0]:
        shown += os.read(master, 1000)
    mark.touch()
    said = child.communicate(timeout=HANG)[0]
    assert b"now: 30_fea/0000 | press s7" in shown and shown.startswith(b"\r\033[K")
    assert "[" not in said.removeprefix(str(tmp_path))  # how far the run has come stands in the line alone
    assert os.read(master, 1000).endswith(b"\r\033[K")


def test_without_a_terminal_each_finished_file_says_how_far_the_run_has_come(tmp_path):
    target, shards = tmp_path / "results/d/30_fea/0000.csv", tmp_path / "results/d/00_plan/shards"
    shards.mkdir(parents=True)
    for name in ("0000.csv", "0001.csv"):
        (shards / name).touch()
    said = wrapped(target, "bash", "-c", f"echo made > {target}.part")[1]
    assert said.rstrip().endswith("[30_fea: 1 of 2 shards]")
    target = tmp_path / "results/d/80_evaluate/24x32/pair_8.card.md"  # of which no shards are made
    assert wrapped(target, "bash", "-c", f"echo made > {target}.part")[1].rstrip().endswith("MiB")


def test_without_a_terminal_one_of_the_steps_at_work_speaks_in_turn(tmp_path):
    """How far the run is, what runs, and the last line of its log; a make that waits for another one does as well."""
    folder, shards = tmp_path / "results/d/30_fea", tmp_path / "results/d/00_plan/shards"
    shards.mkdir(parents=True)

    def working(name: str) -> subprocess.Popen:
        (shards / f"{name}.csv").touch()
        target = folder / f"{name}.csv"
        text = f"echo press s{name}; while ! test -e {tmp_path}/{name}; do sleep 0.1; done; echo made > {target}.part"
        return start(target, "bash", "-c", text, every=0.1)

    def said(step: subprocess.Popen, text: str) -> None:
        while text not in (line := step.stdout.readline()):
            assert line, f"it ended without {text}"

    first = working("0000")
    said(first, " s so far  [30_fea: 0 of 1 shards; now: 30_fea/0000 | press s0000]")
    second, waiting = working("0001"), working("0000")
    said(waiting, "another make is at it; waiting")
    said(first, " s so far  [30_fea: 0 of 2 shards; now: 30_fea/0000, 30_fea/0001 | press s0000]")
    assert not select.select([second.stdout], [], [], 0.5)[0]
    (tmp_path / "0000").touch()
    assert first.wait(HANG) == waiting.wait(HANG) == 0
    said(first, " MiB  [30_fea: 1 of 2 shards")
    said(second, " s so far  [30_fea: 1 of 2 shards; now: 30_fea/0001 | press s0001]")
    (tmp_path / "0001").touch()
    assert second.wait(HANG) == 0


def test_an_interrupt_while_another_make_is_waited_for_is_no_traceback(tmp_path):
    target = tmp_path / "results/d/30_fea/0000.csv"
    started = tmp_path / "started"
    first = start(target, "bash", "-c", f"touch {started}; {FOR_EVER}")
    wait_until(started.exists, of=first)
    words = [sys.executable, "-m", "gelforge.flow.step", str(target), "--", "true"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    second = subprocess.Popen(words, **pipes, preexec_fn=heed_interrupts)
    assert "another make is at it" in second.stdout.readline()
    second.send_signal(signal.SIGINT)
    said = second.communicate(timeout=HANG)[1]
    first.terminate()
    first.wait()
    assert second.returncode == 130 and "Traceback" not in said


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_what_a_person_stops_is_no_failure(tmp_path, number):
    """Ctrl-C goes to make, wrapper and command at once; the next make makes the target."""
    target, started = tmp_path / "results/d/30_fea/0000.csv", tmp_path / "started"
    # no shell: one whose own child just ends takes no notice of an interrupt, nor does a file that is just being closed
    waits = [sys.executable, "-c", f"import os, time; os.mkdir({str(started)!r}); time.sleep({2 * HANG})"]
    words = [sys.executable, "-m", "gelforge.flow.step", str(target), "--", *waits]
    child = subprocess.Popen(
        words, stdout=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=heed_interrupts,
    )  # fmt: skip
    wait_until(started.exists, of=child)
    os.killpg(child.pid, number)
    said = child.communicate(timeout=HANG)[0]
    assert child.returncode and said == f"{target}: interrupted; the same make goes on with it\n"
    assert wrapped(target, "bash", "-c", f"echo made > {target}.part")[0] == 0 and target.read_text() == "made\n"


def test_a_folder_that_takes_nothing_is_one_sentence():
    for error, said in (
        ("PermissionError(13, os.strerror(13), 'results/d')", "results/d: Permission denied"),
        ("OSError(28, os.strerror(28))", "No space left on device"),  # a write does not name its file
    ):
        program = (
            f"import os\nfrom gelforge.flow.main import exit_with\ndef main(argv): raise {error}\nexit_with(main, [])"
        )
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
        assert done.returncode == 2
        assert done.stderr == f"error: {said}; free space or permissions, then run it again\n"
