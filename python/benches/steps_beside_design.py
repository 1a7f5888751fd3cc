"""A lens and a U-Net trained in PyTorch by `LensSteps`, beside a run of `isoplanat design`: the same start, schedule, loss and size; both judged here on held-out photographs.

    isoplanat design lfov-30 --steps 400 --seed 1 --photos TRAIN -o run1
    python python/benches/steps_beside_design.py run1 --train TRAIN --judge EVAL --steps 400 --seed 1

With `--begin RUN` (the same with `--steps 1`) the network begins with the weights of that run. What differs then: draws of photographs, places and noise, and how finely kernels
are rendered, which `design` chooses as it goes.
"""

import argparse
import json
import math
from pathlib import Path

import isoplanat as iso
import numpy as np
import torch
from isoplanat.torch import LensLayer, LensSteps, Sensor
from torch import nn

# The task `lfov-30`.
FRAME = iso.Frame(4608, 512, 6.0, axis_px=(0.0, 0.0))
MOVING = ["surface[0..2].conic", "surface[3..5].conic", "surface[4].thickness"]
PATCH, BATCH, LENS_RATE, NETWORK_RATE, LENS_SHARE = 192, 4, 2e-3, 2e-3, (0.1, 0.85)
SLOPE = 0.25
GOLDEN = (math.sqrt(5) - 1) / 2


class Block(nn.Module):
    """Two convolutions with PReLU."""

    def __init__(self, seen: int, width: int) -> None:
        super().__init__()
        self.conv1, self.conv2 = nn.Conv2d(seen, width, 3, padding=1), nn.Conv2d(width, width, 3, padding=1)
        self.slope1, self.slope2 = (nn.Parameter(torch.full((width,), SLOPE)) for _ in range(2))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = nn.functional.prelu(self.conv1(x), self.slope1)
        return nn.functional.prelu(self.conv2(x), self.slope2)


class Unet(nn.Module):
    """Three scales; its output is added to the capture. Parameters are named as in a run's network.safetensors."""

    def __init__(self, width: int = 16, scales: int = 3) -> None:
        super().__init__()
        widths = [width << s for s in range(scales)]
        self.encoder = nn.ModuleList(Block(3 if s == 0 else widths[s - 1], w) for s, w in enumerate(widths))
        self.up = nn.ModuleList(nn.ConvTranspose2d(widths[s + 1], widths[s], 2, 2) for s in range(scales - 1))
        self.decoder = nn.ModuleList(Block(2 * w, w) for w in widths[:-1])
        self.output = nn.Conv2d(width, 3, 3, padding=1)
        # As a run's network begins: He's bound for PReLU, and near the capture.
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d):
                seen = layer.in_channels * (9 if isinstance(layer, nn.Conv2d) else 1)
                bound = math.sqrt(6.0 / ((1 + SLOPE**2) * seen)) * (0.01 if layer is self.output else 1.0)
                nn.init.uniform_(layer.weight, -bound, bound)
                nn.init.zeros_(layer.bias)

    def forward(self, capture: torch.Tensor) -> torch.Tensor:
        x, skips = capture, []
        for scale, block in enumerate(self.encoder):
            x = block(x if scale == 0 else nn.functional.max_pool2d(x, 2))
            skips.append(x)
        for scale in reversed(range(len(self.up))):
            x = self.decoder[scale](torch.cat([skips[scale], self.up[scale](x)], 1))
        return capture + self.output(x)


def of_run(file: Path) -> Unet:
    """The network of a run."""
    data = file.read_bytes()
    size = int.from_bytes(data[:8], "little")
    network, found = Unet(), {}
    known = network.state_dict()
    for name, entry in json.loads(data[8 : 8 + size]).items():
        if name in known:
            first, last = entry["data_offsets"]
            assert entry["dtype"] == "F32", entry
            values = np.frombuffer(data[8 + size + first : 8 + size + last], dtype="<f4").copy()
            found[name] = torch.tensor(values).reshape(known[name].shape)
    network.load_state_dict(found)
    return network


def rise_and_fall(used: float) -> float:
    """The schedule of `isoplanat design`."""
    return min((used + 1e-3) / 0.031, 1.0) * 0.5 * (1 + math.cos(math.pi * min(max(used, 0.0), 1.0)))


