"""The Slurm executor: what make collected goes out as job arrays, and comes back as result files or reasons.

make writes the tasks of a stage (target, command) to D/.slurm/STAGE.tasks and then calls `flush`. A record beside
it, D/.slurm/STAGE.json, says what was submitted, so that work left running is found and awaited, never submitted
twice. A task is done when its target is there, not empty: make removed an outdated target when it collected the
task, and the wrapper publishes by renaming. An exit code or a job's state alone proves nothing.
"""

import argparse
import os
import secrets
import shlex
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.files import write_text
from gelforge.flow.layout import Layout
from gelforge.flow.orphans import die_with_parent
from gelforge.flow.slurm.client import (
    FINAL,
    HELD,
    STOP,
    WAITING,
    Element,
    Interrupted,
    SlurmRefused,
    array_limit,
    cancel_jobs,
    cancel_named,
    cause_of,
    elements,
    pause,
    submit_job,
)
from gelforge.flow.slurm.cluster import PUBLISHED, Profile, read_profile
from gelforge.flow.slurm.lock import at_work, become_only_make, hold
from gelforge.flow.slurm.record import Batch, Record, Results, Task, counted, load, records, report, show, tail

FIRST_POLL_S = 0.2

# --- submission -----------------------------------------------------------------------------------------------------

SCRIPT = """#!/bin/bash
{setup}
set -euo pipefail
export OMP_NUM_THREADS={cores} MKL_NUM_THREADS={cores} OPENBLAS_NUM_THREADS={cores}
tasks={tasks}
for _ in {{1..60}}; do [ -s "$tasks" ] && break; sleep 1; done
mapfile -t -s $(( (SLURM_ARRAY_TASK_ID - 1) * {each} )) -n {each} lines <"$tasks"
failed=0
for line in "${{lines[@]}}"; do
    # Slurm starts a task again after its node was away; what is there already is not made twice.
    [ -s "${{line%%$'\\t'*}}" ] || (eval "exec ${{line#*$'\\t'}}") || failed=$?
done
exit $failed
"""


def submit(record: Record, profile: Profile, tasks: list[Task]) -> None:
    """Hand tasks to Slurm, one job array for each limit of memory and time and for each `array_limit` of them."""
    number = {id(task): k for k, task in enumerate(record.tasks)}
    alike: dict = {}
    for task in tasks:
        alike.setdefault((task.memory_mb, task.minutes), []).append(number[id(task)])
    limit, each = array_limit(profile), profile.shards_per_task
    for (memory_mb, minutes), members in alike.items():
        groups = [members[k : k + each] for k in range(0, len(members), each)]
        for k in range(0, len(groups), limit):
            submit_array(record, profile, groups[k : k + limit], profile.sbatch_options(memory_mb, minutes))


def submit_array(record: Record, profile: Profile, groups: list[list[int]], options: list[str]) -> None:
    """Submit one job array. Its name is recorded first, so that a job is found even if its id never reached us."""
    batch = Batch(f"gelforge-{record.path.stem}-{secrets.token_hex(4)}", "", groups)
    folder = record.folder / batch.name
    folder.mkdir(parents=True, exist_ok=True)
    members = [record.tasks[k] for group in groups for k in group]
    write_text(folder / "tasks", "".join(f"{task.target}\t{task.command}\n" for task in members))
    for k, group in enumerate(groups, 1):
        for task in (record.tasks[n] for n in group):
            task.state, task.runs, task.where = "queued", task.runs + 1, f"{batch.name}/{k}"
    record.batches.append(batch)
    record.save()
    script = SCRIPT.format(
        setup="\n".join(profile.setup),
        cores=profile.cores,
        each=profile.shards_per_task,
        tasks=shlex.quote(str(folder / "tasks")),
    )
    array = f"1-{len(groups)}" + (f"%{profile.concurrent}" if profile.concurrent else "")
    # After the profile's own options, because the last one of a kind wins.
    ours = [f"--array={array}", f"--chdir={os.getcwd()}", f"--output={folder}/%a.out", "--open-mode=append"]
    batch.job = submit_job(batch.name, ["--requeue", *options, *ours], script, profile)
    record.save()


