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
from tests.support.limited import limited
from tests.support.no_locks import without_locks
from tests.support.waiting import HANG, heed_interrupts, wait_until

FOR_EVER = f"exec sleep {2 * HANG:g}"  # what is waited for to be ended must not end by itself meanwhile


def start(target, *command, reads=()):
    wrapper = [sys.executable, "-m", "gelforge.flow.step", str(target), *map(str, reads), "--", *command]
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


def test_a_target_costs_what_its_own_command_took(tmp_path):
    """An input that was corrupted is made again first; what that takes is the input's cost."""
    source, target = tmp_path / "results/d/30_fea/0000.csv", tmp_path / "results/d/40_forces/0000.csv"
    busy = "i=0; while [ $i -lt 300000 ]; do i=$((i+1)); done"
    assert wrapped(source, "bash", "-c", f"{busy}; echo whole > {source}.part")[0] == 0
    source.write_text("other\n")
    code, said = made_of(target, source, f"cp {source} {target}.part")
    assert code == 0 and "making it again" in said and target.read_text() == "whole\n"
    costs = [json.loads(mirror(path, "metrics", ".json").read_text())["cpu_seconds"] for path in (source, target)]
    assert costs[1] < 0.5 * costs[0]


def made_of(target, source, script):
    child = start(target, "bash", "-c", script, reads=[source])
    said = child.communicate(timeout=HANG)[0]
    return child.returncode, said


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


@pytest.mark.parametrize("there", [False, True])
def test_two_wrappers_of_one_target_work_once(tmp_path, there):
    """Whatever clock stamps the file: a file server's may be far behind."""
    target = tmp_path / "results/d/30_fea/0000.csv"
    count = tmp_path / "count"
    go = tmp_path / "go"
    stamp = f"echo made > {target}.part; touch -d 2001-01-01 {target}.part"
    text = f"echo ran >> {count}; while ! test -e {go}; do sleep 0.1; done; {stamp}"
    if there:
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
    """Also for a make that waited: the file it finds is of the input as it was."""
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
    assert first.returncode == 0 and "source changed while it was made" in said
    assert second.wait(HANG) == 0 and target.read_text() == "new\n"


def test_a_target_is_older_than_an_input_that_changed_meanwhile(tmp_path):
    """Whatever the time of the new input: make is to see it."""
    source, target = tmp_path / "source", tmp_path / "results/d/30_fea/0000.csv"
    source.write_text("old\n")
    replaced = f"cat {source} > {target}.part; echo new > {source}; touch -d 2001-01-01 {source}"
    child = start(target, "bash", "-c", replaced, reads=[source])
    assert child.wait(HANG) == 0 and target.read_text() == "old\n"
    assert target.stat().st_mtime_ns < source.stat().st_mtime_ns


def test_an_input_that_lost_bytes_is_made_again(tmp_path):
    first, second = tmp_path / "results/d/30_fea/0000.csv", tmp_path / "results/d/40_forces/0000.npz"
    assert wrapped(first, "bash", "-c", f"echo whole > {first}.part")[0] == 0
    first.write_text("wh")
    code, said = inputs_wrapped(second, first, "bash", "-c", f"cp {first} {second}.part")
    assert code == 0 and "making it again" in said
    assert first.read_text() == second.read_text() == "whole\n"


def inputs_wrapped(target, source, *command):
    done = subprocess.run(
        [sys.executable, "-m", "gelforge.flow.step", str(target), str(source), "--", *command],
        capture_output=True,
        text=True,
    )
    return done.returncode, done.stdout


def test_an_input_with_a_changed_bit_is_made_again(tmp_path):
    first, second = tmp_path / "results/d/30_fea/0000.csv", tmp_path / "results/d/40_forces/0000.npz"
    assert wrapped(first, "bash", "-c", f"echo whole > {first}.part")[0] == 0
    first.write_text("Whole\n")  # as many bytes
    code, said = inputs_wrapped(second, first, "bash", "-c", f"cp {first} {second}.part")
    assert code == 0 and "making it again" in said
    assert first.read_text() == second.read_text() == "whole\n"


