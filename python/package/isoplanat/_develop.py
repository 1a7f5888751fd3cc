"""RAW captures through a kit, by the program ``isoplanat-camera``."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ._isoplanat import read_picture

__all__ = ["develop"]

_HOW = "`cargo install --path .` in Isoplanat's folder installs it; or name it in ISOPLANAT_CAMERA"


def develop(raw: str | os.PathLike[str], kit: str | os.PathLike[str] | None = None) -> npt.NDArray[np.float32]:
    """The picture that ``isoplanat-camera`` makes of a RAW capture: float32 array [3, row, col], linear light.

    Parameters
    ----------
    raw : str or os.PathLike
        A RAW file (DNG and what the program reads beside it).
    kit : str or os.PathLike, optional
        Folder of a kit, whose network restores the picture.

    The program is looked for in PATH, or is what ISOPLANAT_CAMERA names; it is a program of its own because it brings RAW decoders and network runtimes.

    Raises FileNotFoundError where there is no such program or file, ValueError with the program's text for what it refuses.
    """
    program = os.environ.get("ISOPLANAT_CAMERA") or shutil.which("isoplanat-camera")
    if program is None:
        raise FileNotFoundError(f"isoplanat-camera: not found in PATH; {_HOW}")
    raw = Path(raw)
    if not raw.exists():
        raise FileNotFoundError(f"{raw}: reading: no such file")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "picture.tif"
        command = [program, os.fspath(raw.absolute()), "--linear", "--float", "-o", os.fspath(out)]
        if kit is not None:
            command += ["--kit", os.fspath(Path(kit).absolute())]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError as error:
            raise FileNotFoundError(f"{program}: {error.strerror}; {_HOW}") from error
        if done.returncode != 0 or not out.exists():
            lines = [line for line in done.stderr.splitlines() if line.strip()]
            text = lines[-1] if lines else f"isoplanat-camera ended with {done.returncode}"
            kind = ValueError if done.returncode == 2 else RuntimeError
            raise kind(text)
        picture: npt.NDArray[np.float32] = read_picture(out)
        return picture
