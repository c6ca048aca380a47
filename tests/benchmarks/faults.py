"""Hostile and corrupt input of every kind, and a flow that is disturbed: how much is refused in a sentence, or harms nothing.

A case gives one thing to one part of the product, in a process and a folder of its own. It holds where that part refuses
it in one printable sentence, or gives the answer that a clean input gives; a traceback, a hang, memory without bounds, a
file outside the folder, foreign code that ran, or another answer in silence does not. Cases are made from a fixed seed.
"""

import json
import os
import struct
import tempfile
from argparse import Namespace
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from gelforge.errors import GelforgeError
from gelforge.flow.files import write_json
from gelforge.flow.main import command, option, positive
from gelforge.flow.progress import progress
from tests.benchmarks.attempts import CANARY, ROOT, Case, judge
from tests.benchmarks.figures import Figure, publish_figures
from tests.benchmarks.flow_faults import flow_cases
from tests.benchmarks.neighbour_faults import NEIGHBOURS
from tests.benchmarks.sandbox import link_project, make
from tests.support.press_records import COLUMNS, log_line, write_lines

INJECTED = (
    f"$(shell touch {CANARY})",
    f"$(touch {CANARY})",
    f"`touch {CANARY}`",
    f"; touch {CANARY}",
    f"a\nb: ; touch {CANARY}",
)


# -- settings


NOT_NUMBERS = ("'8'", "true", "[]", "nan", "-inf", "{}")


def settings_cases() -> Iterator[Case]:
    """Every parameter with values that mean nothing for it, and datasets' files of a wrong form."""
    from gelforge.flow.params import load_params, plain

    def leaves(table, path=()):
        for key, value in table.items():
            yield from leaves(value, (*path, key)) if isinstance(value, dict) else [((*path, key), value)]

    def loading(text):
        def run(folder):
            (folder / "dataset.toml").write_text(text, encoding="utf-8")
            load_params(ROOT / "workflow", folder / "dataset.toml")
            return "loaded"

        return run

    for path, given in leaves(plain(load_params(ROOT / "workflow"))):
        name = ".".join(path)
        quoted = "".join(f'."{part}"' for part in path)
        number = isinstance(given, int | float) and not isinstance(given, bool)
        for value in NOT_NUMBERS[:3] if number else (f'"{INJECTED[0]}\\u0001"', "-3.5"):
            yield Case("settings", f"{name} = {value}", loading(f"params{quoted} = {value}\n"))
        if number:
            yield Case("settings", f"{name} out of bounds", loading(f"params{quoted} = -1e30\n"))
    for text in ("params = 5", "[[params]]", "[param.fea]\nrounds = 8", "\x00", "catalog = 'x'", "[params.fea\n", "[params.fea]\nrounds = 8\nrounds = 8",
                 "[params.fea.deeper]\nx = 1", "params.nothing.x = 1", "[params.fea]\nhex_qualty = 'demo'"):  # fmt: skip
        yield Case("settings", repr(text), loading(text + "\n"))


# -- rows and files of a log


BAD_CELLS = ("nan", "inf", "1e999", "one", "1,5", "0x10", "--1", "1e", "\u0661", "=1+1")


def judged_log(path: Path) -> list:
    """Ids of a log that are taken, as stage 10 takes them."""
    from gelforge.records import log
    from gelforge.records.press import parse

    parsed = [parse(raw, str(path)) for raw in log.read_log(path)]
    good, _ = log.without_duplicates([press for press, _ in parsed if press], str(path))
    return [press.sample_id for press in good]


def row_cases() -> Iterator[Case]:
    """One spoilt cell among good rows: its row goes, the others stay."""
    good = ["a", "c"]

    def spoilt(column, text):
        def run(folder):
            middle = log_line(**{"sample_id": "b", column: text})
            return judged_log(
                write_lines(folder / "log.csv", log_line(sample_id="a"), middle, log_line(sample_id="c"))
            )

        return run

    for column in ("x0_mm", "y0_mm", "z0_mm", "dx_mm", "dy_mm", "dz_mm", "rot_deg"):
        for text in BAD_CELLS:
            cell = f'"{text}"' if "," in text else text
            yield Case("rows", f"{column} = {text}", spoilt(column, cell), good, True)
    for text in ("../x", "a/b", "", ".", "..", "\x1b[2J", "a b\tc", "x" * 300, *INJECTED[:4]):
        yield Case("rows", f"sample_id = {text!r}", spoilt("sample_id", text), good, True)