def test_what_cannot_be_made_again_is_never_taken_for_whole(tmp_path):
    """A command that only an older version of the code knew fails; the corrupt file must not serve the next make."""
    first, second = tmp_path / "results/d/30_fea/0000.csv", tmp_path / "results/d/40_forces/0000.npz"
    assert wrapped(first, "bash", "-c", f"[ ! -e {tmp_path}/gone ] && echo whole > {first}.part")[0] == 0
    (tmp_path / "gone").touch()
    first.write_text("wh")
    assert inputs_wrapped(second, first, "bash", "-c", f"cp {first} {second}.part")[0]
    assert not first.exists() and not second.exists()


@pytest.mark.parametrize("record", ["", '{"exit_code": 0, "by', "null"])
def test_an_input_whose_record_is_corrupt_is_made_again_by_the_next_make(tmp_path, record):
    """As a power cut leaves it, of both files maybe: it is unknown whether the input is whole."""
    first, second = tmp_path / "results/d/30_fea/0000.csv", tmp_path / "results/d/40_forces/0000.npz"
    making, reading = f"echo whole > {first}.part", f"cp {first} {second}.part"
    assert wrapped(first, "bash", "-c", making)[0] == 0
    mirror(first, "metrics", ".json").write_text(record)
    code, said = inputs_wrapped(second, first, "bash", "-c", reading)
    assert code == 1 and "cannot be read" in said and "run make again" in said
    assert not first.exists() and not second.exists()
    assert wrapped(first, "bash", "-c", making)[0] == 0
    assert inputs_wrapped(second, first, "bash", "-c", reading)[0] == 0 and second.read_text() == "whole\n"


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


def test_a_file_that_went_missing_beside_its_table_is_made_again(tmp_path):
    """A JSON target names what was made with it, with digests; one that is gone or changed makes the step run again."""
    table, last = tmp_path / "results/d/60_dataset/dataset.json", tmp_path / "results/d/70_train/net.pt"
    array = table.with_name("labels.npy")
    making = (
        f"echo labels > {array}; d=$(sha256sum < {array} | cut -d' ' -f1);"
        f' echo "{{\\"sha256\\": {{\\"labels.npy\\": \\"$d\\"}}}}" > {table}.part'
    )
    assert wrapped(table, "bash", "-c", making)[0] == 0
    for corrupt in (array.unlink, lambda: array.write_text("Labels\n")):
        corrupt()
        code, said = inputs_wrapped(last, table, "bash", "-c", f"cp {array} {last}.part")
        assert code == 0 and f"{array}: not as it was" in said
        assert last.read_text() == "labels\n"
        last.unlink()
    code, said = inputs_wrapped(last, table, "bash", "-c", f"cp {array} {last}.part")
    assert code == 0 and "making it again" not in said


def test_a_full_disk_is_a_sentence_and_leaves_no_part(tmp_path):
    """Files may grow to 64 KiB only, as if the disk ended there: the command fails, and what it half wrote goes."""
    target = tmp_path / "results/d/30_fea/0000.csv"
    words = ["gelforge.flow.step", str(target), "--", "bash", "-c", f"head -c 100000 /dev/zero > '{target}.part'"]
    done = limited(64, *words)
    assert done.returncode and "Traceback" not in done.stdout + done.stderr
    assert "File size limit" in done.stdout + done.stderr or "too large" in done.stdout + done.stderr
    assert not target.exists() and not target.with_name("0000.csv.part").exists()


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_named_and_nothing_is_made(tmp_path, number):
    """Not as a lack of space, which was looked for in vain."""
    target = tmp_path / "results/d/30_fea/0000.csv"
    words = ["-m", "gelforge.flow.step", target, "--", "bash", "-c", f"echo made > '{target}.part'"]
    done = without_locks(number, sys.executable, *words)
    assert done.returncode == 2 and f"no file locks here ({os.strerror(number)})" in done.stdout, done.stderr
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
        [sys.executable, "-m", "gelforge.flow.step", str(target), "--", "bash", "-c", waits],
        stdout=subprocess.PIPE, text=True,
        env=os.environ | {"MAKE_TERMERR": device, "COLUMNS": "200"},
    )  # fmt: skip
    shown = b""
    while b"press s7" not in shown and select.select([master], [], [], HANG)[0]:
        shown += os.read(master, 1000)
    mark.touch()
    said = child.communicate(timeout=HANG)[0]
    assert b"no press is planned yet; now: 30_fea/0000 | press s7" in shown and shown.startswith(b"\r\033[K")
    assert "[" not in said.removeprefix(str(tmp_path))  # how far the run has come stands in the line alone
    assert os.read(master, 1000).endswith(b"\r\033[K")


