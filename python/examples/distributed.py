"""A lens and a network trained together, by all processes that torchrun starts:

    torchrun --nproc-per-node 2 distributed.py

One process alone is `python distributed.py`. Each process renders and restores its share of every batch; DistributedDataParallel takes the mean of the
gradients, so that all processes take the same steps of the network and of the lens. The lens is rendered on the processors, cores ÷ processes each
(`isoplanat.set_threads` takes another number); the network runs where `--device` says.
"""

import argparse
import os

import isoplanat as iso
import numpy as np
import torch
from isoplanat.torch import LensLayer, LensSteps
from torch import distributed, nn
from torch.nn.parallel import DistributedDataParallel


class Camera(nn.Module):
    """A lens with what makes its captures better: captures, truths → squared error of the restored pictures."""

    def __init__(self, lens, frame):
        super().__init__()
        self.lens = LensLayer(lens, frame, trainable=["surface[*].curvature", "surface[*].thickness"])
        layers = [nn.Conv2d(3, 16, 3, padding=1), nn.ReLU(), nn.Conv2d(16, 16, 3, padding=1), nn.ReLU(), nn.Conv2d(16, 3, 3, padding=1)]
        self.network = nn.Sequential(*layers)

    def forward(self, scenes, place, margin):
        captures, truths = self.lens(scenes, place=place, margin=margin)
        return (captures + self.network(captures) - truths).square().mean()


def batch(step, rank, share, frame, size, margin, kind):
    """This process's share of a batch: scenes and their places, each drawn by its own number in the whole batch."""
    scenes, places = [], []
    for k in range(rank * share, (rank + 1) * share):
        draw = np.random.default_rng([step, k])
        side = size + 2 * margin
        scenes.append(iso.scene(["text", "dead_leaves", "facades"][draw.integers(3)], side, side, seed=int(draw.integers(1 << 30))))
        places.append([int(draw.integers(n - size + 1)) for n in (frame.rows, frame.columns)])
    return torch.tensor(np.stack(scenes)).to(kind), places


def main():
    told = argparse.ArgumentParser(description=__doc__.split(":")[0])
    told.add_argument("--lens", default="cooke_triplet")
    told.add_argument("--steps", type=int, default=40)
    told.add_argument("--batch", type=int, default=8, help="patches of all processes together")
    told.add_argument("--size", type=int, default=64, help="pixels of a patch's side")
    told.add_argument("--double", action="store_true", help="float64 throughout")
    told.add_argument("--device", default="cpu", help="of the network, such as cuda")
    told.add_argument("--gradients", metavar="FILE.npz", help="write the first step's gradients and end")
    told.add_argument("-o", "--output", metavar="LENS.toml", help="write the lens")
    told = told.parse_args()
    ranks, rank = int(os.environ.get("WORLD_SIZE", 1)), int(os.environ.get("RANK", 0))
    if told.batch % ranks:
        raise SystemExit(f"--batch: {told.batch}; a multiple of {ranks} processes: equal shares give the whole batch's gradient")
    if ranks > 1:
        distributed.init_process_group("gloo" if told.device == "cpu" else "nccl")
    torch.manual_seed(1)
    lens = iso.Lens(told.lens)
    pitch = float(np.hypot(lens.frame.columns, lens.frame.rows) * lens.frame.pitch_um / 600)
    frame = iso.Frame(480, 360, pitch)
    kind = torch.float64 if told.double else torch.float32
    camera = Camera(lens, frame).to(told.device, kind)
    steps = LensSteps(camera.lens, lr=2e-3), torch.optim.Adam(camera.network.parameters(), lr=1e-3)
    trained = DistributedDataParallel(camera) if ranks > 1 else camera
    for step in range(told.steps):
        margin = camera.lens.reach_px
        scenes, places = batch(step, rank, told.batch // ranks, frame, told.size, margin, kind)
        loss = trained(scenes.to(told.device), places, margin)
        camera.zero_grad()
        loss.backward()
        if told.gradients:
            if rank == 0:
                np.savez(told.gradients, **{name: p.grad.cpu().numpy() for name, p in camera.named_parameters()})
            break
        for optimizer in steps:
            optimizer.step()
        if rank == 0:
            print(f"{step}: {loss.item():.6f}, rays moved {1e3 * steps[0].last.length_mm:.3f} µm")
    if told.output and rank == 0 and not told.gradients:
        camera.lens.lens.save(told.output)
    if ranks > 1:
        distributed.destroy_process_group()


if __name__ == "__main__":
    main()
