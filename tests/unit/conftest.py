"""What unit tests may cost, and what tests of networks share: small networks, trained once."""

import pytest

PROCESSES = ("subprocess.Popen.__init__", "os.fork", "multiprocessing.util.spawnv_passfds")
SOLVES = ("gelforge.mechanics.solvers.hex.HexSolver.solve_frames", "gelforge.mechanics.solvers.ccx.CcxSolver.solve")


@pytest.fixture(autouse=True)
def cheap(request, monkeypatch):
    """A unit test solves no press, and starts no process unless it is marked `processes`.

    Nor does it use a base mesh that a marked test before it had made by pytetwild, in a process.
    """

    def refused(*_args, **_named):
        pytest.fail(
            "a unit test that solves or starts a process: move it to physics/ or workflow/, or mark it `processes`"
        )

    marked = request.node.get_closest_marker("processes")
    for name in SOLVES if marked else (*SOLVES, *PROCESSES):
        monkeypatch.setattr(name, refused)
    if not marked:
        monkeypatch.setattr("gelforge.mechanics.mesh.basemesh._known", {})


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    from tests.support.small_networks import small_dataset

    return small_dataset(tmp_path_factory.mktemp("dataset"))


@pytest.fixture(scope="session")
def models(data):
    from tests.support.small_networks import small_models

    return small_models(data)


@pytest.fixture(scope="session")
def paths(models, tmp_path_factory):
    from tests.support.small_networks import small_files

    return small_files(models, tmp_path_factory.mktemp("models"))


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A dataset of 96 presses of one law, which `trained` learnt from."""
    from tests.support.small_networks import GRID, IMAGE
    from tests.support.synthetic_presses import write_dataset

    return write_dataset(tmp_path_factory.mktemp("learning") / "6x8", 96, IMAGE, GRID)


@pytest.fixture(scope="session")
def trained(folder):
    from tests.support.small_networks import learnt

    return learnt(folder)


@pytest.fixture(scope="session")
def shipped():
    """The network that comes with gelforge."""
    from gelforge.reading.model import load_model

    return load_model(None)


@pytest.fixture(scope="session")
def demo_nocontact(root):
    """No-contact images (240, 320, 3) uint8 of the demo's sensors, by name."""
    from gelforge.records.image import read_image

    return {path.stem: read_image(path)[..., :3] for path in sorted((root / "data/demo/nocontact").glob("*.png"))}
