"""The frame of `cargo bench --bench blur -- tables` in PyTorch, with batched FFTs, in two forms:

- `hats`: the same sum as ours. Every node blurs the patch of the image that its hat covers, the hats multiply the
  outputs, and the patches are added (`fold`, or slice by slice). Image and kernel gradient must be ours.
- `cut`: the hard cut that tiled renderers make. One kernel a tile of the image, no windows: less work, another image.

    cargo bench --bench blur -- export FOLDER
    python tests/peers/blur_torch.py FOLDER [threads]

Reads `kernels`, `source`, `bar`, `image` and `kernels_bar` (`.npy`) and prints the best time of several runs.
"""

import sys
import time

import numpy as np
import torch


def load(folder, name):
    return torch.from_numpy(np.load(f"{folder}/{name}.npy"))


def hat(spacing):
    """One axis of the window over the patch that starts `spacing` before its node."""
    return 1 - (torch.arange(2 * spacing) - spacing).abs().float() / spacing


class Hats:
    def __init__(self, source, spacing, size, padded, way):
        self.spacing, self.size, self.padded, self.way = spacing, size, padded, way
        self.side = source.shape[-1]
        self.nodes = self.side // spacing + 1
        window = hat(spacing)
        self.window = window[:, None] * window[None, :]
        # [channel, node row, node col, 2d + k - 1, 2d + k - 1]: what the patch around a node sees.
        margin = spacing + size // 2
        framed = torch.nn.functional.pad(source, (margin, margin, margin, margin))
        seen = 2 * spacing + size - 1
        self.patches = framed.unfold(1, seen, spacing).unfold(2, seen, spacing)

    def __call__(self, kernels):
        d, n, first = self.spacing, self.nodes, self.size - 1
        s = (self.padded, self.padded)
        spectra = torch.fft.rfft2(self.patches, s=s) * torch.fft.rfft2(kernels, s=s)
        tiles = torch.fft.irfft2(spectra, s=s)[..., first : first + 2 * d, first : first + 2 * d] * self.window
        length = (n + 1) * d
        if self.way == "fold":
            columns = tiles.permute(0, 3, 4, 1, 2).reshape(tiles.shape[0], -1, n * n)
            canvas = torch.nn.functional.fold(columns, (length, length), (2 * d, 2 * d), stride=d)[:, 0]
        else:
            canvas = torch.zeros(tiles.shape[0], length, length)
            for i in range(n):
                for j in range(n):
                    canvas[:, i * d : i * d + 2 * d, j * d : j * d + 2 * d] += tiles[:, i, j]
        return canvas[:, d : d + self.side, d : d + self.side]


class Cut:
    def __init__(self, source, spacing, size, padded):
        self.size, self.padded = size, padded
        half = size // 2
        framed = torch.nn.functional.pad(source, (half, half, half, half))
        # [channel, tile row, tile col, d + k - 1, d + k - 1]
        self.patches = framed.unfold(1, spacing + size - 1, spacing).unfold(2, spacing + size - 1, spacing)
        self.spacing = spacing

    def __call__(self, kernels):
        d, first, s = self.spacing, self.size - 1, (self.padded, self.padded)
        spectra = torch.fft.rfft2(self.patches, s=s) * torch.fft.rfft2(kernels, s=s)
        tiles = torch.fft.irfft2(spectra, s=s)[..., first : first + d, first : first + d]
        c, n, m = tiles.shape[:3]
        return tiles.permute(0, 1, 3, 2, 4).reshape(c, n * d, m * d)


def best(work, runs):
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def times(blur, kernels, bar, runs):
    def forward():
        with torch.no_grad():
            return blur(kernels)

    def gradient():
        leaf = kernels.clone().requires_grad_()
        blur(leaf).backward(bar)
        return leaf.grad

    return forward(), gradient(), best(forward, runs), best(gradient, runs)


def main():
    folder, threads = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 2
    torch.set_num_threads(threads)
    source = load(folder, "source")[:, 0]
    stored = load(folder, "kernels")[:, :, 0]
    size = stored.shape[-1]
    nodes = int(round(stored.shape[0] ** 0.5))
    spacing = source.shape[-1] // (nodes - 1)
    # [channel, node row, node col, k, k]
    kernels = stored.permute(1, 0, 2, 3).reshape(stored.shape[1], nodes, nodes, size, size).contiguous()
    bar, image = load(folder, "bar"), load(folder, "image")
    kernels_bar = load(folder, "kernels_bar")[:, :, 0].permute(1, 0, 2, 3).reshape(kernels.shape)
    megapixels = source.shape[-1] ** 2 * 1e-6

    def report(name, ahead, both, more=""):
        print(
            f"{name}: forward {ahead * 1e3:.0f} ms, {megapixels / ahead:.2f} Mpixel/s; with kernel gradient "
            f"{both * 1e3:.0f} ms, {megapixels / both:.2f} Mpixel/s{more}",
            flush=True,
        )

    print(f"torch {torch.__version__}, {torch.get_num_threads()} threads")
    padded = spacing + size - 1
    _, _, ahead, both = times(Cut(source, spacing, size, padded), kernels[:, :-1, :-1].contiguous(), bar, 12)
    report(f"cut, padded {padded}", ahead, both)
    for way in ("fold", "slices"):
        padded = 2 * spacing + size - 1
        y, grad, ahead, both = times(Hats(source, spacing, size, padded, way), kernels, bar, 4)
        error = ((y - image).abs().max() / image.abs().max()).item()
        error_bar = ((grad - kernels_bar).abs().max() / kernels_bar.abs().max()).item()
        assert error < 2e-6 and error_bar < 2e-5, (error, error_bar)
        report(f"hats, {way}, padded {padded}", ahead, both, f"; differences {error:.1e}, {error_bar:.1e}")


if __name__ == "__main__":
    main()
