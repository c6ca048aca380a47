"""FEATS' published dataset from a server that speaks the hub's protocol: the hub's own library is the client."""

import os
import shutil
import signal
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from gelforge.flow.files import read_csv
from gelforge.formats.feats_folder import import_folder, split_of
from gelforge.formats.featsfile import LabelSample, read_sample, write_label
from gelforge.labelling.sensor import load_sensors
from gelforge.records.image import read_image
from gelforge.records.labelfile import read_labels
from gelforge.records.samplefile import SPLITS
from tests.support.feats_published import publish
from tests.support.hub_server import hub
from tests.support.waiting import HANG, wait_until

pytestmark = pytest.mark.processes

COUNT = 20


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    """The dataset as the hub holds it, below a folder of its own as some repositories have it."""
    folder = tmp_path_factory.mktemp("published")
    publish(folder / "labels", COUNT)
    (folder / "README.md").write_text("a card")
    return folder


def words(folder, *options):
    return [sys.executable, "-m", "gelforge.commands.feats", "fetch", "--downloads", str(folder / "loaded"),
            "--data", str(folder / "data"), *map(str, options)]  # fmt: skip


def environment(folder, url):
    return os.environ | {"HF_ENDPOINT": url, "HF_HOME": str(folder / "hub"), "HF_HUB_DOWNLOAD_TIMEOUT": "60"}


def fetch(root, folder, url, *options, limit_kib=None):
    """What the command says, run for a server."""
    command = words(folder, *options)
    if limit_kib:
        command = ["bash", "-c", f'ulimit -f {limit_kib}; exec "$@"', "limited", sys.executable, "-B", *command[1:]]
    ran = subprocess.run(
        command, cwd=root, env=environment(folder, url), capture_output=True, text=True, timeout=HANG
    )
    assert "Traceback" not in ran.stderr, ran.stderr
    return ran


def refused(ran, folder, *said):
    """Assert that it failed in one sentence, and left no dataset."""
    (sentence,) = [line for line in ran.stderr.splitlines() if line.startswith("error: ")]
    assert ran.returncode == 2 and all(word in sentence for word in said), sentence
    assert not (folder / "data").exists()
    return sentence


def test_what_is_published_becomes_a_dataset_with_its_splits(root, tmp_path, published):
    with hub(published) as server:
        ran = fetch(root, tmp_path, server.url)
        assert ran.returncode == 0 and f"{COUNT} presses" in ran.stdout, ran.stderr
        assert set(server.loaded.values()) == {1} and "README.md" not in server.loaded
        again = fetch(root, tmp_path, server.url)
        assert again.returncode == 2 and "exists already; remove it" in again.stderr
        # with the dataset removed: what changed here and what changed there comes again, and nothing else
        shutil.rmtree(tmp_path / "data")
        mine, theirs = sorted((tmp_path / "loaded/labels/train").iterdir())[:2]
        mine.unlink()
        kept = published / theirs.relative_to(tmp_path / "loaded")
        before = kept.read_bytes()
        sample = read_sample(kept)
        write_label(kept, LabelSample(sample.image, 2 * sample.label))
        try:
            assert fetch(root, tmp_path, server.url).returncode == 0
        finally:
            kept.write_bytes(before)
    assert server.loaded.total() == COUNT + 2
    splits = {row["sample_id"]: row["split"] for row in read_csv(tmp_path / "data/splits.csv")}
    assert sorted(set(splits.values())) == sorted(SPLITS[:5]) and len(splits) == COUNT
    sensors = {row["sample_id"]: row["sensor_id"] for row in read_csv(tmp_path / "data/log.csv")}
    assert {splits[name] for name, sensor in sensors.items() if sensor == "feats_mini_2"} == {"test_unseen_sensor"}
    still = read_sample(sorted((published / "labels/train").iterdir())[0])  # the one without contact
    assert not still.label.any()
    assert np.array_equal(read_image(tmp_path / "data/nocontact/feats_mini.png"), still.image)
    assert "branches = []" in (tmp_path / "data/dataset.toml").read_text()  # no pose and no reading is known
    labels = read_labels(tmp_path / "data/labels/24x32.npz")
    assert labels.label.shape == (COUNT, 3, 24, 32)


