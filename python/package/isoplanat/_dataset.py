"""Data sets: pairs of capture and truth of lenses and photographs, made as files, and read."""

import csv
import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ._isoplanat import Frame, Lens, make_dataset, read_picture

__all__ = ["Dataset", "dataset"]

_Path = str | os.PathLike[str]
_Floats = npt.NDArray[np.float32]

_WHOLE = {"pair", "row", "column", "rows", "columns", "seed", "lens_index", "place"}
_TEXT = {"lens", "photo", "sensor", "capture", "truth"}


def _value(name: str, text: str) -> Any:
    if name in _TEXT:
        return text
    if not text:
        return None
    return int(text) if name in _WHOLE else float(text)


def _with_inf(said: Any, name: str = "") -> Any:
    """What JSON says, which has no infinity: distances that it gives as null are infinite."""
    if said is None and name in ("distance_mm", "distances_mm"):
        return math.inf
    if isinstance(said, list):
        return [_with_inf(value, name) for value in said]
    if isinstance(said, dict):
        return {key: _with_inf(value, key) for key, value in said.items()}
    return said


class Dataset(Sequence[tuple[_Floats, _Floats]]):
    """A data set that ``isoplanat.dataset`` or ``isoplanat dataset`` made: ``capture, truth = data[k]``, float32 arrays [3, row, col] of linear light.

    It is a sequence, as a ``torch.utils.data.DataLoader`` takes it, can be pickled, and opens files in the process that reads them.

    Parameters
    ----------
    folder : str or os.PathLike
        It must be whole: ``pairs.csv`` is there.

    Attributes
    ----------
    folder : pathlib.Path
    rows : list of dict
        The lines of ``pairs.csv``, with numbers as numbers; None where a line says nothing.
    settings : dict
        What ``dataset.json`` says.
    made : dict
        What ``isoplanat.dataset`` did: pairs, seconds, plans, judged and held; empty of a data set that was opened.

    Raises FileNotFoundError where there is none, or where parts of it are still to be made.
    """

    def __init__(self, folder: _Path) -> None:
        self.folder = Path(folder)
        about, table = self.folder / "dataset.json", self.folder / "pairs.csv"
        if not about.is_file():
            raise FileNotFoundError(f"{about}: reading: no such file; isoplanat.dataset makes data sets")
        if not table.is_file():
            raise FileNotFoundError(f"{table}: reading: no such file; it comes when all parts of the data set are made")
        self.settings: dict[str, Any] = _with_inf(json.loads(about.read_text(encoding="utf-8")))
        with table.open(newline="", encoding="utf-8") as lines:
            self.rows = [{k: _value(k, v) for k, v in row.items()} for row in csv.DictReader(lines)]
        self.made: dict[str, Any] = {}
        self._open: tuple[str, Any] = ("", None)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        row = self.rows[k]
        capture, truth = row["capture"], row["truth"]
        if capture.endswith(".npz"):
            shard = self._shard(capture)
            pair = [shard[name][row["place"]] for name in ("capture", "truth")]
        elif capture.endswith(".npy"):
            pair = [np.load(self.folder / file, mmap_mode="r")[row["place"]] for file in (capture, truth)]
        else:
            return read_picture(self.folder / capture), read_picture(self.folder / truth)
        return tuple(np.ascontiguousarray(np.moveaxis(np.asarray(image), -1, 0)) for image in pair)

    def __iter__(self) -> Iterator[tuple[_Floats, _Floats]]:
        return (self[k] for k in range(len(self)))

    def _shard(self, file: str) -> Any:
        """The arrays of an archive; the last one is kept."""
        if self._open[0] != file:
            with np.load(self.folder / file) as shard:
                self._open = (file, {name: shard[name] for name in ("capture", "truth")})
        return self._open[1]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": ("", None)}

    def __repr__(self) -> str:
        lenses = len({row["lens_index"] for row in self.rows})
        return f"<Dataset {os.fspath(self.folder)!r}: {len(self)} pairs of {lenses} {'lens' if lenses == 1 else 'lenses'}>"


