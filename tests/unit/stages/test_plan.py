"""Shards: every sample has one, keeps it, and appending changes the last one only."""

import shutil
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelforge.commands.sample import find_rows
from gelforge.errors import BadInput
from gelforge.evidence.settings import check_pictures
from gelforge.flow import params as config
from gelforge.flow.files import read_csv, read_json, states_of, write_if_changed, write_text
from gelforge.flow.layout import Layout
from gelforge.flow.tables import ENOUGH_PRESSES
from gelforge.geometry.gel import GELS
from gelforge.records.log import read_shard
from gelforge.records.press import RawRow
from gelforge.stages import plan
from gelforge.stages.plan import (
    assign_shards,
    digests,
    inside,
    logged_rows,
    networks,
    pressed,
    reported_model,
    room,
    write_shards,
)
from tests.support.parameters import parameters, place_workflow
from tests.support.refused import refused

NAMES = st.lists(st.integers(0, 200).map(str), unique=True, max_size=60)


@given(NAMES, NAMES, st.integers(1, 9))
def test_a_sample_keeps_its_shard_when_the_log_grows(first, second, size):
    before = assign_shards(first, {}, size)
    after = assign_shards(first + second, before, size)
    assert {name: after[name] for name in first} == before
    assert set(after) == set(first) | set(second)


@given(NAMES, st.integers(1, 9))
def test_shards_hold_at_most_their_size_and_fill_in_order(names, size):
    counts = {}
    for shard in assign_shards(names, {}, size).values():
        counts[shard] = counts.get(shard, 0) + 1
    assert all(count <= room(shard, size) for shard, count in counts.items())
    assert sorted(counts) == list(range(len(counts)))


def sharded(folder, ids):
    """Plan a log of these samples in shards of four; names of the shards, and the time of each one's file."""
    log = folder / "log.csv"
    log.write_text("sample_id,x0_mm\n" + "".join(f"{i},0.5\n" for i in ids), encoding="utf-8")
    of = Layout(folder)
    names = write_shards(of, logged_rows(log, None), 4, {})
    return names, {path.name: path.stat().st_mtime_ns for path in of.shards.glob("*.csv")}


def test_appending_rewrites_only_the_last_shard(tmp_path):
    before = sharded(tmp_path, range(10))[1]
    names, after = sharded(tmp_path, range(13))
    assert names == ["0000", "0001", "0002", "0003"]
    assert [name for name in before if after[name] != before[name]] == ["0002.csv"]


def test_rows_that_go_leave_no_shard_behind_and_find_theirs_again(tmp_path):
    """What was solved of them is still there: a log cut off for one make costs no solve."""
    shards = Layout(tmp_path).shards
    assert sharded(tmp_path, range(10))[0] == ["0000", "0001", "0002"]
    before = {path.name: path.read_text() for path in shards.glob("*.csv")}
    assert sharded(tmp_path, range(4))[0] == ["0000"] and [path.name for path in shards.glob("*.csv")] == ["0000.csv"]
    assert [row["logged"] for row in read_csv(Layout(tmp_path).shard_table)] == ["1"] * 4 + ["0"] * 6
    assert sharded(tmp_path, range(10))[0] == ["0000", "0001", "0002"]
    assert {path.name: path.read_text() for path in shards.glob("*.csv")} == before


def test_a_corrupt_table_of_shards_is_refused_in_a_sentence(tmp_path):
    """Without it samples may come into other shards, and be solved again: nobody but a person may say so."""
    sharded(tmp_path, range(5))
    table = Layout(tmp_path).shard_table
    whole = table.read_text()
    for text in (whole[:-5], "", whole.replace("shard", "sherd")):
        table.write_text(text)
        refused("shards.csv: .*remove it: samples that come into another shard", sharded, tmp_path, range(5))


def test_a_row_without_a_name_is_planned_again_and_again(tmp_path):
    """Stage 10 rejects it and names the cell; what the plan wrote of it the next plan reads."""
    for _ in range(2):
        assert sharded(tmp_path, ["a", "", "b"])[0] == ["0000"]
    assert [row.cells["sample_id"] for row in read_shard(Layout(tmp_path).shard("0000"))] == ["a", "", "b"]


def test_a_frame_alone_goes_through_the_stages_with_its_whole_press(tmp_path):
    """Frames of a press are solved together: alone, one would get other forces than in its dataset."""
    log = tmp_path / "log.csv"
    log.write_text("sample_id,press_id\na,film\nb,\nc,film\nd,\ne,film\n", encoding="utf-8")
    write_shards(Layout(tmp_path), logged_rows(log, None), 4, {})
    reported = {name: [row.cells["sample_id"] for row in find_rows(tmp_path, name)] for name in "abcde"}
    assert reported == {**dict.fromkeys("ace", ["a", "c", "e"]), "b": ["b"], "d": ["d"]}


