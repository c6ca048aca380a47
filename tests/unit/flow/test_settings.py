"""Settings of a dataset: what has no meaning is refused in a sentence that names table, key, value, hint and file."""

import json
from dataclasses import fields
from functools import cache
from typing import Any, Literal, get_args, get_origin

import pytest

from gelforge.errors import BadInput
from gelforge.flow import tables as t
from gelforge.flow.files import canonical
from gelforge.flow.layout import STAGES
from gelforge.flow.params import (
    laid_over,
    load_params,
    parameters_of,
    plain,
    read_dataset_file,
    read_parameters,
    read_toml,
)
from gelforge.flow.schema import Number, ParameterTable, Place, Within, kinds_of, parse, split
from gelforge.mechanics.hexsettings import QUALITIES
from tests.support.parameters import parameters
from tests.support.refused import refused


def load(root, tmp_path, text):
    path = tmp_path / "dataset.toml"
    path.write_text(text, encoding="utf-8")
    return load_params(root / "workflow", path)


@cache
def raw(root):
    return read_toml(root / "workflow" / "params.toml")


def test_the_schema_and_params_toml_hold_the_same_keys(root):
    """Both name the same keys, and there is no second default: every key stands in params.toml but those that may be left out."""

    def compare(kind, table, name):
        known = kinds_of(kind)
        assert not table.keys() - known.keys(), name
        for key, hint in known.items():
            may_miss = type(None) in get_args(hint)
            assert key in table or may_miss, f"{name}.{key}"
            inner = split(hint)[0]
            if key in table and isinstance(inner, type) and issubclass(inner, ParameterTable):
                compare(inner, table[key], f"{name}.{key}")

    compare(t.Params, raw(root), "params")


def test_a_value_is_kept_digit_for_digit(root):
    """Keys of solves are digests of what stages are given: it is what the file holds, whole numbers whole."""
    assert canonical(plain(load_params(root / "workflow"))) == canonical(raw(root))
    odd = parameters(material={"nu": 0}, interface={"mu": 2}, poses={"touch_offset_mm": 1e-2})
    assert canonical(plain(parameters_of(odd, "fea", 7))) == canonical(
        {
            "version": 7,
            "fea": raw(root)["fea"],
            "interface": raw(root)["interface"] | {"mu": 2},
            "material": {"nu": 0},
        }
    )


def test_parameters_of_a_stage_read_back_as_they_were(tmp_path):
    for stage in STAGES:
        made = parameters_of(parameters(), stage, 3)
        path = tmp_path / f"{stage}.json"
        path.write_text(canonical(plain(made)))
        assert plain(read_parameters(path)) == plain(made)
        path.write_text(json.dumps(plain(made) | {"more": 1}))
        refused(r"json: cannot be read .*'more'", read_parameters, path)
    path.write_text("{")
    refused(r"json: cannot be read .* run make again", read_parameters, path)


def leaves(kind: type[ParameterTable], path: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], Any]]:
    """Every key of every table with its kind."""
    found = []
    for key, hint in kinds_of(kind).items():
        inner = split(hint)[0]
        if isinstance(inner, type) and issubclass(inner, ParameterTable):
            found += leaves(inner, (*path, key))
        else:
            found.append(((*path, key), hint))
    return found


def meaningless(hint: Any) -> list[Any]:
    """Values that no key of this kind can take."""
    kind, rules = split(hint)
    always: list[Any] = [{"a": 1}] if get_origin(kind) is not dict else [3, "text", []]
    bounds = [value for rule in rules if isinstance(rule, Within)
              for value in (rule.low - 1 - abs(rule.low), rule.high * 2 + 1)]  # fmt: skip
    if kind is bool:
        return [*always, "no", 3, []]
    if kind is int:
        return [*always, True, "8", 1.5, float("nan"), float("inf"), [], *bounds]
    if kind == Number:
        return [*always, True, "0.4", float("nan"), float("-inf"), [], *bounds]
    if kind is str:
        return [*always, 3, True, []]
    if get_origin(kind) is Literal:
        return [*always, 3, True, [], "no such word"]
    if get_origin(kind) is tuple:
        return [*always, 3, "text", True, [[]], [{}], [True], [None]]
    if get_origin(kind) is dict:
        return [*always, {"a": "text"}, {"a": {}}, {"hex": True}]
    return [*always, True, "soft", -1.0, 0, []]


def test_every_key_refuses_what_has_no_meaning(root):
    """In one sentence: file, table, key, what was given, what is allowed."""
    cases = [(path, value) for path, hint in leaves(t.Params) for value in meaningless(hint)]
    assert len(cases) > 500 and len({path for path, _ in cases}) > 90
    for path, value in cases:
        given = value
        for key in reversed(path):
            given = {key: given}
        with pytest.raises(BadInput) as error:
            parse(t.Params, laid_over(raw(root), given), Place("dataset.toml", ("params",)))
        said = str(error.value)
        assert said.startswith("dataset.toml: [params.") and "\n" not in said, (path, value)
        assert path[-1] in said and path[0] in said, (path, value)
        assert any(word in said for word in ("give", "unknown key", "unknown name", "is missing")), (path, value)


