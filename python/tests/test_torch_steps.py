"""Steps of a lens by a loss of PyTorch; kernels, a sensor and pairs beside the layer; two processes."""

import copy
import pickle
import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import isoplanat as iso
from conftest import ROOT, frame_of

with warnings.catch_warnings():
    # Of torch's own parts.
    warnings.simplefilter("ignore")
    torch = pytest.importorskip("torch", reason="torch is not installed")
    from isoplanat.torch import LensLayer, LensSteps, PairDataset, PsfLayer, RayLayer, Sensor


def scenes_of(count, side, first=0):
    return torch.tensor(np.stack([iso.scene("text", side, side, seed=first + k) for k in range(count)]))


def a_loss(layer, scenes):
    captures, truths = layer(scenes, margin=8)
    return (captures - truths).square().mean()


def test_steps_keep_what_is_held():
    lens = iso.Lens("cooke_triplet")
    thickness = lens.parameters["surface[5].thickness"]
    off = lens.replace({"surface[5].thickness": thickness + 0.6})
    layer = LensLayer(off, frame_of(lens, 64, 64, 2400), trainable=["surface[*].curvature", "surface[*].thickness"], replan_every=5)
    steps = LensSteps(layer, lr=2e-2, hold=["focal_length", "track"])
    assert steps.held["track"][1] == pytest.approx(sum(off.parameters[f"surface[{k}].thickness"] for k in range(6)), rel=1e-12)
    focal, scenes, losses = off.inspect()["effective_focal_length_mm"], scenes_of(2, 64), []
    schedule = torch.optim.lr_scheduler.LinearLR(steps, 1.0, 0.1, total_iters=40)
    for _ in range(40):
        loss = a_loss(layer, scenes)
        steps.zero_grad()
        loss.backward()
        steps.step()
        schedule.step()
        losses.append(loss.item())
        assert steps.last.moved and steps.last.length_mm <= 10 * 2e-2 and 0 <= steps.last.signal <= 1
    assert losses[-1] < 0.3 * losses[0], losses
    found = layer.lens
    assert found.inspect()["effective_focal_length_mm"] == pytest.approx(focal, rel=1e-5)
    assert sum(found.parameters[f"surface[{k}].thickness"] for k in range(6)) <= steps.held["track"][1] * (1 + 1e-6)
    assert steps.violation() < 1e-5 and "focal_length" in steps.last.held_by


def test_a_step_is_as_long_as_its_rate():
    """Gradients that agree: rays move by the rate, root mean square, as a trace of them says."""
    lens = iso.Lens("cooke_triplet")
    layer = LensLayer(lens, frame_of(lens, 64, 64), trainable=["surface[*].curvature", "surface[*].thickness"])
    steps = LensSteps(layer, lr=1e-3, hold=[])
    a_loss(layer, scenes_of(2, 48)).backward()
    steps.step()
    assert 0.1e-3 < steps.last.length_mm <= 1.01e-3, steps.last
    moved = layer.lens.parameters
    assert any(moved[name] != lens.parameters[name] for names in layer.names.values() for name in names)


@pytest.mark.parametrize("first", [3, 6])
def test_steps_go_on_where_they_were(first):
    """To the bit, in between two layouts, before the first new one and after it."""
    lens = iso.Lens("double_gauss")

    def made():
        layer = LensLayer(lens, frame_of(lens, 48, 48), trainable="surface[*].curvature", replan_every=4)
        return layer, LensSteps(layer, lr=1e-3)

    def run(layer, steps, numbers):
        for k in numbers:
            steps.zero_grad()
            a_loss(layer, scenes_of(1, 40, k)).backward()
            steps.step()

    layer, steps = made()
    run(layer, steps, range(first))
    kept = copy.deepcopy((layer.state_dict(), steps.state_dict()))
    run(layer, steps, range(first, 10))
    other, again = made()
    other.load_state_dict(kept[0])
    again.load_state_dict(kept[1])
    run(other, again, range(first, 10))
    for kind in layer.names:
        assert torch.equal(layer.numbers[kind], other.numbers[kind])
    # Of other numbers, another lens, another optimizer: refused.
    fewer = LensLayer(lens, frame_of(lens, 48, 48), trainable="surface[1].curvature")
    with pytest.raises(ValueError, match=r"state_dict: numbers that are not trained here: surface\[0\].curvature, .*; trained here and not in it: no others"):
        fewer.load_state_dict(kept[0])
    with pytest.raises(ValueError, match="not of LensSteps of these numbers"):
        LensSteps(fewer).load_state_dict(kept[1])
    with pytest.raises(ValueError, match="not of LensSteps of these numbers"):
        again.load_state_dict(torch.optim.Adam(other.parameters()).state_dict())
    triplet = iso.Lens("cooke_triplet")
    alike = LensLayer(triplet, frame_of(triplet, 48, 48), trainable=["surface[0].curvature"])
    one = LensLayer(lens, frame_of(lens, 48, 48), trainable=["surface[0].curvature"])
    with pytest.raises(ValueError, match="state_dict: of the lens"):
        alike.load_state_dict(one.state_dict())


