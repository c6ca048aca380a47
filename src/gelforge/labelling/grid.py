"""The grid of label cells laid over an image."""

import re
from dataclasses import dataclass

from gelforge.errors import BadInput

LARGEST = 4096  # cells along one side; beyond a pixel per cell nothing is gained


@dataclass(frozen=True)
class Grid:
    """Cells of a label: `rows` along v (down), `cols` along u (right)."""

    rows: int
    cols: int

    @classmethod
    def parse(cls, text: str) -> "Grid":
        """Read "24x32"; anything but two positive integers raises BadInput."""
        found = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", text.strip(), re.ASCII)
        if not found or not all(0 < int(n) <= LARGEST for n in found.groups()):
            raise BadInput(
                f"resolution {text!r}: write ROWSxCOLS, two whole numbers from 1 to {LARGEST}, as RES=24x32"
            )
        return cls(*(int(n) for n in found.groups()))

    @classmethod
    def of(cls, resolution: "str | tuple[int, int]") -> "Grid":
        """The grid of "24x32" or (24, 32); anything else raises BadInput."""
        return cls.parse(resolution if isinstance(resolution, str) else "x".join(map(str, resolution)))

    def __str__(self) -> str:
        return f"{self.rows}x{self.cols}"

    @property
    def shape(self) -> tuple[int, int]:
        return self.rows, self.cols

    @property
    def cells(self) -> int:
        return self.rows * self.cols