def test_a_network_that_make_would_miss_is_refused(tmp_path):
    models = tmp_path / "models.toml"
    models.write_text('[grid_8] # small\nkind = "grid"\n')
    assert set(networks(tmp_path)) == {"grid_8"}
    models.write_text('[grid-8]\nkind = "grid"\n')
    refused(r"\[grid-8\].*underscores", networks, tmp_path)


def test_a_log_that_cannot_be_sharded_is_refused(tmp_path):
    log = tmp_path / "log.csv"
    for content, named in (
        (b"", "sample_id"), (b"a,b\n1,2\n", "sample_id"), (b"sample_id,x0_mm\n", "no rows"), (b"sample_id\n\xff\xfe\0", "UTF-8"),
    ):  # fmt: skip
        log.write_bytes(content)
        with pytest.raises(BadInput, match=named):
            write_shards(Layout(tmp_path), logged_rows(log, None), 4, {})


def test_a_misspelt_override_is_refused(tmp_path, root):
    dataset = tmp_path / "dataset.toml"
    dataset.write_text("[params.fea]\nfidelty = 'ccx'\n")
    refused("fidelty", config.load_params, root / "workflow", dataset)


LOG = "sample_id,sensor_id,indenter\ns1,{},sphere_15\ns2,mini_b,sphere_15\n"


@pytest.fixture
def lab(tmp_path):
    """The folder data/lab of a place with the project's workflow."""
    folder = place_workflow(tmp_path) / "data/lab"
    folder.mkdir()
    return folder


def planned(lab, text, sensor="mini_a", ccx="none"):
    """Plan a log of two rows under a dataset.toml; the sensors of the rows as the shard has them."""
    (lab / "dataset.toml").write_text(text)
    (lab / "log.csv").write_text(LOG.format(sensor))
    of = Layout(lab.parents[1] / "results/lab")
    write_text(of.ccx, ccx)
    plan.main([str(of.root)])
    return [row.cells["sensor_id"] for row in read_shard(of.shard("0000"))]


def test_images_of_a_linked_folder_count_and_a_path_that_leads_out_does_not(tmp_path):
    """A folder of images on another disk, as data/X itself may be one."""
    data = tmp_path / "data"
    (tmp_path / "elsewhere/more").mkdir(parents=True)
    data.mkdir()
    for name in ("a.png", "more/b.png", "c.png"):
        (tmp_path / "elsewhere" / name).write_bytes(name.encode())
    (data / "images").symlink_to(tmp_path / "elsewhere")
    (data / "c.png").symlink_to(tmp_path / "elsewhere/c.png")
    good = {"images/a.png", "images/more/b.png"}
    names = good | {"../elsewhere/a.png", "images/../../elsewhere/a.png", str(tmp_path / "elsewhere/a.png"), "c.png"}
    assert inside(data, names).keys() == good
    (data / "c.png").unlink()
    (data / "c.png").write_bytes(b"a copy")
    assert inside(data, names).keys() == good | {"c.png"}


@pytest.mark.parametrize("name", ["mini_a.jpg", "mini_a.PNG", "mini_a.tiff"])
def test_a_no_contact_image_that_nobody_would_read_is_named(lab, name):
    (lab / "nocontact").mkdir()
    (lab / "nocontact" / name).touch()
    refused(rf"nocontact/{name}: .*save it as mini_a\.png", planned, lab, "")
    (lab / "nocontact/mini_a.png").touch()
    planned(lab, "")


def test_what_belongs_to_no_sensor_is_named_while_a_sensor_lacks_its_no_contact_image(lab):
    folder = lab / "nocontact"
    for stray in ("Mini_A.png", "mini-a.png", "mini_a/0001.png", "old/a.png"):
        (folder / stray).parent.mkdir(parents=True)
        (folder / stray).touch()
        refused(rf"nocontact/{stray.split('/')[0]}: .*save one as .*nocontact/mini_a\.png", planned, lab, "")
        planned(lab, "[params.poses]\nimages = false\n")
        shutil.rmtree(folder)
    folder.mkdir()
    for name in ("mini_c.png", "notes.txt"):  # of a sensor that is not in this log; no picture
        (folder / name).touch()
    planned(lab, "")
    (folder / "old").mkdir()
    for name in ("mini_a.png", "mini_b.png"):  # nothing is missing
        (folder / name).touch()
    planned(lab, "")


