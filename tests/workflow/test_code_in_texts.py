"""Code of README and guide runs as it stands, and what it tells people to type exists."""

import importlib
import re
import textwrap

import numpy as np
import pytest

from gelforge.commands import gelforge as commands
from gelforge.reading.markers import markers_in
from gelforge.reading.model import load_model
from gelforge.reading.profile import Gain, make_profile, write_profile
from gelforge.records.image import read_image
from tests.support.pressed_dataset import label, write_pressed
from tests.support.recordings import filmed, ramp, write

TEXTS = ["README.md", "workflow/guide/first-sensor.md", "workflow/guide/recordings.md", "workflow/guide/your-data.md"]


def blocks(path):
    """Python blocks of a text."""
    return [textwrap.dedent(found) for found in re.findall(r"^ *```python\n(.*?)```", path.read_text(), re.S | re.M)]


@pytest.fixture
def given(root, tmp_path, monkeypatch):
    """What the texts assume: a pair of images, and a profile, a recording and labels in the folder that code runs in."""
    image, nocontact = (
        read_image(root / "data/demo" / name) for name in ("images/demo-000000.png", "nocontact/mini_a.png")
    )
    profile = make_profile("mine", nocontact, markers_in(nocontact).pitch, Gain(), load_model(None).metadata)
    write_profile(tmp_path / "mine.toml", profile)
    write(tmp_path / "one.mcap", filmed([0.0, 0.5], lambda k: 0.0), ramp())
    folder = label(write_pressed(tmp_path / "made", count=8), "24x32")
    (tmp_path / "results/mylab/50_labels").mkdir(parents=True)
    folder.rename(tmp_path / "results/mylab/50_labels/24x32")
    monkeypatch.chdir(tmp_path)
    return {"image": image, "nocontact": nocontact, "images": [nocontact, image]}


@pytest.mark.parametrize("name", TEXTS)
def test_python_code_runs(root, given, capsys, name):
    for code in blocks(root / name):
        names = dict(given)
        exec(code, names)
        said = capsys.readouterr().out
        assert said.strip()
        if "read" in names:
            assert names["found"].total[2] < 0.0 and not names["found"].flag
        if "labels" in names:
            assert np.isfinite(names["labels"]["label"]).all() and "s000" in said


def test_no_other_text_has_python_code(root):
    pages = [root / "README.md", *(root / "workflow/guide").glob("*.md")]
    assert sorted(str(path.relative_to(root)) for path in pages if blocks(path)) == sorted(TEXTS)


def test_what_people_are_told_to_type_exists(root, capsys):
    """Goals of make, and commands of gelforge with their options, in code of all texts."""
    rules = "".join(path.read_text() for path in [root / "Makefile", *(root / "rules").glob("*.mk")])
    goals = {name for line in re.findall(r"^\.PHONY: (.*)$", rules, re.M) for name in line.split()}
    choices = set(re.search(r"^CHOICES := ((?:.*\\\n)*.*)$", rules, re.M)[1].replace("\\", "").split())
    helped = {}
    for path in [root / "README.md", root / "CONTRIBUTING.md", *(root / "workflow").rglob("*.md")]:
        fenced = r"^ *```\w*\n(.*?)```"
        within = re.findall(r"`([^`]+)`", re.sub(fenced, "", path.read_text(), flags=re.S | re.M))
        code = "\n".join(
            [*re.findall(fenced, path.read_text(), re.S | re.M), *(" ".join(each.split()) for each in within)]
        )
        for line in re.sub(r"\s*\\\n\s*", " ", code).splitlines():
            words = re.sub(r'"[^"]*"', "x", line.split("#")[0]).split()
            if words[:1] == ["make"]:
                chosen = [word.split("=")[0] for word in words[1:] if "=" in word]
                asked = [word for word in words[1:] if word.isascii() and re.fullmatch(r"[a-z][a-z-]*", word)]
                assert set(chosen) <= choices, (path, line)
                assert all(goal in goals or goal.startswith(("clean-", "benchmark-")) for goal in asked), (path, line)
            elif words and words[0].endswith("gelforge") and words[1:2] and words[1].isalpha():
                home = commands.HOMES.get(words[1], f"gelforge.commands.{words[1]}")
                if words[1] not in helped:
                    assert words[1] in commands.COMMANDS, (path, line)
                    with pytest.raises(SystemExit):
                        importlib.import_module(home).main(["-h"])
                    helped[words[1]] = capsys.readouterr().out
                options = [word for word in words[2:] if word.startswith("--")]
                assert all(option in helped[words[1]] for option in options), (path, line)
    assert {"predict", "live", "sensor", "solve", "align"} <= helped.keys()
