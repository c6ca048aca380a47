"""What users of neighbouring tools ran into: answers of solvers, solids of CAD programs, films and recordings.

Public reports of these are the source of each kind; where a case has a clean answer, that or a refusal holds.
"""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from gelforge.errors import GelforgeError
from tests.benchmarks.attempts import Case

LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
FRACTIONS = (0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99)  # of a file that is left

# -- CalculiX' results

HEAD = "\n forces (fx,fy,fz) for set NTOP and time  0.1000000E+01\n\n"
ROWS = "         1  1.000000E-02  2.000000E-02 -3.000000E-02\n         2  4.000000E-02 -5.000000E-02  6.000000E-02\n"
SPELLINGS = (
    "NaN",
    "NAN(IND)",
    "-1.#IND0E+00",
    "-nan(ind)",
    "Infinity",
    "-inf",
    "************",
    "1,000000E-02",
    "1.0D",
    "",
)


def answer_cases() -> Iterator[Case]:
    """Tables of a .dat that other builds and languages write, and files that end early."""
    from gelforge.mechanics.ccx.dat import DatError, last_table, read_dat

    def reading(text: str) -> Callable[[Path], object]:
        def run(folder: Path) -> object:
            try:
                return last_table(read_dat(text), "forces", "NTOP", np.array([1, 2])).tolist()
            except DatError as error:
                raise GelforgeError(str(error)) from error

        return run

    whole = [[0.01, 0.02, -0.03], [0.04, -0.05, 0.06]]
    yield Case("answers", "whole", reading(HEAD + ROWS), whole, True)
    for exponent in ("E-002", "-002"):
        yield Case("answers", f"exponents {exponent}", reading(HEAD + ROWS.replace("E-02", exponent)), whole, True)
    yield Case("answers", "columns that touch", reading(HEAD + ROWS.replace("E-02 -", "E-002-")))
    yield Case(
        "answers", "all columns touch", reading(HEAD + ROWS.replace("E-02  ", "E-002").replace("E-02 -", "E-002-"))
    )
    for word in SPELLINGS:
        yield Case("answers", f"a value is {word!r}", reading(HEAD + ROWS.replace("2.000000E-02", word)))
    text = HEAD + ROWS
    for fraction in FRACTIONS:
        yield Case("answers", f"cut to {fraction:.0%}", reading(text[: int(fraction * len(text))]))


# -- solids

CUBE = np.array([[x, y, z] for z in (0, 4) for y in (-2, 2) for x in (-2, 2)], float)
SIDES = np.array([[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]])  # fmt: skip


def soup(triangles: np.ndarray, header: bytes = b"") -> bytes:
    """Binary STL of triangles (f, 3, 3)."""
    record = np.zeros(len(triangles), [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("attribute", "<u2")])
    record["v"] = triangles
    return header.ljust(80) + struct.pack("<I", len(triangles)) + record.tobytes()


