"""A lens and a U-Net trained in PyTorch by `LensSteps`, beside a run of `isoplanat design`: the same start, schedule, loss and size; both judged here on held-out photographs.

    isoplanat design lfov-30 --steps 400 --seed 1 --photos TRAIN -o run1
    python python/benches/steps_beside_design.py run1 --train TRAIN --judge EVAL --steps 400 --seed 1

Photographs, places, turns and noise are those of the run, drawn anew by `design_draws`; the first ten losses say whether they are. With `--begin RUN` (the same with `--steps 1`)
the network begins with the weights of that run.
"""

import argparse
import json
import math
from collections.abc import Iterable
from pathlib import Path

import isoplanat as iso
import numpy as np
import torch
from design_draws import Draws, photographs
from isoplanat.torch import LensLayer, LensSteps, Sensor
from torch import nn

# The task `lfov-30`.
FRAME = iso.Frame(4608, 512, 6.0, axis_px=(0.0, 0.0))
MOVING = ["surface[0..2].conic", "surface[3..5].conic", "surface[4].thickness"]
PATCH, BATCH, LENS_RATE, NETWORK_RATE, LENS_SHARE = 192, 4, 2e-3, 2e-3, (0.1, 0.85)
SLOPE = 0.25


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
    """Draws as tensors, in batches."""

    def __init__(self, photos: list[np.ndarray], size: int, seed: int) -> None:
        self.draws = Draws(photos, FRAME, size, seed)

    def seen(self, layer: LensLayer, sensor: Sensor, numbers: Iterable[int]) -> tuple[torch.Tensor, torch.Tensor]:
        """What the network sees of some, and its targets."""
        scenes, options, noise = self.asked(numbers)
        captures, truths, illumination = layer(scenes, **options, illumination=True)
        return sensor(captures, options["place"], illumination=illumination, draw=noise), truths

    def asked(self, numbers: Iterable[int]) -> tuple[torch.Tensor, dict, torch.Tensor]:
        """Scenes, what a layer is told of them, noise."""
        scenes, places, shifts, noise = zip(*map(self.draws.patch, numbers))
        options = {"place": list(places), "shift": list(shifts), "margin": self.draws.margin}
        return torch.tensor(np.stack(scenes)), options, torch.tensor(np.stack(noise), dtype=torch.float32)


def judged(lens: iso.Lens, network: nn.Module, photos: list[np.ndarray], count: int = 96) -> tuple[float, float]:
    """Mean PSNR of restored patches and of captures, linear light, dB."""
    layer, sensor, patches, found = LensLayer(lens, FRAME, trainable=MOVING).eval(), Sensor("generic"), Patches(photos, PATCH, 77), []
    with torch.no_grad():
        for first in range(0, count, BATCH):
            seen, truths = patches.seen(layer, sensor, range(first, first + BATCH))
            for of in (network(seen), seen):
                found.append(-10 * torch.log10((of - truths).square().mean((1, 2, 3))))
    return tuple(float(torch.cat(found[k::2]).mean()) for k in (0, 1))


def trained(first: iso.Lens, photos: list[np.ndarray], steps: int, seed: int, network: Unet) -> tuple[iso.Lens, Unet, list[float], list[float]]:
    """Lens and network by `LensSteps` and Adam; how far each step moved, and losses."""
    layer, sensor = LensLayer(first, FRAME, trainable=MOVING), Sensor("generic")
    constraints = {"track": (None, 1.2 * first.inspect()["length_mm"])}
    lens_steps = LensSteps(layer, lr=LENS_RATE, hold=["focal_length", "distortion"], constraints=constraints)
    adam = torch.optim.Adam(network.parameters(), lr=NETWORK_RATE)
    patches, small, lengths, losses = Patches(photos, PATCH, seed), Patches(photos, 96, seed ^ 0x6669_6E65), [], []
    for step in range(steps):
        used, (start, end) = step / steps, LENS_SHARE
        moves = start <= used < end
        if step == 0 or step % 100 == 0 and (step // 100).bit_count() == 1:
            scenes, options, _ = small.asked(step << 16 | k for k in range(6))
            print(step, layer.tune(scenes, **options), flush=True)
        adam.param_groups[0]["lr"] = NETWORK_RATE * rise_and_fall(used)
        for number in layer.parameters():
            number.requires_grad_(moves)
        seen, truths = patches.seen(layer, sensor, range(step * BATCH, (step + 1) * BATCH))
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
    return layer.lens, network, lengths, losses


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
    held_out = photographs(asked.judge)
    print("first lens", judged(first, nn.Identity(), held_out)[1], flush=True)
    by_design = judged(iso.Lens(asked.run / "lens.toml"), of_run(asked.run / "network.safetensors"), held_out)
    print(f"seed {asked.seed}, design: {by_design[0]:.3f} dB, captures {by_design[1]:.3f}", flush=True)
    torch.manual_seed(asked.seed)
    network = of_run(asked.begin / "network.safetensors") if asked.begin else Unet()
    lens, network, lengths, losses = trained(first, photographs(asked.train), asked.steps, asked.seed, network)
    log = np.genfromtxt(asked.run / "log.csv", delimiter=",", names=True)
    print(f"loss of the first ten steps {np.mean(losses[:10]):.6f}, of the run {log['loss'][0]:.6f}; path of the run {1e-2 * log['moved_um'].sum():.4f} mm", flush=True)
    by_torch = judged(lens, network, held_out)
    print(f"seed {asked.seed}, LensSteps: {by_torch[0]:.3f} dB, captures {by_torch[1]:.3f}, path {sum(lengths):.4f} mm", flush=True)
    if asked.save:
        asked.save.mkdir(parents=True, exist_ok=True)
        lens.save(asked.save / "lens.toml", force=True)
        torch.save(network.state_dict(), asked.save / "network.pt")


if __name__ == "__main__":
    main()
