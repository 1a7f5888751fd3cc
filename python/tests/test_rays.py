"""Rays against a tracer of thirty lines."""

import numpy as np
import pytest

import isoplanat as iso
from conftest import difference, direction, moved


def plain(lens, origins, directions, wavelength_nm):
    """Sequential rays through spheres and planes in NumPy: points on the image plane, directions, optical paths."""
    told = lens.inspect(wavelength_nm=wavelength_nm)
    at, towards = origins.copy(), directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    path, index, z = np.zeros(len(at)), 1.0, 0.0
    for surface in told["surfaces"]:
        c = surface["curvature_per_mm"]
        p = at - [0, 0, z]
        # |p + t d − R|² = R²: t from the quadratic in c, the root near the vertex.
        f = towards[:, 2] - c * (p * towards).sum(-1)
        g = c * (p * p).sum(-1) - 2 * p[:, 2]
        t = g / (f + np.sqrt(f * f - c * g))
        at = at + t[:, None] * towards
        path += index * t
        normal = np.array([0, 0, 1.0]) - c * (at - [0, 0, z])
        mu = index / surface["index"]
        cosine = (normal * towards).sum(-1)
        towards = mu * towards + (np.sqrt(1 - mu**2 * (1 - cosine**2)) - mu * cosine)[:, None] * normal
        index = surface["index"]
        z += surface["thickness_mm"]
    t = (z - at[:, 2]) / towards[:, 2]
    at = at + t[:, None] * towards
    return at - [0, 0, z], towards, path + index * t


@pytest.mark.parametrize("count", [1, 200, 5000])
def test_rays_are_those_of_a_plain_tracer(count):
    lens = iso.Lens("cooke_triplet")
    rng = np.random.default_rng(count)
    origins = np.column_stack([rng.uniform(-4, 4, (count, 2)), np.full(count, -12.0)])
    directions = np.column_stack([rng.uniform(-0.1, 0.1, (count, 2)), np.ones(count)])
    rays = lens.trace(origins, directions, wavelength_nm=500.0)
    position, direction, path = plain(lens, origins, directions, 500.0)
    assert (rays.status == 0).all() and (rays.surface == -1).all()
    for found, wanted, tolerance in [(rays.positions, position, 1e-11), (rays.directions, direction, 1e-12), (rays.paths, path, 1e-10)]:
        assert found.dtype == np.float64 and np.abs(found - wanted).max() < tolerance


def test_shapes_follow_the_origins():
    lens = iso.Lens("cooke_triplet")
    grid = np.stack(np.broadcast_arrays(*np.meshgrid([0.0, 1.0, 2.0], [-1.0, 1.0]), -5.0), -1)
    rays = lens.trace(grid, [0, 0, 2])
    assert rays.positions.shape == (2, 3, 3) and rays.paths.shape == rays.status.shape == (2, 3)
    one = lens.trace([1, 1, -5], [0, 0, 1])
    assert one.positions.shape == (3,) and one.paths.shape == () and (one.positions == rays.positions[1, 1]).all()
    assert lens.trace(np.zeros((0, 3)), np.zeros((0, 3))).positions.shape == (0, 3)
    # Lists, whole numbers, single precision, steps and columns in another order.
    wide = np.zeros((6, 6))
    wide[::2, 3:] = [1, 1, -5]
    for other in [grid.astype(np.float32), np.asfortranarray(grid), grid[:, ::-1][:, ::-1], grid.tolist(), grid.astype(int), grid.astype(">f8")]:
        assert (lens.trace(other, [0, 0, 1]).positions == rays.positions).all()
    assert (lens.trace(wide[::2, 3:], [0, 0, 1]).positions == one.positions).all()


