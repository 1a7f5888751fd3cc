"""The lens as a layer of PyTorch."""

import copy
import pickle
import warnings

import numpy as np
import pytest

import isoplanat as iso
from conftest import difference, direction, frame_of, smooth

with warnings.catch_warnings():
    # Of torch's own parts.
    warnings.simplefilter("ignore")
    torch = pytest.importorskip("torch", reason="torch is not installed")
    from isoplanat.torch import LensLayer, LensSteps, PsfLayer, RayLayer


@pytest.mark.parametrize("distance", [1000.0, float("inf")])
@pytest.mark.parametrize("name", ["cooke_triplet", "double_gauss", "two_element"])
def test_gradients_are_those_of_differences(name, distance):
    lens = iso.Lens(name)
    layer = LensLayer(lens, frame_of(lens), distances_mm=[3000.0, distance], trainable="surface[*].*", replan_every=0)
    # Farther than light comes from: where a scene goes on with its border there are kinks.
    margin = 16
    assert layer.reach_px < margin
    scenes, places = torch.tensor(smooth((3, 3, 40 + 2 * margin, 32 + 2 * margin), 1)), [(0, 0), (20, 61), (7, 30)]
    rng = np.random.default_rng(7)

    def both():
        return layer(scenes, [distance, distance, 3000.0], places, margin=margin, illumination=True)

    captures, truths, illumination = both()
    assert captures.shape == truths.shape == illumination.shape == (3, 3, 40, 32) and captures.dtype == illumination.dtype == torch.float64
    assert all((a == b).all() for a, b in zip((captures, truths), layer(scenes, [distance, distance, 3000.0], places, margin=margin)))
    # A smooth loss: differences of one that jumps from pixel to pixel are those of its noise.
    bars = [torch.tensor(np.cumsum(np.cumsum(rng.normal(size=captures.shape), -1), -2)) for _ in range(3)]
    loss = sum((a * b).sum() for a, b in zip((captures, truths, illumination), bars))
    loss.backward()
    gradient = {n: float(g) for kind, names in layer.names.items() for n, g in zip(names, layer.numbers[kind].grad)}
    start = {kind: number.detach().clone() for kind, number in layer.numbers.items()}

    def moved(along, by):
        with torch.no_grad():
            for kind, names in layer.names.items():
                layer.numbers[kind].copy_(start[kind] + by * torch.tensor([along.get(n, 0.0) for n in names], dtype=torch.float64))
            return sum(float((a * b).sum()) for a, b in zip(both(), bars))

    for seed in [1, 2]:
        along = direction(lens, gradient, seed)
        assert len(along) >= 5
        ours = sum(gradient[n] * step for n, step in along.items())
        found, apart = difference(lambda by: moved(along, by), 1e-3)
        assert ours == pytest.approx(found, rel=1e-6, abs=2 * apart), (seed, apart)
        assert apart < 1e-5 * abs(found)


def test_a_patch_is_that_part_of_the_picture():
    lens, photo = iso.Lens("cooke_triplet"), iso.scene("facades", 128, 192)
    frame = frame_of(lens, 192, 128)
    layer = LensLayer(lens, frame, distances_mm=2000).eval()
    picture, truth = iso.render(lens, photo, frame, distance_mm=2000, min_psnr_db=60, texels_per_pixel=1)
    row, column, side = 48, 80, 32
    margin = min(layer.reach_px + 4, row)
    part = photo[:, row - margin : row + side + margin, column - margin : column + side + margin]
    with torch.no_grad():
        captures, truths = layer(torch.tensor(part)[None], margin=margin, shift=[(0, 0)])
    for ours, wanted in [(captures, picture), (truths, truth)]:
        error = ours[0].numpy() - wanted[:, row : row + side, column : column + side]
        assert ours.dtype == torch.float32 and np.mean(error**2) < 1e-4, np.mean(error**2)


