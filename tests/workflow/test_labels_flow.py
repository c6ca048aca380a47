"""Labels through real make: any resolution by itself, several at once, nothing upstream again."""

import os
import re
import shutil

import numpy as np
import pytest

from gelforge.flow.files import write_json
from gelforge.records.labelfile import read_labels
from tests.support.pressed_dataset import write_pressed
from tests.support.sandbox import link_project, make

# The images are noise, of which nothing can be told.
UNJUDGED = '[params.poses]\njudge_images = false\n[params.fea]\nmethod = "draft"\n'
DATASET = f'sensor = "mini_a"\ngel = "gelsight_mini"\ncatalogue = "indenters.toml"\n{UNJUDGED}'


@pytest.fixture(scope="module")
def pressed(root, tmp_path_factory):
    """A sandbox whose stages up to 40 are done, which tests copy and leave as it is."""
    project = link_project(root, tmp_path_factory.mktemp("labels") / "project")
    made = write_pressed(project, count=16)
    (made["data"] / "dataset.toml").write_text(DATASET)
    (made["results"] / "30_fea").mkdir()
    write_json(made["results"] / "15_images/images.json", {"left_out": {}})
    run(project, "-t", "forces")
    return project


def copy(project, folder):
    """A copy of a sandbox, of which nothing is outdated."""
    return shutil.copytree(project, folder / "project", symlinks=True)


@pytest.fixture(scope="module")
def made(pressed, tmp_path_factory):
    """That sandbox with labels of two resolutions, which tests copy and leave as it is."""
    project = copy(pressed, tmp_path_factory.mktemp("made"))
    assert built(run(project, "labels", "RES=4x4 6x8")) == of_shards("4x4") | of_shards("6x8")
    return project


def of_shards(resolution):
    """Targets of stage 50."""
    return {f"results/made/50_labels/{resolution}/{shard}.npz" for shard in ("0000", "0001")}


@pytest.fixture(scope="module")
def exported(made, tmp_path_factory):
    """That with a dataset and its export, and another dataset that is made of the export."""
    project = copy(made, tmp_path_factory.mktemp("exported"))
    assert built(run(project, "feats-export", "RES=4x4")) == {
        f"results/made/{name}" for name in ("60_dataset/4x4/dataset.json", "feats/4x4/normalization_gelforge.npy")
    }
    back = make(project, "DATASET=back", "feats-import", "FROM=results/made/feats/4x4")
    assert back.returncode == 0 and "16 presses" in back.stdout, back.stdout
    with (project / "data/back/dataset.toml").open("a") as settings:
        settings.write(UNJUDGED)
    return project


@pytest.fixture
def labelled(made, tmp_path):
    """A copy of the sandbox with labels."""
    return copy(made, tmp_path)


@pytest.fixture
def folder(exported, tmp_path):
    """A copy of the sandbox with a dataset and its export."""
    return copy(exported, tmp_path)


def run(project, *arguments) -> str:
    done = make(project, "DATASET=made", *arguments)
    assert done.returncode == 0, done.stdout
    return done.stdout


def built(text) -> set[str]:
    """Targets that make reported as made, but plans."""
    return set(re.findall(r"^(results/(?!\w+/00_plan)\S+)  [0-9.]+ s", text, re.MULTILINE))


def test_resolutions_are_built_beside_each_other(labelled):
    assert built(run(labelled, "labels", "RES=6x8 12x16")) == of_shards("12x16")
    assert not built(run(labelled, "labels", "RES=4x4 6x8 12x16"))
    for name in ("6x8", "12x16"):
        rows, cols = map(int, name.split("x"))
        for target in of_shards(name):
            assert read_labels(labelled / target).label.shape == (8, 3, rows, cols)


@pytest.mark.slow
def test_pictures_and_a_dataset_of_the_export_follow(folder):
    run(folder, "look", "ID=s003", "RES=4x4")
    assert (folder / "results/made/look/s003.vtu").stat().st_size > 1000
    assert "results/back/60_dataset/4x4/dataset.json" in built(
        make(folder, "DATASET=back", "dataset", "RES=4x4").stdout
    )


