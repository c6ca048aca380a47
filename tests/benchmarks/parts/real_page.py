"""One page with pictures of real sensors, what the network reads in them and how sure it is, and the figures."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from gelforge.flow.files import write_text
from gelforge.formats.featsfile import read_npy
from gelforge.reading.model import ForceModel
from gelforge.reading.reader import Reader
from gelforge.records.film import numbered
from gelforge.records.image import encode_png, read_image
from gelforge.records.nocontactimage import find_nocontact
from gelforge.reporting.forcemaps import (
    FULL_COLOUR_N,
    MARGIN_PX,
    PANEL_PX,
    WARNING_LINES,
    captioned,
    signed_colours,
    wrapped,
)
from gelforge.reporting.page import Section, render
from tests.benchmarks.parts.rig_page import figure_table
from tests.support.feats_film import feats_maps
from tests.support.figures import Figure
from tests.support.films import frames_of

A_ROW = 2  # pictures side by side
OF_THE_GIF = 12  # of FEATS' 51 presses


def read_over(predictor: Reader, image: np.ndarray) -> np.ndarray:
    """An image (h, w, 3) RGB below its totals and their intervals, beside its normal force below why it is flagged."""
    found = predictor(image)
    shown = found.image
    height = round(shown.shape[0] * PANEL_PX / shown.shape[1])
    normal = signed_colours(found.cells[2] / max(float(np.abs(found.cells[2]).max()), FULL_COLOUR_N[2]))
    why = wrapped(found.reason, PANEL_PX - 2 * MARGIN_PX, WARNING_LINES)
    lines = total_lines(found.total, found.half_width)
    return np.hstack([captioned(shown, lines, height), captioned(normal, why, height)])


def total_lines(total: np.ndarray, half_width: np.ndarray | None) -> list[str]:
    """Totals (3,) N and half of their intervals, as `live` reports them."""
    within = [""] * 3 if half_width is None else [f" +- {value:.1f}" for value in half_width]
    return [
        f"z {total[2]:+.1f}{within[2]} N",
        f"x {total[0]:+.2f}{within[0]}  y {total[1]:+.2f}{within[1]} N",
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
        "Left: the first frames at rest. Right: the frame that is least like them. Each with its normal force"
        " and totals with the intervals that hold nine of ten on unseen units of the rig."
    )
    pictures = []
    for path in films:
        images = frames_of(path)
        rest, _ = find_nocontact(numbered(images), str(path))
        hardest = max(images, key=lambda image: float(np.abs(image.astype(np.int16) - rest).mean()))
        predictor = Reader(rest, model=model)
        pictures += [read_over(predictor, rest), read_over(predictor, hardest)]
    for k, row in enumerate(rows_of(pictures)):
        section.picture(row, ", ".join(path.stem for path in films[k * A_ROW // 2 : (k + 1) * A_ROW // 2]))
    return section


def feats_sections(model: ForceModel, reference: Path) -> list[Section]:
    """FEATS' cuboid, and presses of its film beside FEATS' own normal maps."""
    rest = read_npy(reference / "feats/images/nocontact_train_sensor.npy")["gs_img"]
    predictor = Reader(rest, model=model)
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