# --- what became of a task ------------------------------------------------------------------------------------------


def with_more(task: Task, cause: str, profile: Profile) -> bool:
    """Change what a task asks for according to why it ended; return whether to run it again."""
    if task.runs > profile.retries or cause == "error":
        return False
    before = (task.memory_mb, task.minutes)
    if cause == "memory":
        task.memory_mb = profile.more_memory(task.memory_mb)
    if cause == "time":
        task.minutes = profile.more_time(task.minutes)
    return cause in ("node", "unknown") or (task.memory_mb, task.minutes) != before


def by_task(found: list[Element]) -> dict[tuple[str, int], Element]:
    """Elements by the name of their array and their index; of several such jobs the one that still runs counts."""
    return {(element.name, element.task): element for element in sorted(found, key=lambda e: not e.over)}


def observe(record: Record, known: dict[tuple[str, int], Element] | None, results: Results) -> list[tuple]:
    """Bring the states of open tasks up to date from result files and from the queue (None: it is silent).

    Returns (task, state, wait status, reason) of those that have ended, or cannot start, with no result in sight.
    """
    ended = []
    for task in record.open_tasks():
        if results.there(task.target):
            task.state, task.reason = "done", ""
            continue
        if known is None:
            continue
        name, _, index = task.where.rpartition("/")
        found = known.get((name, int(index or 0))) or known.get((name, 0))
        state, status, why = (found.state, found.status, found.reason) if found else ("", 0, "")
        if not state or state in FINAL or HELD in why:
            ended.append((task, state, status, why))
        else:
            task.state, task.reason = ("queued", why) if state in WAITING else ("running", "")
    return ended


def judge(record: Record, profile: Profile, ended: list[tuple], gone: dict) -> list[Task]:
    """Find out why tasks ended without a result; mark the failed ones, return those to run again.

    `gone` remembers when each was first seen to have ended: a result may still be on its way through the file
    system's caches, and Slurm may bring a lost task back by itself.
    """
    again, now = [], time.monotonic()
    since = {task.where: gone.get(task.where, now) for task, *_ in ended}
    gone.clear()
    gone.update(since)
    jobs = {batch.name: batch.job for batch in record.batches}
    for task, state, status, why in ended:
        name, _, index = task.where.rpartition("/")
        output = "\n".join(tail(record.folder / name / f"{index}.out", 200))
        cause, task.reason = cause_of(state, status, why, output)
        if cause in ("node", "unknown") and now - since[task.where] < profile.visible_seconds:
            continue
        if HELD in why:
            cancel_jobs([f"{jobs[name]}_{index}"])
        limit = {"memory": f" of {task.memory_mb} MiB", "time": f" of {task.minutes} min"}
        task.reason += limit.get(cause, "")
        if with_more(task, cause, profile):
            print(f"{task.target}: {task.reason}; again with {task.memory_mb} MiB, {task.minutes} min", flush=True)
            again.append(task)
        else:
            task.state = "failed"
    return again


def settle(record: Record, profile: Profile) -> None:
    """Wait until every task of a record is done or failed, running lost ones again; close the record."""
    gone: dict[str, float] = {}
    results, interval, answered, said = Results(), FIRST_POLL_S, time.monotonic(), time.monotonic()
    while record.open_tasks():
        known, answered = ask_queue(record, answered, profile)
        results.look({os.path.dirname(task.target) for task in record.open_tasks()})
        again = judge(record, profile, observe(record, known, results), gone)
        if again:
            resubmit(record, profile, again)
            interval = FIRST_POLL_S
        if record.open_tasks():
            said = show(record, said, silent=known is None)
            pause(interval)
            interval = min(interval * 1.3, profile.poll_seconds)
    record.closed = True
    record.save()


def ask_queue(record: Record, answered: float, profile: Profile) -> tuple[dict | None, float]:
    """Return what Slurm knows of a record's jobs (None while it does not answer) and when it last answered."""
    try:
        found = elements([batch.name for batch in record.open_batches()])
        keep_one(record, found)
        return by_task(found), time.monotonic()
    except SlurmRefused as error:
        if time.monotonic() - answered > profile.silence_seconds:
            raise SlurmRefused(
                f"{error}; the work of {record.stage} stays with Slurm, and the next make awaits it"
            ) from error
        return None, answered


