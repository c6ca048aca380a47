"""Data that come and go: FEATS' dataset, a film to Foxglove; figures of benchmark-face."""

import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import cv2

from tests.support.feats_published import DEMO, publish
from tests.support.figures import Figure
from tests.support.foxglove_client import FoxgloveClient
from tests.support.hub_server import hub
from tests.support.waiting import HANG, wait_until

SAMPLES, PUBLISHED = 1000, 14_279
FRAMES = 250  # ten seconds of a film
RATE = 25


def fetching(folder: Path, *options) -> list[str]:
    """The command that fetches into a folder."""
    return [sys.executable, "-m", "gelforge.commands.feats", "fetch", "--downloads", str(folder / "loaded"),
            "--data", str(folder / "data"), *map(str, options)]  # fmt: skip


def run(command: list[str], url: str, home: Path) -> tuple[float, float, float]:
    """Seconds by the clock, seconds of processors and peak memory in MiB of a command."""
    started, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-c", PEAK, *command]
    environment = os.environ | {"HF_ENDPOINT": url, "HF_HOME": str(home), "HF_HUB_DOWNLOAD_TIMEOUT": "60"}
    said = subprocess.run(words, check=True, capture_output=True, text=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - started, spent, int(said.stderr.split()[-1]) / 1024


# A parent of its own, so that the peak is of this command alone.
PEAK = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, file=sys.stderr)
"""


def time_fetch(folder: Path, presses: int) -> list[Figure]:
    """Fetch 1000 samples (fewer where `presses` are) from a local server, killed once; import copies of two sizes for the memory of all."""
    samples = min(SAMPLES, presses)
    few, home = samples // 4, folder / "hub"
    publish(folder / "published", samples)
    with hub(folder / "published") as server:
        server.commit()  # digests are the hub's work
        seconds, spent, peak = run(fetching(folder / "whole"), server.url, home)
        child = subprocess.Popen(fetching(folder / "killed"), stderr=subprocess.DEVNULL,
                                 env=os.environ | {"HF_ENDPOINT": server.url, "HF_HOME": str(home)})  # fmt: skip
        wait_until(lambda: len(list((folder / "killed").rglob("*.npy"))) > samples // 3, of=child)
        child.send_signal(signal.SIGKILL)
        child.wait()
        loaded = folder / "killed" / "loaded"
        there = [str(path.relative_to(loaded)) for path in loaded.rglob("*.npy")]
        server.loaded.clear()
        run(fetching(folder / "killed"), server.url, home)
        twice = len(server.loaded.keys() & set(there))
    publish(folder / "few", few)
    _, _, small = run(fetching(folder / "small", "--from", folder / "few"), "", home)
    copied, _, large = run(fetching(folder / "copy", "--from", folder / "published"), "", home)
    all_of_it = (large + (large - small) / (samples - few) * (PUBLISHED - samples)) / 1024
    note = f"from a local server; {spent:.0f} s of processors, peak {peak:.0f} MiB"
    return [
        Figure(f"fetch of {samples} samples", seconds, "<=", 60.0, "s", note),
        Figure(f"import of a folder of {samples} samples", copied, "<=", 60.0, "s"),
        Figure("complete files that are downloaded again after a kill", twice, "==", 0, "", f"of {len(there)}; partial files start again"),
        Figure(f"memory of {PUBLISHED} samples", all_of_it, "<=", 4.0, "GiB", f"from {small:.0f} MiB of {few} and {large:.0f} MiB of {samples}"),
    ]  # fmt: skip


def film(path: Path, frames: int) -> None:
    """Pictures of the demo, a gel at rest first."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), RATE, (320, 240))
    still = cv2.imread(str(DEMO.parent / "nocontact" / "mini_a.png"))
    pictures = [cv2.imread(str(DEMO / f"demo-{k:06d}.png")) for k in range(6)]
    for k in range(frames):
        writer.write(still if k < 16 else pictures[k // 10 % 6])
    writer.release()


def time_live(folder: Path, presses: int) -> list[Figure]:
    """Serve a film to a client that decodes all of it, of at most as many frames as presses."""
    frames = max(48, min(FRAMES, presses))  # the gel without contact is found among the first
    film(folder / "film.avi", frames)
    command = [
        "taskset",
        "-c",
        "0",
        sys.executable,
        "-m",
        "gelforge.commands.live",
        "--video",
        str(folder / "film.avi"),
    ]
    child = subprocess.Popen([*command, "--foxglove", "--port", "0", "--record", str(folder / "kept")],
                             stderr=subprocess.PIPE, text=True)  # fmt: skip
    address = next(found[0] for line in child.stderr if (found := re.search(r"ws://\S+", line)))
    client = FoxgloveClient(address, HANG)
    heard: list[tuple[int, float]] = []

    def hear() -> None:
        for topic, _, said in client.messages():
            if topic.endswith("/flag"):
                heard.append((int(said.status[0].values[0].value), time.perf_counter()))

    hearing = threading.Thread(target=hear)
    hearing.start()
    wait_until(lambda: any("ended after" in said for said in client.status), of=child)
    child.send_signal(signal.SIGINT)
    child.communicate(timeout=HANG)
    hearing.join(HANG)
    numbers = [number for number, _ in heard]
    lost = frames - numbers[0] - len(set(numbers))
    rate = (len(heard) - 1) / (heard[-1][1] - heard[0][1])
    spent = [
        cpu_of([*command, "--record", str(folder / "kept"), "--frames", str(count)])
        for count in (frames // 2, frames)
    ]
    each = 1e3 * (spent[1] - spent[0]) / (frames - frames // 2)
    return [
        Figure("frames that a Foxglove client lost", lost, "==", 0, "", f"of {frames} of a film, the client joined at frame {numbers[0]}"),
        Figure("frames a second at the client, one core", rate, ">=", 0.98 * RATE, "1/s", "by the clock; the film has 25"),
        Figure("processor time of a frame, read and encoded", each, "<=", 1e3 / RATE, "ms", "start-up is not in it"),
    ]  # fmt: skip


def cpu_of(command: list[str]) -> float:
    """Seconds of processors of a command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
