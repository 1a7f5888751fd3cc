"""Point spread functions: what they sum to, where they lie, the command's bits, gradients."""

import copy
import pickle

import numpy as np
import pytest

import isoplanat as iso
from conftest import difference, direction, moved


def test_shapes_energy_and_places():
    lens = iso.Lens("cooke_triplet")
    psf = lens.psf(fields_deg=[0, 10, 18], distances_mm=[1000, np.inf], pitch_um=20, size=65)
    assert psf.kernels.shape == (2, 3, 3, 65, 65) and psf.kernels.dtype == np.float32
    sums = psf.kernels.astype(float).sum((-2, -1))
    assert np.abs(sums + psf.outside - 1).max() < 1e-5 and (psf.kernels >= 0).all()
    assert np.abs(psf.angle_deg - [0, 10, 18]).max() < 1e-9
    # A distant object 10 degrees off the axis: its slope is the tangent, its image about that times the focal length.
    assert psf.slope[1] == pytest.approx(np.tan(np.radians([0, 10, 18])), abs=1e-12)
    assert psf.radius_mm[1, 1] == pytest.approx(50.02 * np.tan(np.radians(10)), rel=0.01)
    assert psf.distances_mm == [1000, np.inf] and psf.pitch_um == pytest.approx(20) and len(psf.weights) == 3
    assert (psf.relative_illumination[:, 0] == 1).all() and (psf.relative_illumination[:, 2] < 1).all()
    # The kernel on the axis is its own mirror image.
    axis = psf.kernels[1, 0, 1]
    assert np.abs(axis - axis[::-1]).max() < 1e-6 and np.abs(axis - axis[:, ::-1]).max() < 1e-6
    assert np.abs(psf.centroid_um[:, 0]).max() < 1e-3 and np.abs(psf.centroid_um[..., 0]).max() < 1e-3


def test_pickles_and_other_words_for_numbers():
    lens = iso.Lens("cooke_triplet")
    asked = {"fields_deg": [0, 9], "pitch_um": 15, "size": 31, "rays": 400}
    psf = lens.psf(**asked, dtype="float64")
    for one in (psf, lens.replace({"surface[0].curvature": 0.0455}).psf(like=psf), lens.psf(**asked, diffraction="on")):
        again = pickle.loads(pickle.dumps(one))
        assert again.kernels.dtype == one.kernels.dtype and (again.kernels == one.kernels).all() and (again.outside == one.outside).all()
        assert again.vjp(np.ones_like(one.kernels)) == one.vjp(np.ones_like(one.kernels)) and copy.copy(one) is one
    assert (lens.psf(**asked, diffraction=True).kernels == lens.psf(**asked, diffraction="on").kernels).all()
    with pytest.raises(ValueError, match='diffraction: "approximate"; "on" or "off"; True is'):
        lens.psf(diffraction="approximate")
    # Half the light at each f-number's square.
    wide, narrow = (lens.replace(f_number=n).inspect() for n in (8, 16))
    assert wide["f_number"] == pytest.approx(8, rel=1e-9) and narrow["entrance_pupil_diameter_mm"] == pytest.approx(0.5 * wide["entrance_pupil_diameter_mm"], rel=1e-9)
    with pytest.raises(ValueError, match="f_number: value: 0.5, a stop of .* mm; .* or more"):
        lens.replace(f_number=0.5)
    for fields in (9, np.float32(9), np.array(9.0), [9], (9.0,)):
        assert lens.spot(fields_deg=fields, rays=100)["field_angle_deg"].tolist() == [9]


