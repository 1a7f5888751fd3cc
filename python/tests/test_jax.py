"""The lens as a function of JAX."""

import numpy as np
import pytest

import isoplanat as iso
from conftest import difference, direction, frame_of, smooth

jax = pytest.importorskip("jax", reason="jax is not installed")
jnp = jax.numpy


@pytest.fixture(autouse=True)
def double():
    before = jax.config.read("jax_enable_x64")
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


def made(name="cooke_triplet", spread=600, **options):
    from isoplanat.jax import LensFunction

    lens = iso.Lens(name)
    return LensFunction(lens, frame_of(lens, spread=spread), distances_mm=[3000.0, float("inf")], **options)


@pytest.mark.parametrize("name", ["cooke_triplet", "double_gauss", "two_element"])
def test_gradients_are_those_of_differences(name):
    through = made(name, held=True)
    margin = 16
    assert through.reach_px < margin
    scenes = smooth((2, 3, 32 + 2 * margin, 32 + 2 * margin), 1)
    places, distances = jnp.array([[0, 0], [20, 61]]), jnp.array([3000.0, jnp.inf])
    rng = np.random.default_rng(7)
    bars = [np.cumsum(np.cumsum(rng.normal(size=(2, 3, 32, 32)), -1), -2) for _ in range(2)]

    @jax.jit
    def loss(values):
        captures, truths, status = through(values, scenes, distances, places, margin=margin)
        return jnp.sum(captures * bars[0] + truths * bars[1]), status

    (_, status), gradient = jax.value_and_grad(loss, has_aux=True)(through.values)
    assert int(status) == 0 and gradient.dtype == jnp.float64
    chosen = direction(iso.Lens(name), dict(zip(through.names, map(float, gradient))), 1)
    along = np.array([chosen.get(name, 0.0) for name in through.names])
    found, apart = difference(lambda by: float(loss(through.values + by * along)[0]), 1e-3)
    assert apart < 1e-5 * abs(found)
    assert float(gradient @ along) == pytest.approx(found, rel=1e-6, abs=2 * apart)


def test_it_is_the_layer():
    torch = pytest.importorskip("torch", reason="torch is not installed")
    from isoplanat.torch import LensLayer

    through, scenes = made(), smooth((2, 3, 40, 40), 2).astype(np.float32)
    layer = LensLayer(iso.Lens("cooke_triplet"), through.frame, distances_mm=[3000.0, float("inf")])
    captures, truths = layer(torch.tensor(scenes), [3000.0, float("inf")], margin=4)
    ours = through(through.values, scenes, jnp.array([3000.0, jnp.inf]), margin=4)
    assert ours[0].dtype == jnp.float32
    assert (np.asarray(ours[0]) == captures.detach().numpy()).all() and (np.asarray(ours[1]) == truths.detach().numpy()).all()
    shift = [(0.25, -0.5), (0.0, 3.0)]
    moved = layer(torch.tensor(scenes), margin=4, shift=shift)
    ours = through(through.values, scenes, margin=4, shift=jnp.array(shift))
    assert all((np.asarray(a) == b.detach().numpy()).all() for a, b in zip(ours, moved)) and not (moved[0] == captures).all()
    captures.square().mean().backward()
    gradient = jax.grad(lambda v: jnp.mean(jnp.square(through(v, scenes, jnp.array([3000.0, jnp.inf]), margin=4)[0])))(through.values)
    assert np.allclose(gradient, layer.numbers["curvature"].grad.numpy(), rtol=1e-5)


def test_scenes_follow_the_lens_unless_they_are_held():
    # A lens of another magnification: what stands before it afterwards is what stands before one that was laid out for it.
    scenes, corner = smooth((1, 3, 40, 40), 4), jnp.array([[0, 0]])
    free, held = made(), made(held=True)
    moved = free.values * 1.01
    anew = free.replanned(moved)(moved, scenes, place=corner, margin=4)[1]
    assert np.abs(np.asarray(free(moved, scenes, place=corner, margin=4)[1]) - anew).max() < 1e-6
    assert np.abs(np.asarray(held(moved, scenes, place=corner, margin=4)[1]) - anew).max() > 1e-3
    assert held.replanned(moved).held


def test_failures_are_nan_with_a_status():
    through, scenes = made(), smooth((1, 3, 24, 24), 3)
    no_lens = through.values.at[0].set(5.0)
    captures, truths, status = jax.jit(through)(no_lens, scenes)
    assert np.isnan(captures).all() and np.isnan(truths).all() and int(status) == 1
    with pytest.raises(ValueError, match=r"surface\[0\].semi_diameter_mm: 9.5; at most the conic's reach"):
        through.check(status)
    assert np.isnan(jax.grad(lambda v: jnp.mean(through(v, scenes)[0]))(no_lens)).all()
    through.check(through(through.values, scenes)[2])
    # One after the other under vmap.
    three = jnp.stack([through.values, 1.001 * through.values, no_lens])
    assert jax.vmap(lambda v: through(v, scenes)[2])(three).tolist() == [0, 0, 1]
    for arguments, kind, text in [
        ((through.values[:2], scenes), ValueError, r"values: float64 of shape \(2,\)"),
        ((through.values, scenes[0]), ValueError, "scenes: shape"),
        ((through.values, scenes.astype(int)), TypeError, "scenes: int64"),
        ((through.values, scenes, None, [[0.5, 0.0]]), TypeError, "place: float64; whole rows"),
        ((through.values, np.zeros((1, 3, 80, 80))), ValueError, "at most the frame, 64 × 96"),
    ]:
        with pytest.raises(kind, match=text):
            through(*arguments)
    for arguments, text in [((None, [[-1, 0]]), "whole rows and columns from 0"), ((500.0,), "distance_mm: 500; one of 3000, inf")]:
        status = through(through.values, scenes, *arguments)[2]
        with pytest.raises(ValueError, match=text):
            through.check(status)
    with pytest.raises(TypeError, match="stop_gradient"):
        jax.grad(lambda s: jnp.mean(through(through.values, s)[0]))(scenes)
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(ValueError, match="jax_enable_x64"):
        made()


def test_a_lens_is_focused():
    lens = iso.Lens("cooke_triplet")
    through = made(trainable="surface[5].thickness", spread=2400)
    start, scenes = through.values + 0.3, np.stack([iso.scene("text", 48, 48, seed=k) for k in range(2)])

    @jax.jit
    def slope(values):
        def loss(values):
            captures, truths, _ = through(values, scenes, jnp.inf, margin=8)
            return jnp.mean(jnp.square(captures - truths))

        return jax.value_and_grad(loss)(values)

    values, first = start, float(slope(start)[0])
    for _ in range(25):
        _, gradient = slope(values)
        values = values - 0.02 * jnp.sign(gradient)
    assert float(slope(values)[0]) < 0.4 * first
    assert abs(float(values[0]) - lens.parameters["surface[5].thickness"]) < 0.2
    again = through.replanned(values)
    assert np.allclose(again.values, values) and int(again(values, scenes)[2]) == 0
