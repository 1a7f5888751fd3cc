"""Patches of scenes before a lens: distances by number, sizes, and what PyTorch and JAX both say of them."""

from collections.abc import Iterable, Sequence
from numbers import Integral
from typing import Any

from ._isoplanat import Frame, Layer


def which(known: Sequence[float], asked: Iterable[float]) -> list[int]:
    """The numbers of ``asked`` distances among the ``known`` ones, mm, which may be infinite. Raises ValueError for another."""
    found = []
    for distance in asked:
        near = min(range(len(known)), key=lambda k: abs(1 / known[k] - 1 / distance) if distance else 1.0)
        if not distance or not abs(1 / known[near] - 1 / distance) <= 1e-6 * abs(1 / distance) + 1e-15:
            raise ValueError(f"distance_mm: {distance:g}; one of {', '.join(f'{k:g}' for k in known)} (distances_mm)")
        found.append(near)
    return found


def pairs(name: str, asked: Iterable[Iterable[Any]]) -> list[tuple[float, float]]:
    """Two numbers for each scene, down and across. Raises ValueError for something else."""
    try:
        return [(float(down), float(across)) for down, across in asked]
    except (TypeError, ValueError):
        raise ValueError(f"{name}: {asked}; a pair (row, column) for each scene") from None


class Placed:
    """What has a frame before which patches stand."""

    _core: Layer

    @property
    def distances_mm(self) -> list[float]:
        """Object distances, mm."""
        return self._core.distances_mm

    @property
    def frame(self) -> Frame:
        """The sensor."""
        return self._core.frame

    @property
    def reach_px(self) -> int:
        """How far the light of a pixel comes from, at most: a margin of so many texels leaves no pixel that sees past its scene."""
        return self._core.reach_px

    def _patch(self, shape: Sequence[int], margin: int) -> tuple[int, int]:
        """Rows and columns of a patch of scenes of a shape [B, 3, H, W]. Raises ValueError for what is none."""
        if len(shape) != 4 or shape[1] != 3 or not shape[0]:
            raise ValueError(f"scenes: shape {tuple(shape)}; [B, 3, H, W] with one or more")
        rows, columns = shape[2:]
        if not isinstance(margin, Integral) or not 0 <= 2 * margin < min(rows, columns):
            raise ValueError(f"margin: {margin}; 0 to less than half of {rows} rows and {columns} columns")
        rows, columns, frame = rows - 2 * margin, columns - 2 * margin, self.frame
        if rows > frame.rows or columns > frame.columns:
            raise ValueError(f"scenes: patches of {rows} × {columns} pixels; at most the frame, {frame.rows} × {frame.columns}")
        return rows, columns