def test_a_kernel_stands_as_in_the_upright_picture():
    """The mean of the light of an off-axis point lies to the side that exact rays say, the field upwards."""
    lens = iso.Lens("cooke_triplet")
    nm = lens.primary_nm
    angle = 15.0
    psf = lens.psf(fields_deg=[angle], wavelengths_nm=[nm], pitch_um=5, size=101, dtype="float64")
    spot = lens.spot(rays=20000, max_angle_deg=angle)
    field = int(np.argmin(abs(spot["field_angle_deg"] - angle)))
    colour = int(np.argmin(abs(spot["wavelength_nm"] - nm)))
    x, y, _, _, weight = spot["rays"][field, colour].T
    weight = np.where(np.isfinite(y), weight, 0)
    mean = (weight * np.nan_to_num(y)).sum() / weight.sum() - spot["fields"][field]["chief_height_mm"]
    # On the sensor the image lies at the other side of the axis: outwards is where the chief ray went.
    outwards = mean * np.sign(spot["fields"][field]["chief_height_mm"]) * 1e3
    assert abs(outwards) > 0.4
    assert psf.centroid_um[0, 0, 0, 1] == pytest.approx(outwards, abs=0.15)


def test_kernels_are_the_bits_of_the_command(command, tmp_path):
    command("psf", "cooke_triplet", "-o", "k.npz", "--fields", 4, "--depth-mm", "900,inf", "--pitch-um", 12, "--size", 41, "--wavelength-nm", "486.1,656.3")
    told = np.load(tmp_path / "k.npz")
    psf = iso.Lens("cooke_triplet").psf(fields=4, distances_mm=[900, np.inf], pitch_um=12, size=41, wavelengths_nm=[486.1, 656.3])
    assert (psf.kernels == told["kernels"]).all() and psf.kernels.dtype == told["kernels"].dtype
    for name, ours in [("outside", psf.outside), ("relative_illumination", psf.relative_illumination), ("sensor_radius_mm", psf.radius_mm), ("field_angle_deg", psf.angle_deg)]:
        assert (ours == told[name]).all(), name


@pytest.mark.parametrize("name", ["cooke_triplet", "double_gauss", "two_element"])
def test_gradients_are_those_of_differences(name):
    lens = iso.Lens(name)
    psf = lens.psf(fields_deg=[0, 9], distances_mm=[1500, np.inf], pitch_um=15, size=31, rays=400, dtype=np.float64)
    bar = np.random.default_rng(2).normal(size=psf.kernels.shape)
    # A smooth loss: differences of one that jumps from pixel to pixel are those of its noise.
    bar = np.cumsum(np.cumsum(bar, -1), -2)
    gradient = psf.vjp(bar)
    assert gradient.keys() == lens.parameters.keys()
    for seed in [1, 2]:
        along = direction(lens, gradient, seed)
        ours = sum(gradient[name] * step for name, step in along.items())
        found, apart = difference(lambda by: float((moved(lens, along, by).psf(like=psf).kernels * bar).sum()), 1e-2)
        assert ours == pytest.approx(found, rel=1e-6, abs=2 * apart), (name, seed, apart)
        assert apart < 1e-5 * abs(found)


def test_gradients_of_kernels_by_diffraction_are_those_of_differences():
    lens = iso.Lens("cooke_triplet")
    psf = lens.psf(fields_deg=[0, 9], pitch_um=3, size=31, wavelengths_nm=[550], dtype=np.float64, diffraction=True)
    rays = lens.psf(fields_deg=[0, 9], pitch_um=3, size=31, wavelengths_nm=[550], dtype=np.float64)
    assert psf.kernels[0, 0].max() < 0.9 * rays.kernels[0, 0].max()
    bar = np.cumsum(np.cumsum(np.random.default_rng(2).normal(size=psf.kernels.shape), -1), -2)
    gradient = psf.vjp(bar)
    along = direction(lens, gradient, 1)
    ours = sum(gradient[name] * step for name, step in along.items())
    found, _ = difference(lambda by: float((moved(lens, along, by).psf(like=psf).kernels * bar).sum()), 1e-3)
    assert ours == pytest.approx(found, rel=1e-3)