def test_what_does_not_move_stays():
    lens = iso.Lens("cooke_triplet")
    layer = LensLayer(lens, frame_of(lens, 48, 48), trainable=["surface[*].curvature", "surface[*].thickness"])
    layer.numbers["curvature"].requires_grad_(False)
    steps, before = LensSteps(layer, lr=1e-2, hold=[]), layer.numbers["curvature"].clone()

    def step(factor=1.0):
        steps.zero_grad()
        (factor * a_loss(layer, scenes_of(2, 40))).backward()
        steps.step()
        return steps.last

    assert step().moved and torch.equal(layer.numbers["curvature"], before)
    now = layer.numbers["thickness"].clone()
    assert not torch.equal(now, torch.tensor([lens.parameters[n] for n in layer.names["thickness"]], dtype=torch.float64))
    steps.zero_grad()
    steps.step()
    assert not steps.last.moved and steps.last.held_by == ["no gradient"]
    assert step(0.0).held_by == ["no gradient"]
    with pytest.warns(UserWarning, match="3 steps in a row moved nothing: a gradient that is not finite"):
        assert step(float("nan")).held_by == ["a gradient that is not finite"]
    steps.param_groups[0]["lr"] = 0.0
    assert step().held_by == ["no rate"] and torch.equal(layer.numbers["thickness"], now)
    steps.param_groups[0]["lr"] = 1e-3
    layer.numbers["curvature"].requires_grad_(True)
    with pytest.raises(ValueError, match="frozen or freed since"):
        step()
    with pytest.raises(ValueError, match="moves one layer's numbers"):
        steps.add_param_group({"params": [torch.nn.Parameter(torch.ones(2))]})
    with pytest.raises(TypeError, match="state_dict"):
        copy.deepcopy(steps)


def test_kernels_follow_the_lens():
    """Held in training; laid out anew where light would be lost, and in evaluation whenever the numbers have changed."""
    lens = iso.Lens("cooke_triplet")
    layer = LensLayer(lens, iso.Frame(96, 64, 60.0), trainable="surface[*].curvature", replan_every=0)
    scenes = scenes_of(2, 40)
    layer(scenes)
    for curvature in (0.04, 0.03, 0.0):
        with torch.no_grad():
            layer.numbers["curvature"][0] = curvature
        captures, truths = layer(scenes)
        fresh = LensLayer(layer.lens, layer.frame)(scenes)
        assert torch.allclose(captures, fresh[0], atol=1e-4) and torch.allclose(truths, fresh[1], atol=1e-4)
        assert captures.mean().item() > 0.7 * truths.mean().item()
    with torch.no_grad():
        layer.numbers["curvature"][0] = 0.0001
        held = layer(scenes)[0]
        fresh = LensLayer(layer.lens, layer.frame)(scenes)[0]
        assert not torch.allclose(held, fresh, atol=1e-6)
        assert torch.allclose(layer.eval()(scenes)[0], fresh, atol=1e-6)


