"""gelforge: contact-force labels for optical tactile sensors, by finite elements.

In Python, without make:

    import gelforge
    press = gelforge.solve("sphere_10", depth=0.5)
    print(press.total)  # N on the gel along its x, y, z
    cells = gelforge.label(press, resolution="24x32")  # N, (3, rows, cols)
    forces, verdict = gelforge.predict(image, nocontact=nocontact)

    read = gelforge.Reader(nocontact=nocontact)  # many images of one sensor
    found = read(image)  # found.total +- found.half_width N, found.cells, found.flag
    for one in read.stream(images):  # as they come from a camera
        print(one.total)

Importing this loads nothing else; each name is loaded when it is first used.
"""

from typing import Any as _Any

__version__ = "0.2.0"
__all__ = ["ForceReading", "Reader", "Sensor", "SolvedPress", "label", "predict", "solve"]

_HOMES = {
    "solve": "gelforge.api",
    "label": "gelforge.api",
    "predict": "gelforge.reading.reader",
    "Reader": "gelforge.reading.reader",
    "Sensor": "gelforge.labelling.sensor",
    "SolvedPress": "gelforge.api",
    "ForceReading": "gelforge.reading.forcereading",
}


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> _Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'gelforge' has no attribute {name!r}; it has {', '.join(__all__)}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
