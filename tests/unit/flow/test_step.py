"""The wrapper publishes whole files, keeps logs, and leaves nothing behind when killed."""

import errno
import fcntl
import json
import os
import shlex
import signal
import socket
import subprocess
import sys
import time
from functools import partial
from importlib.metadata import version

import pytest

from gelforge.flow.files import alone, write_text
from gelforge.flow.layout import Layout, mirror
from gelforge.flow.runs import changes, last_runs
from tests.support.limited import limited
from tests.support.no_locks import without_locks
from tests.support.sandbox import clean_environment
from tests.support.waiting import HANG, heed_interrupts, wait_until

pytestmark = pytest.mark.processes

FOR_EVER = f"exec sleep {2 * HANG:g}"  # what is waited for to be ended must not end by itself meanwhile


def start(target, *command, reads=()):
    wrapper = [sys.executable, "-m", "gelforge.flow.step", str(target), *map(str, reads), "--", *command]
    return subprocess.Popen(wrapper, stdout=subprocess.PIPE, text=True)


def wrapped(target, *command, reads=()):
    child = start(target, *command, reads=reads)
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


def test_what_a_step_says_is_one_write_so_that_lines_of_two_steps_do_not_mix(tmp_path):
    """Of a socket of messages, each write is one message; Python writes at once if PYTHONUNBUFFERED is set."""
    target = tmp_path / "results/d/50_labels/4x4/x.json"
    for code in (0, 3):
        here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        make = ["bash", "-c", f"echo note: one; echo made > {target}.part; exit {code}"]
        wrapper = [sys.executable, "-m", "gelforge.flow.step", str(target), "--", *make]
        with here, there:
            environment = clean_environment() | {"PYTHONUNBUFFERED": "1"}
            done = subprocess.run(wrapper, env=environment, stdout=there, timeout=HANG, check=False)
            there.close()
            said = [message.decode() for message in iter(partial(here.recv, 65536), b"")]
        assert done.returncode == code and str(target) in said[-1]
        assert all(message.endswith("\n") and message.strip() for message in said)


def test_the_last_line_of_a_long_command_s_log_is_repeated_once(tmp_path):
    """A progress bar ends no line: what stands after the last carriage return is told."""
    target, go = tmp_path / "results/d/30_fea/0000.csv", tmp_path / "go"
    work = f"printf '1 of 9\\r2 of 9'; until [ -e {go} ]; do sleep 0.05; done; echo made > {target}.part"
    code = "import sys; from gelforge.flow import step; step.TELL_S = 0.2; sys.exit(step.main())"
    words = [sys.executable, "-c", code, str(target), "--", "bash", "-c", work]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as child:
        told = child.stdout.readline()
        time.sleep(0.5)  # two more times at which nothing is new
        go.touch()
        rest = child.communicate(timeout=HANG)[0]
    assert told == f"{mirror(target, 'logs', '.log')}: 2 of 9\n"
    assert rest.splitlines()[0].startswith(f"{target}  ") and child.returncode == 0


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
from gelforge.flow.jobs import pool
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
    assert "another make is making it" in second.stdout.readline()
    go.touch()
    assert first.wait(HANG) == 0 and second.wait(HANG) == 0
    assert count.read_text() == "ran\n" and target.read_text() == "made\n"


def test_a_file_that_is_being_made_is_nobody_else_s(tmp_path):
    path = tmp_path / "folder" / "part.bin"
    with lock_of(path) as lock, alone(path), pytest.raises(BlockingIOError):
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    with lock_of(path) as lock:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)


def lock_of(path):
    """The open lock of a file that processes make together."""
    path.parent.mkdir(exist_ok=True)
    return path.with_name(f".{path.name}.lock").open("a")