def dataset(
    lenses: Lens | Sequence[Lens] | Mapping[str, Lens],
    photos: _Path,
    folder: _Path,
    *,
    frame: Frame | tuple[int, int] | None = None,
    distances_mm: float | Sequence[float] = (),
    crop: int | tuple[int, int] | None = None,
    crops: int = 1,
    texels_per_pixel: float | None = None,
    noise: _Path | None = None,
    noise_level: float | tuple[float, float] | None = None,
    flat_field: bool = False,
    illuminant: str | None = None,
    min_psnr_db: float = 45.0,
    diffraction: str | bool | None = None,
    judge: float = 0.0,
    judge_samples: int = 128,
    form: str = "npy",
    shard: int | None = None,
    index: int = 0,
    of: int = 1,
    seed: int = 1,
    force: bool = False,
    progress: Callable[[float, str], object] | None = None,
) -> Dataset | None:
    """Pairs of capture and truth of ``lenses`` and the photographs in a folder, as files in ``folder``; what is whole there already stays.

    Parameters
    ----------
    lenses : Lens, sequence of Lens, or dict of Lens by name
    photos : str or os.PathLike
        Folder of .png, .jpg, .tif, .npy.
    folder : str or os.PathLike
        Where the data set is made, or gone on with.
    frame : Frame or (columns, rows), optional
        One frame for all lenses, or so many pixels over each lens's own sensor; each lens's own raster where left out.
    distances_mm : float or sequence of float
        Object distances, each for every lens; inf is allowed. Each lens's own where left out. Lenses are not focused anew: at other distances than their own
        pictures are out of focus.
    crop : int or (columns, rows), optional
        Crops at random places of the frame in place of whole frames; ``crops`` of each photograph.
    texels_per_pixel : float, optional
        Pixels of the photograph that one of the frame sees: on the axis of whole frames, in the middle of crops. A photograph just fills the frame where
        left out.
    noise : "generic" or a sensor's file, optional
        Mosaic and noise of that sensor, demosaicked. ``noise_level`` times its own deviation, or drawn between two; 1 where left out.
    flat_field : bool
        Divide the falling light out.
    min_psnr_db : float
        What pictures are planned to hold against exact ones, before noise.
    diffraction : "auto", "on", "approximate" or "off"
        By what captures are made, as of `render`: "auto" where left out; "off" with ``judge``, since rays judge.
    judge : float
        Share of the pairs that rays judge, ``judge_samples`` a pixel.
    form : "npy", "npz", "png" or "tiff"
    shard : int, optional
        Pairs of a file of many, at most.
    index, of : int
        Which part of the work this process does.
    force : bool
        Whether another data set in the folder gives way.
    progress : callable, optional
        Called with the share that is done and what is worked on, from any thread. What it raises ends the work.

    Returns the `Dataset`, with ``made`` saying what was done; None while other parts are to be made.
    """
    if noise is None and noise_level is not None:
        raise ValueError('noise_level: given without noise; noise="generic", or a sensor\'s file')
    if noise is not None and not isinstance(noise, str | os.PathLike):
        raise TypeError(f'noise: {noise!r}; "generic", or a sensor\'s file')
    if isinstance(noise, str) and noise != "generic" and not Path(noise).exists():
        raise FileNotFoundError(f'noise: {noise}: no such file; "generic", or a sensor\'s file')
    given = 1.0 if noise_level is None else noise_level
    level = given if isinstance(given, Sequence) else (given, given)
    made = make_dataset(
        lenses if isinstance(lenses, Lens | dict) else dict(lenses) if isinstance(lenses, Mapping) else list(lenses),
        photos,
        folder,
        frame,
        distances_mm,
        (crop, crop) if isinstance(crop, int) else crop,
        crops,
        texels_per_pixel,
        noise,
        level,
        flat_field,
        illuminant,
        min_psnr_db,
        diffraction,
        judge,
        judge_samples,
        form,
        shard,
        index,
        of,
        seed,
        force,
        progress,
    )
    if not made["complete"]:
        return None
    data = Dataset(folder)
    data.made = _with_inf(made)
    return data
