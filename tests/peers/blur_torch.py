"""The frame of `cargo bench --bench blur -- tables` in PyTorch: hat-windowed patches, batched FFTs, overlap-add.

    cargo bench --bench blur -- export FOLDER
    python tests/peers/blur_torch.py FOLDER [threads]

Reads `kernels`, `source`, `bar`, `image` and `kernels_bar` (`.npy`), checks that PyTorch gives the same image and the
same kernel gradient, and prints the best time of several runs of each way to write it.
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


class Blur:
    def __init__(self, source, spacing, size, padded, way):
        self.source, self.spacing, self.size, self.padded, self.way = source, spacing, size, padded, way
        self.side = source.shape[-1]
        self.nodes = self.side // spacing + 1
        window = hat(spacing)
        self.window = window[:, None] * window[None, :]

    def __call__(self, kernels):
        d, n = self.spacing, self.nodes
        framed = torch.nn.functional.pad(self.source, (d, d, d, d))
        # [channel, node row, node col, 2d, 2d]; beyond the frame the source is zero, so the hats need no flat ends.
        patches = framed.unfold(1, 2 * d, d).unfold(2, 2 * d, d) * self.window
        s = (self.padded, self.padded)
        spectra = torch.fft.rfft2(patches, s=s) * torch.fft.rfft2(kernels, s=s)
        tiles = torch.fft.irfft2(spectra, s=s)
        length = (n - 1) * d + self.padded
        if self.way == "fold":
            columns = tiles.permute(0, 3, 4, 1, 2).reshape(tiles.shape[0], -1, n * n)
            canvas = torch.nn.functional.fold(columns, (length, length), s, stride=d)[:, 0]
        else:
            canvas = torch.zeros(tiles.shape[0], length, length)
            for i in range(n):
                for j in range(n):
                    canvas[:, i * d : i * d + self.padded, j * d : j * d + self.padded] += tiles[:, i, j]
        at = d + self.size // 2
        return canvas[:, at : at + self.side, at : at + self.side]


def best(work, runs):
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


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
    print(f"torch {torch.__version__}, {torch.get_num_threads()} threads")
    for padded in (2 * spacing + size - 1, 384):
        for way in ("fold", "slices"):
            blur = Blur(source, spacing, size, padded, way)

            def forward():
                with torch.no_grad():
                    return blur(kernels)

            def gradient():
                leaf = kernels.clone().requires_grad_()
                blur(leaf).backward(bar)
                return leaf.grad

            error = ((forward() - image).abs().max() / image.abs().max()).item()
            error_bar = ((gradient() - kernels_bar).abs().max() / kernels_bar.abs().max()).item()
            assert error < 2e-6 and error_bar < 2e-5, (error, error_bar)
            ahead, both = best(forward, 5), best(gradient, 4)
            print(
                f"padded {padded}, {way}: forward {ahead * 1e3:.0f} ms, {megapixels / ahead:.2f} Mpixel/s; with kernel "
                f"gradient {both * 1e3:.0f} ms, {megapixels / both:.2f} Mpixel/s; differences {error:.1e}, {error_bar:.1e}"
            )


if __name__ == "__main__":
    main()