def keep_one(record: Record, found: list[Element]) -> None:
    """Note the job of each array, and cancel others of its name: Slurm may take one after its answer was given up."""
    for batch in record.open_batches():
        jobs = {element.job for element in found if element.name == batch.name}
        if jobs and batch.job not in jobs:
            batch.job = min(jobs, key=int)
        doubled = {e.job for e in found if e.name == batch.name and e.job != batch.job and not e.over}
        if doubled:
            cancel_jobs(sorted(doubled, key=int))


def resubmit(record: Record, profile: Profile, tasks: list[Task]) -> None:
    """Submit tasks again; where Slurm refuses, those it refused have failed and the others go on."""
    before = {id(task): task.where for task in tasks}
    try:
        submit(record, profile, tasks)
    except SlurmRefused as error:
        asked = {batch.name for batch in record.batches if not batch.job}
        try:
            cancel_named(asked)
        except SlurmRefused:
            return  # it may have taken what it did not confirm, and shows it by its name when it answers again
        for task in tasks:
            if task.where == before[id(task)] or task.where.rpartition("/")[0] in asked:
                task.where = before[id(task)]
                task.state, task.reason = "failed", f"{task.reason}, and could not be submitted again: {error}"
        record.save()


def cancel(record: Record) -> None:
    """Cancel what a record has in the queue and forget it; SlurmRefused, and nothing forgotten, where that is not sure."""
    try:
        cancel_named([batch.name for batch in record.batches])
    except SlurmRefused as error:
        goal = Layout(record.results).command("slurm-cancel")
        raise SlurmRefused(
            f"{error}; jobs of {record.stage} may still be on Slurm: the next make awaits them, {goal} cancels them"
        ) from error
    forget(record)


def withdraw(record: Record, refused: SlurmRefused) -> None:
    """Leave nothing behind of a submission that Slurm refused half-way; SlurmRefused tells both where that fails."""
    try:
        cancel(record)
    except SlurmRefused as error:
        raise SlurmRefused(f"{refused}; and {error}") from refused


def forget(record: Record) -> None:
    """Remove a record with its task lists and outputs."""
    record.path.unlink(missing_ok=True)
    shutil.rmtree(record.folder, ignore_errors=True)


# --- what make calls ------------------------------------------------------------------------------------------------


def work(record: Record, profile: Profile, detach: bool, submitting: bool) -> int:
    """Submit a record's tasks (or find them submitted), await them, report; an interrupt cancels or leaves them."""
    try:
        if submitting:
            submit(record, profile, record.tasks)
        settle(record, profile)
    except Interrupted:
        if detach:
            print(f"{record.stage}: left running on Slurm ({counted(record)}); the next make awaits it", flush=True)
        else:
            cancel(record)
            print(f"{record.stage}: interrupted, its Slurm jobs are cancelled", flush=True)
        return 130
    except SlurmRefused as refused:
        if submitting and not record.accepted():
            withdraw(record, refused)
        raise
    code = report(record)
    if not code:
        forget(record)
    return code


def collected(path: Path) -> list[tuple[str, str]]:
    """Targets and commands that make collected, each once; the file is gone afterwards."""
    lines = path.read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
    return list(dict(line.split("\t", 1) for line in lines if line).items())


def start(results: Path, key: str, stage: str, tasks: list[tuple[str, str]], profile: Profile) -> Record:
    """Return a new record of tasks, replacing the closed one of the same name."""
    record = Record(results / ".slurm" / f"{key}.json", stage)
    if record.path.exists() and not load(record.path).closed:
        of = Layout(results)
        raise BadInput(
            f"{record.path}: work of {stage} is on Slurm already, of another make or left running; let that make end, or"
            f" cancel it by {of.command('slurm-cancel')}, then run make again"
        )
    shutil.rmtree(record.folder, ignore_errors=True)
    record.tasks = [Task(target, command, profile.memory_mb, profile.time_minutes) for target, command in tasks]
    return record


