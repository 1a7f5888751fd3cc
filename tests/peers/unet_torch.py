"""The table of `cargo bench --bench network -- tables` in PyTorch: a training step of the same networks.

    python tests/peers/unet_torch.py [threads]

Two 3x3 convolutions with PReLU (one slope a channel) at every scale, max-pooling, 2x2 transposed convolution, skips by
concatenation, a global skip; mean absolute difference, Adam. Every line is measured in a process of its own, in the
usual order of memory and with channels last.
"""

import os
import subprocess
import sys
import time

import torch
from torch import nn

WARM_UPS, STEPS = 3, 10
CASES = {"three": 3, "seven": 7}


def width(scale):
    return 32 << min(scale, 4)


class Block(nn.Sequential):
    def __init__(self, inputs, outputs):
        super().__init__(
            nn.Conv2d(inputs, outputs, 3, padding=1),
            nn.PReLU(outputs),
            nn.Conv2d(outputs, outputs, 3, padding=1),
            nn.PReLU(outputs),
        )


class Unet(nn.Module):
    def __init__(self, scales):
        super().__init__()
        self.encoder = nn.ModuleList(Block(width(s - 1) if s else 3, width(s)) for s in range(scales))
        self.up = nn.ModuleList(nn.ConvTranspose2d(width(s + 1), width(s), 2, 2) for s in range(scales - 1))
        self.decoder = nn.ModuleList(Block(2 * width(s), width(s)) for s in range(scales - 1))
        self.output = nn.Conv2d(width(0), 3, 3, padding=1)

    def forward(self, x):
        features, skips = x, []
        for scale, block in enumerate(self.encoder):
            if scale:
                features = nn.functional.max_pool2d(features, 2)
            features = block(features)
            skips.append(features)
        for scale in reversed(range(len(self.decoder))):
            features = self.decoder[scale](torch.cat([skips[scale], self.up[scale](features)], 1))
        return x + self.output(features)


def status(key):
    """A line of /proc/self/status, KiB."""
    with open("/proc/self/status") as lines:
        return next(int(line.split()[1]) for line in lines if line.startswith(key))


def measure(name, order, threads):
    torch.set_num_threads(threads)
    torch.manual_seed(1)
    memory = torch.channels_last if order == "last" else torch.contiguous_format
    model = Unet(CASES[name]).to(memory_format=memory)
    optimiser = torch.optim.Adam(model.parameters(), lr=1e-4)
    x, target = (torch.rand(1, 3, 256, 256).to(memory_format=memory) for _ in range(2))

    def step():
        optimiser.zero_grad(set_to_none=True)
        nn.functional.l1_loss(model(x), target).backward()
        optimiser.step()

    with open("/proc/self/clear_refs", "w") as peak:
        peak.write("5")
    built = status("VmHWM:")
    for _ in range(WARM_UPS):
        step()
    before, seconds = time.process_time(), []
    for _ in range(STEPS):
        start = time.perf_counter()
        step()
        seconds.append(time.perf_counter() - start)
    busy = (time.process_time() - before) / STEPS
    seconds.sort()
    median = (seconds[STEPS // 2 - 1] + seconds[STEPS // 2]) / 2
    parameters = sum(p.numel() for p in model.parameters()) * 1e-6
    peak = (status("VmHWM:") - built) / 1024
    print(
        f"| {name}, channels {order} | {parameters:.2f} | {median * 1e3:.0f} | {seconds[0] * 1e3:.0f} "
        f"| {busy * 1e3:.0f} | {peak:.0f} |"
    )


def main():
    arguments = sys.argv[1:]
    if arguments[:1] == ["measure"]:
        return measure(arguments[1], arguments[2], int(arguments[3]))
    threads = arguments[0] if arguments else "2"
    print(f"torch {torch.__version__}, {threads} threads\n")
    print("| network | 10^6 parameters | step, ms: median | least | processor time | peak above the built model, MiB |")
    print("|---|---|---|---|---|---|", flush=True)
    for name in CASES:
        for order in ("first", "last"):
            # Idle threads of OpenMP would otherwise spin and count as processor time.
            environment = {**os.environ, "OMP_WAIT_POLICY": "passive", "GOMP_SPINCOUNT": "0"}
            command = [sys.executable, __file__, "measure", name, order, threads]
            subprocess.run(command, check=True, env=environment)


if __name__ == "__main__":
    main()
