"""What the tests of the installed package share: the programs to compare with, and differences that are steady."""

import os
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]


def program(name):
    """A program of this repository: in the folder that ISOPLANAT_PROGRAMS names, in target/release, or in PATH."""
    named = os.environ.get("ISOPLANAT_PROGRAMS")
    for folder in [named] if named else [ROOT / "target" / "release"]:
        path = Path(folder) / name
        if path.is_file():
            return path
    if named:
        raise FileNotFoundError(f"{name} is not in {named}, which ISOPLANAT_PROGRAMS names")
    found = shutil.which(name)
    if not found:
        pytest.skip(f"{name} is neither in target/release nor in PATH")
    return Path(found)


@pytest.fixture
def command(tmp_path):
    """Runs the program `isoplanat` in a folder of its own."""
    import subprocess

    path = program("isoplanat")

    def run(*arguments):
        done = subprocess.run([path, *map(str, arguments)], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.fixture(autouse=True)
def no_warnings():
    """A warning that nobody asked for is a failure."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Of JAX, once its tests have imported it: no worker here uses it.
        warnings.filterwarnings("ignore", message=r"os\.fork\(\) was called", category=RuntimeWarning)
        yield


def difference(f, first, steps=9):
    """The derivative of `f` at 0 by central differences of fourth order, of the step that agrees best with the next: at kinks of a texture large steps are off,
    by rounding small ones. The derivative, and how far the two are apart."""
    sizes = [first * 10 ** (-k / 2) for k in range(steps)]
    found = [(8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h) for h in sizes]
    apart = [abs(a - b) for a, b in zip(found, found[1:])]
    k = int(np.argmin(apart))
    return found[k + 1], apart[k]


# How far a number is moved, and how much of it a derivative by 1 is.
SIZES = {"curvature": 1e-3, "thickness": 1e-1, "n_d": 1e-2, "v_d": 1.0, "conic": 1e-1, "entrance_pupil_diameter": 1e-1}


def direction(lens, gradient, seed):
    """A direction in all numbers of `lens` that rays depend on, in which each adds about as much: by name."""
    rng = np.random.default_rng(seed)
    chosen = {}
    for name, slope in gradient.items():
        kind = name.split(".")[-1]
        size = SIZES.get(kind)
        if kind.startswith("dispersion_"):
            size = 1e-2
        if kind.startswith("a") and kind[1:].isdigit():
            # A change of the sag of about 0.1 mm at 6 mm from the axis.
            size = 0.1 / 6.0 ** int(kind[1:])
        if size and slope:
            chosen[name] = rng.uniform(0.5, 1.5) * np.sign(slope) * min(size, 1.0 / abs(slope))
    return chosen


def moved(lens, direction, by):
    """`lens` moved along a direction."""
    now = lens.parameters
    return lens.replace({name: now[name] + by * step for name, step in direction.items()})


def frame_of(lens, columns=96, rows=64, spread=600):
    """A raster of `spread` pixels over the diagonal of the lens's own sensor, of which it takes a part around the axis."""
    import isoplanat as iso

    own = lens.frame
    return iso.Frame(columns, rows, float(np.hypot(own.columns, own.rows) * own.pitch_um / spread))


def smooth(shape, seed):
    """Scenes without edges, so that a difference of small steps is that of a smooth function: an array of float64."""
    rng = np.random.default_rng(seed)
    i, j = np.mgrid[: shape[-2], : shape[-1]]
    waves = [0.2 * np.sin(rng.uniform(0.075, 0.3) * i + rng.uniform(0.075, 0.3) * j + rng.uniform(0, 6)) for _ in range(2 * shape[0] * shape[1])]
    return 0.5 + np.sum(np.reshape(waves, (2, *shape)), 0)