def test_numbers_that_are_no_lens_go_back():
    lens = iso.Lens("cooke_triplet")
    layer = LensLayer(lens, frame_of(lens, 32, 32), trainable=["surface[*].curvature", "surface[*].thickness"])
    scenes = scenes_of(1, 24)
    before = layer(scenes)[0]
    with torch.no_grad():
        layer.numbers["curvature"][0] = 5.0
    with pytest.raises(ValueError, match=r"surface\[0\].*conic's reach.*its last pass again; farthest moved since: surface\[0\].curvature from 0.0\d+ to 5"):
        layer(scenes)
    assert layer.lens.parameters == lens.parameters and (layer(scenes)[0] == before).all()
    with torch.no_grad():
        layer.numbers["thickness"][1] = -40.0
    with pytest.raises(ValueError, match=r"surface\[1\].thickness from .* to -40"):
        layer.replan()
    assert layer.lens.parameters == lens.parameters
    for options, kind, text in [
        ({"hold": ["sharpness"]}, ValueError, "hold: `sharpness`; any of focal_length, track"),
        ({"constraints": {"trakc": 3.0}}, ValueError, "trakc"),
        ({"lr": -1.0}, ValueError, "lr: -1.0; a number from 0 to 10"),
        ({"lr": "a"}, ValueError, "lr: a; a number"),
        ({"lr": float("nan")}, ValueError, "lr: nan"),
    ]:
        with pytest.raises(kind, match=text):
            steps = LensSteps(layer, **options)
            a_loss(layer, scenes_of(1, 24)).backward()
            steps.step()
    with pytest.raises(TypeError, match="a LensLayer"):
        LensSteps(torch.nn.Linear(2, 2))


@pytest.mark.parametrize("distance", [1000.0, float("inf")])
def test_kernels_are_those_of_the_lens(distance):
    lens = iso.Lens("cooke_triplet")
    options = {"fields_deg": [0, 14], "distances_mm": [distance], "pitch_um": 4.0, "size": 25, "dtype": "float64"}
    layer = PsfLayer(lens, trainable=["surface[*].curvature", "surface[2].thickness"], **options)
    kernels = layer()
    psf = lens.psf(**options)
    assert kernels.shape == (1, 2, 3, 25, 25) and (kernels.detach().numpy() == psf.kernels).all()
    bar = np.random.default_rng(1).normal(size=kernels.shape)
    (kernels * torch.tensor(bar)).sum().backward()
    wanted = psf.vjp(bar)
    for kind, names in layer.names.items():
        assert layer.numbers[kind].grad.tolist() == [wanted[name] for name in names]
    assert layer.lens == lens
    # Of places that are held: the derivative of the layer itself.
    weights = torch.tensor(np.mgrid[:25, :25].sum(0) ** 2 / 1e3)
    parameter = layer.numbers["curvature"]

    def moment():
        return (layer() * weights).sum()

    parameter.grad = None
    moment().backward()
    start, along = parameter.detach().clone(), parameter.grad.sign() * parameter.detach().abs()
    ours, slopes = float((parameter.grad * along).sum()), []
    for h in (1e-4, 1e-5):
        with torch.no_grad():
            values = [float(moment()) for sign in (1, -1) if parameter.copy_(start + sign * h * along) is parameter]
        slopes.append((values[0] - values[1]) / (2 * h))
    assert ours == pytest.approx(slopes[1], rel=1e-4), (ours, slopes)
    # In evaluation kernels are placed anew.
    assert (layer.eval()().detach().numpy() == layer.lens.psf(**options).kernels).all()
    other = pickle.loads(pickle.dumps(copy.deepcopy(layer)))
    assert torch.equal(other(), layer())


@pytest.mark.parametrize("of", [lambda lens, **o: PsfLayer(lens, [0, 14], pitch_um=4.0, size=25, **o), RayLayer])
def test_states_of_kernels_and_rays_are_of_their_numbers(of):
    """A state goes on to the same bits, laid out as it was; other numbers and other lenses refuse it."""
    lens = iso.Lens("cooke_triplet")
    layer = of(lens, trainable="surface[5].thickness")
    with torch.no_grad():
        layer.numbers["thickness"].add_(0.3)
    fresh = of(lens, trainable="surface[5].thickness")
    fresh.load_state_dict(copy.deepcopy(layer.state_dict()))
    assert fresh.lens == layer.lens and torch.equal(fresh._planned, layer._planned)
    if isinstance(layer, PsfLayer):
        layer()
        layer.replan()
        with torch.no_grad():
            layer.numbers["thickness"].add_(0.1)
        fresh.load_state_dict(copy.deepcopy(layer.state_dict()))
        assert torch.equal(fresh(), layer())
    with pytest.raises(ValueError, match=r"state_dict: numbers that are not trained here: surface\[5\].thickness; trained here and not in it: surface\[0\].thickness"):
        of(lens, trainable="surface[0].thickness").load_state_dict(layer.state_dict())
    with pytest.raises(ValueError, match="state_dict: of the lens"):
        of(iso.Lens("double_gauss"), trainable="surface[5].thickness").load_state_dict(layer.state_dict())