def file_cases() -> Iterator[Case]:
    """Whole logs in the forms that programs write them, and in forms that are none."""
    lines = [",".join(COLUMNS), *(log_line(sample_id=name) for name in "abc")]
    text, every = "\n".join(lines) + "\n", ["a", "b", "c"]
    kept = {
        "byte order mark": b"\xef\xbb\xbf" + text.encode(), "CRLF": text.replace("\n", "\r\n").encode(),
        "no last newline": text.rstrip().encode(), "blank lines": text.replace("\n", "\n\n").encode(),
        "quoted": ("\n".join(",".join(f'"{cell}"' for cell in line.split(",")) for line in lines) + "\n").encode(),
    }  # fmt: skip
    for name, data in kept.items():
        yield Case("logs", name, lambda folder, data=data: read_bytes_log(folder, data), every, True)
    refused = {
        "empty": b"", "header alone": lines[0].encode(), "semicolons": text.replace(",", ";").encode(), "UTF-16": text.encode("utf-16"),
        "bytes of a picture": bytes(range(256)) * 40, "a column missing": text.replace("dz_mm", "dz").encode(),
        "a column twice": text.replace("y0_mm", "x0_mm", 1).encode(), "latin-1": text.replace("a", "\xe9").encode("latin-1"),
        "only blanks": b"   \n\n", "a header of numbers": b"1,2,3\n4,5,6\n", "JSON": b'[{"sample_id": "a"}]', "zeros": bytes(4096),
    }  # fmt: skip
    for name, data in refused.items():
        yield Case("logs", name, lambda folder, data=data: read_bytes_log(folder, data))


def read_bytes_log(folder: Path, data: bytes) -> list:
    """Ids that are taken of a log of these bytes; none at all is a refusal of each row, and counts as one."""
    (folder / "log.csv").write_bytes(data)
    found = judged_log(folder / "log.csv")
    if not found:
        raise GelforgeError("every row was rejected")
    return found


# -- pictures