def test_without_a_terminal_each_finished_file_says_how_far_the_run_has_come(tmp_path):
    target = tmp_path / "results/d/30_fea/0000.csv"
    said = wrapped(target, "bash", "-c", f"echo made > {target}.part")[1]
    assert said.rstrip().endswith("[no press is planned yet]")
    target = tmp_path / "results/d/80_evaluate/24x32/pair_8.card.md"  # of which the presses say nothing
    assert wrapped(target, "bash", "-c", f"echo made > {target}.part")[1].rstrip().endswith("MiB")


def test_of_two_readers_of_a_corrupt_input_one_makes_it_again(tmp_path):
    first, count = tmp_path / "results/d/40_forces/0000.npz", tmp_path / "count"
    go = tmp_path / "go"
    make_it = f"echo ran >> {count}; while ! test -e {go}; do sleep 0.1; done; echo whole > {first}.part"
    go.touch()
    assert wrapped(first, "bash", "-c", make_it)[0] == 0
    go.unlink()
    first.write_text("corrupt\n")
    readers = []
    for name in ("a", "b"):
        target = tmp_path / f"results/d/50_labels/{name}.npz"
        words = [
            sys.executable,
            "-m",
            "gelforge.flow.step",
            str(target),
            str(first),
            "--",
            "cp",
            str(first),
            f"{target}.part",
        ]
        readers.append(subprocess.Popen(words, stdout=subprocess.PIPE, text=True))
    lines = [reader.stdout.readline() for reader in readers]
    for words in ("making it again", "another make is at it"):
        assert sum(words in line for line in lines) == 1, lines
    go.touch()
    said = [reader.communicate(timeout=HANG)[0] for reader in readers]
    assert [reader.returncode for reader in readers] == [0, 0], said
    assert count.read_text() == "ran\nran\n" and first.read_text() == "whole\n"
    assert (tmp_path / "results/d/50_labels/b.npz").read_text() == "whole\n"


def test_an_interrupt_while_another_make_is_waited_for_is_no_traceback(tmp_path):
    target = tmp_path / "results/d/30_fea/0000.csv"
    started = tmp_path / "started"
    first = start(target, "bash", "-c", f"touch {started}; {FOR_EVER}")
    wait_until(started.exists, of=first)
    words = [sys.executable, "-m", "gelforge.flow.step", str(target), "--", "true"]
    second = subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=heed_interrupts,
    )  # fmt: skip
    assert "another make is at it" in second.stdout.readline()
    second.send_signal(signal.SIGINT)
    said = second.communicate(timeout=HANG)[1]
    first.terminate()
    first.wait()
    assert second.returncode == 130 and "Traceback" not in said


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
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


@pytest.mark.parametrize(
    ("error", "said"),
    [
        ("PermissionError(13, os.strerror(13), 'results/d')", "results/d: Permission denied"),
        ("OSError(28, os.strerror(28))", "No space left on device"),  # a write does not name its file
    ],
)
def test_a_folder_that_takes_nothing_is_one_sentence(error, said):
    program = (
        f"import os\nfrom gelforge.flow.main import exit_with\ndef main(argv): raise {error}\nexit_with(main, [])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == f"error: {said}; free space or permissions, then run it again\n"