def test_sensors_count_in_single_precision_at_least():
    """Under autocast, and for bfloat16 captures: demosaicking in bfloat16 is as far off as noise."""
    captures = torch.tensor(iso.scene("facades", 48, 48)[None])
    exact = Sensor(level=0)(captures)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(Sensor(level=0)(captures), exact)
    half = captures.bfloat16()
    assert torch.equal(Sensor(level=0)(half), Sensor(level=0)(half.float()).bfloat16())


def test_a_sensor_is_the_programs(tmp_path):
    """Without noise: demosaicked as the data sets' pictures are, wherever a crop's mosaic begins. With noise: mean and deviation of each colour."""
    text = (ROOT / "calibration" / "generic-rggb" / "sensor.toml").read_text()
    quiet, changed = re.subn(r"full_well_electrons = .*", "full_well_electrons = 1e12", text)
    quiet, more = re.subn(r"read_noise_electrons = .*", "read_noise_electrons = 0.0", quiet)
    assert changed == more == 1
    file = tmp_path / "quiet.toml"
    file.write_text(quiet)
    photos, lens = tmp_path / "photos", iso.Lens("cooke_triplet")
    photos.mkdir()
    iso.write_picture(photos / "a.png", iso.scene("facades", 160, 200))
    made = [
        iso.dataset(lens, photos, tmp_path / name, frame=(180, 120), crop=40, crops=4, noise=noise, form="npy", seed=3)
        for name, noise in [("clean", None), ("raw", file)]
    ]
    sensor = Sensor(file, level=0)
    assert sensor.facts["cfa"] == "RGGB" and sensor.facts["full_well_electrons"] == 1e12
    for clean, raw, row in zip(*made, made[0].rows):
        place = (row["row"], row["column"])
        found = sensor(torch.tensor(clean[0])[None], place)[0].numpy()
        # Within two pixels of the edge the program's mosaic goes on beyond the crop, or is mirrored.
        assert np.abs(found - raw[0])[:, 2:-2, 2:-2].max() < 2e-5, place
    # A part that begins elsewhere in the mosaic is that part of the whole.
    whole = torch.tensor(made[0][0][0])[None]
    for row, column in [(1, 0), (0, 1), (3, 5)]:
        part = sensor(whole[:, :, row : row + 20, column : column + 22], (row, column))
        assert torch.allclose(part[..., 2:-2, 2:-2], sensor(whole)[:, :, row + 2 : row + 18, column + 2 : column + 20], atol=1e-6)
    # Places of their own, and places that batches have.
    parts = torch.cat([whole[:, :, row : row + 20, column : column + 22] for row, column in [(1, 0), (4, 6), (3, 5)]])
    alone = torch.cat([sensor(part[None], place) for part, place in zip(parts, [(1, 0), (4, 6), (3, 5)])])
    for places in ([(1, 0), (4, 6), (3, 5)], torch.tensor([[1, 0], [4, 6], [3, 5]]), np.array([[1, 0], [4, 6], [3, 5]])):
        assert (sensor(parts, places) == alone).all()
    assert (sensor(parts[:2], torch.tensor([1, 0]))[0] == alone[0]).all()
    # A flat field takes off what the lens dims, behind the noise, and not more than a hundredth.
    layer, scenes = LensLayer(lens, iso.Frame(180, 120, 240.0)), torch.full((2, 3, 40, 40), 0.5)
    captures, _, dims = layer(scenes, place=[(0, 0), (80, 140)], illumination=True)
    assert dims[0, :, :5, :5].mean().item() < 0.9
    flat = sensor(captures, [(0, 0), (80, 140)], illumination=dims)
    assert (flat - 0.5).abs().max() < 2e-3 and (captures[0] - 0.5).abs().max() > 0.05
    assert (Sensor(file, level=0, demosaic=False)(captures, illumination=0.002 * torch.ones_like(captures)) - 100 * Sensor(file, level=0, demosaic=False)(captures)).abs().max() < 1e-3
    assert (sensor(captures, illumination=torch.zeros_like(captures)) == 0).all()
    with pytest.raises(ValueError, match=r"illumination: shape \(1, 3, 40, 40\); that of the captures"):
        sensor(captures, illumination=dims[:1])
    noisy, light = Sensor(demosaic=False), 0.4
    picture = torch.full((1, 3, 400, 400), light, dtype=torch.float64, requires_grad=True)
    found = noisy(picture, generator=torch.Generator().manual_seed(1))
    assert found.shape == (1, 1, 400, 400)
    for row, column, response in [(0, 0, 0.55), (0, 1, 1.0), (1, 0, 1.0), (1, 1, 0.7)]:
        of = found[0, 0, row::2, column::2].detach()
        deviation = np.sqrt(light * response / 6000 + (4 / 6000) ** 2) / response
        assert abs(float(of.mean()) - light) < 5 * deviation / 200 and float(of.std()) == pytest.approx(deviation, rel=5 / np.sqrt(2 * 200 * 200))
    assert (noisy(picture, generator=torch.Generator().manual_seed(1)) == found).all()
    drawn = torch.randn(picture[:, 0].shape, generator=torch.Generator().manual_seed(1), dtype=picture.dtype)
    assert (noisy(picture, draw=drawn) == found).all()
    with pytest.raises(ValueError, match="draw: shape"):
        noisy(picture, draw=drawn[..., 1:])
    small = torch.rand(1, 3, 6, 7, dtype=torch.float64, requires_grad=True)
    sensor = Sensor(level=2.0)
    assert torch.autograd.gradcheck(lambda x: sensor(x, (1, 0), generator=torch.Generator().manual_seed(2)), small)
    dims = 0.3 + 0.6 * torch.rand(1, 3, 6, 7, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda x, d: sensor(x, (1, 0), illumination=d, generator=torch.Generator().manual_seed(2)), (small, dims))
    with pytest.raises(ValueError, match=r"captures: shape \(3, 4, 4\)"):
        sensor(torch.zeros(3, 4, 4))
    assert sensor(torch.rand(1, 3, 6, 6).half()).dtype == torch.float16
    for arguments, kind, text in [
        ((torch.zeros(1, 3, 4, 4, dtype=torch.uint8),), TypeError, "captures: torch.uint8"),
        ((np.zeros((1, 3, 4, 4)),), TypeError, "captures: float64; a tensor"),
        ((torch.zeros(1, 3, 4, 4), [(0, 0), (1, 1)]), ValueError, "place: .*; a row and column for all captures, or for each of the 1"),
        ((torch.zeros(1, 3, 4, 4), (0.5, 0)), ValueError, "place: .*; a row and column"),
        ((torch.zeros(1, 3, 4, 4), 3), ValueError, "place: 3; a row and column"),
    ]:
        with pytest.raises(kind, match=text):
            sensor(*arguments)
    with pytest.raises(FileNotFoundError):
        Sensor("none.toml")