def test_what_was_made_of_an_input_that_changed_meanwhile_is_due_again(tmp_path):
    """By its date, as make sees it; also for a make that waited: the file it finds is of the input as it was."""
    source, target, go = tmp_path / "source", tmp_path / "results/d/30_fea/0000.csv", tmp_path / "go"
    source.write_text("old\n")
    text = f"cat {source} > {target}.part; touch {target}.read; while ! test -e {go}; do sleep 0.1; done"
    first = start(target, "bash", "-c", text, reads=[source])
    wait_until(target.with_name("0000.csv.read").exists, of=first)
    source.write_text("new\n")
    second = start(target, "bash", "-c", text, reads=[source])
    assert "another make is making it" in second.stdout.readline()
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
    assert (run.target, list(run.record["inputs"])) == (str(target), [str(source)])
    assert changes(target) == []
    source.write_text("changed")
    assert changes(target) == [str(source)]


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

    assert wrapped(table, "bash", "-c", making)[0] == 0 and read()[0] == 0
    harms = {
        "cut off": (table, lambda: table.write_text(table.read_text()[:-4])),
        "one byte changed": (table, lambda: table.write_text(table.read_text().replace("labels", "Labels"))),
        "record lost": (table, lambda: record.write_text('{"exit_code": 0, "by')),
        "file beside it changed": (array, lambda: array.write_text("Labels\n")),
    }
    for harm, (named, do) in harms.items():
        assert wrapped(table, "bash", "-c", making)[0] == 0, harm
        last.unlink(missing_ok=True)
        do()
        code, said = read()
        gone = table if named == table else f"{table} {named}"
        assert code == 2 and said.startswith(
            f"{last}: {named}: missing or changed since it was made; remove it (rm {gone})"
        ), harm
        assert not last.exists()
    # a file beside it that is gone is made again, by the table's own command
    array.unlink()
    code, said = read()
    assert code == 0 and f"{table}: made again, because {array} is missing" in said and array.exists()
    # a run that failed since left the file of the one before
    assert wrapped(table, "bash", "-c", making)[0] == 0 and wrapped(table, "false")[0] == 1
    assert read()[0] == 0


def test_what_was_written_beside_a_prerequisite_and_is_gone_is_made_again(tmp_path):
    """By its stem or in a folder of its name; a target of its own that has the same stem is none of it."""
    table, last = tmp_path / "results/d/10_poses/0000.csv", tmp_path / "results/d/30_fea/0000.csv"
    inner, shown, own = (
        table.with_name("0000") / "a.stl",
        table.with_name("0000.png"),
        table.with_name("0000.card.md"),
    )
    making = f"mkdir -p {inner.parent}; touch {inner} {shown}; echo rows > {table}.part"
    assert wrapped(own, "bash", "-c", f"echo card > {own}.part")[0] == 0
    assert wrapped(table, "bash", "-c", making)[0] == 0
    for gone in (inner, shown):
        gone.unlink()
        code, said = wrapped(last, "bash", "-c", f"cat {gone} > {last}.part", reads=[table])
        assert code == 0 and f"{table}: made again, because {gone} is missing" in said and gone.exists()
        last.unlink()
    own.unlink()
    assert f"{table}: made" not in wrapped(last, "bash", "-c", f"echo > {last}.part", reads=[table])[1]


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
    assert "mount the file system with locks" in done.stdout and "space" not in done.stdout
    assert not target.exists() and not target.with_name("0000.csv.part").exists()


def test_a_finished_shard_says_which_of_how_many_it_is(tmp_path):
    of = Layout(tmp_path / "results/d")
    for name in ("0000", "0001", "0003"):
        write_text(of.shard(name), "")

    def said(target):
        return wrapped(target, "bash", "-c", f"echo made > {target}.part")[1].rstrip()

    assert said(of.fea("0003")).endswith(" MiB  [3 of 3]") and said(of.labels("4x4", "0000")).endswith("  [1 of 3]")
    assert said(of.card("24x32", "pair_8")).endswith("MiB")  # of which no shards are made