def test_a_dataset_may_bring_indenters_of_its_own(lab):
    own = lab / "indenters.toml"
    own.write_text('[sphere_15]\nkind = "sphere"\n')
    refused(r"indenters.toml: .*workflow/indenters.toml also defines sphere_15", planned, lab, "")
    own.write_text('[mine]\nkind = "stl"\nfile = "shapes/mine.stl"\n')
    planned(lab, '[params.dataset]\nunseen_indenters = ["mine"]\n')
    bodies = config.read_indenter_tables("workflow", lab, "indenters.toml")
    assert (Path("workflow") / bodies["mine"]["file"]).resolve() == lab / "shapes/mine.stl" and "sphere_15" in bodies
    refused(
        r"workflow/data/own/mine.toml: not found; catalogues lie in .*workflow/; .* go into",
        planned,
        lab,
        'catalogue = "data/own/mine.toml"',
    )


def test_rows_that_name_no_sensor_are_of_the_datasets(lab):
    assert planned(lab, 'sensor = "mini_c"\ngel = "gelsight_mini"\n', "") == ["mini_c", "mini_b"]
    assert planned(lab, 'sensor = "mini_c"\n', "mini_a") == ["mini_a", "mini_b"]
    assert planned(lab, "", "") == ["", "mini_b"]


UNKNOWN = [
    ('sensor = "mini_x"', r"dataset\.toml: sensor: 'mini_x' is unknown; did you mean mini_e\?|sensor: 'mini_x'"),
    ('gel = "digit"', r"dataset\.toml: gel 'digit' is unknown"),
    ('[params.report]\nmodel = "tunedd"', r"dataset\.toml: \[params.report\] model = 'tunedd': choose"),
    ('gel = "soft"', "sensor 'mini_a' of the log has gel 'gelsight_mini'.*dataset.toml: gel has 'soft'"),
    ('[params.dataset]\nunseen_sensors = ["mini_f"]', "unseen_sensors: 'mini_f' is unknown"),
    (
        '[params.dataset]\nunseen_indenters = ["spere_15"]',
        "unseen_indenters: 'spere_15' is unknown; did you mean sphere_15",
    ),
    ('[params.fea]\nmethod = "label"\n[params.train]\nseed = -1', "seed = -1"),
    ('catalogue = "none.toml"', "none.toml: not found"),
    ("[params.poses.mounting_tilt_deg]\nagain = [2.0, 0.0]", "no row of the log is of 'again'; the log names none"),
    ("[params.poses.mounting_tilt_deg]\nagain = [60.0, 0.0]", "from -30 to 30 degrees"),
]


def test_names_that_are_none_are_refused_at_the_plan(lab, monkeypatch):
    monkeypatch.setitem(GELS, "soft", GELS["gelsight_mini"])
    for text, named in UNKNOWN:
        refused(named, planned, lab, text)


def test_a_tilt_of_a_mounting_that_the_log_names_is_planned(lab):
    params = parameters(poses={"mounting_tilt_deg": {"again": [2.0, 0.0]}})
    rows = [RawRow(2, {"sample_id": "a", "mounting": "again"}), RawRow(3, {"sample_id": "b", "mounting": ""})]
    plan.refuse_other_log(params, rows, Path("dataset.toml"), None)
    with pytest.raises(BadInput, match="'again'; did you mean agin"):
        plan.refuse_other_log(params, [RawRow(2, {"mounting": "agin"})], Path("dataset.toml"), None)


def test_sensors_sit_on_gels_of_one_shape_each_of_its_own_thickness(lab, monkeypatch):
    def sensor(gel):
        (lab / "sensors.toml").write_text(
            f'[thin]\ngel = "{gel}"\nimage = [320, 240]\n'
            "projection = [[0.0, -14.0, 160.0], [-14.0, 0.0, 120.0], [0.0, 0.0, 1.0]]\n"
        )

    sensor("gelsight_mini-3.6mm")
    for table in ('[params.fea]\nmethod = "label"\n', 'gel = "gelsight_mini-3.6mm"\n'):
        assert planned(lab, table, "thin") == ["thin", "mini_b"]
    assert planned(lab, '[params.fea]\nmethod = "auto"\n', "thin", ccx="/usr/bin/ccx") == ["thin", "mini_b"]
    monkeypatch.setitem(GELS, "soft", GELS["gelsight_mini"])
    sensor("soft")
    refused("different gels in datasets of their own", planned, lab, "", "thin")


