"""Pictures of a dataset, as PNG bytes."""

import io

import numpy as np

from gelforge.records.image import encode_png

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


def press_3d(mesh, nodes: np.ndarray, displacement: np.ndarray, force: np.ndarray, stl, travel) -> bytes:
    """The deformed gel surface, the forces on it, and the indenter where it ended.

    mesh: GelMesh; nodes (s,) its surface nodes with displacement (s, 3) mm and force (s, 3) N;
    stl: path of the posed indenter surface; travel (3,) mm moves it to the end of the path.
    """
    import pyvista as pv

    moved = mesh.nodes.copy()
    moved[nodes] += displacement
    corners = mesh.faces[:, : 4 if mesh.kind == "hex8" else 3]
    cells = np.column_stack([np.full(len(corners), corners.shape[1]), corners]).ravel()
    gel = pv.PolyData(moved, cells)
    gel["indentation, mm"] = np.bincount(nodes, -displacement[:, 2], len(moved))
    plotter = pv.Plotter(off_screen=True, window_size=(1300, 640))
    bar = {"position_x": 0.68, "position_y": 0.04, "width": 0.28, "fmt": "%.1f"}
    plotter.add_mesh(gel, scalars="indentation, mm", cmap="viridis", show_edges=True, edge_color="#44505c",
                     line_width=0.4, scalar_bar_args=bar)  # fmt: skip
    plotter.add_mesh(pv.read(stl).translate(travel), color="#c8ccd2", opacity=0.25)
    touched = np.flatnonzero(np.linalg.norm(force, axis=1) > 0)
    if len(touched):
        # An arrow ends where its force acts, because one that starts there is hidden in the gel.
        arrows = force[touched] * (3.0 / np.linalg.norm(force[touched], axis=1).max())
        points = pv.PolyData(moved[nodes[touched]] - arrows)
        points["force"] = arrows
        plotter.add_mesh(points.glyph(orient="force", scale="force", factor=1.0), color="#d1495b")
    plotter.camera_position = [(19, -23, 17), (1, -1, -1.5), (0, 0, 1)]
    picture = plotter.screenshot(None, return_img=True)
    plotter.close()
    return encode_png(picture)
