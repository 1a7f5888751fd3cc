"""The layer's gradient beside that of a step of ``isoplanat design``, recorded by a test of the program's own."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

import isoplanat as iso

with warnings.catch_warnings():
    # Of torch's own parts.
    warnings.simplefilter("ignore")
    torch = pytest.importorskip("torch", reason="torch is not installed")
    from isoplanat.torch import LensLayer, Sensor

RECORDED = json.loads((Path(__file__).parent / "chain_gradient.json").read_text(encoding="utf-8"))


def texels(side, seed):
    """The record's scenes: few bits, so that both programs make the same."""
    c, i, j = np.indices((3, side, side))
    return ((31 * c + 17 * i + 7 * j + i * j + 5 * seed) % 97) / 128


@pytest.mark.parametrize("known", RECORDED, ids=[known["lens"] for known in RECORDED])
def test_gradient_is_that_of_a_design(known):
    """1e-12 of its norm, by every number of the lens, through kernels, distortion, illumination, mosaic, flat field and truths."""
    frame = iso.Frame(known["columns"], known["rows"], known["pitch_um"], axis_px=known["axis_px"])
    layer = LensLayer(iso.Lens(known["lens"]), frame, trainable=known["names"])
    sensor = Sensor("generic", level=0.0)
    scenes = torch.tensor(np.stack([texels(known["side"] + 2 * known["margin"], seed) for seed in range(len(known["places"]))]))
    captures, truths, illumination = layer(scenes, place=known["places"], margin=known["margin"], illumination=True)
    loss = (sensor(captures, known["places"], illumination=illumination) - truths).square().sum()
    loss.backward()
    found = {name: value for kind, names in layer.names.items() for name, value in zip(names, layer.numbers[kind].grad.tolist())}
    gradient = np.array([found[name] for name in known["names"]])
    recorded = np.array(known["gradient"])
    norm = np.linalg.norm(recorded)
    assert norm > 1
    assert abs(loss.item() / known["loss"] - 1) < 1e-12
    assert np.abs(gradient - recorded).max() <= 1e-12 * norm