LARGE = """[large]
gel = "gelsight_mini"
image = [640, 480]
projection = [[0.0, -28.0, 320.0], [-28.0, 0.0, 240.0], [0.0, 0.0, 1.0]]
"""


def test_pictures_of_several_sizes_are_refused_before_anything_is_solved(lab):
    (lab / "sensors.toml").write_text(LARGE)
    refused(r"several sizes \(large 640 x 480, mini_b 320 x 240\): make one dataset", planned, lab, "", "large")
    assert planned(lab, "[params.poses]\nimages = false\n", "large") == ["large", "mini_b"]


def test_a_network_that_does_not_read_the_pictures_is_refused_before_anything_is_solved(root):
    """Also one that is fine-tuned from the shipped network."""
    sensors, models = tomllib.loads(LARGE), networks(root / "workflow")
    for model in ("shipped", "tuned"):
        with pytest.raises(BadInput, match=f"{model}.*pictures of 320 x 240, .*large 640 x 480"):
            check_pictures(Path("dataset.toml"), parameters(report={"model": model}), sensors, models)
    for model in ("pair_24", ""):
        check_pictures(Path("dataset.toml"), parameters(report={"model": model}), sensors, models)
    small = {"mini": {"image": [320, 240]}, "broken": {"image": 4}}
    check_pictures(Path("dataset.toml"), parameters(report={"model": "shipped"}), small, models)


def test_a_planned_file_is_written_anew_where_its_bytes_differ_and_there_alone(tmp_path):
    """Cut within a letter it is no text; line endings that a reader of text would turn are bytes too."""
    for text in ("Gerät\n", "a\r\nb\rc\n"):
        path = tmp_path / "slice.json"
        assert write_if_changed(path, text) and not write_if_changed(path, text)
        path.write_bytes("Gerä".encode()[:-1])
        assert write_if_changed(path, text) and path.read_bytes() == text.encode()


def test_without_calculix_presses_are_solved_in_process_unless_a_dataset_asks_for_it(tmp_path):
    """CalculiX is not replaced by other numbers where it was asked for."""
    dataset = tmp_path / "dataset.toml"
    dataset.write_text('[params.fea]\nmethod = "ccx"\n')
    with pytest.raises(BadInput, match=r"'ccx' needs CalculiX.*make setup"):
        plan.without_ccx(config.load_params("workflow", dataset), dataset)
    for text in ("", '[params.fea]\nmethod = "auto"\n', '[params.fea]\nmethod = "label"\n'):
        dataset.write_text(text)
        assert plan.without_ccx(config.load_params("workflow", dataset), dataset).fea.method == "label"


def test_presses_that_show_one_picture_are_planned_as_such(tmp_path):
    """By name and by content, over shards; frames of one press may share theirs."""
    columns = "sample_id,press_id,image"
    pictures = {"a.png": b"1", "b.png": b"2", "copy.png": b"1", "c.png": b"3"}
    for name, content in pictures.items():
        (tmp_path / name).write_bytes(content)
    rows = ["s0,,a.png", "s1,,b.png", "s2,,copy.png", "s3,p,c.png", "s4,p,c.png", "s5,,gone.png", "s6,,gone.png",
            "s7,,a.png"]  # fmt: skip
    log = tmp_path / "log.csv"
    log.write_text("\n".join([columns, *rows]) + "\n")
    of, named = Layout(tmp_path), {name: tmp_path / name for name in pictures}
    write_shards(of, logged_rows(log, None), 3, digests(states_of(named.values(), {}), named))
    found = {name: read_json(of.pictures(name))["repeated"] for name in ("0000", "0001", "0002")}
    assert found["0000"] == {"2": "row 4, s2,", "4": "row 2, s0,"} and found["0001"] == {}
    assert found["0002"] == {"9": "row 2, s0,"}


@pytest.mark.parametrize(
    ("presses", "nocontact", "named", "shown"),
    [
        (41, True, "", ["shipped"]), (ENOUGH_PRESSES, True, "", []), (41, False, "", []), (41, True, "tuned", ["tuned"]),
    ],
)  # fmt: skip
def test_few_presses_are_read_by_the_network_that_ships(tmp_path, presses, nocontact, named, shown):
    """A report trains no network for minutes that nobody asked for; ten frames of a press are one."""
    frames = [RawRow(n, {"press_id": f"p{n // 10}", "image": "a.png"}) for n in range(10 * presses)]
    assert pressed(frames) == pressed(frames + [RawRow(0, {"image": ""})]) == presses
    if nocontact:
        (tmp_path / "nocontact").mkdir()
    params = parameters(report={"model": named})
    assert reported_model(tmp_path / "dataset.toml", params, {"tuned": {}}, presses) == shown