def test_a_launcher_runs_the_command_and_is_no_part_of_the_record(tmp_path, monkeypatch):
    target = tmp_path / "results/d/30_fea/0000.csv"
    monkeypatch.setenv("GELFORGE_LAUNCHER", "env -i PATH=/usr/bin:/bin LAUNCHED=yes")
    assert wrapped(target, "bash", "-c", f'echo "$LAUNCHED" > {target}.part')[0] == 0
    assert target.read_text() == "yes\n"
    monkeypatch.delenv("GELFORGE_LAUNCHER")
    assert wrapped(target, "bash", "-c", f'echo "$LAUNCHED" > {target}.part') == (0, "")


def test_what_a_command_counts_last_stands_in_its_record(tmp_path):
    target = tmp_path / "results/d/30_fea/0000.csv"
    text = """echo '{"done": 1}'; echo 'failed: b'; echo '{"done": 7, "failed": {"DIVERGED: too deep": 1}}'"""
    assert wrapped(target, "bash", "-c", f"{text}; echo made > {target}.part")[0] == 0
    (run,) = last_runs(tmp_path / "results/d")
    assert (run.done, run.lost) == (7, {"DIVERGED: too deep": 1})


SPENT = """
import multiprocessing, sys, time
def spend():
    until = time.process_time() + 0.5
    while time.process_time() < until:
        pass
if __name__ == "__main__":
    context = multiprocessing.get_context(sys.argv[1])
    child = context.Process(target=spend)
    child.start()
    child.join()
    open(sys.argv[2], "w").close()
"""


@pytest.mark.parametrize("way", ["fork", "spawn", "forkserver"])
def test_the_cost_of_a_target_is_that_of_all_its_processes(tmp_path, way):
    """Also of those that another one forked, which outlives the command."""
    target, script = tmp_path / "results/d/pareto/pareto.json", tmp_path / "spent.py"
    script.write_text(SPENT)
    assert wrapped(target, sys.executable, str(script), way, f"{target}.part")[0] == 0
    assert 0.5 <= last_runs(tmp_path / "results/d")[0].record["cpu_seconds"] < 5.0


# -- the cut-off


def counting(target, source, count) -> tuple:
    """A command that copies its input, and says that it ran."""
    return ("bash", "-c", f"echo ran >> '{count}'; cp '{source}' '{target}.part'")


def without_digest(target):
    """A record of the target that lacks one, as an edit by hand or another version leaves it."""
    path = mirror(target, "metrics", ".json")
    record = json.loads(path.read_text())
    path.write_text(json.dumps({key: value for key, value in record.items() if key != "sha256"}))


def test_nothing_runs_where_command_and_contents_are_those_of_the_record_and_else_it_is_said_why(tmp_path):
    """Whatever the dates: the target is then newer than all that it was made of."""
    target, source, count = tmp_path / "results/d/60_dataset/x.csv", tmp_path / "source", tmp_path / "count"
    source.write_text("old\n")
    command = counting(target, source, count)

    def ran(*command, reads=(source,)) -> str:
        """What it said, if the command ran."""
        before = count.read_text() if count.exists() else ""
        code, said = wrapped(target, *command, reads=reads)
        assert code == 0
        assert all(target.stat().st_mtime_ns >= path.stat().st_mtime_ns for path in reads if path.exists())
        again = count.read_text() != before
        assert bool(said) == again
        return said

    assert "because" not in ran(*command)
    for change in (
        lambda: None, lambda: os.utime(target, (1e9, 1e9)), lambda: os.utime(source, (time.time() + 9e4,) * 2),
        lambda: (source.unlink(), source.write_text("old\n")),
    ):  # fmt: skip
        change()
        assert not ran(*command)
    other, longer = tmp_path / "other", ("bash", "-c", f"{command[2]}; true")
    for change, words, reads, why in (
        (lambda: source.write_text("new\n"), command, (source,), f"{source} changed\n"),
        (
            lambda: (source.write_text("old\n"), os.utime(source, (1e9, 1e9))),
            command,
            (source,),
            f"{source} changed\n",
        ),
        (target.unlink, command, (source,), "it is missing"),
        (lambda: target.write_text("edited\n"), command, (source,), "it changed since it was made"),
        (lambda: other.write_text(""), command, (source, other), f"{other} is a new prerequisite"),
        (lambda: None, command, (source,), f"{other} is no prerequisite any more"),
        (lambda: None, longer, (source,), "its command changed"),
        (lambda: without_digest(target), command, (source,), "it changed since it was made"),
        (mirror(target, "metrics", ".json").unlink, command, (source,), ""),
    ):
        change()
        said = ran(*words, reads=reads)
        assert said and (not why or f"{target}: made again, because {why}" in said), why
    assert not ran(*command)
    other.unlink()
    assert ran(*command, reads=(source, other)) and not ran(*command, reads=(source, other))  # what may come to be
    other.write_text("came\n")
    assert ran(*command, reads=(source, other))