def flush(args: argparse.Namespace) -> int:
    """Run what make collected for a stage."""
    path = args.results / ".slurm" / f"{args.stage}.tasks"
    profile = read_profile(args.profile, args.stage)
    record = start(args.results, args.stage, args.stage, collected(path), profile)
    record.save()
    path.unlink()
    return work(record, profile, args.detach, submitting=True)


def run(args: argparse.Namespace) -> int:
    """Run one target by itself: of a stage that makes few files, or a file asked for by its name."""
    inside = args.target.relative_to(args.results)
    stage, key = inside.parts[0], "-".join(inside.parts)
    profile = read_profile(args.profile, stage)
    args.target.unlink(missing_ok=True)
    record = start(args.results, key, stage, [(str(args.target), shlex.join(args.command))], profile)
    return work(record, profile, args.detach, submitting=True)


def attend(args: argparse.Namespace) -> int:
    """Become the only make at work on these results, then await what an earlier one left running."""
    lock = become_only_make(args.results, args.make)
    if lock is None:
        return 0
    # make reads standard output.
    sys.stdout = sys.stderr
    # What a make collected and never submitted, because it was killed, is collected anew.
    for path in (args.results / ".slurm").glob("*.tasks"):
        path.unlink()
    code = 0
    for record in records(args.results):
        if not record.closed:
            print(f"{record.stage}: awaiting what was left running on Slurm ({counted(record)})", flush=True)
            code = work(record, read_profile(args.profile, record.stage), args.detach, submitting=False) or code
    if not code:
        hold(lock, args.make)
    return code


def give_up(args: argparse.Namespace) -> int:
    """Cancel all work of a dataset that was left running."""
    running = [record for record in records(args.results) if not record.closed]
    for record in running:
        cancel(record)
        print(f"{record.stage}: cancelled")
    if not running:
        print(f"{args.results}: nothing was left running on Slurm; name another dataset by DATASET=NAME")
    return 0


def overview(results: Path) -> list[str]:
    """Lines for `make status`: tasks queued, running, done and failed, with the reasons of the failed ones."""
    lines = []
    for record in records(results):
        note = ""
        if not record.closed:
            jobs = [batch.job for batch in record.open_batches() if batch.job]
            note = f" (jobs {', '.join(jobs)})"
            try:
                known = by_task(elements([batch.name for batch in record.open_batches()]))
            except SlurmRefused:
                known, note = None, f"{note[:-1]}; the controller does not answer)"
            seen = Results()
            seen.look({os.path.dirname(task.target) for task in record.open_tasks()})
            # Looking only: what ended without a result is judged by the make that awaits it.
            observe(record, known, seen)
        lines.append(f"{'slurm ' + record.path.stem:20s} {counted(record)}{note}")
        failed = [task for task in record.tasks if task.state == "failed"]
        lines += [f"           {task.target}: {task.reason}" for task in failed[:20]]
        lines += [f"           … and {len(failed) - 20} more"] if len(failed) > 20 else []
    return lines


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="gelforge.flow.slurm.run", description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=["attend", "flush", "run", "cancel"])
    parser.add_argument("--results", type=Path, required=True, help="results/DATASET")
    parser.add_argument("--profile", type=Path, default=PUBLISHED)
    parser.add_argument("--stage", default="", help="flush: the stage whose tasks make collected")
    parser.add_argument("--make", type=int, default=0, help="attend: process id of make")
    parser.add_argument("--detach", action="store_true", help="an interrupt leaves work running")
    parser.add_argument("--target", type=Path, help="run: what the command after -- makes")
    argv = sys.argv[1:] if argv is None else list(argv)
    split = argv.index("--") if "--" in argv else len(argv)
    args = parser.parse_args(argv[:split])
    args.command = argv[split + 1 :]
    # A make that is killed ends this too, and so what it submitted.
    die_with_parent()
    if args.action == "attend":
        return attend(args)
    if args.action == "cancel":
        return give_up(args)
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP)
    with at_work(args.results):
        return {"flush": flush, "run": run}[args.action](args)


if __name__ == "__main__":
    from gelforge.flow.main import exit_with

    exit_with(main)