def test_scenes_are_shifted_by_parts_of_a_texel_or_as_asked():
    lens = iso.Lens("cooke_triplet")
    layer = LensLayer(lens, frame_of(lens, 96, 96)).eval()
    photo = torch.tensor(iso.scene("facades", 40, 40))
    with torch.no_grad():
        # A shift of whole texels is another part of the picture.
        moved = layer(photo[None, :, 0:36, 0:36], margin=8, shift=[(3, 2)])
        there = layer(photo[None, :, 3:39, 2:38], margin=8, shift=torch.zeros(1, 2))
        assert all((a[..., :16, :16] - b[..., :16, :16]).abs().max() < 2e-6 for a, b in zip(moved, there))
        # On a slope of light the truth in the middle tells the shift: half a texel unless another is asked for.
        slope = torch.arange(12.0, dtype=torch.float64)
        for scene in (slope[:, None].expand(12, 12), slope.expand(12, 12)):
            scenes = scene.expand(2, 3, 12, 12).contiguous()
            for shift, wanted in [(None, [0.5, 0.5]), ([(0, 0), (-0.25, -0.25)], [0.0, -0.25])]:
                truths = layer(scenes, shift=shift)[1]
                found = truths[:, :, 5:7, 5:7].mean((1, 2, 3)) - 5.5
                assert (found - torch.tensor(wanted)).abs().max() < 1e-3, found
    for wrong, why in [([(0, torch.nan)], "finite texels"), ([(0, 0), (0, 0)], "one of each of 1 scenes"), ([1, 2], "a pair")]:
        with pytest.raises(ValueError, match=f"shift: .*{why}"):
            layer(photo[None], shift=wrong)


@pytest.fixture(scope="module")
def sharp():
    """A lens out of focus, its frame, and patches with detail of one texel."""
    lens = iso.Lens("cooke_triplet").replace({"surface[5].thickness": 42.8})
    photo = iso.scene("facades", 600, 800).reshape(3, 300, 2, 400, 2).mean((2, 4))
    rng = np.random.default_rng(3)
    corners = [(int(rng.integers(300 - 72)), int(rng.integers(400 - 72))) for _ in range(96)]
    scenes = np.stack([photo[:, row : row + 72, column : column + 72] for row, column in corners])
    places = [(int(rng.integers(128 - 48)), int(rng.integers(192 - 48))) for _ in corners]
    return lens, iso.Frame(192, 128, 60.0), torch.tensor(scenes).double(), places


def test_gradients_of_sharp_scenes_are_those_of_new_layouts(sharp):
    # What moves a scene must not gain by softening it: at a layout the gradient is that of differences between lenses that are laid out each for itself.
    lens, frame, scenes, places = sharp
    name = "surface[5].thickness"

    def loss(layer):
        captures, truths = layer(scenes, place=places, margin=12)
        return (captures - truths).square().mean()

    layer = LensLayer(lens, frame, trainable=name)
    loss(layer).backward()
    start = lens.parameters[name]
    with torch.no_grad():
        up, down = (float(loss(LensLayer(lens.replace({name: start + by}), frame, trainable=name))) for by in (0.01, -0.01))
    ours = float(layer.numbers["thickness"].grad)
    assert ours == pytest.approx((up - down) / 0.02, rel=0.05)
    # Texels on pixels: a difference to either side sees the loss fall.
    layer = LensLayer(lens, frame, trainable=name, replan_every=0)
    with torch.no_grad():
        aligned = [(0.0, 0.0)] * len(places)
        losses = []
        for by in (-0.01, 0.0, 0.01):
            layer.numbers["thickness"].fill_(start + by)
            captures, truths = layer(scenes, place=places, margin=12, shift=aligned)
            losses.append(float((captures - truths).square().mean()))
    assert losses[0] + losses[2] < 2 * losses[1]


def test_sharp_scenes_lead_into_focus(sharp):
    lens, frame, scenes, places = sharp
    layer = LensLayer(lens, frame, trainable=["surface[*].curvature", "surface[*].thickness"])
    steps = LensSteps(layer, lr=1e-2)
    for k in range(96):
        captures, truths = layer(scenes[k : k + 1].float(), place=places[k : k + 1], margin=12)
        steps.zero_grad()
        (captures - truths).square().mean().backward()
        steps.step()
    spots = [field["rms_mm"] for field in layer.lens.spot()["fields"]]
    assert spots[0] < 0.008 and max(spots) < 0.015, spots