@pytest.mark.slow
def test_a_fetch_that_was_killed_goes_on(root, tmp_path, published):
    with hub(published) as server:
        server.pace_s = 0.05
        child = subprocess.Popen(
            words(tmp_path),
            cwd=root,
            env=environment(tmp_path, server.url),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        files = tmp_path / "loaded/labels"
        wait_until(lambda: len(list(files.rglob("*.npy"))) >= 4, of=child)
        child.send_signal(signal.SIGKILL)
        child.communicate()
        there = {str(path.relative_to(tmp_path / "loaded")) for path in files.rglob("*.npy")}
        assert 4 <= len(there) < COUNT and not (tmp_path / "data").exists()
        refused(
            fetch(root, tmp_path, "http://127.0.0.1:1"), tmp_path, "check the connection"
        )  # not content with a part
        server.pace_s = 0.0
        server.loaded.clear()
        ran = fetch(root, tmp_path, server.url)
        assert ran.returncode == 0, ran.stderr
        assert server.loaded.keys().isdisjoint(there) and len(server.loaded) == COUNT - len(there)


@pytest.mark.slow
def test_single_splits_come_alone_and_one_that_is_none_is_named(root, tmp_path, published):
    with hub(published) as server:
        sentence = refused(
            fetch(root, tmp_path, server.url, "--split", "train exam"), tmp_path, "SPLIT=exam", "no such"
        )
        assert not server.loaded and "test, test_unseen_indenter, test_unseen_sensor, train, val" in sentence
        ran = fetch(root, tmp_path, server.url, "--split", "train val")
    assert ran.returncode == 0 and {name.split("/")[1] for name in server.loaded} == {"train", "val"}


class Page(BaseHTTPRequestHandler):
    """A proxy that answers everything with a page to sign in."""

    def do_GET(self) -> None:
        content = b"<!DOCTYPE html><html><body>Sign in to the network</body></html>"
        self.send_response(200)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_) -> None:
        """No request is logged."""


def test_a_proxy_that_answers_with_a_page_is_one_sentence(root, tmp_path):
    with ThreadingHTTPServer(("127.0.0.1", 0), Page) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_address[1]}"
        refused(fetch(root, tmp_path, url), tmp_path, url, "any proxy", "FROM=folder")
        server.shutdown()


def test_a_full_disk_keeps_what_was_loaded(root, tmp_path, published):
    """The shell's limit on the size of a file stands for the disk: no sample fits it."""
    with hub(published) as server:
        ran = fetch(root, tmp_path, server.url, limit_kib=100)
    refused(ran, tmp_path, "File too large", "free space")


def test_a_copy_is_imported_without_the_hub(root, tmp_path, published):
    ran = fetch(root, tmp_path, "http://127.0.0.1:1", "--from", published / "labels", "--split", "train val")
    assert ran.returncode == 0 and {row["split"] for row in read_csv(tmp_path / "data/splits.csv")} == {
        "train",
        "val",
    }
    gone = fetch(root, tmp_path / "b", "http://127.0.0.1:1", "--from", published / "labels", "--split", "exam")
    refused(gone, tmp_path / "b", "SPLIT=exam", "has no such folder", "train")
    refused(
        fetch(root, tmp_path / "b", "http://127.0.0.1:1", "--from", published / "x"), tmp_path / "b", "not a folder"
    )


def test_folders_stand_for_splits():
    stands = {
        "train": "train", "Validation": "val", "test-unseen-indenters": "test_unseen_indenter",
        "unknown_sensor": "test_unseen_sensor", "labels": "", "raw": "",
    }  # fmt: skip
    assert {folder: split_of(folder) for folder in stands} == stands


def test_without_a_still_picture_the_median_of_gentle_ones_is_made(root, tmp_path, monkeypatch):
    monkeypatch.chdir(root)
    rng = np.random.default_rng(1)
    gel = rng.integers(60, 200, (240, 320, 3), np.uint8)
    for k in range(20):
        image = gel.copy()
        image[12 * k : 12 * k + 12] = 255  # each touches another place
        write_label(tmp_path / f"in/train/p{k}.npy", LabelSample(image, np.full((3, 4, 5), -0.01 * (k + 1))))
    import_folder(tmp_path / "in", tmp_path / "out", load_sensors("workflow/sensors.toml")["feats_mini"])
    assert np.array_equal(read_image(tmp_path / "out/nocontact/feats_mini.png"), gel)