def solid_cases() -> Iterator[Case]:
    """A cube as CAD programs write it: headers of text, edges split on one side, slivers, sides twice, parts that touch."""
    from gelforge.geometry.indenters import build

    corners, middle = CUBE[SIDES], np.array([0.0, -2.0, 0.0])
    split = np.array([[CUBE[0], CUBE[2], middle], [middle, CUBE[2], CUBE[1]], [CUBE[1], CUBE[2], CUBE[3]]])
    sliver = np.array([[CUBE[0], middle, CUBE[1]]])
    rng = np.random.default_rng(4)

    def made(data: bytes) -> Callable[[Path], object]:
        def run(folder: Path) -> object:
            (folder / "b.stl").write_bytes(data)
            body = build("b", {"kind": "stl", "file": "b.stl"}, folder / "indenters.toml", folder)
            return np.round(body.distance(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]))[0], 3).tolist()

        return run

    parts = {
        "a header that begins with solid": soup(corners, b"solid Part1"), "a header as of text": soup(corners, b"solid a\n facet"),
        "a sliver that closes an edge": soup(np.concatenate([split, sliver, corners[2:]])),
        "a sliver beside it": soup(np.concatenate([corners, sliver])), "an edge split on one side": soup(np.concatenate([split, corners[2:]])),
        "a triangle twice": soup(np.concatenate([corners, corners[:1]])), "a side twice": soup(np.concatenate([corners, corners[:2]])),
        "a side twice, once turned": soup(np.concatenate([corners, corners[:2, ::-1]])), "all of it twice": soup(np.concatenate([corners, corners])),
        "another cube at its edge": soup(np.concatenate([corners, corners + [4, 4, 0]])),
        "another cube at its corner": soup(np.concatenate([corners, corners + [4, 4, 4]])),
        "a Git LFS pointer": LFS,
    }  # fmt: skip
    for size in (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3):
        parts[f"corners that differ by {size:g} mm"] = soup(corners + rng.uniform(-size, size, corners.shape))
    # any other one may be refused, where it is named
    good = (
        "a header",
        "a sliver",
        "a triangle twice",
        "another cube",
        "corners that differ by 1e-08",
        "corners that differ by 1e-07",
    )
    for name, data in parts.items():
        yield Case("solids", name, made(data), [1.0, -1.0], name.startswith(good))


# -- pictures and films


def frame_cases() -> Iterator[Case]:
    """Pictures of other depths, and films that were not ended."""
    import cv2

    from gelforge.records.film import frames, open_source
    from gelforge.records.image import read_image

    image = cv2.GaussianBlur(np.random.default_rng(2).integers(0, 255, (240, 320, 3), np.uint8), (0, 0), 3)

    def picture(suffix: str, data: np.ndarray | bytes) -> Callable[[Path], object]:
        def run(folder: Path) -> object:
            path = folder / f"a{suffix}"
            path.write_bytes(data if isinstance(data, bytes) else cv2.imencode(suffix, data)[1].tobytes())
            return bool(np.array_equal(read_image(path)[..., ::-1], image))

        return run

    alpha = np.dstack([image, np.full(image.shape[:2], 9, np.uint8)])
    for suffix in (".png", ".tiff"):
        yield Case("frames", f"{suffix}, 8 bits", picture(suffix, image), True, True)
        yield Case("frames", f"{suffix}, with transparency", picture(suffix, alpha), True, True)
        for factor in (257, 16):
            yield Case(
                "frames", f"{suffix}, 16 bits, times {factor}", picture(suffix, image.astype(np.uint16) * factor)
            )
        yield Case("frames", f"{suffix}, a Git LFS pointer", picture(suffix, LFS))

    def film(cut: Callable[[bytes], bytes], suffix: str = ".mp4", code: str = "mp4v") -> Callable[[Path], object]:
        def run(folder: Path) -> object:
            path = folder / f"a{suffix}"
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), 25, (320, 240))
            for _ in range(12):
                writer.write(image)
            writer.release()
            path.write_bytes(cut(path.read_bytes()))
            with open_source(path, None) as (source, announced):
                return len(list(frames(source, announced, path.name, None)))

        return run

    for suffix, code in ((".mp4", "mp4v"), (".avi", "MJPG")):
        yield Case("frames", f"film {suffix}, whole", film(bytes, suffix, code), 12, True)
        yield Case("frames", f"film {suffix}, a Git LFS pointer", film(lambda data: LFS, suffix, code))
        for fraction in FRACTIONS:
            yield Case("frames", f"film {suffix}, cut to {fraction:.0%}",
                       film(lambda data, fraction=fraction: data[: int(fraction * len(data))], suffix, code), 12)  # fmt: skip
    yield Case("frames", "film .mp4, without its index", film(lambda data: data[: data.find(b"moov") - 4]))


# -- recordings