def test_rays_that_fail_say_where():
    lens = iso.Lens("cooke_triplet")
    far = [[0, 0, -5], [0, 9, -5], [0, 300, -5]]
    rays = lens.trace(far, [0, 0, 1], clip=True)
    assert [iso.STATUS[s] for s in rays.status] == ["ok", "vignetted", "missed"] or rays.status[1] != 0
    assert rays.surface[0] == -1 and (rays.surface[1:] >= 0).all()
    assert np.isfinite(rays.positions[0]).all() and np.isnan(rays.positions[1:]).all() and np.isnan(rays.paths[1:]).all()


def test_what_is_no_ray_is_refused():
    lens = iso.Lens("cooke_triplet")
    good = np.zeros((4, 3))
    for origins, directions, kind, text in [
        (np.zeros((4, 2)), good, ValueError, r"origins: shape \(4, 2\); \(..., 3\)"),
        (np.float64(3), good, ValueError, r"origins: shape \(\)"),
        (good, np.zeros((3, 3)), ValueError, r"directions: shape \(3, 3\); that of origins, \(4, 3\), or \(3,\)"),
        (good, good, ValueError, "directions, ray 0: 0, 0, 0; three finite numbers, not all 0"),
        (good * np.nan, [0, 0, 1], ValueError, "origins, ray 0: NaN, NaN, NaN; three finite numbers"),
        (good.astype(complex), [0, 0, 1], TypeError, "origins: dtype complex128; float32 or float64"),
        (good.astype(object), [0, 0, 1], TypeError, "origins: dtype object"),
        ([[1, 2], [3]], [0, 0, 1], TypeError, "origins: list: no array"),
        ("abc", [0, 0, 1], TypeError, "origins: dtype <U3"),
        (None, [0, 0, 1], TypeError, "origins: dtype object"),
    ]:
        with pytest.raises(kind, match=text):
            lens.trace(origins, directions)
    with pytest.raises(ValueError, match="wavelength_nm: 3; 200 to 20000 nm"):
        lens.trace(good, [0, 0, 1], wavelength_nm=3)
    with pytest.raises(ValueError, match="cooke_triplet: surface\\[0\\].medium: "):
        lens.trace(good, [0, 0, 1], wavelength_nm=15000)


@pytest.mark.parametrize("name", ["double_gauss", "phone", "two_element"])
def test_the_gradient_is_that_of_differences(name):
    """By every number of the lens at once, and by the rays; 1e-7."""
    lens, rng = iso.Lens(name), np.random.default_rng(11)
    reach = 0.3 * lens.inspect()["entrance_pupil_diameter_mm"]
    origins = np.append(rng.uniform(-reach, reach, (3, 70, 2)), np.full((3, 70, 1), -2.0), -1)
    directions = np.array([0.05, -0.1, 2.0])
    bars = {"positions": rng.normal(size=(3, 70, 3)), "directions": rng.normal(size=(3, 70, 3)), "paths": rng.normal(size=(3, 70))}
    options = {"wavelength_nm": 520.0, "clip": True}

    def loss(lens, origins, directions):
        rays = lens.trace(origins, directions, **options)
        assert not rays.status.any()
        return sum(float((bar * getattr(rays, of)).sum()) for of, bar in bars.items())

    given = {f"{of}_bar": bar for of, bar in bars.items()}
    gradient, *by_rays = lens.trace_vjp(origins, directions, **given, **options)
    along = direction(lens, gradient, 5)
    found, apart = difference(lambda by: loss(moved(lens, along, by), origins, directions), 1e-3)
    assert sum(gradient[number] * by for number, by in along.items()) == pytest.approx(found, rel=1e-7, abs=2 * apart)
    for k, bar in enumerate(by_rays):
        start = [origins, directions]
        towards = rng.normal(size=start[k].shape)
        found, apart = difference(lambda by: loss(lens, *(ray + by * towards * (which == k) for which, ray in enumerate(start))), 1e-3)
        assert float((bar * towards).sum()) == pytest.approx(found, rel=1e-7, abs=2 * apart)
    with pytest.raises(ValueError, match=r"paths_bar: shape \(3,\); \(3, 70\)"):
        lens.trace_vjp(origins, directions, paths_bar=np.zeros(3))