def test_a_layer_is_as_fine_as_its_gradient_needs(sharp):
    lens, frame, scenes, places = sharp
    layer = LensLayer(lens, frame, trainable=["surface[*].curvature", "surface[*].thickness"])
    few, options = scenes[:6].float(), {"place": places[:6], "margin": 12}
    before = layer(few, **options)[0]
    found = layer.tune(few, **options)
    assert 0 <= found.error < 0.05 and 0.05 < found.noise <= 1 and found.holds and found.error < 0.1 * found.noise
    after = layer(few, **options)[0].detach()
    assert 0 < (after - before).square().mean() < 1e-4
    # A state goes on to the bit, with the settings.
    with torch.no_grad():
        layer.numbers["thickness"][0] += 1e-3
    layer.replan()
    other = LensLayer(lens, frame, trainable=["surface[*].curvature", "surface[*].thickness"])
    other.load_state_dict(layer.state_dict())
    assert other._core.settings == layer._core.settings and (other(few, **options)[0] == layer(few, **options)[0]).all()
    again = pickle.loads(pickle.dumps(layer))
    assert again._core.settings == layer._core.settings
    dark = LensLayer(lens, frame).tune(torch.zeros(1, 3, 40, 40))
    assert dark.holds and dark.error == 0
    with pytest.raises(ValueError, match="place: .*; a pair"):
        layer.tune(few, place=(0, 0))


def test_it_behaves_as_a_module():
    lens = iso.Lens("cooke_triplet")
    layer = LensLayer(lens, frame_of(lens, 32, 32), trainable=["surface[*].curvature", "surface[1].thickness"])
    assert list(layer.numbers) == ["curvature", "thickness"] and layer.names["thickness"] == ["surface[1].thickness"]
    assert layer.lens.parameters == lens.parameters
    scenes = torch.tensor(smooth((2, 3, 24, 24), 3)).float()
    before = [t.detach() for t in layer(scenes)]
    for cast in (layer.half(), layer.bfloat16(), layer.float(), layer.to("cpu", torch.float16)):
        assert all(n.dtype == torch.float64 for n in cast.parameters())
    with torch.autocast("cpu", torch.bfloat16):
        assert all((a == b).all() and a.dtype == torch.float32 for a, b in zip(layer(scenes), before))
    # Copies are their own; a state goes from one to the other.
    twin, other = copy.deepcopy(layer), pickle.loads(pickle.dumps(layer))
    with torch.no_grad():
        twin.numbers["curvature"].mul_(1.01)
        assert not (twin(scenes)[0] == before[0]).all() and (layer(scenes)[0] == before[0]).all()
    assert torch.allclose(other(scenes)[0], before[0], atol=1e-6)
    layer.load_state_dict(twin.state_dict())
    assert (layer(scenes)[0] == twin(scenes)[0]).all()
    assert layer.lens.parameters["surface[0].curvature"] == lens.parameters["surface[0].curvature"] * 1.01
    # Under torch.compile the graph breaks at the layer, and goes on.
    # The compiler itself looks at gradients of what is no leaf.
    warnings.filterwarnings("ignore", message="The .grad attribute of a Tensor that is not a leaf")
    compiled = torch.compile(lambda s: layer(s)[0].square().mean(), backend="eager")
    compiled(scenes).backward()
    assert layer.numbers["curvature"].grad.abs().sum() > 0
    # A parameter that the loss does not see has zeros.
    layer.zero_grad()
    (0.0 * layer(scenes)[0]).sum().backward()
    assert (layer.numbers["thickness"].grad == 0).all()
    assert "6 curvature, 1 thickness; 1 distances, frame 32 × 32" in repr(layer)