def picture_cases() -> Iterator[Case]:
    """Pictures that are cut, changed, of other kinds, or no files at all."""
    import cv2

    from gelforge.records.image import read_image

    rng = np.random.default_rng(11)
    image = cv2.GaussianBlur(rng.integers(0, 255, (240, 320, 3), dtype=np.uint8), (0, 0), 3)
    png, jpg = (cv2.imencode(kind, image)[1].tobytes() for kind in (".png", ".jpg"))

    def reading(data, name="p.png"):
        def run(folder):
            (folder / name).write_bytes(data)
            found = read_image(folder / name, (320, 240))
            return [found.shape, str(found.dtype), bool(np.array_equal(found[..., ::-1], image))]

        return run

    yield Case("pictures", "whole", reading(png), [(240, 320, 3), "uint8", True], True)
    for fraction in (0.0, 0.01, 0.1, 0.5, 0.9, 0.99):
        yield Case("pictures", f"PNG cut to {fraction:.0%}", reading(png[: int(fraction * len(png))]))
    for at in rng.integers(8, len(png), 12):
        changed = bytearray(png)
        changed[at] ^= 1 << int(rng.integers(8))
        yield Case("pictures", f"PNG with a bit changed at {at}", reading(bytes(changed)))
    others = {"text": b"no picture", "GIF head": b"GIF89a" + bytes(100), "a zip": b"PK\x03\x04" + bytes(60), "an ELF": b"\x7fELF" + bytes(60),
              "another size": cv2.imencode(".png", image[:100])[1].tobytes(), "half a JPEG": jpg[: len(jpg) // 3]}  # fmt: skip
    for name, data in others.items():
        yield Case("pictures", name, reading(data))
    claims = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 60000, 60000, 8, 2, 0, 0, 0) + bytes(4)
    yield Case("pictures", "claims 60000 x 60000", reading(claims))
    places = {"a folder": lambda p: p.mkdir(), "a pipe": os.mkfifo, "a link to itself": lambda p: p.symlink_to(p),
              "a link to nothing": lambda p: p.symlink_to("gone"), "a device": lambda p: p.symlink_to("/dev/zero"), "nothing": lambda p: None}  # fmt: skip
    for name, lay in places.items():

        def run(folder, lay=lay):
            lay(folder / "p.png")
            return read_image(folder / "p.png").shape

        yield Case("pictures", name, run)


# -- shapes


def shape_cases() -> Iterator[Case]:
    """STL files and tables of indenters that describe no body."""
    from gelforge.geometry.indenters import build
    from gelforge.geometry.triangles import write_stl

    cube = np.array([[x, y, z] for z in (0, 4) for y in (-2, 2) for x in (-2, 2)], float)
    faces = np.array([[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]])  # fmt: skip

    def made(change):
        def run(folder):
            change(folder / "b.stl")
            body = build("b", {"kind": "stl", "file": "b.stl"}, folder / "indenters.toml", folder)
            return [round(float(v), 1) for v in body.distance(np.array([[0.0, 0.0, -1.0]]))[0]]

        return run

    def stl(vertices=cube, triangles=faces):
        return made(lambda path: write_stl(path, np.asarray(vertices, float), np.asarray(triangles)))

    whole = stl()
    yield Case("shapes", "a cube", whole, [1.0], True)
    rng = np.random.default_rng(7)
    spoilt = {
        "no triangles": stl(triangles=faces[:0]), "one triangle": stl(triangles=faces[:1]), "a hole": stl(triangles=faces[:-1]),
        "not a number": stl(vertices=np.where(cube == 4, np.nan, cube)), "infinite": stl(vertices=np.where(cube == 4, np.inf, cube)),
        "flat": stl(vertices=cube * [1, 1, 0]), "in metres": stl(vertices=cube * 1e-3), "in micrometres": stl(vertices=cube * 1e3),
        "inverted faces": stl(triangles=faces[:, ::-1]), "far away": stl(vertices=cube + [500, 0, 0]), "text": made(lambda p: p.write_text("solid x\nfacet\n")),
        "empty": made(lambda p: p.write_bytes(b"")), "a count of four thousand million": made(lambda p: p.write_bytes(bytes(80) + b"\xff\xff\xff\xff" + bytes(50))),
        "random bytes": made(lambda p: p.write_bytes(rng.bytes(5000))), "a folder": made(lambda p: p.mkdir()), "a pipe": made(os.mkfifo),
    }  # fmt: skip
    for name, run in spoilt.items():
        # a body that stands elsewhere or has inverted faces may be mended; then it is the cube
        yield Case("shapes", name, run, [1.0] if name == "inverted faces" else None)
    tables = [
        {"kind": "sphere"}, {"kind": "sphere", "diameter": -5}, {"kind": "sphere", "diameter": float("nan")}, {"kind": "ball", "diameter": 5},
        {"kind": "cuboid", "size": [5]}, {"kind": "cuboid", "size": [5, 0]}, {"kind": "cuboid", "size": "5"}, {"kind": "cuboid", "size": [5, 5], "fillet": 9},
        {"kind": "cuboid", "size": [5, 5], "colour": "red"}, {"kind": "polygon", "sides": 2, "size": 5}, {"kind": "outline", "points": [[0, 0], [1, 1]]},
        {"kind": "outline", "points": [[0, 0], [4, 4], [4, 0], [0, 4]]}, {"kind": "stl"}, {"kind": "stl", "file": "../../etc/passwd"}, {"kind": 7}, {},
        {"kind": "stl", "file": INJECTED[0]}, {"kind": "sphere", "diameter": True}, {"kind": "pyramid", "size": 1e9}, {"kind": "cross", "arms": []},
    ]  # fmt: skip
    for table in tables:
        name = json.dumps(table, default=str)
        yield Case(
            "shapes", name, lambda folder, table=table: str(build("x", table, folder / "indenters.toml", folder))
        )


# -- files of arrays and networks


def flips(data: bytes, rng, count: int) -> Iterator[tuple[str, bytes]]:
    """The same bytes cut short and with single bits changed."""
    for fraction in (0.0, 0.2, 0.6, 0.95):
        yield f"cut to {fraction:.0%}", data[: int(fraction * len(data))]
    for at in sorted(rng.integers(0, len(data), count).tolist()):
        changed = bytearray(data)
        changed[at] ^= 1 << int(rng.integers(8))
        yield f"bit changed at {at}", bytes(changed)


def array_cases(folder: Path) -> Iterator[Case]:
    """Solves, labels and networks, corrupt: refused, or read as they were."""
    from gelforge.networks.checkpoint.modelfile import digest_of_graph, load_model, save_model
    from gelforge.networks.inference.predictor import load_for_use
    from gelforge.records.labelfile import read_labels

    rng = np.random.default_rng(5)
    labels, network = folder / "24x32.npz", folder / "net.onnx"
    np.savez(labels, sample_id=np.array(["a", "b", "c"]), status=np.array(["OK", "OK", "DIVERGED"]), c10=np.float64(0.0792),
             label=rng.normal(size=(3, 3, 24, 32)).astype(np.float32), outside=np.full((3, 3), np.nan))  # fmt: skip
    save_model(network, load_for_use(None))

    def labels_of(path):
        found = read_labels(path)
        return [found.sample_id.tolist(), float(np.asarray(found.label[...]).sum(dtype=float)), found.material]

    def weights_of(path):
        return digest_of_graph(load_model(path).graph)

    for area, path, read, count in (("labels", labels, labels_of, 24), ("networks", network, weights_of, 24)):
        clean = read(path)
        for name, data in flips(path.read_bytes(), rng, count):

            def run(place, data=data, read=read, name=path.name):
                (place / name).write_bytes(data)
                return read(place / name)

            yield Case(area, name, run, clean)


# -- names given to make


def name_cases() -> Iterator[Case]:
    """Variables of make's command line that are no names: refused before anything runs or is made."""
    hostile = (*INJECTED[:4], "../../x", "a b", "/etc", "", "-n", "%", "a:b", "a#b", "x'y", 'x"y')
    goals = {
        "DATASET": "poses",
        "RES": "labels",
        "MODEL": "train",
        "ID": "sample",
        "FORMAT": "export",
        "SENSOR": "projection",
    }

    def run(folder, variable, value, goal):
        project = link_project(ROOT, folder / "project")
        done = make(project, goal, f"{variable}={value}")
        if "Traceback" in done.stdout:
            return "traceback: " + done.stdout[-300:]
        if any(project.rglob(CANARY)) or (
            (project / "results").exists() and any((project / "results").rglob("*.npz"))
        ):
            return "something was made"
        if done.returncode == 0:
            return "exit 0"
        raise GelforgeError("refused by make")

    for variable, goal in goals.items():
        for value in hostile:
            if not value and variable in ("DATASET", "RES", "MODEL", "FORMAT", "SENSOR"):
                continue  # empty: the default
            yield Case(
                "names", f"{goal} {variable}={value!r}", lambda f, v=variable, x=value, g=goal: run(f, v, x, g)
            )


# -- keys of solves


def key_cases() -> Iterator[Case]:
    """One number of a press, a setting, a shape or a gel changed: another key, so a solve made before is not taken."""
    from gelforge.flow import params as config
    from gelforge.geometry.indenters import build
    from gelforge.records.press import PosedPress
    from gelforge.stages.fea import VERSION, press_keys, scene_of
    from tests.support.press_records import press_record

    params = config.parameters_of(config.load_params(ROOT / "workflow"), config.SOURCES["fea"].kind, VERSION)
    tables = {
        "indenters": {"sphere_15": {"kind": "sphere", "diameter": 15, "height": 10}},
        "sensors": {"gelsight_mini": {"gel": "gelsight_mini"}},
    }
    mesh = "ccx-disc-0.4-01234567"
    bodies = {"sphere_15": build("sphere_15", tables["indenters"]["sphere_15"], "a benchmark", ROOT / "workflow")}
    fields = set(PosedPress.__dataclass_fields__)
    press = PosedPress(**{k: v for k, v in vars(press_record()).items() if k in fields})

    def key(p=press, q=params, t=tables, m=mesh):
        return press_keys([p], [scene_of(p, bodies, t["sensors"], q)], q, t, {p.sample_id: m})[0]

    def judged(other):
        return lambda folder: "another" if other() != key() else "the same key"

    for column in ("x0_mm", "y0_mm", "z0_mm", "dx_mm", "dy_mm", "dz_mm", "rot_deg"):
        moved = replace(press, **{column: getattr(press, column) + 1e-9})
        yield Case("keys", column, judged(lambda m=moved: key(p=m)), "another")
    for name, value in config.plain(params.fea).items():
        if isinstance(value, int | float) and not isinstance(value, bool):
            changed = replace(params, fea=replace(params.fea, **{name: value * 2}))
            # they choose a fidelity, or limit how long it may take
            expected = "the same key" if name in ("tolerance", "cell_tolerance", "timeout_s") else "another"
            yield Case("keys", f"fea.{name}", judged(lambda c=changed: key(q=c)), expected)
    for name, value, expected in (
        ("interface.law", "frictionless", "another"),
        ("interface.mu", 0.7, "the same key"),
        ("material.nu", 0.45, "another"),
        ("fea.hex_quality", "demo", "the same key"),
    ):
        table, _, field = name.partition(".")
        changed = replace(params, **{table: replace(getattr(params, table), **{field: value})})
        yield Case("keys", name, judged(lambda c=changed: key(q=c)), expected)
    for name, change in (
        ("diameter", {"diameter": 15.001}),
        ("height", {"height": 11}),
        ("content of a file", {"sha256": "0"}),
    ):
        other = {**tables, "indenters": {"sphere_15": {**tables["indenters"]["sphere_15"], **change}}}
        yield Case("keys", f"indenter: {name}", judged(lambda t=other: key(t=t)), "another")
    other = {**tables, "sensors": {"gelsight_mini": {"gel": "gelsight_mini-3.6mm"}}}
    yield Case("keys", "the sensor's gel", judged(lambda: key(t=other)), "another")
    yield Case("keys", "a mesh", judged(lambda: key(m="ccx-disc-0.4-01234568")), "another")
    same = {
        **tables,
        "indenters": {"sphere_15": {**tables["indenters"]["sphere_15"], "seen": False, "file": "renamed.stl"}},
    }
    yield Case(
        "keys", "what is no shape", lambda folder: "the same" if key(t=same) == key() else "another key", "the same"
    )


AREAS: dict[str, Callable[[Path], Iterator[Case]]] = {
    "settings": lambda folder: settings_cases(),
    "rows": lambda folder: row_cases(),
    "logs": lambda folder: file_cases(),
    "pictures": lambda folder: picture_cases(),
    "shapes": lambda folder: shape_cases(),
    "arrays": array_cases,
    "names": lambda folder: name_cases(),
    "keys": lambda folder: key_cases(),
    **{area: lambda folder, cases=cases: cases() for area, cases in NEIGHBOURS.items()},
    "flow": flow_cases,
}


@command(
    option("--areas", nargs="+", choices=list(AREAS), default=list(AREAS)),
    option(
        "--every", type=positive, default=1, help="of so many cases of an area one; more than 1 only to try it out"
    ),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    with tempfile.TemporaryDirectory() as work:
        base = Path(work)
        cases = [case for area in args.areas for case in islice(AREAS[area](base), 0, None, args.every)]
        records = [judge(case, base) for case in progress(cases, "cases", len(cases))]
    tried, failed = Counter(r["area"] for r in records), [r for r in records if r["fault"]]
    lost = Counter(r["area"] for r in failed)
    print("area | tried | held", *(f"{area} | {n} | {n - lost[area]}" for area, n in tried.items()), sep="\n")
    for record in failed:
        print(
            f"does not hold: {record['area']}: {record['case']}: {record['fault']}".encode("unicode_escape").decode()
        )
    write_json(args.out.with_suffix("") / "cases.json", {"cases": records})
    publish_figures(args.out, [
        Figure("cases tried", len(records), ">=", 300),
        Figure("cases that hold", 100.0 * (len(records) - len(failed)) / len(records), ">=", 99.0, "%"),
        Figure("cases after which a stranger's file lay there", sum("left " in r["fault"] for r in failed), "==", 0),
        Figure("cases with another answer in silence", sum(r["fault"].startswith("another") for r in failed), "==", 0),
    ])  # fmt: skip


if __name__ == "__main__":
    main.exit()
