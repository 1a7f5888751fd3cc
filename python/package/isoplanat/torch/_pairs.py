"""Pairs of capture and truth for a network, rendered as they are asked for."""

import math
import operator
import os
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from .._isoplanat import Frame, Layer, Lens, read_picture

_ENDINGS = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy"}


class PairDataset(Dataset[tuple[torch.Tensor, torch.Tensor]]):
    """Pairs that are rendered as they are asked for: ``capture, truth = pairs[k]``, float32 [3, size, size], of a lens, photograph, place and distance drawn by k.

    Parameters
    ----------
    lenses : Lens, sequence of Lens, or dict of Lens by name
    photos : str or os.PathLike, or sequence of them, or of arrays [3, row, col]
        A folder of .png, .jpg, .tif, .npy; such files; or linear light.
    size : int
        Pixels of a patch's side.
    frame : Frame, optional
        Each lens's own raster where left out.
    distances_mm : float or sequence of float, optional
        Object distances; each lens's own where left out.
    length : int
        Pairs of an epoch.
    seed : int
    brightness : (float, float)
        Light of a scene is times a number between these.
    flips : bool
        Whether scenes are turned and mirrored.
    keep : int
        Photographs that each process keeps in memory.

    Pair k of an epoch is the same in every process and with any number of workers; `set_epoch` draws others. Workers are welcome, forked or spawned:
    ``DataLoader(pairs, batch_size=8, num_workers=2)``. A lens is planned once a process.
    """

    def __init__(
        self,
        lenses: Lens | Sequence[Lens] | Mapping[str, Lens],
        photos: str | os.PathLike[str] | Sequence[Any],
        size: int = 128,
        *,
        frame: Frame | None = None,
        distances_mm: float | Sequence[float] | None = None,
        length: int = 1000,
        seed: int = 1,
        brightness: tuple[float, float] = (0.5, 1.0),
        flips: bool = True,
        keep: int = 32,
    ) -> None:
        several = [lenses] if isinstance(lenses, Lens) else list(lenses.values() if isinstance(lenses, Mapping) else lenses)
        if not several:
            raise ValueError("lenses: none; one or more")
        for name, number, least in (("size", size, 1), ("length", length, 1), ("keep", keep, 1), ("seed", seed, 0)):
            if not isinstance(number, Integral) or number < least:
                raise ValueError(f"{name}: {number}; a whole number from {least}")
        try:
            low, high = brightness
            sound = 0 < low <= high < math.inf
        except (TypeError, ValueError):
            sound = False
        if not sound:
            raise ValueError(f"brightness: {brightness}; two numbers above 0, the first not larger")
        # The smallest set of numbers: none of them moves here.
        self._cores = [Layer(lens, frame, distances_mm, [next(iter(lens.parameters))], None) for lens in several]
        for core in self._cores:
            if size > min(core.frame.rows, core.frame.columns):
                raise ValueError(f"size: {size}; at most the frame, {core.frame.rows} × {core.frame.columns}")
        self._margin = [core.reach_px for core in self._cores]
        self._files: list[Path] = []
        self._arrays: list[Any] = []
        if isinstance(photos, str | os.PathLike):
            folder = Path(photos)
            if not folder.is_dir():
                raise FileNotFoundError(f"{folder}: reading: no such folder; photographs (.png, .jpg, .tif, .npy)")
            self._files = sorted(f for f in folder.iterdir() if f.suffix.lower() in _ENDINGS)
        elif len(photos) and all(isinstance(photo, str | os.PathLike) for photo in photos):
            self._files = [Path(photo) for photo in photos]
            missing = next((f for f in self._files if not f.is_file()), None)
            if missing:
                raise FileNotFoundError(f"{missing}: reading: no such file; photographs (.png, .jpg, .tif, .npy)")
        else:
            # One array is one photograph, or one a number of its first axis.
            shape = tuple(getattr(photos, "shape", ()))
            if len(shape) == 2 or len(shape) == 3 and shape[0] in (1, 3):
                photos = [photos]
            elif shape and len(shape) != 4:
                raise ValueError(f"photos: one array of shape {shape}; a list of [3, row, col] or [row, col], one of them, or [count, 3, row, col]")
            for k, photo in enumerate(photos):
                kind = np.asarray(photo).dtype
                if kind.kind != "f":
                    raise TypeError(f"photos: number {k} is of {kind}; linear light in floating point, as iso.read_picture gives it")
                if not np.isfinite(photo).all():
                    raise ValueError(f"photos: number {k} has NaN or inf; finite light")
            self._arrays = [self._coloured(np.ascontiguousarray(p, dtype=np.float32), k) for k, p in enumerate(photos)]
        if not self._files and not self._arrays:
            raise ValueError("photos: none; a folder of .png, .jpg, .tif, .npy, or arrays [3, row, col]")
        self.size, self.length, self.seed, self.epoch = size, length, seed, 0
        self.brightness, self.flips, self.keep = brightness, flips, keep
        self._kept: OrderedDict[int, Any] = OrderedDict()

    def set_epoch(self, epoch: int) -> None:
        """Draws other pairs. Workers that live on (``persistent_workers=True``) do not hear of it."""
        self.epoch = epoch

    def __len__(self) -> int:
        return self.length

    @staticmethod
    def _coloured(photo: Any, k: int) -> Any:
        """A grey photograph is one of three equal channels."""
        if photo.ndim == 2 or photo.ndim == 3 and photo.shape[0] == 1:
            return np.broadcast_to(photo if photo.ndim == 3 else photo[None], (3, *photo.shape[-2:]))
        if photo.ndim != 3 or photo.shape[0] != 3:
            raise ValueError(f"photos: number {k} has the shape {photo.shape}; [3, row, col] or [row, col]")
        return photo

    def _photo(self, k: int) -> Any:
        if k in self._kept:
            self._kept.move_to_end(k)
            return self._kept[k]
        photo = self._arrays[k] if self._arrays else self._coloured(read_picture(self._files[k]), k)
        self._kept[k] = photo
        while len(self._kept) > self.keep:
            self._kept.popitem(last=False)
        return photo

    def __getitem__(self, k: int) -> tuple[torch.Tensor, torch.Tensor]:
        k = operator.index(k)
        if not -self.length <= k < self.length:
            raise IndexError(f"pair {k} of {self.length}")
        draw = np.random.default_rng([self.seed, self.epoch, k % self.length])
        which = int(draw.integers(len(self._cores)))
        core, margin = self._cores[which], self._margin[which]
        photo = self._photo(int(draw.integers(len(self._arrays or self._files))))
        side = self.size + 2 * margin
        # A photograph that is too small goes on with its mirror image.
        short = [max(0, side - n) for n in photo.shape[1:]]
        if any(short):
            photo = np.pad(photo, [(0, 0), (0, short[0]), (0, short[1])], mode="symmetric")
        row, column = (int(draw.integers(n - side + 1)) for n in photo.shape[1:])
        scene = photo[:, row : row + side, column : column + side]
        turns, mirror, light = int(draw.integers(4)), bool(draw.integers(2)), float(draw.uniform(*self.brightness))
        if self.flips:
            scene = np.rot90(scene, turns, (1, 2))
            scene = scene[:, :, ::-1] if mirror else scene
        scene = np.ascontiguousarray(light * scene, dtype=np.float32)[None]
        frame = core.frame
        place = (int(draw.integers(frame.rows - self.size + 1)), int(draw.integers(frame.columns - self.size + 1)))
        distance = int(draw.integers(len(core.distances_mm)))
        captures, truths, *_ = core.record(np.asarray(core.values), scene, [distance], [place], margin, [(0.0, 0.0)])
        return torch.from_numpy(captures[0]), torch.from_numpy(truths[0])

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": OrderedDict()}