def recording_cases() -> Iterator[Case]:
    """Recordings that are cut, split over files, of ROS 1, of a sensor that was not tared, with stamps that rolled over."""
    from gelforge.formats.mcap_import import Topics, import_recordings
    from gelforge.labelling.sensor import load_sensors
    from tests.benchmarks.attempts import ROOT
    from tests.unit import test_recordings as made

    film = made.FILM[:12]

    def imported(folder: Path, source: Path) -> tuple[dict, list[dict]]:
        (folder / "topics.toml").write_text(f'image = "{made.IMAGE}"\nwrench = "{made.WRENCH}"\n')
        sensor = load_sensors(ROOT / "workflow" / "sensors.toml")["gelsight_mini"]
        found = import_recordings(source, folder / "lab", Topics.read(folder / "topics.toml"), sensor)
        return found, made.read_csv(folder / "lab" / "log.csv")

    def off(rows: list[dict]) -> bool:
        """Whether each force is of its image's moment, to half the interval of the forces and a digit."""
        return len(rows) == len(film) and bool(np.abs(made.moments(rows) - film).max() < 6.0)

    def whole(folder: Path) -> Path:
        return made.write(folder / "a.mcap", made.filmed(film, lambda k: 0.0), made.ramp())

    def cut(fraction: float) -> Callable[[Path], object]:
        def run(folder: Path) -> object:
            path = whole(folder)
            path.write_bytes(path.read_bytes()[: int(fraction * path.stat().st_size)])
            return off(imported(folder, path)[1])

        return run

    yield Case("recordings", "whole", cut(1.0), True, True)
    for fraction in FRACTIONS:
        yield Case("recordings", f"cut to {fraction:.0%}", cut(fraction), True)

    def split(count: int) -> Callable[[Path], object]:
        def run(folder: Path) -> object:
            (folder / "bag").mkdir()
            for part in range(count):
                each = len(film) // count
                images = made.filmed(film, lambda k: 0.0)[each * part : each * (part + 1)]
                made.write(folder / "bag" / f"bag_{part}.mcap", images, made.ramp())
            rows = imported(folder, folder / "bag")[1]
            return off(rows) and len({row["press_id"] for row in rows}) == 1

        return run

    for count in (1, 2, 3, 12):
        yield Case("recordings", f"in {count} files", split(count), True, True)

    def pointer(folder: Path) -> object:
        (folder / "a.mcap").write_bytes(LFS)
        return imported(folder, folder / "a.mcap")

    yield Case("recordings", "a Git LFS pointer", pointer)

    def stamped(stamp: int) -> Callable[[Path], object]:
        def run(folder: Path) -> object:
            forces = [
                (time, made.wrench(stamp, -9.0) if k % 7 == 3 else said) for k, (time, said) in enumerate(made.ramp())
            ]
            path = made.write(folder / "a.mcap", made.filmed(film, lambda k: 0.0), forces)
            found, rows = imported(folder, path)
            # where the nearest wrench is left out the next one is 10 ms farther
            return (
                len(rows) == len(film)
                and bool(np.abs(made.moments(rows) - film).max() < 12.0)
                and bool(found["notes"])
            )

        return run

    for stamp in (0, 1, 2**31 * 10**9 - 1):
        yield Case("recordings", f"stamps of {stamp} ns among others", stamped(stamp), True, True)

    def tared(offset: float) -> Callable[[Path], object]:
        def run(folder: Path) -> object:
            forces = [(t, made.wrench(t - made.MS, said["wrench"]["force"]["z"] - offset)) for t, said in made.ramp()]
            path = made.write(folder / "a.mcap", made.filmed(film, lambda k: 0.0), forces)
            return any("tare the sensor" in note for note in imported(folder, path)[0]["notes"])

        return run

    for offset in (0.0, 5.0, 20.0):
        yield Case("recordings", f"{offset:g} N read all the time", tared(offset), offset > 0.2, True)


NEIGHBOURS: dict[str, Callable[[], Iterator[Case]]] = {
    "answers": answer_cases,
    "solids": solid_cases,
    "frames": frame_cases,
    "recordings": recording_cases,
}