def test_pairs_are_the_same_in_every_worker(tmp_path):
    lens = iso.Lens("cooke_triplet")
    photos = tmp_path / "photos"
    photos.mkdir()
    iso.write_picture(photos / "a.png", iso.scene("facades", 120, 140))
    # Smaller than a patch with what its light comes from.
    iso.write_picture(photos / "b.png", iso.scene("text", 50, 50))
    (photos / "notes.txt").write_text("none")
    options = {"frame": frame_of(lens, 96, 80), "distances_mm": [2000, float("inf")], "length": 12, "seed": 5}
    pairs = PairDataset([lens, iso.Lens("tessar")], photos, 48, **options)
    alone = [pairs[k] for k in range(len(pairs))]
    for capture, truth in alone:
        assert capture.shape == truth.shape == (3, 48, 48) and capture.dtype == torch.float32
        assert 0 < float((capture - truth).square().mean()) < 0.05
    assert not torch.equal(alone[0][0], alone[1][0])
    listed = PairDataset([lens, iso.Lens("tessar")], [photos / "a.png", str(photos / "b.png")], 48, **options)
    assert all(torch.equal(listed[k][0], alone[k][0]) for k in range(3))
    for context in ("fork", "spawn"):
        loader = torch.utils.data.DataLoader(pairs, batch_size=4, num_workers=2, multiprocessing_context=context)
        for k, (captures, truths) in enumerate(loader):
            for j in range(4):
                assert torch.equal(captures[j], alone[4 * k + j][0]) and torch.equal(truths[j], alone[4 * k + j][1])
    pairs.set_epoch(1)
    assert not torch.equal(pairs[0][0], alone[0][0])
    arrays = PairDataset(lens, [iso.scene("text", 90, 90)], 32, frame=frame_of(lens, 96, 80), flips=False, brightness=(1, 1))
    assert arrays[0][0].shape == (3, 32, 32)
    grey = PairDataset(lens, [iso.scene("text", 90, 90)[1]], 32, frame=frame_of(lens, 96, 80))
    assert torch.equal(grey[0][1][0], grey[0][1][2])
    # One array is one photograph.
    chart, options = iso.scene("color_chart", 90, 90), {"frame": frame_of(lens, 96, 80)}
    assert torch.equal(PairDataset(lens, chart, 32, **options)[0][1], PairDataset(lens, [chart], 32, **options)[0][1])
    with pytest.raises(TypeError):
        pairs[0:2]
    with pytest.raises(IndexError):
        arrays[1000]
    for arguments, kind, text in [
        ((lens, tmp_path / "nowhere"), FileNotFoundError, "no such folder"),
        ((lens, []), ValueError, "photos: none"),
        (([], photos), ValueError, "lenses: none"),
        ((lens, [photos / "a.png", photos / "c.png"]), FileNotFoundError, "c.png: reading: no such file"),
        ((lens, photos, 48.5), ValueError, "size: 48.5; a whole number from 1"),
        ((lens, photos, 0), ValueError, "size: 0; a whole number from 1"),
        ((lens, [np.zeros((3, 60, 60), np.uint8)]), TypeError, "photos: number 0 is of uint8; linear light"),
        ((lens, [np.full((3, 60, 60), np.nan)]), ValueError, "photos: number 0 has NaN"),
        ((lens, [np.zeros((4, 60, 60))]), ValueError, "photos: number 0 has the shape"),
        ((lens, np.zeros((60, 60, 3))), ValueError, r"photos: one array of shape \(60, 60, 3\); a list of"),
        ((lens, photos, 5000), ValueError, "size: 5000; at most the frame"),
    ]:
        with pytest.raises(kind, match=text):
            PairDataset(*arguments)
    for options, text in [({"seed": -1}, "seed: -1; a whole number from 0"), ({"brightness": 2.0}, "brightness: 2.0; two numbers"), ({"length": 2.5}, "length: 2.5")]:
        with pytest.raises(ValueError, match=text):
            PairDataset(lens, photos, 48, **options)


def test_two_processes_have_the_whole_batchs_gradient(tmp_path):
    example = ROOT / "python" / "examples" / "distributed.py"
    runner = Path(sys.executable).with_name("torchrun")
    for kind, within in [(["--double"], 1e-10), ([], 1e-4)]:
        found = []
        for start in ([sys.executable], [runner, "--nproc-per-node", "2"]):
            file = tmp_path / f"{len(found)}{len(kind)}.npz"
            command = [*start, example, "--batch", "4", "--size", "48", "--gradients", file, *kind]
            done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, timeout=300)
            assert done.returncode == 0, done.stderr
            found.append(np.load(file))
        one, two = found
        assert "lens.numbers.curvature" in one.files and one.files == two.files
        for name in one.files:
            apart = np.linalg.norm(one[name].astype(float) - two[name])
            assert apart <= within * np.linalg.norm(one[name].astype(float)), (name, apart)
