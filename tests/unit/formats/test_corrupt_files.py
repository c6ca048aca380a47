"""Whatever happens to the bytes of a file, its reader gives it or refuses it in a sentence; nothing else escapes."""

import io
import zipfile

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gelforge.errors import BadInput
from gelforge.formats.export import ros
from gelforge.formats.featsfile import read_npy
from gelforge.formats.mcap_import import Topics, pair
from gelforge.formats.mcap_messages import messages
from gelforge.formats.messageimage import picture
from gelforge.mechanics.mesh.hexmesh import FineBox
from gelforge.mechanics.mesh.hexname import HexMeshName
from gelforge.reading.model import load_model
from gelforge.records.forcefile import ForceFile, SampleForces, write_forces
from gelforge.records.image import read_image
from gelforge.records.labelfile import read_labels
from gelforge.records.log import read_log, read_poses
from gelforge.records.predictionfile import read_predictions, write_predictions
from gelforge.records.press import COLUMNS, parse
from gelforge.records.rowfile import RowFile
from gelforge.records.samplefile import read_samples
from gelforge.records.solvestore import SolveStore
from gelforge.records.solvetable import Solved, read_solves, write_solves
from gelforge.records.status import Status
from gelforge.stages.forces import read_sample
from tests.support.press_records import log_line

PICTURE = np.random.default_rng(1).integers(0, 255, (24, 32, 3), np.uint8)
LABELS = {"sample_id": np.array(["a", "b"]), "status": np.array(["OK", "OK"]), "outside": np.zeros((2, 3)),
          "label": np.zeros((2, 3, 2, 2), np.float32), "c10": np.float64(0.07)}  # fmt: skip
HEXAHEDRA = HexMeshName("gelsight_mini", FineBox(-2.0, 2.0, -2.0, 2.0, 1.0), 2, 2.0, 2.0, 4.0)
MESH = HEXAHEDRA.name
LOG = "\n".join([",".join(COLUMNS), *(log_line(sample_id=f"s{k}", fz_n=-1.0 - k) for k in range(6))]) + "\n"


def log_rows(path):
    return [parse(row, "log.csv") for row in read_log(path)]


def forces(path):
    with ForceFile(path) as file:
        return file.sample(0, np.arange(3)), file.node, file.force, file.surface_ptr, file.displacement


def solved(path):
    """What stage 40 makes of a solve's output; where that is corrupt, a status and a reason of one sentence."""
    store = SolveStore(path.parent / "solves")
    store.folder.mkdir(exist_ok=True)
    store.arrays("key").write_bytes(path.read_bytes())
    sample, reason = read_sample(Solved("a", Status.OK, "", "label", MESH, "key", (0.0, 0.1, -1.0), {}), store)
    if sample.status != "OK":
        raise BadInput(reason)
    return sample.force


def recording(path) -> None:
    """A recording of two pictures with a wrench each."""
    from mcap_ros2.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        image = writer.register_msgdef(
            "sensor_msgs/msg/CompressedImage", ros.schema("sensor_msgs/msg/CompressedImage")
        )
        wrench = writer.register_msgdef(
            "geometry_msgs/msg/WrenchStamped", ros.schema("geometry_msgs/msg/WrenchStamped")
        )
        seen = {"header": ros.header(0, "gel"), "format": "png", "data": cv2.imencode(".png", PICTURE)[1].tobytes()}
        axes = {"x": 0.1, "y": 0.2, "z": -3.0}
        felt = {"header": ros.header(0, "gel"), "wrench": {"force": axes, "torque": axes}}
        for time in (10**18, 10**18 + 10**7):
            writer.write_message("/image", image, seen, log_time=time, publish_time=time)
            writer.write_message("/wrench", wrench, felt, log_time=time, publish_time=time)
        writer.finish()


def recorded(path):
    topics = Topics("/image", "/wrench", "mini", 0.02, 1, 1, 0.2, np.eye(3), (), ())
    return pair(path, topics), [picture(said, str(path)) for _, _, said in messages(path, [topics.image])]


def archive(save, **arrays) -> bytes:
    stream = io.BytesIO()
    save(stream, **arrays)
    return stream.getvalue()