def test_energy_by_diffraction_is_that_of_the_command(command, tmp_path):
    asked = {"fields": 3, "size": 15}
    command("psf", "double_gauss", "-o", "k.npz", "--diffraction", "--fields", 3, "--size", 15, "--wavelength-nm", "550")
    told = np.load(tmp_path / "k.npz")
    lens = iso.Lens("double_gauss")
    energy = lens.psf(**asked, wavelengths_nm=[550], diffraction=True).energy()
    assert energy["strehl"].shape == (1, 3, 1) and energy["radius_um"].shape == (1, 3, 1, 3)
    assert (energy["strehl"][..., 0] == told["strehl"]).all() and (0 < told["strehl"]).all() and (told["strehl"] <= 1).all()
    assert np.abs(energy["radius_um"][:, :, 0] - 1e3 * told["encircled_50_80_95_mm"]).max() < 1e-9
    assert (np.diff(energy["radius_um"], axis=-1) > 0).all()
    # Of each channel its own.
    each = lens.psf(**asked, wavelengths_nm=[450, 550, 650], diffraction=True).energy()
    assert each["strehl"].shape == (1, 3, 3) and each["strehl"][0, 0, 1] == pytest.approx(energy["strehl"][0, 0, 0], abs=1e-3)
    assert len(set(each["strehl"][0, 0])) == 3
    assert lens.psf(**asked).energy() is None


def test_one_number_stands_for_a_list_of_it():
    lens = iso.Lens("cooke_triplet")
    listed = lens.psf([10.0], [1000.0], size=9, wavelengths_nm=[550.0])
    for one in (10, 10.0, np.float32(10), np.array(10.0), np.array([10.0]), (10,)):
        assert (lens.psf(one, 1000, size=9, wavelengths_nm=550).kernels == listed.kernels).all(), repr(one)
    for wrong in ("10", {}, [[1.0]]):
        with pytest.raises(TypeError, match="a number, or several in a list") as refused:
            lens.psf(distances_mm=wrong)
        assert "distances_mm" in refused.value.__notes__[0]
    assert lens.optimize(vary="surface[2].thickness", iterations=1).moved.keys() == lens.optimize(vary=["surface[2].thickness"], iterations=1).moved.keys()


def test_what_cannot_be_is_refused():
    lens = iso.Lens("cooke_triplet")
    for wrong, text in [
        (dict(fields_deg=[-1]), "fields_deg: -1; 0 to below 90 degrees"),
        (dict(fields_deg=[float("nan")]), "fields_deg: NaN"),
        (dict(fields_deg=[]), "fields_deg: none; one or more"),
        (dict(fields_deg=[80]), "cooke_triplet: field angle: 80 degrees; up to .* degrees, where the light ends"),
        (dict(fields_deg=[0], fields=3), "fields: given beside fields_deg"),
        (dict(distances_mm=[0.0]), "distances_mm: 0; a positive distance in mm, or inf"),
        (dict(size=10), "size: 10; an odd number"),
        (dict(pitch_um=-2), "pitch_um: -2; a positive number of µm"),
        (dict(rays=1), "rays: 1; 16 to 1000000"),
        (dict(wavelengths_nm=[5.0]), "wavelengths_nm: 5; 200 to 20000 nm"),
        (dict(size=2001, fields=512, distances_mm=[1e3] * 64), "memory: .* needed; at most"),
    ]:
        with pytest.raises(ValueError, match=text):
            lens.psf(**wrong)
    with pytest.raises(TypeError, match='dtype: int8; "float32" or "float64"'):
        lens.psf(dtype="int8")
    psf = lens.psf(fields=2, size=9)
    with pytest.raises(ValueError, match="like: given beside what it decides"):
        lens.psf(like=psf, size=9)
    with pytest.raises(ValueError, match=r"kernels_bar: shape \(3,\); that of kernels, \(1, 2, 3, 9, 9\)"):
        psf.vjp(np.zeros(3))
    with pytest.raises(ValueError, match="kernels_bar: nan or inf"):
        psf.vjp(psf.kernels * np.nan)
