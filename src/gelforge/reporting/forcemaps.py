"""Pictures of force maps."""

import numpy as np

from gelforge.records.axes import TITLES
from gelforge.records.image import write_png

# Colour maps of all pictures. SIGNED shows force along an axis in red and against it in blue, as the pages of the
# explorer and of `live` do; PRESSURE, which is against the axis, is a darker blue for more pressure.
SIGNED, PRESSURE = "RdBu_r", "Blues"
PANEL_PX = 380  # width of each panel of `write_maps`
# Text above a panel: OpenCV's plain font (cv2.FONT_HERSHEY_SIMPLEX) and its scale, line height, margin, number of
# lines. Five lines of a panel hold a file name and the longest reason for a flag.
FONT = (0, 0.5)
LINE_PX, MARGIN_PX, WARNING_LINES = 18, 6, 5
BAR_PX, SOFT = 12, (150, 150, 150)  # height of a colour bar; colour of frames
# Least force per cell of full colour, by channel. Predictions for a released gel are a tenth of it, and would
# otherwise look as strong as a press.
FULL_COLOUR_N = (0.005, 0.005, 0.03)


def write_maps(path, image, forces, title: str) -> None:
    """Write a PNG of an image (h, w, 3) RGB beside its force maps (3, rows, cols) in N per cell, with OpenCV only."""
    height = round(image.shape[0] * PANEL_PX / image.shape[1])
    panels = [captioned(image, wrapped(title, PANEL_PX - 2 * MARGIN_PX, WARNING_LINES), height, None)]
    for channel, force in enumerate(forces):
        span = max(float(np.abs(force).max()), FULL_COLOUR_N[channel])
        lines = [f"{TITLES[channel]}: {force.sum():+.3f} N", "N per cell:"]
        panels.append(captioned(signed_colours(force / span), lines, height, span))
    write_png(path, np.hstack(panels))


def captioned(picture, lines: list[str], height: int, span: float | None) -> np.ndarray:
    """A picture (h, w, 3) RGB in a frame, resized to PANEL_PX x `height` px, with lines of text above it.

    span: N per cell at both ends of the colour bar at the foot of the text; None for a picture without one.
    """
    import cv2

    how = cv2.INTER_NEAREST if picture.shape[1] < PANEL_PX else cv2.INTER_AREA
    panel = cv2.resize(picture, (PANEL_PX, height), interpolation=how)
    cv2.rectangle(panel, (0, 0), (PANEL_PX - 1, height - 1), SOFT)
    head = np.full((LINE_PX * WARNING_LINES, PANEL_PX, 3), 255, np.uint8)
    if span is not None:
        top, left, right = len(head) - BAR_PX - 3, 2 * MARGIN_PX, PANEL_PX - 2 * MARGIN_PX
        head[top : top + BAR_PX, left:right] = signed_colours(np.linspace(-1.0, 1.0, right - left)[None])
        for value, at in ((-span, left), (0.0, PANEL_PX // 2), (span, right)):
            text = f"{value:+.3g}" if value else "0"
            (width, _), _ = cv2.getTextSize(text, *FONT, 1)
            x = int(np.clip(at - width // 2, MARGIN_PX, PANEL_PX - MARGIN_PX - width))
            cv2.putText(head, text, (x, top - 5), *FONT, (0, 0, 0), 1, cv2.LINE_AA)
    for i, text in enumerate(lines):
        cv2.putText(head, text, (MARGIN_PX, 14 + LINE_PX * i), *FONT, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([head, panel])


def signed_colours(values) -> np.ndarray:
    """Values (rows, cols) from -1 to 1 as RGB: blue below, white at 0, red above."""
    strength = np.clip(np.abs(values), 0.0, 1.0)[..., None]
    ends = np.where(np.asarray(values)[..., None] > 0, (178, 24, 43), (33, 102, 172))
    return np.rint(255 + strength * (ends - 255)).astype(np.uint8)


def draw_component(axis, force, channel: int, note: str = "", **placed) -> None:
    """Draw the map (rows, cols) of one component of force, N per cell, with its name and total as title.

    note: text after the total. placed: further arguments of matplotlib's imshow.
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
    """Draw the map (rows, cols) of normal force, N per cell, compression negative; most: N of the darkest colour."""
    return axis.imshow(-force, cmap=PRESSURE, vmin=0, vmax=most)


def wrapped(text: str, width: int, most: int) -> list[str]:
    """Text in at most `most` lines no wider than `width` px; if it is longer, the last line ends in an ellipsis."""
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