def test_a_lens_is_trained():
    lens = iso.Lens("cooke_triplet")
    off = lens.replace({"surface[5].thickness": lens.parameters["surface[5].thickness"] + 0.6})
    layer = LensLayer(off, frame_of(lens, 64, 64, 2400), trainable="surface[5].thickness", replan_every=5)
    scenes = torch.tensor(np.stack([iso.scene("text", 64, 64, seed=k) for k in range(2)]))
    steps = torch.optim.Adam(layer.parameters(), lr=0.04)
    losses = []
    for _ in range(30):
        captures, truths = layer(scenes, margin=8)
        loss = (captures - truths).square().mean()
        steps.zero_grad()
        loss.backward()
        steps.step()
        losses.append(loss.item())
    assert losses[-1] < 0.2 * losses[0], losses
    found = layer.lens.parameters["surface[5].thickness"] - lens.parameters["surface[5].thickness"]
    assert abs(found) < 0.15, found


def test_passes_of_one_lens_are_one():
    """Passes of one lens are the same whether it was traced for them or for another; one that moved is traced anew; a lens of several passes gives each its gradient."""
    lens = iso.Lens("tessar")
    layer = LensLayer(lens, frame_of(lens, 48, 48), trainable="surface[*].curvature", replan_every=0)
    scenes = torch.tensor(smooth((2, 3, 32, 32), 5)).float()

    def passed():
        captures, truths = layer(scenes)
        return captures, (captures - truths).square().mean()

    (first, loss), (second, other) = passed(), passed()
    assert (first == second).all()
    loss.backward()
    gradient = layer.numbers["curvature"].grad.clone()
    layer.zero_grad()
    other.backward()
    assert (gradient == layer.numbers["curvature"].grad).all() and gradient.abs().sum() > 0
    kept = layer.numbers["curvature"].detach().clone()
    with torch.no_grad():
        layer.numbers["curvature"][0] *= 1 + 1e-6
    moved, _ = passed()
    assert not (moved == first).all()
    with torch.no_grad():
        layer.numbers["curvature"].copy_(kept)
    assert (passed()[0] == first).all()


def test_numbers_that_are_no_lens_go_back():
    lens = iso.Lens("cooke_triplet")
    psf, rays = PsfLayer(lens, fields_deg=torch.tensor([0.0, 5.0]), size=21), RayLayer(lens)
    arguments = {psf: (), rays: (torch.tensor([[0.0, 1.0, -10.0]]), torch.tensor([0.0, 0.0, 1.0]))}
    for layer in (psf, rays):
        first = layer(*arguments[layer])
        kept = layer.numbers["curvature"].detach().clone()
        with torch.no_grad():
            layer.numbers["curvature"][0] = 5.0
        with pytest.raises(ValueError, match="its last pass again; farthest moved since: surface.0..curvature from 0.0.* to 5"):
            layer(*arguments[layer])
        assert (layer.numbers["curvature"] == kept).all()
        second = layer(*arguments[layer])
        assert (second == first).all() if layer is psf else (second.positions == first.positions).all()
    other = PsfLayer(lens, fields_deg=[0.0], trainable="surface[0].curvature")
    with pytest.raises(ValueError, match=r"numbers that are not trained here: surface\[1\].curvature, .*; trained here and not in it: no others"):
        other.load_state_dict(psf.state_dict())
    layer = LensLayer(lens, frame_of(lens, 24, 24), distances_mm=[1000, float("inf")])
    scenes = torch.zeros(1, 3, 24, 24)
    for distance in (1000, np.float32(1000), np.array(1000), torch.tensor(1000.0), [1000], torch.tensor([1000.0])):
        assert layer(scenes, distance)[0].shape == (1, 3, 24, 24)