class Patches:
    """Patches of photographs, spread evenly over image height."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.photos = [iso.read_picture(file) for file in sorted(folder.iterdir()) if file.suffix in (".png", ".jpg")]
        self.rng = np.random.default_rng(seed)
        rows, columns = np.meshgrid(np.arange(0, FRAME.rows - PATCH + 1, 4), np.arange(0, FRAME.columns - PATCH + 1, 16), indexing="ij")
        self.places = np.stack([rows.ravel(), columns.ravel()], 1)
        height = np.hypot(*(self.places + PATCH / 2).T)
        step = np.minimum(((height - height.min()) / np.ptp(height) * 64).astype(int), 63)
        order = np.argsort(height)
        weight = (1.0 / np.bincount(step, minlength=64)[step])[order]
        self.places, self.shares, self.number = self.places[order], np.cumsum(weight / weight.sum()), self.rng.random()

    def draw(self, count: int, margin: int) -> tuple[torch.Tensor, list[tuple[int, int]]]:
        """Scenes and places."""
        side, scenes, places = PATCH + 2 * margin, [], []
        for _ in range(count):
            photo = self.photos[self.rng.integers(len(self.photos))]
            short = [max(0, side - n) for n in photo.shape[1:]]
            photo = np.pad(photo, [(0, 0), (0, short[0]), (0, short[1])], mode="symmetric") if any(short) else photo
            row, column = (self.rng.integers(n - side + 1) for n in photo.shape[1:])
            scene = np.rot90(photo[:, row : row + side, column : column + side], self.rng.integers(4), (1, 2))
            scenes.append(scene[:, :, ::-1] if self.rng.integers(2) else scene)
            self.number = (self.number + GOLDEN) % 1.0
            k = min(int(np.searchsorted(self.shares, self.number)), len(self.places) - 1)
            places.append((int(self.places[k, 0]), int(self.places[k, 1])))
        return torch.tensor(np.ascontiguousarray(np.stack(scenes), dtype=np.float32)), places


def pictures(layer: LensLayer, sensor: Sensor, scenes: torch.Tensor, places: list[tuple[int, int]], margin: int, draw: torch.Generator | None = None):
    """What the network sees, and its targets."""
    captures, truths, illumination = layer(scenes, place=places, margin=margin, illumination=True)
    return sensor(captures, places, illumination=illumination, generator=draw), truths


def judged(lens: iso.Lens, network: nn.Module, folder: Path, count: int = 96) -> tuple[float, float]:
    """Mean PSNR of restored patches and of captures, linear light, dB."""
    layer, sensor = LensLayer(lens, FRAME, trainable=MOVING).eval(), Sensor("generic")
    patches, draw, found = Patches(folder, 77), torch.Generator().manual_seed(77), []
    with torch.no_grad():
        for _ in range(count // 4):
            margin = 64
            seen, truths = pictures(layer, sensor, *patches.draw(4, margin), margin, draw)
            for of in (network(seen), seen):
                found.append(-10 * torch.log10((of - truths).square().mean((1, 2, 3))))
    return tuple(float(torch.cat(found[k::2]).mean()) for k in (0, 1))


def trained(first: iso.Lens, folder: Path, steps: int, seed: int, network: Unet) -> tuple[iso.Lens, Unet, list[float]]:
    """Lens and network by `LensSteps` and Adam."""
    layer, sensor = LensLayer(first, FRAME, trainable=MOVING), Sensor("generic")
    constraints = {"track": (None, 1.2 * first.inspect()["length_mm"])}
    lens_steps = LensSteps(layer, lr=LENS_RATE, hold=["focal_length", "distortion"], constraints=constraints)
    adam = torch.optim.Adam(network.parameters(), lr=NETWORK_RATE)
    patches, lengths, losses = Patches(folder, seed), [], []
    for step in range(steps):
        used, (start, end) = step / steps, LENS_SHARE
        moves = start <= used < end
        adam.param_groups[0]["lr"] = NETWORK_RATE * rise_and_fall(used)
        margin = min(layer.reach_px, 96)
        scenes, places = patches.draw(BATCH, margin)
        for number in layer.parameters():
            number.requires_grad_(moves)
        seen, truths = pictures(layer, sensor, scenes, places, margin)
        loss = (network(seen) - truths).abs().mean()
        adam.zero_grad()
        lens_steps.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        adam.step()
        if moves:
            lens_steps.param_groups[0]["lr"] = max(LENS_RATE * rise_and_fall((used - start) / (end - start)), 1e-9)
            lens_steps.step()
            lengths.append(lens_steps.last.length_mm)
        losses.append(float(loss.detach()))
        if step % 20 == 19:
            print(step + 1, f"loss {np.mean(losses[-20:]):.5f}", f"held by {lens_steps.last.held_by if moves else '-'}", flush=True)
    return layer.lens, network, lengths


def main() -> None:
    """Prints a table's rows."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("run", type=Path)
    words.add_argument("--train", type=Path, required=True)
    words.add_argument("--judge", type=Path, required=True)
    words.add_argument("--steps", type=int, default=400)
    words.add_argument("--seed", type=int, default=1)
    words.add_argument("--begin", type=Path, help="a run of `isoplanat design` of one step")
    words.add_argument("--save", type=Path, help="folder for the lens and network that PyTorch trained")
    asked = words.parse_args()
    first = iso.Lens(asked.run / "lens-first.toml")
    print("first lens", judged(first, nn.Identity(), asked.judge)[1], flush=True)
    by_design = judged(iso.Lens(asked.run / "lens.toml"), of_run(asked.run / "network.safetensors"), asked.judge)
    print(f"seed {asked.seed}, design: {by_design[0]:.3f} dB, captures {by_design[1]:.3f}", flush=True)
    torch.manual_seed(asked.seed)
    network = of_run(asked.begin / "network.safetensors") if asked.begin else Unet()
    lens, network, lengths = trained(first, asked.train, asked.steps, asked.seed, network)
    by_torch = judged(lens, network, asked.judge)
    print(f"seed {asked.seed}, LensSteps: {by_torch[0]:.3f} dB, captures {by_torch[1]:.3f}, path {sum(lengths):.4f} mm", flush=True)
    if asked.save:
        asked.save.mkdir(parents=True, exist_ok=True)
        lens.save(asked.save / "lens.toml", force=True)
        torch.save(network.state_dict(), asked.save / "network.pt")


if __name__ == "__main__":
    main()
