"""PSNR and SSIM of photographs against damaged versions of themselves, by scikit-image.

    python tests/peers/ssim_skimage.py [--write]

Recomputes `crates/imaging/src/metrics/ssim_skimage.json`, which a test of `imaging::metrics` holds this crate to, and compares; `--write`
replaces it. Photographs are ../shared/data/photos/eval; the damage is integer arithmetic on their 8-bit values, so that any
program can repeat it. Values are the 8-bit ones over 255, as seen, data range 1. Needs numpy, Pillow, scikit-image.
Exit code 1 where a number differs by more than 1e-12.
"""

import json
import sys
from pathlib import Path

import numpy as np
import skimage
from PIL import Image
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

ROOT = Path(__file__).resolve().parents[2]
PHOTOS = ROOT.parent / "shared/data/photos/eval"
RECORD = Path(__file__).parents[2] / "crates/imaging/src/metrics/ssim_skimage.json"
TOLERANCE = 1e-12


def blurred(v):
    """Mean of 3 x 3, rounded down after adding a half, the border repeated."""
    p = np.pad(v, ((1, 1), (1, 1), (0, 0)), mode="edge")
    rows, cols, _ = v.shape
    return (sum(p[i : i + rows, j : j + cols] for i in range(3) for j in range(3)) + 4) // 9


def noisy(v):
    """Plus -15 to 15 from a hash of row, column and channel, cut off at 0 and 255."""
    r, c, k = np.indices(v.shape)
    hashed = (r * 7919 + c * 104729 + k * 1299709 + 1) * 2654435761 % 2**32
    return np.clip(v + (hashed >> 16) % 31 - 15, 0, 255)


def coarse(v):
    """Eight levels."""
    return v // 32 * 32 + 16


PAIRS = [
    ("01.png", "blurred", blurred),
    ("05.png", "noisy", noisy),
    ("09.png", "coarse", coarse),
    ("13.png", "blurred", blurred),
    ("20.png", "noisy", noisy),
]


def numbers():
    for name, how, damage in PAIRS:
        picture = np.asarray(Image.open(PHOTOS / name).convert("RGB"), dtype=np.int64)
        a, b = picture / 255, damage(picture) / 255
        ssim = structural_similarity(
            a, b, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1
        )
        yield {"photo": name, "damage": how, "psnr_db": peak_signal_noise_ratio(a, b, data_range=1), "ssim": ssim}


def main():
    found = list(numbers())
    if "--write" in sys.argv[1:]:
        RECORD.write_text(json.dumps({"scikit_image": skimage.__version__, "pairs": found}, indent=1) + "\n")
    recorded = json.loads(RECORD.read_text())["pairs"]
    wrong = len(found) != len(recorded)
    for new, old in zip(found, recorded):
        error = max(abs(new[k] - old[k]) for k in ("psnr_db", "ssim"))
        differs = (new["photo"], new["damage"]) != (old["photo"], old["damage"]) or not error <= TOLERANCE
        wrong |= differs
        print(f"{new['photo']} {new['damage']:8} {new['psnr_db']:8.4f} dB  {new['ssim']:.6f}  {'DIFFERS' if differs else 'as recorded'}")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
