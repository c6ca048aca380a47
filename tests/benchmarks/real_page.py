"""One page with pictures of real sensors, what the network reads in them and how sure it is, and the figures."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from gelforge.flow.files import write_text
from gelforge.formats.numpy_pickle import read_npy
from gelforge.networks.checkpoint.modelfile import ForceModel
from gelforge.networks.inference.predictor import Predictor
from gelforge.records.axes import CHANNEL_OF_AXIS
from gelforge.records.film import numbered
from gelforge.records.image import encode_png, read_image
from gelforge.records.nocontactimage import find_nocontact
from gelforge.reporting.forcemaps import FONT, FULL_COLOUR_N, LINE_PX, MARGIN_PX, WARNING_LINES, wrapped
from gelforge.reporting.page import Section, render
from tests.benchmarks.figures import Figure
from tests.benchmarks.films import frames_of
from tests.benchmarks.real import feats_maps
from tests.benchmarks.rig_page import figure_table

A_ROW = 4  # pictures side by side
OF_THE_GIF = 12  # of FEATS' 51 presses
ARROW_PX_PER_N = 400.0  # a typical shear of 0.02 N per cell becomes an arrow of 8 px
LONGEST_ARROW_PX = 24.0
TEXT_BGR, WARNING_BGR = (230, 230, 230), (60, 60, 255)


def overlay(image, forces, lines: list[str], warning: str = "", zoom: int = 1) -> np.ndarray:
    """Return a picture (BGR) of a frame (h, w, 3) BGR with heat by normal force, arrows by shear, and text below."""
    height, width = image.shape[0] * zoom, image.shape[1] * zoom
    picture = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
    pressure = np.clip(-forces[2], 0, None)
    fraction = cv2.resize(pressure / max(float(pressure.max()), FULL_COLOUR_N[2]), (width, height))
    heat = cv2.applyColorMap((255 * np.clip(fraction, 0, 1)).astype(np.uint8), cv2.COLORMAP_INFERNO)
    weight = 0.7 * np.clip(fraction, 0, 1)[..., None]
    picture = (picture * (1 - weight) + heat * weight).astype(np.uint8)
    draw_arrows(picture, forces)
    return np.vstack([picture, footer(width, lines, warning)])


def footer(width: int, lines: list[str], warning: str) -> np.ndarray:
    """Text (h, width, 3) BGR below a picture, the warning in red; as high without one, because films have one size."""
    drawn = np.zeros((LINE_PX * (len(lines) + WARNING_LINES), width, 3), np.uint8)
    red = wrapped(warning, width - 2 * MARGIN_PX, WARNING_LINES)
    for i, (text, colour) in enumerate(
        [*((line, TEXT_BGR) for line in lines), *((line, WARNING_BGR) for line in red)]
    ):
        cv2.putText(drawn, text, (MARGIN_PX, 17 + LINE_PX * i), *FONT, colour, 1, cv2.LINE_AA)
    return drawn


def draw_arrows(picture, forces) -> None:
    """Draw the shear of every second cell that carries some onto a picture, in place."""
    rows, cols = forces.shape[1:]
    high, wide = picture.shape[0] / rows, picture.shape[1] / cols
    # FEATS' channels: 0 runs along gel y and 1 along gel x, both opposite to u and v in the image.
    shear = -forces[:2] * ARROW_PX_PER_N
    for i in range(0, rows, 2):
        for j in range(0, cols, 2):
            du, dv = shear[0, i, j], shear[1, i, j]
            length = float(np.hypot(du, dv))
            if length >= 2:
                shrink = min(1.0, LONGEST_ARROW_PX / length)
                start = (round((j + 0.5) * wide), round((i + 0.5) * high))
                end = (round(start[0] + du * shrink), round(start[1] + dv * shrink))
                cv2.arrowedLine(picture, start, end, (255, 255, 255), 1, cv2.LINE_AA, tipLength=0.3)


def read_over(predictor: Predictor, image: np.ndarray) -> np.ndarray:
    """An image (h, w, 3) RGB with its force map, totals and their intervals on it, and why it is flagged."""
    found = predictor.predict(image)
    lines = total_lines(found.total, found.half_width)
    drawn = overlay(cv2.cvtColor(found.image, cv2.COLOR_RGB2BGR), found.cells, lines, found.reason)
    return cv2.cvtColor(drawn, cv2.COLOR_BGR2RGB)


def total_lines(total: np.ndarray, half_width: np.ndarray | None) -> list[str]:
    """Totals (3,) N and half of their intervals, in the channels' order, reported along the gel's axes as `live` does."""
    within = [""] * 3 if half_width is None else [f" +- {value:.1f}" for value in half_width]
    x, y, z = CHANNEL_OF_AXIS
    return [
        f"z {total[z]:+.1f}{within[z]} N",
        f"x {total[x]:+.2f}{within[x]}  y {total[y]:+.2f}{within[y]} N",
    ]


def strip(pictures: Sequence[np.ndarray]) -> bytes:
    """RGB pictures side by side as PNG."""
    height = max(len(picture) for picture in pictures)
    padded = [np.pad(p, ((0, height - len(p)), (0, 6), (0, 0)), constant_values=255) for p in pictures]
    return encode_png(np.hstack(padded))


def rows_of(pictures: list[np.ndarray]) -> Iterator[bytes]:
    """Pictures in rows, as PNG."""
    for start in range(0, len(pictures), A_ROW):
        yield strip(pictures[start : start + A_ROW])


def film_section(model: ForceModel, films: Sequence[Path]) -> Section:
    """Of each film its no-contact image and the frame that is least like it."""
    section = Section("Films of grippers").text(
        "Left: the first frames at rest. Right: the frame that is least like them, with the normal force as heat, the"
        " sideways force as arrows, and totals with the intervals that hold nine of ten on unseen units of the rig."
    )
    pictures = []
    for path in films:
        images = frames_of(path)
        rest, _ = find_nocontact(numbered(images), str(path))
        hardest = max(images, key=lambda image: float(np.abs(image.astype(np.int16) - rest).mean()))
        predictor = Predictor(model, rest)
        pictures += [read_over(predictor, rest), read_over(predictor, hardest)]
    for k, row in enumerate(rows_of(pictures)):
        section.picture(row, ", ".join(path.stem for path in films[k * A_ROW // 2 : (k + 1) * A_ROW // 2]))
    return section


def feats_sections(model: ForceModel, reference: Path) -> list[Section]:
    """FEATS' cuboid, and presses of its film beside FEATS' own normal maps."""
    rest = read_npy(reference / "feats/images/nocontact_train_sensor.npy")["gs_img"]
    predictor = Predictor(model, rest)
    cuboid = read_image(reference / "feats/images/cuboid_10-2-284.png")[..., :3]
    one = Section("FEATS' 10 mm cuboid").picture(
        strip([rest, cuboid, read_over(predictor, cuboid)]),
        "No-contact image of another day, pressed 2.3 mm, and as it is read.",
    )
    presses = feats_maps(reference / "feats/images/demo.gif", rest)
    pictures = []
    for image, normal in presses[:: max(1, len(presses) // OF_THE_GIF)][:OF_THE_GIF]:
        theirs = cv2.applyColorMap(np.uint8(255 * normal), cv2.COLORMAP_INFERNO)[..., ::-1]
        pictures += [cv2.resize(theirs, (320, 240), interpolation=cv2.INTER_NEAREST), read_over(predictor, image)]
    section = Section("FEATS' film").text(
        "Left: its own normal map, scaled to itself. Right: what is read here. FEATS places forces at 14 px/mm where pictures"
        " show 15.8, so its maps are a ninth smaller."
    )
    for row in rows_of(pictures):
        section.picture(row, "")
    return [one, section]


def write_page(path: Path, model: ForceModel, reference: Path, films: Sequence[Path], figures: list[Figure]) -> None:
    """Write the page."""
    sections = [figure_table(figures), film_section(model, films), *feats_sections(model, reference)]
    lead = "No force was measured beside these pictures. The network learnt from the virtual rig alone."
    write_text(path, render("real sensors", lead, sections))