def test_what_cannot_be_is_refused():
    lens = iso.Lens("cooke_triplet")
    layer = LensLayer(lens, frame_of(lens, 32, 32), distances_mm=[1000, float("inf")])
    scenes = torch.zeros(2, 3, 24, 24)
    for arguments, options, kind, text in [
        ((scenes[0],), {}, ValueError, r"scenes: shape \(3, 24, 24\); \[B, 3, H, W\]"),
        ((scenes.numpy(),), {}, TypeError, "scenes: ndarray; a tensor"),
        ((scenes, None, (0, 0)), {}, ValueError, r"place: \(0, 0\); a pair"),
        ((scenes,), {"margin": 2.5}, ValueError, "margin: 2.5"),
        ((scenes.byte(),), {}, TypeError, "scenes: torch.uint8; linear light"),
        ((scenes.clone().requires_grad_(),), {}, ValueError, "scenes: they ask for a gradient"),
        ((scenes * float("nan"),), {}, ValueError, "scenes.*NaN; finite light"),
        ((scenes, 500.0), {}, ValueError, "distance_mm: 500; one of 1000, inf"),
        ((scenes, [1000.0]), {}, ValueError, "distance_mm: 1 of them; one of each of 2 scenes"),
        ((scenes, None, [(0, 9), (0, 8)]), {}, ValueError, r"place: \(0, 9\); a patch of 24 × 24 within 32 rows and 32 columns"),
        ((scenes, None, [(-1, 0), (0, 8)]), {}, ValueError, r"place: \(-1.0, 0.0\); whole rows and columns from 0, within 32 and 32"),
        ((scenes, None, torch.tensor([[1.0, 0.5], [0, 8]])), {}, ValueError, r"place: \(1.0, 0.5\)"),
        ((scenes, float("nan")), {}, ValueError, "distance_mm: nan"),
        ((scenes, "near"), {}, ValueError, "distance_mm: 'near'; a number of mm for all scenes, or one for each"),
        ((scenes, 0), {}, ValueError, "distance_mm: 0"),
        ((scenes,), {"margin": 12}, ValueError, "margin: 12; 0 to less than half"),
        ((scenes,), {"margin": -1}, ValueError, "margin: -1"),
        ((scenes[:0],), {}, ValueError, "one or more"),
        ((torch.zeros(1, 3, 48, 48),), {}, ValueError, "scenes: patches of 48 × 48 pixels; at most the frame, 32 × 32"),
    ]:
        with pytest.raises(kind, match=text):
            layer(*arguments, **options)
    for options, text in [
        ({"trainable": "surface[9].curvature"}, "trainable"),
        ({"trainable": []}, "trainable: none"),
        ({"distances_mm": [10.0]}, "front focal point"),
        ({"replan_every": -1}, "replan_every: -1"),
        ({"distances_mm": []}, "distances_mm: none"),
    ]:
        with pytest.raises(ValueError, match=text):
            LensLayer(lens, **options)
    with torch.no_grad():
        layer.numbers["curvature"][0] = float("nan")
    with pytest.raises(ValueError, match="curvature"):
        layer(scenes)


def test_rays_that_fail_have_no_gradient():
    """A lens is focused by the spots of rays that arrive; others are nan, and leave gradients alone."""
    lens = iso.Lens("cooke_triplet")
    layer = RayLayer(lens, trainable=["surface[5].thickness"], clip=True)
    x = torch.linspace(-60, 60, 101, dtype=torch.float64)
    origins = torch.stack([x, torch.zeros_like(x), torch.zeros_like(x)], -1)
    directions = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    found = layer(origins, directions)
    known = lens.trace(origins.numpy(), directions.numpy(), clip=True)
    assert np.array_equal(found.status.numpy(), known.status) and np.array_equal(found.positions.detach().numpy(), known.positions, equal_nan=True)
    through = found.status == 0
    assert 5 < int(through.sum()) < 90
    (spot,) = torch.autograd.grad(found.positions[through][:, 0].square().mean(), layer.numbers["thickness"])
    (whole,) = torch.autograd.grad(layer(origins, directions).positions[:, 0].square().nanmean(), layer.numbers["thickness"])
    assert torch.isfinite(spot).all() and float(spot) != 0 and torch.equal(spot, whole)
    # Along straight lines: the slope of x² is twice x times the ray's slope.
    steep = found.directions[through][:, 0] / found.directions[through][:, 2]
    assert float(spot) == pytest.approx((2 * found.positions[through][:, 0] * steep).mean().item(), rel=1e-12)
    with pytest.raises(TypeError, match="origins: torch.int64; a tensor in floating point"):
        layer(origins.long(), directions)