@pytest.mark.slow
def test_a_dataset_follows_what_lies_beside_its_log(folder):
    """A split or a picture that comes, goes, or is replaced by an older one makes the dataset anew, nothing else does."""
    target, data = {"results/made/60_dataset/4x4/dataset.json"}, folder / "data/made"
    judged = target | {"results/made/15_images/images.json"}
    assert not built(run(folder, "dataset", "RES=4x4"))
    splits = data / "splits.csv"
    splits.write_text(
        "sample_id,split\n" + "".join(f"s{k:03d},{('train', 'val', 'test')[k % 3]}\n" for k in range(16))
    )
    assert built(run(folder, "dataset", "RES=4x4")) == target
    splits.unlink()  # which the next make finds, beside a picture that came
    nocontact = data / "nocontact/mini_a.png"
    nocontact.parent.mkdir(exist_ok=True)
    shutil.copy(data / "images/s000.png", nocontact)
    assert built(run(folder, "dataset", "RES=4x4")) == judged and not built(run(folder, "dataset", "RES=4x4"))
    shutil.move(nocontact.parent, data / "elsewhere")
    nocontact.parent.symlink_to("elsewhere")
    shutil.copy(data / "images/s001.png", nocontact)
    assert built(run(folder, "dataset", "RES=4x4")) == judged and not built(run(folder, "dataset", "RES=4x4"))


def test_a_dataset_follows_labels_that_are_imported(folder):
    """They come, others take their place, and they go: the dataset is made anew of what there is."""
    target, labels = {"results/made/60_dataset/4x4/dataset.json"}, folder / "data/made/labels/4x4.npz"
    come = folder / "data/back/labels/4x4.npz"
    os.utime(come, (1e9, 1e9))
    labels.parent.mkdir()
    shutil.copy2(come, labels)
    assert built(run(folder, "dataset", "RES=4x4")) == target and not built(run(folder, "dataset", "RES=4x4"))
    with np.load(labels) as held:
        other = {name: held[name] for name in held} | {"label": -held["label"]}
    np.savez(labels, **other)
    assert built(run(folder, "dataset", "RES=4x4")) == target and not built(run(folder, "dataset", "RES=4x4"))
    shutil.rmtree(labels.parent)
    assert built(run(folder, "dataset", "RES=4x4")) == target and not built(run(folder, "dataset", "RES=4x4"))


def test_a_dataset_of_imported_labels_follows_its_presses(folder):
    """Rows with their indenters and forces, pictures, files beside the log and bodies, as the plan has them; no path of stage 10."""
    words, plan = ("DATASET=back", "dataset", "RES=4x4"), "results/back/00_plan/"
    assert make(folder, *words).returncode == 0
    presses = ("shards/0000.csv", "shards/0000.pictures.json", "beside/rows.json", "params/indenters.json")
    for changed in (*presses, "shards/0000.json"):
        said = make(folder, "-n", "-W", plan + changed, *words).stdout
        assert ("flow.step results/back/60_dataset/" in said) == (changed in presses), said


def test_resolutions_made_side_by_side_share_their_pictures(labelled):
    names = ("4x4", "6x8")
    run(labelled, "dataset", f"RES={' '.join(names)}", "-j2")
    files = [labelled / f"results/made/60_dataset/{name}/images.npy" for name in names]
    assert len({path.stat().st_ino for path in files}) == 1 and files[0].stat().st_nlink == 3  # and the shared name


def test_a_bad_resolution_fails_and_leaves_nothing(made):
    done = make(made, "DATASET=made", "labels", "RES=24by32")
    assert done.returncode != 0 and "RES=24by32: give resolutions as ROWSxCOLUMNS" in done.stdout
    assert not (made / "results/made/50_labels/24by32").exists()


def test_a_setting_that_changes_labels_changes_every_shard(labelled):
    """Shards that were there are not taken for those of the new setting."""
    shards = [labelled / f"results/made/50_labels/6x8/000{k}.npz" for k in (0, 1)]
    old = [shard.read_bytes() for shard in shards]
    params = labelled / "workflow/params.toml"
    params.write_text(params.read_text().replace('channels = ["force"]', 'channels = ["force", "traction"]'))
    run(labelled, "labels", "RES=6x8")
    assert all(shard.read_bytes() != was for shard, was in zip(shards, old, strict=True))