def test_a_failed_run_is_repeated_though_nothing_changed(tmp_path):
    target, source, count = tmp_path / "results/d/30_fea/0000.csv", tmp_path / "source", tmp_path / "count"
    source.write_text("old\n")
    command = counting(target, source, count)
    assert wrapped(target, *command, reads=[source])[0] == 0
    source.write_text("new\n")
    assert wrapped(target, "bash", "-c", "exit 3", reads=[source])[0] == 3
    assert wrapped(target, *command, reads=[source])[0] == 0 and target.read_text() == "new\n"


def test_of_any_number_of_inputs_each_stands_in_the_record(tmp_path):
    """More than a command line holds go by a list."""
    target, count = tmp_path / "results/d/50_labels/24x32/labels.json", tmp_path / "count"
    reads = [tmp_path / f"{k:04d}" for k in range(3000)]
    for path in reads:
        path.write_text(path.name)
    (tmp_path / "list").write_text("\n".join(map(str, reads)))
    command = counting(target, reads[0], count)
    assert wrapped(target, *command, reads=[f"@{tmp_path}/list"])[0] == 0
    assert list(last_runs(tmp_path / "results/d")[0].record["inputs"]) == list(map(str, reads))
    reads[2999].write_text("changed")
    for _ in range(2):
        assert wrapped(target, *command, reads=[f"@{tmp_path}/list"])[0] == 0
    assert count.read_text() == "ran\nran\n"


def test_a_rule_names_any_number_of_inputs(tmp_path, root):
    """To the wrapper, whose command line takes so many."""
    (tmp_path / "Makefile").write_text(
        f"PY := echo\nEXECUTOR := local\nJOBS := 1\nD := results/d\nREADS := $(addprefix in/,$(shell seq $(COUNT)))\n"
        f"$D/all: $(READS)\n$(READS):\n\t@:\ninclude {root}/rules/run.mk\n"
    )
    for count in (499, 500, 3000):
        said = subprocess.run(
            ["make", "-C", tmp_path, f"COUNT={count}"], env=clean_environment(), capture_output=True, text=True
        )
        words = said.stdout.split("gelforge.flow.step results/d/all ")[1].splitlines()[0].split()
        if words[0].startswith("@"):
            words = (tmp_path / words[0][1:]).read_text().split()
        assert words == [f"in/{k + 1}" for k in range(count)], count


def test_an_interrupt_while_another_make_is_waited_for_is_no_traceback(tmp_path):
    target = tmp_path / "results/d/30_fea/0000.csv"
    started = tmp_path / "started"
    first = start(target, "bash", "-c", f"touch {started}; {FOR_EVER}")
    wait_until(started.exists, of=first)
    words = [sys.executable, "-m", "gelforge.flow.step", str(target), "--", "true"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    second = subprocess.Popen(words, **pipes, preexec_fn=heed_interrupts)
    assert "another make is making it" in second.stdout.readline()
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
            f"import os\nfrom gelforge.flow.cli import exit_with\ndef main(argv): raise {error}\nexit_with(main, [])"
        )
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
        assert done.returncode == 2
        assert done.stderr == f"error: {said}; free space or permissions, then run it again\n"