def test_a_calibration_of_another_log_is_refused_and_of_another_dataset_noted(lab, tmp_path, capsys):
    """A folder that was copied as a template: labels were 1.7 times too large. Rows that were added since are no fault."""
    frozen = tmp_path / "calibration.toml"
    text = 'name = "old-1a2b3c"\nlaw = "coulomb"\npresses = ["a", "b", "c"]\n\n[params.material]\nc10 = 0.12\n'
    frozen.write_text(text)
    rows = [RawRow(at, {"sample_id": name, "mounting": ""}) for at, name in enumerate("abd", 2)]
    plan.refuse_other_log(parameters(), rows, Path("dataset.toml"), frozen)
    assert "calibration.toml: was found in dataset 'old', and labels follow it" in capsys.readouterr().out
    frozen.write_text(text.replace("old", tmp_path.name))
    plan.refuse_other_log(parameters(), rows, Path("dataset.toml"), frozen)
    assert capsys.readouterr().out == ""
    said = "calibration.toml: 2 of its 3 presses are not in the log, the first 'b': it was found for another gel or bench"
    refused(said, plan.refuse_other_log, parameters(), rows[:1], Path("dataset.toml"), frozen)
    frozen.write_text(f"{text}[params.poses]\nmounting_touch_offset_mm = {{again = 0.01}}\n")
    refused(
        "calibration.toml: .* no row of the log is of 'again'",
        plan.refuse_other_log,
        parameters(),
        rows,
        Path("dataset.toml"),
        frozen,
    )


def test_names_that_differ_in_case_or_punctuation_are_refused(tmp_path):
    """The second of two mountings `reseated` and `Reseated` had no tilt, which is a third of a flat body's force."""
    plan.refuse_near_names([RawRow(2, {"press_id": "1-11"}), RawRow(3, {"press_id": "11-1"})], tmp_path / "log.csv")
    rows = [RawRow(2, {"press_id": "p_1"}), RawRow(3, {"press_id": "P-1"})]
    refused("column press_id has 'P-1' and 'p_1'", plan.refuse_near_names, rows, tmp_path / "log.csv")
    for column in ("mounting", "gel_id", "sensor_id"):
        rows = [RawRow(2, {column: "reseated"}), RawRow(3, {column: ""}), RawRow(4, {column: "other"})]
        plan.refuse_near_names(rows, tmp_path / "log.csv")
        for name in ("Reseated", "re-seated"):
            refused(
                f"column {column} has .* differ in case",
                plan.refuse_near_names,
                [*rows, RawRow(5, {column: name})],
                tmp_path / "log.csv",
            )


UNITS = {"rot_deg": "", "fz_n": "-3.0", "mx_nm": "", "my_nm": "", "mz_nm": ""}


def test_columns_that_show_another_unit_are_refused(tmp_path):
    """Radians and N mm passed; small turns in degrees, moments about a distant origin and empty cells do."""

    def judge(**columns):
        count = len(next(iter(columns.values())))
        cells = [UNITS | {name: str(of[k]) for name, of in columns.items()} for k in range(count)]
        plan.refuse_other_units([RawRow(k, one) for k, one in enumerate(cells, 2)], tmp_path / "log.csv")

    for turns in ((0, 0.7854, 1.5708, 3.1416), (-1.571, 0.524, 1.047), (0.26179939, 0.52359878, 6.28318531)):
        refused("log.csv: column rot_deg holds only multiples of 5 degrees in radians", judge, rot_deg=turns)
    for turns in (
        (0, 0, 0),
        (0, 45, 90, 180),
        (0.5, 1.0, 1.5, 2.0),
        (0, 0.7854, 1.5708, 3.0),
        (0.1, 0.35, 1.57, 3.14),
        (1.5708, ""),
    ):
        judge(rot_deg=turns)
    for moments in ((12.0, -7.5, 9.0), (1.5, 2.0, 0.9)):
        refused("moments over forces are .* m, longer than any such bench: .*N mm; write N m", judge, my_nm=moments)
    for moments in ((0.012, -0.0075, 0.009), (0.3, 0.31, 0.29), ("", 12.0, ""), (0, 0, 0)):
        judge(my_nm=moments)
    judge(my_nm=(1.5, 2.0, 0.9), fz_n=("", "", ""))
