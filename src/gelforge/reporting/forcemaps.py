"""Pictures of force maps."""

import numpy as np

from gelforge.records.axes import TITLES
from gelforge.records.image import write_png

# Colour maps, the same in every picture. Of a component: red along its axis, blue against it, as on the pages of the
# explorer and of `live`. Of pressure: light where nothing presses, the darker, the harder.
SIGNED, PRESSURE = "RdBu_r", "OrRd"
PANEL_PX = 380  # width of each of the panels of a written map
# Text beside a picture: OpenCV's plain font (cv2.FONT_HERSHEY_SIMPLEX) and its scale, in lines of so many px. Three lines
# of 640 px hold the longest sentence that a picture is flagged by.
FONT = (0, 0.5)
LINE_PX, MARGIN_PX, WARNING_LINES = 22, 6, 3
# Force per cell that full colour stands for at least, by channel: what a network reads in a released gel is a tenth of
# it, and would else be drawn as strong as a press.
FULL_COLOUR_N = (0.005, 0.005, 0.03)


def write_maps(path, image, forces, title: str) -> None:
    """Write a PNG of an image (h, w, 3) RGB beside its force maps (3, rows, cols) in N per cell, by OpenCV alone."""
    height = round(image.shape[0] * PANEL_PX / image.shape[1])
    panels = [captioned(image, wrapped(title, PANEL_PX - 2 * MARGIN_PX, WARNING_LINES), height)]
    for channel, force in enumerate(forces):
        span = max(float(np.abs(force).max()), FULL_COLOUR_N[channel])
        lines = [f"{TITLES[channel]}: {force.sum():+.3f} N", f"full colour: {span:.3g} N per cell"]
        panels.append(captioned(signed_colours(force / span), lines, height))
    write_png(path, np.hstack(panels))


def captioned(picture, lines: list[str], height: int) -> np.ndarray:
    """A picture (h, w, 3) RGB, PANEL_PX wide and so high, with lines of text above it."""
    import cv2

    how = cv2.INTER_NEAREST if picture.shape[1] < PANEL_PX else cv2.INTER_AREA
    panel = cv2.resize(picture, (PANEL_PX, height), interpolation=how)
    head = np.full((LINE_PX * WARNING_LINES, PANEL_PX, 3), 255, np.uint8)
    for i, text in enumerate(lines):
        cv2.putText(head, text, (MARGIN_PX, 17 + LINE_PX * i), *FONT, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([head, panel])


def signed_colours(values) -> np.ndarray:
    """Values (rows, cols) from -1 to 1 as RGB: blue below, white at 0, red above."""
    strength = np.clip(np.abs(values), 0.0, 1.0)[..., None]
    ends = np.where(np.asarray(values)[..., None] > 0, (178, 24, 43), (33, 102, 172))
    return np.rint(255 + strength * (ends - 255)).astype(np.uint8)


def draw_component(axis, force, channel: int, note: str = "", **placed) -> None:
    """Draw the map (rows, cols) of one component of force, N per cell, under its name and total.

    note: what is said behind the total. placed: where and how the map lies, as matplotlib's imshow takes it.
    """
    span = max(float(np.abs(force).max()), 1e-6)
    shown = axis.imshow(force, cmap=SIGNED, vmin=-span, vmax=span, **placed)
    axis.set_title(f"{TITLES[channel]}: {force.sum():+.3f} N{note}", fontsize=9)
    axis.figure.colorbar(shown, ax=axis, shrink=0.85, label="N per cell")


def maps_figure(forces, title: str):
    """Matplotlib figure of the three maps (3, rows, cols) of force, N per cell."""
    from gelforge.reporting.canvas import canvas_with_axes

    figure, axes = canvas_with_axes(1, 3, 13.0, 3.9)
    for channel, axis in enumerate(axes[0]):
        draw_component(axis, forces[channel], channel)
        axis.set(xticks=[], yticks=[])
    figure.suptitle(title, fontsize=10)
    return figure


def draw_pressure(axis, force, most: float):
    """Draw the map (rows, cols) of normal force, N per cell, compression negative; most: what the darkest colour means."""
    return axis.imshow(-force, cmap=PRESSURE, vmin=0, vmax=most)


def wrapped(text: str, width: int, most: int) -> list[str]:
    """Text in lines no wider than `width` px; where it needs more than `most` of them, the last one ends in an ellipsis."""
    import cv2

    def fits(line: str) -> bool:
        return cv2.getTextSize(line, *FONT, 1)[0][0] <= width

    lines: list[str] = []
    for word in text.split():
        if lines and fits(f"{lines[-1]} {word}"):
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    if len(lines) <= most:
        return lines
    last = lines[most - 1]
    while last and not fits(f"{last} ..."):
        last = last.rpartition(" ")[0]
    return [*lines[: most - 1], f"{last} ..."]
