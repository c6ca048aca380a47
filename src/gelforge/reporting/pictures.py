"""Pictures of a dataset, as PNG bytes."""

import io

DPI = 110


def to_png(figure) -> bytes:
    """A matplotlib figure as PNG bytes; the figure is closed."""
    import matplotlib.pyplot as plt

    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DPI, bbox_inches="tight")
    plt.close(figure)
    return stream.getvalue()


def new_figure(rows: int, columns: int, width: float, height: float):
    """Axes on a figure that needs no screen."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt.subplots(rows, columns, figsize=(width, height), layout="constrained", squeeze=False)
