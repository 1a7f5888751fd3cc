"""`torch.autograd.gradcheck` of what the layers give, in float64, three lenses at two distances.

Outputs are summed up along rows and columns: a single pixel jumps as light goes from one to the next, and random weights of pixels would see that alone.
"""

import warnings

import numpy as np
import pytest

import isoplanat as iso
from conftest import SIZES, smooth

with warnings.catch_warnings():
    # Of torch's own parts.
    warnings.simplefilter("ignore")
    torch = pytest.importorskip("torch", reason="torch is not installed")
    from isoplanat.torch import LensLayer, PsfLayer, RayLayer, Sensor

LENSES = ["cooke_triplet", "double_gauss", "two_element"]
SIDE, MARGIN = 16, 16


def held(layer):
    """The layer as a function of one number each for its numbers, in steps of which each counts about as much, from 0 on; and how many there are."""
    numbers = {f"numbers.{kind}": number.detach().clone() for kind, number in layer.numbers.items()}
    sizes = {name: SIZES.get(name.split(".")[1], 1e-3) for name in numbers}

    def at(x, *arguments, **options):
        parts = x.split([len(number) for number in numbers.values()])
        moved = {name: number + sizes[name] * part for (name, number), part in zip(numbers.items(), parts)}
        return torch.func.functional_call(layer, moved, arguments, options)

    return at, sum(map(len, numbers.values()))


def sums(picture):
    """Sums over all rows above and columns before, of the order of 1."""
    return picture.cumsum(-1).cumsum(-2) / picture.shape[-1] ** 2


def check(function, count, step, rtol):
    torch.manual_seed(3)
    start = torch.zeros(count, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(function, start, eps=step, atol=1e-12, rtol=rtol, fast_mode=True)


@pytest.mark.parametrize("distance", [1000.0, float("inf")])
@pytest.mark.parametrize("name", LENSES)
def test_pictures(name, distance):
    lens = iso.Lens(name)
    radius = 0.5 * np.hypot(36, 24)
    frame = iso.Frame(columns=SIDE, rows=SIDE, pitch_um=1e3 * radius / (SIDE * np.sqrt(2)) * 0.5)
    layer = LensLayer(lens, frame, distances_mm=distance, trainable=["surface[*].curvature", "surface[*].thickness"], replan_every=0)
    at, count = held(layer)
    sensor = Sensor("generic", level=0.5)
    scenes = torch.tensor(smooth((2, 3, SIDE + 2 * MARGIN, SIDE + 2 * MARGIN), 5))
    options = {"margin": MARGIN, "illumination": True}
    for which in range(3):
        check(lambda x, k=which: sums(at(x, scenes, **options)[k]), count, 1e-3, 1e-6)

    def captured(x):
        captures, _, illumination = at(x, scenes, **options)
        return sums(sensor(captures, illumination=illumination, generator=torch.Generator().manual_seed(4)))

    check(captured, count, 1e-3, 1e-6)


@pytest.mark.parametrize("distance", [1000.0, float("inf")])
@pytest.mark.parametrize("name", LENSES)
def test_kernels(name, distance):
    options = {"fields_deg": [0, 8], "distances_mm": distance, "pitch_um": 20, "size": 15, "dtype": "float64", "replan_every": 0}
    layer = PsfLayer(iso.Lens(name), trainable=["surface[*].curvature", "surface[*].thickness"], **options)
    at, count = held(layer)
    check(lambda x: sums(at(x)), count, 1e-4, 1e-6)


@pytest.mark.parametrize("model", ["approximate", "on"])
def test_pictures_by_diffraction(model):
    lens = iso.Lens("phone")
    frame = iso.Frame(columns=SIDE, rows=SIDE, pitch_um=1.5)
    layer = LensLayer(lens, frame, trainable=["surface[*].curvature"], diffraction=model, replan_every=0)
    at, count = held(layer)
    scenes = torch.tensor(smooth((1, 3, SIDE + 2 * MARGIN, SIDE + 2 * MARGIN), 5))
    check(lambda x: sums(at(x, scenes, margin=MARGIN)[0]), count, 1e-3, 1e-4)


def rays(name, distance, side=5):
    """Rays from a point off the axis, at a distance or without end, into the first vertex plane."""
    y, x = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j]
    height = 0.3 * iso.Lens(name).inspect()["entrance_pupil_diameter_mm"]
    entry = np.stack([height * x, height * y, np.zeros_like(x)], -1)
    if np.isinf(distance):
        return torch.tensor(entry), torch.tensor([0.02, 0.1, 2.0], dtype=torch.float64)
    start = np.array([0.01 * distance, -0.05 * distance, -distance])
    return torch.tensor(np.broadcast_to(start, entry.shape).copy()), torch.tensor(entry - start)


@pytest.mark.parametrize("distance", [1000.0, float("inf")])
@pytest.mark.parametrize("name", LENSES)
def test_landings(name, distance):
    layer = RayLayer(iso.Lens(name), trainable=["surface[*].curvature", "surface[*].thickness"])
    at, count = held(layer)
    origins, directions = rays(name, distance)

    def landed(numbers, origins, directions):
        positions, cosines, paths, status = at(numbers, origins, directions)
        assert not status.any()
        return positions[..., :2], cosines, paths

    torch.manual_seed(3)
    given = [t.requires_grad_() for t in (torch.zeros(count, dtype=torch.float64), origins, directions)]
    for which in range(3):
        assert torch.autograd.gradcheck(lambda *x, k=which: landed(*x)[k], given, eps=1e-5, atol=1e-9, rtol=1e-6, fast_mode=True)