MEANINGLESS = (
    ("[params.train]\nepochs = 8.0", r"epochs = 8.0: give a whole number"),
    ("[params.fea]\nmetod = 'ccx'", r"\[params.fea\] metod: unknown key; did you mean method"),
    ("[params.fae]\nmethod = 'ccx'", "fae: unknown key; did you mean fea"),
    ("[[params]]", "params = .*: give tables"),
    ("params = 5", "params = 5: give tables"),
    ("[param.fea]\nmethod = 'ccx'", "param is unknown; did you mean params"),
    ("catalog = 'x.toml'", "did you mean catalogue"),
    ("catalogue = '.'", r"catalogue = '\.': give the name of a \.toml file"),
    ("catalogue = '../indenters.toml'", "catalogue = .*: give the name"),
    ("meshes = 4", "meshes is unknown"),
    ("[params.material]\nc10 = 72.5", "c10 = 72.5: give a number from 0.002 to 5 MPa"),
    (f"[params.interface]\nmu = 1{'0' * 400}", "mu = 1000.*: give a number from 0 to 1000"),
    ("[params.poses]\ndeepest_share = 0", "deepest_share = 0: give a number from 1e-12"),
    ("[params.evaluate]\nforce_edges = [2.0, 1.0]", "force_edges = .*: give a list of 2 or more, .* rising"),
    ("[params.dataset]\nvalidation = 0.6\ntest = 0.5", "validation = 0.6 and test = 0.5"),
    ("[params.labels]\nchannels = ['traction']", "channels = .*\"force\" first"),
    ("[params.meshes]\ngel = 'dome'", "meshes: unknown"),
    ("[params.calibrate.priors.offset]\nkind = 'lognormal'", "median is missing: a prior of kind \"lognormal\""),
    ("[params.calibrate.priors.c10]\nspread = 0", "has no width"),
    ("[params.calibrate.priors.c10]\nmedian = -1", "needs a positive one"),
    ("[params.calibrate.priors.c10]\nmedian = 80.0", "c10: median = 80.0: give a number from 0.002 to 5 MPa"),
    ("[params.calibrate.priors.c10]\nkind = 'normal'\nmean = 150", "c10: mean = 150: give a number .* MPa"),
    ("[params.calibrate.priors.mu]\nfree = false", "mu: free = false needs `fixed`"),
    ("[params.calibrate.priors.c10]\nfree = false\nfixed = 0.08", "c10: free = false; it is what calibrate finds"),
    ("[params.train]\naveraged_share = 0.3", "averaged_share = 0.3 is above frozen_share = 0.25"),
    ("[params.report]\nmodel = '$(shell touch x)'", "model = .*: give a name of letters"),
    ("[params.train.epochs_of]\nuet = 3", "uet: unknown key; did you mean unet"),
)  # fmt: skip


def test_what_has_no_meaning_is_refused(root, tmp_path):
    for text, named in MEANINGLESS:
        refused(named, load, root, tmp_path, text)


def test_files_of_settings_that_cannot_be_read_are_named(root, tmp_path):
    text = (root / "workflow" / "params.toml").read_text().replace("shard_size = 8", "shard_size = 0")
    (tmp_path / "params.toml").write_text(text)
    refused(r"params\.toml: \[plan\] shard_size = 0: give a whole number from 1", load_params, tmp_path)
    (tmp_path / "params.toml").write_text(text.replace("shard_size = 0", ""))
    refused(r"params\.toml: \[plan\] shard_size is missing", load_params, tmp_path)
    refused(r"cannot be read \(Is a directory\); name a TOML file", read_toml, tmp_path)
    given = tmp_path / "given.toml"
    given.write_text('gel = "größer"', encoding="utf-8-sig")  # as Windows writes it
    assert read_toml(given) == {"gel": "größer"}
    given.write_text('gel = "mine"', encoding="utf-16")
    refused(r"given\.toml: not UTF-8 text .*save it as UTF-8", read_toml, given)
    gone = tmp_path / "nothere.toml"
    refused("nothere.toml: not found; check the name .workflow/guide/your-data.md and", read_toml, gone)
    refused("nothere.toml: not found; make it with gel", read_toml, gone, "make it with gelforge sensor")


def test_settings_that_mean_something_are_taken(root, tmp_path):
    params = load(
        root, tmp_path, "[params.material]\nc10 = 'calibrated'\nnu = 0\n[params.interface]\nlaw = 'coulomb'\nmu = 2\n"
        "[params.calibrate.priors.c10]\nkind = 'normal'\nmean = 0.1\nspread = 1",
    )  # fmt: skip
    assert plain(params.material) == {"c10": "calibrated", "nu": 0} and params.interface.mu == 2
    assert params.calibrate.priors.c10.numbers == {"mean": 0.1, "spread": 1}


def test_the_datasets_that_come_along_are_sound(root):
    for name in ("demo", "feats_sphere15"):
        assert load_params(root / "workflow", root / "data" / name / "dataset.toml")
        assert read_dataset_file(root / "data" / name / "dataset.toml").catalogue == "indenters.toml"


def test_words_of_the_schema_are_those_of_the_code():
    from gelforge.calibration.parameters import NAMES, ORIGIN, TILT, prior_name
    from gelforge.records.labelfile import FIELDS

    assert (
        set(t.IN_PROCESS) == set(QUALITIES)
        and set(t.IN_PROCESS) < set(t.METHODS)
        and set(t.PRIOR_KEYS) == set(get_args(kinds_of(t.PriorTable)["kind"]))
    )
    every = (*NAMES, *TILT, *ORIGIN, "scale of ball", "tilt_x of mounting")
    assert {prior_name(name) for name in every} == {field.name for field in fields(t.PriorsTable)}
    channels = get_args(get_args(split(kinds_of(t.LabelsTable)["channels"])[0])[0])
    assert set(channels) - {"force"} <= set(FIELDS)