@pytest.fixture(scope="module")
def whole(tmp_path_factory, root):
    """Bytes of a good file of every kind, and its readers."""
    folder = tmp_path_factory.mktemp("whole")
    found = {
        kind: (cv2.imencode(f".{kind}", PICTURE)[1].tobytes(), [read_image]) for kind in ("png", "jpg", "bmp", "tiff")
    }
    found["labels"] = archive(np.savez, **LABELS), [read_labels]
    found["packed"] = archive(np.savez_compressed, **LABELS), [read_labels]
    sample = SampleForces("a", "OK", "m", np.arange(3), np.ones((3, 3)), np.zeros((3, 3)))
    write_forces(folder / "f.npz", [sample], 0.07)
    found["forces"] = (folder / "f.npz").read_bytes(), [forces]
    write_predictions(folder / "p.npz", np.array(["a"]), np.zeros((1, 3, 2, 2), np.float32), np.zeros((1, 3)))
    found["predictions"] = (folder / "p.npz").read_bytes(), [read_predictions]
    write_solves(folder / "s.csv", [Solved("a", Status.OK, "", "hex", "m", "f", (0.0, 0.1, -1.0), {"seconds": 1.5})])
    found["solves"] = (folder / "s.csv").read_bytes(), [read_solves]
    np.save(folder / "x.npy", np.array({"gs_img": PICTURE, "f_x": 1.5}, object), allow_pickle=True)
    found["npy"] = (folder / "x.npy").read_bytes(), [read_npy]
    np.save(folder / "rows.npy", np.arange(12.0).reshape(4, 3))
    found["rows"] = (folder / "rows.npy").read_bytes(), [lambda path: RowFile(path)[:]]
    surface = np.zeros((len(HEXAHEDRA.mesh().surface_nodes), 3))
    found["solve"] = archive(np.savez, force=surface + 1.0, displacement=surface), [solved]
    recording(folder / "r.mcap")
    found["mcap"] = (folder / "r.mcap").read_bytes(), [recorded]
    found["log"] = LOG.encode(), [log_rows, read_poses, read_samples]
    found["model"] = (root / "src/gelforge/reading/weights/default.onnx").read_bytes(), [load_model]
    return found


def corrupt(data: bytes, draw) -> bytes:
    """Cut, flip, insert, delete or overwrite, where `draw` says."""
    at = draw(st.integers(0, len(data) - 1))
    bad = [b"\xff" * 4, b"\0" * 8, b'",",', b"\n\n", b"PK\x03\x04"]
    junk = draw(st.binary(min_size=1, max_size=40) | st.sampled_from(bad))
    how = draw(st.sampled_from(["cut", "insert", "delete", "overwrite"]))
    after = data[at + len(junk) :]
    behind = {"cut": b"", "insert": junk + data[at:], "delete": after, "overwrite": junk + after}
    return data[:at] + behind[how]


KINDS = [
    "png",
    "jpg",
    "bmp",
    "tiff",
    "labels",
    "packed",
    "forces",
    "predictions",
    "solves",
    "npy",
    "rows",
    "solve",
    "mcap",
    "log",
]


@pytest.mark.parametrize(("kind", "examples"), [*((kind, 75) for kind in KINDS), ("model", 15)])
def test_a_corrupt_file_is_read_or_refused(whole, tmp_path, kind, examples):
    data, readers = whole[kind]

    @settings(max_examples=examples, suppress_health_check=list(HealthCheck), database=None)
    @given(st.data())
    def holds(drawn):
        path = tmp_path / f"x.{kind}"
        path.write_bytes(corrupt(data, drawn.draw))
        for read in readers:
            try:
                read(path)
            except BadInput as error:
                assert str(error).isprintable() and len(str(error)) < 1000

    holds()


def unclosed(header: bytes) -> bytes:
    """A .npy file whose header ends inside its dictionary: where the tokeniser of numpy's parser gives up."""
    at = header.index(b"(")
    return header[:at] + header[at:].replace(b")", b" ", 1).replace(b"}", b" ", 1)


@pytest.mark.parametrize("kind", ["npy", "rows", "solve", "labels", "forces"])
def test_a_header_that_ends_inside_its_dictionary_is_refused(whole, tmp_path, kind):
    data, readers = whole[kind]
    path = tmp_path / f"x.{kind}"
    if data.startswith(b"PK"):
        with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(path, "w") as new:
            for name in old.namelist():
                new.writestr(name, unclosed(old.read(name)))
    else:
        path.write_bytes(unclosed(data))
    for read in readers:
        with pytest.raises(BadInput):
            read(path)


def test_whole_files_are_read(whole, tmp_path):
    for kind, (data, (read, *_)) in whole.items():
        (tmp_path / f"x.{kind}").write_bytes(data)
        assert read(tmp_path / f"x.{kind}") is not None, kind
