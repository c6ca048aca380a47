"""STL files as programs write them, and files of other kinds under the name .stl."""

import numpy as np
import pytest

from gelforge.errors import BadInput
from gelforge.geometry.sampled import sampled_from_stl
from gelforge.geometry.stlfile import read_stl
from gelforge.geometry.triangles import cleaned, is_watertight, joined, write_stl
from tests.support.blocks import box

BODY = box([-2.0, -2.0, 0.0], [4.0, 4.0, 6.0])


def text_stl(mesh=BODY, name="probe", end="\n", indent="  ") -> str:
    """A text STL as CAD programs write it."""
    lines = [f"solid {name}"]
    for triangle in mesh[0][mesh[1]]:
        lines += [f"{indent}facet normal 0 0 0", f"{indent * 2}outer loop"]
        lines += [f"{indent * 3}vertex {x:e} {y:e} {z:e}" for x, y, z in triangle]
        lines += [f"{indent * 2}endloop", f"{indent}endfacet"]
    return end.join([*lines, f"endsolid {name}", ""])


TEXTS = {
    "plain": text_stl().encode(),
    "CR": text_stl(end="\r").encode(),
    "CR LF": text_stl(end="\r\n").encode(),
    "LF CR mixed": text_stl(end="\n\r").encode(),
    "one line": text_stl(end=" ").encode(),
    "no indent": text_stl(indent="").encode(),
    "capitals": text_stl().upper().encode(),
    "a byte-order mark": b"\xef\xbb\xbf" + text_stl().encode(),
    "two byte-order marks": 2 * b"\xef\xbb\xbf" + text_stl().encode(),
    "an umlaut": text_stl(name="Fühler").encode(),
    "an umlaut of Latin-1": text_stl(name="Fühler").encode("latin-1"),
    "an umlaut with CR": text_stl(name="Fühler", end="\r").encode(),
    "blank lines before": b"\n\n  " + text_stl().encode(),
    "no name": text_stl(name="").encode(),
    "a name of its own words": text_stl(name="vertex 1 2 endfacet solid").encode(),
    "two solids": text_stl((BODY[0], BODY[1][:5])).encode() + text_stl((BODY[0], BODY[1][5:])).encode(),
    "cut after a triangle": text_stl().encode()[: text_stl().rindex("endsolid")],
}


def test_a_text_file_is_read_whatever_its_lines_and_name(tmp_path):
    for kind, data in TEXTS.items():
        (tmp_path / "b.stl").write_bytes(data)
        for found, expected in zip(read_stl(tmp_path / "b.stl"), cleaned(*BODY), strict=True):
            np.testing.assert_array_equal(found, expected, err_msg=kind)


def test_a_binary_file_is_known_by_its_size_whatever_its_header(tmp_path):
    path = tmp_path / "b.stl"
    write_stl(path, *BODY)
    data = path.read_bytes()
    for header in (b"gelforge", b"solid from a program", b"\xef\xbb\xbfsolid"):
        for behind in (b"", b"\x00" * 7, b"what the program adds"):
            path.write_bytes(header.ljust(80) + data[80:] + behind)
            np.testing.assert_array_equal(read_stl(path)[0], cleaned(*BODY)[0])


OTHERS = {
    "HTML": (b"<!DOCTYPE html>\n<html><body>404</body></html>", "no text that begins with solid"),
    "OBJ": (b"# Blender\no probe\n" + 20 * b"v 1.0 -2e-3 0\n" + b"f 1 2 3\n", "no text that begins with solid"),
    "a picture": (b"\x89PNG\r\n\x1a\n" + bytes(200), "no text that begins with solid"),
    "nothing": (b"", "0 bytes where 0 triangles"),
    "decimal commas": (text_stl().replace(".", ",").encode(), "is not a number; write decimals with a point"),
    "words for numbers": (text_stl().replace("vertex", "vertex x", 1).encode(), "'x' is not a number"),
    "not finite": (
        text_stl().replace("vertex -2.000000e+00", "vertex nan", 1).encode(),
        "triangle .* not a finite number",
    ),
    "cut within a triangle": (text_stl().encode()[:300], "corners and .* ends of triangles"),
    "without triangles": (b"solid x\nendsolid x\n", "holds no triangles"),
    "binary without triangles": (bytes(84), "holds no triangles"),
    "binary cut short": (bytes(80) + b"\x0c\x00\x00\x00" + bytes(99), "12 triangles would take 684"),
}


def test_a_file_of_another_kind_or_that_is_not_whole_is_refused(tmp_path):
    for data, says in OTHERS.values():
        (tmp_path / "b.stl").write_bytes(data)
        with pytest.raises(BadInput, match=rf"b\.stl: .*{says}"):
            read_stl(tmp_path / "b.stl")
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(BadInput, match=r"folder\.stl: cannot be read \(it is a folder\)"):
        read_stl(tmp_path / "folder.stl")


def test_corners_that_single_precision_parts_are_one_and_others_stay_apart(tmp_path):
    """Programs compute a corner once for each triangle that meets in it; a slot of 0.01 mm is far wider than that."""
    rng = np.random.default_rng(2)
    for place in ([0.0, 0.0, 0.0], [30.0, -20.0, 5.0]):
        corners = (BODY[0] + place)[BODY[1]]
        for size in (0.0, 2e-8, 1e-7):
            moved = corners * (1.0 + rng.uniform(-size, size, corners.shape))
            write_stl(tmp_path / "b.stl", moved.reshape(-1, 3), np.arange(moved.size // 3).reshape(-1, 3))
            vertices, faces = read_stl(tmp_path / "b.stl")
            assert len(vertices) == 8 and is_watertight(faces)
            assert np.linalg.norm(vertices[:, None] - (BODY[0] + place), axis=2).min(axis=1).max() < 2e-5
    left, right = box([-2.0, -2.0, 0.0], [1.995, 4.0, 6.0]), box([0.005, -2.0, 0.0], [1.995, 4.0, 6.0])
    write_stl(tmp_path / "b.stl", *joined([left, right]))
    assert len(read_stl(tmp_path / "b.stl")[0]) == 16


def test_faces_that_point_inward_are_named_because_a_mirrored_file_has_them(tmp_path, capsys):
    """The mirror image of the body was pressed without a word."""
    vertices, faces = BODY
    for name, mesh, told in (
        ("whole", BODY, False),
        ("mirrored", (vertices * [-1.0, 1.0, 1.0], faces), True),
        ("mirrored and mended", (vertices * [-1.0, 1.0, 1.0], faces[:, ::-1]), False),
    ):
        write_stl(tmp_path / "b.stl", *mesh)
        sampled_from_stl(tmp_path / "b.stl", name="b")
        assert ("b.stl: its faces point inward, as where the file was mirrored" in capsys.readouterr().err) == told, (
            name
        )
