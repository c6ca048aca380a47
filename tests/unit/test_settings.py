"""Settings of a dataset: what has no meaning is refused in a sentence that names it."""

import pytest

from gelforge.errors import BadInput
from gelforge.flow.params import load_params
from gelforge.flow.schema import SCHEMA, spec_of


def load(root, tmp_path, text):
    path = tmp_path / "dataset.toml"
    path.write_text(text, encoding="utf-8")
    return load_params(root / "workflow", path)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[params.fea]\nrounds = '8'", "rounds = '8': give a number"),
        ("[params.fea]\npress_steps = -3", "fea.press_steps = -3"),
        ("[params.fea]\npress_steps = true", "press_steps = True: give a number"),
        ("[params.fea]\nfidelity = 'cxx'", "fea.fidelity = 'cxx': choose one of hex, ccx"),
        ("[params.fea]\nfidelty = 'ccx'", "fidelity is meant"),
        ("[params]\nposes = 7", "poses = 7: give a table"),
        ("params = 5", "params = 5"),
        ("[param.fea]\nrounds = 8", "param is read by nothing; params is meant"),
        ("catalog = 'x.toml'", "catalogue is meant"),
        ("[params.train]\nepochs = 0", "train.epochs = 0"),
        ("[params.train]\nbatch = 0", "train.batch = 0"),
        ("[params.train]\nseed = -1", "train.seed = -1"),
        ("[params.plan]\nshard_size = '8'", "shard_size = '8': give a number"),
        ("[params.plan]\nshard_size = -3", "plan.shard_size = -3"),
        ("[params.material]\nnu = 0.5", "material.nu = 0.5"),
        ("[params.material]\nnu = -1", "material.nu = -1"),
        ("[params.material]\nc10 = true", "material.c10 = True"),
        ("[params.material]\nc10 = 0", "material.c10 = 0"),
        ("[params.material]\nc10 = 'soft'", "material.c10 = 'soft'"),
        ("[params.interface]\nlaw = 'coulomb'\nmu = inf", "interface.mu = inf"),
        ("[params.interface]\nmu = nan", "interface.mu = nan"),
        ("[params.poses]\ndeepest_share = nan", "poses.deepest_share = nan"),
        ("[params.poses]\nimages = 'no'", "images = 'no': give true or false"),
        ("[params.poses]\ntouch_offset_mm = []", "touch_offset_mm = \\[\\]: give a number"),
        ("[params.report]\nbranches = 'pareto'", "branches = 'pareto': give a list"),
        ("[params.evaluate]\nforce_edges = [0.0, inf]", "evaluate.force_edges = .* finite"),
    ],
)
def test_what_has_no_meaning_is_refused(root, tmp_path, text, named):
    with pytest.raises(BadInput, match=named):
        load(root, tmp_path, text)


def test_settings_that_mean_something_are_taken(root, tmp_path):
    params = load(
        root, tmp_path, "[params.material]\nc10 = 'calibrated'\nnu = 0\n[params.interface]\nlaw = 'coulomb'\nmu = 2"
    )
    assert params["material"] == {"c10": "calibrated", "nu": 0} and params["interface"]["mu"] == 2


@pytest.mark.parametrize("name", ["demo", "feats_sphere15"])
def test_the_datasets_that_come_along_are_sound(root, name):
    assert load_params(root / "workflow", root / "data" / name / "dataset.toml")


def leaves(table, path=""):
    for key, value in table.items():
        name = f"{path}.{key}" if path else key
        yield from leaves(value, name) if isinstance(value, dict) else [(name, value)]


def test_the_schema_and_the_defaults_tell_of_the_same_parameters(root):
    """Every default has a specification that allows it, and every specification stands for a default."""
    defaults = dict(leaves(load_params(root / "workflow")))
    used = set()
    for name, value in defaults.items():
        spec = spec_of(name)
        assert spec is not None and spec.fault(value) is None, name
        used |= {
            pattern for pattern, other in SCHEMA.items() if other is spec and (pattern == name or "*" in pattern)
        }
    assert set(SCHEMA) - used == set()


NONSENSE = ("text with; $(shell x)", "", True, -1e30, 1e30, [], [[]], ["$(shell x)\n"], {}, 0.5, -3)


def test_a_wrong_kind_is_refused_everywhere(root):
    """No parameter takes a value of every kind: what is nonsense for it is told, and how to mend it."""
    for name, _ in leaves(load_params(root / "workflow")):
        faults = [fault for value in NONSENSE if (fault := spec_of(name).fault(value))]
        assert len(faults) >= 5, name
        assert all(fault.startswith(("give", "choose", "in the list")) for fault in faults)


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")])
def test_no_parameter_takes_what_is_not_finite(root, number):
    for name, value in leaves(load_params(root / "workflow")):
        given = [number] * len(value) if isinstance(value, list) and value else number
        assert spec_of(name).fault(given), name


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[params.dataset]\nvalidation = 0.5\ntest = 0.5", "leave presses to train on"),
        ("[params.pareto]\nhex_layers = [3]", "of one length"),
        ("[params.calibrate]\nwalkers = 33", "even"),
        ("[params.train]\nleast_rate = 1.0", "not be above"),
        ("[params.calibrate]\nacceptance = [0.6, 0.15]", "larger than the one before"),
        ("[params.report]\nmodel = '$(shell touch x)'", "give a name"),
        ("[params.meshes.regions]\nspot = [2.0]", "a list of 2"),
        ("[params.fea]\npress_steps = 1.5", "a whole number"),
    ],
)
def test_what_does_not_go_together_is_refused(root, tmp_path, text, named):
    with pytest.raises(BadInput, match=named):
        load(root, tmp_path, text)
