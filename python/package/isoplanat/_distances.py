"""Object distances by number."""

from collections.abc import Iterable, Sequence


def which(known: Sequence[float], asked: Iterable[float]) -> list[int]:
    """The numbers of ``asked`` distances among the ``known`` ones, mm, which may be infinite. Raises ValueError for another."""
    found = []
    for distance in asked:
        near = min(range(len(known)), key=lambda k: abs(1 / known[k] - 1 / distance) if distance else 1.0)
        if not distance or not abs(1 / known[near] - 1 / distance) <= 1e-6 * abs(1 / distance) + 1e-15:
            raise ValueError(f"distance_mm: {distance:g}; one of {', '.join(f'{k:g}' for k in known)} (distances_mm)")
        found.append(near)
    return found
