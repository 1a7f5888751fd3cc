"""Patches as `isoplanat design` draws them, by number: the same photographs, places, turns and noise."""

import math
from pathlib import Path

import isoplanat as iso
import numpy as np

WORD = (1 << 64) - 1
STEP, TWIST = 0x2D358DCCAA6C78A5, 0x8BB84B93962EACC9
GOLDEN = 0x9E3779B97F4A7C15
# Largest side of a photograph that is kept, its middle.
LARGEST = 1024


def mixed(seed: int, counter: int) -> int:
    """SplitMix64 of a seed and a counter."""
    z = (seed ^ ((counter + 1) * GOLDEN)) & WORD
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 & WORD
    z = (z ^ (z >> 27)) * 0x94D049BB133111EB & WORD
    return z ^ (z >> 31)


class Wyrand:
    """The generator of the program's draws."""

    def __init__(self, seed: int) -> None:
        self.state = seed & WORD

    def word(self) -> int:
        """64 bits."""
        self.state = (self.state + STEP) & WORD
        product = self.state * (self.state ^ TWIST)
        return (product & WORD) ^ (product >> 64)

    def below(self, n: int) -> int:
        """A whole number from 0 to ``n - 1``, by Lemire's multiplication."""
        while True:
            product = self.word() * n
            if product & WORD >= n or product & WORD >= (-n & WORD) % n:
                return product >> 64

    def coin(self) -> bool:
        """True as often as False."""
        return self.word() & 1 == 0


def normal(seed: int, rows: int, columns: int) -> np.ndarray:
    """Standard normal numbers, by Box and Muller, a generator a row."""
    low, half = np.uint64(0xFFFFFFFF), np.uint64(32)
    with np.errstate(over="ignore"):
        seeds = np.array([mixed(seed, row) for row in range(rows)], dtype=np.uint64)[:, None]
        a = seeds + np.arange(1, 2 * ((columns + 1) // 2) + 1, dtype=np.uint64) * np.uint64(STEP)
        b = a ^ np.uint64(TWIST)
        # High words of products of 64 bits.
        cross = (a & low) * (b >> half), (a >> half) * (b & low)
        carry = (((a & low) * (b & low)) >> half) + (cross[0] & low) + (cross[1] & low)
        high = (a >> half) * (b >> half) + (cross[0] >> half) + (cross[1] >> half) + (carry >> half)
        uniform = ((a * b ^ high) >> np.uint64(1)) / 2.0**63
    radius, angle = np.sqrt(-2 * np.log1p(-uniform[:, ::2])), math.tau * uniform[:, 1::2]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1).reshape(rows, -1)[:, :columns]


def photographs(folder: Path) -> list[np.ndarray]:
    """The middles of a folder's photographs in the order of their names, linear light."""
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy"))
    kept = []
    for photo in map(iso.read_picture, files):
        sides = [min(n, LARGEST) for n in photo.shape[1:]]
        row, column = ((n - side) // 2 for n, side in zip(photo.shape[1:], sides))
        kept.append(np.ascontiguousarray(photo[:, row : row + sides[0], column : column + sides[1]]))
    return kept


class Draws:
    """Patches of ``size`` pixels on a frame, every step of image height as often as the others."""

    def __init__(self, photos: list[np.ndarray], frame: iso.Frame, size: int, seed: int) -> None:
        self.photos, self.size, self.seed = photos, size, seed

        def along(n: int) -> range:
            last = max(n - size, 0) // 4
            return range(0, 4 * last + 1, 4 * max(-(-last // 256), 1))

        columns, rows = (np.array(both) for both in np.meshgrid(along(frame.columns), along(frame.rows)))
        height = np.hypot(columns + size / 2 - frame.axis_px[0], rows + size / 2 - frame.axis_px[1]).ravel()
        order = np.lexsort((columns.ravel(), rows.ravel(), height))
        self.starts, height = np.stack([rows.ravel(), columns.ravel()], 1)[order], height[order]
        step = np.minimum(((height - height[0]) / np.ptp(height) * 64).astype(int), 63)
        self.shares = np.cumsum(1 / np.bincount(step, minlength=64)[step])
        self.shares /= self.shares[-1]
        # Texels of a photograph that a patch takes, and those of them around it.
        self.side = math.ceil(1.25 * size) + 160
        self.margin = (self.side - size) // 2

    def patch(self, number: int) -> tuple[np.ndarray, tuple[int, int], tuple[float, float], np.ndarray]:
        """A scene [3, row, column] with its margin, where it stands, its shift, and its noise [row, column]."""
        share = ((mixed(self.seed, 0) + number * GOLDEN) & WORD) >> 11
        k = min(int(np.searchsorted(self.shares, share / 2**53, side="right")), len(self.starts) - 1)
        random = Wyrand(mixed(self.seed ^ 0x7061_7463, number))
        scene = self.photos[random.below(len(self.photos))]
        scene = scene[:, ::-1] if random.coin() else scene
        scene = scene[:, :, ::-1] if random.coin() else scene
        scene = scene.transpose(0, 2, 1) if random.coin() else scene
        sides = [min(self.side, n) for n in scene.shape[1:]]
        row, column = (random.below(n - side + 1) for n, side in zip(scene.shape[1:], sides))
        scene = scene[:, row : row + sides[0], column : column + sides[1]]
        short = [self.size + 2 * self.margin - side for side in sides]
        before = [n // 2 for n in short]
        scene = np.pad(scene, [(0, 0), *((first, n - first) for first, n in zip(before, short))], mode="edge")
        # The texel behind a part's middle is seen by the middle of the pixel behind the patch's.
        down, across = (side // 2 + first - self.margin - self.size / 2 - 0.5 for side, first in zip(sides, before))
        place = (int(self.starts[k, 0]), int(self.starts[k, 1]))
        return scene, place, (down, across), normal(random.word(), self.size, self.size)
