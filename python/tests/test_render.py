"""Pictures: the command's bits, precision, plans, and the gradient of one's own loss."""

import numpy as np
import pytest

import isoplanat as iso
from conftest import difference, direction, moved


@pytest.fixture(scope="module")
def photo():
    return iso.scene("facades", 120, 180, seed=3)


def test_pictures_are_the_bits_of_the_command(command, tmp_path, photo):
    iso.write_picture(tmp_path / "photo.npy", photo)
    assert (iso.read_picture(tmp_path / "photo.npy") == photo).all()
    with pytest.raises(ValueError, match=r"picture: NaN at .*; finite light"):
        iso.write_picture(tmp_path / "nan.png", np.full((3, 4, 4), np.nan))
    frame = iso.Frame(columns=96, rows=64, pitch_um=375.0)
    # The ideal picture, too: the photograph has nearly two texels a pixel, and twice that of the second frame.
    for columns, rows, pitch in [(96, 64, 375.0), (48, 32, 750.0)]:
        command("render", "cooke_triplet", "photo.npy", "-o", f"of{columns}.npy", "--truth", f"truth{columns}.npy", "--columns", columns, "--rows", rows,
                "--pitch-um", pitch, "--min-psnr-db", 40)
        small = iso.Frame(columns=columns, rows=rows, pitch_um=pitch)
        truth = iso.render(iso.Lens("cooke_triplet"), photo, small, min_psnr_db=40)[1]
        assert (truth == np.moveaxis(np.load(tmp_path / f"truth{columns}.npy"), -1, 0)).all()
    for distance in ["1000", "inf"]:
        command("render", "cooke_triplet", "photo.npy", "-o", f"{distance}.npy", "--columns", 96, "--rows", 64, "--pitch-um", 375,
                "--depth-mm", distance, "--min-psnr-db", 40)
        picture, truth = iso.render(iso.Lens("cooke_triplet"), photo, frame, distance_mm=float(distance), min_psnr_db=40)
        told = np.moveaxis(np.load(tmp_path / f"{distance}.npy"), -1, 0)
        assert picture.dtype == truth.dtype == told.dtype == np.float32 and picture.shape == (3, 64, 96)
        assert (picture == told).all()
        # The same scene without blur: near where nothing is sharp.
        assert np.abs(picture - truth).mean() < 0.1 and picture.mean() == pytest.approx(truth.mean(), rel=0.2)


def test_a_uniform_scene_shows_the_falling_light():
    lens, frame = iso.Lens("cooke_triplet"), iso.Frame(60, 40, 600.0)
    white = np.ones((3, 30, 45), np.float32)
    value, record = iso.render.record(lens, white, frame, min_psnr_db=40)
    assert np.abs(record.truth - 1).max() < 1e-6
    assert value == pytest.approx(record.illumination, abs=2e-3)
    assert record.illumination[0, 20, 30] == pytest.approx(1, abs=1e-3) and record.illumination[0, 0, 0] < 0.95


def test_precision_and_channels_follow_the_photograph(photo):
    lens, frame = iso.Lens("cooke_triplet"), iso.Frame(48, 32, 750.0)
    single = iso.render(lens, photo, frame, min_psnr_db=35)[0]
    double = iso.render(lens, photo.astype(np.float64), frame, min_psnr_db=35)[0]
    assert (single.dtype, double.dtype) == (np.float32, np.float64)
    assert 0 < np.abs(single - double).max() < 1e-5
    grey = iso.render(lens, photo[1], frame, min_psnr_db=35)[0]
    assert grey.shape == (3, 32, 48)
    assert (iso.render(lens, photo[1:2], frame, min_psnr_db=35)[0] == grey).all()
    # Views with steps of another order are the same photograph.
    turned = np.ascontiguousarray(photo[:, ::-1, ::-1])[:, ::-1, ::-1]
    assert (iso.render(lens, turned, frame, min_psnr_db=35)[0] == single).all()
    assert (iso.render(lens, np.asfortranarray(photo), frame, min_psnr_db=35)[0] == single).all()


def test_a_plan_serves_many_photographs_and_another_lens(photo):
    lens, frame = iso.Lens("cooke_triplet"), iso.Frame(48, 32, 750.0)
    photos = [photo, iso.scene("text", 120, 180), iso.scene("mixed", 120, 180)]
    plan = iso.render.plan(lens, photos, frame, distance_mm=1200, min_psnr_db=35)
    assert plan.holds and plan.predicted_psnr_db >= 35 and plan.frame == frame and plan.distance_mm == pytest.approx(1200)
    first, _ = iso.render(lens, photos[0], plan=plan)
    assert (iso.render(lens, photos[0], frame, plan=plan)[0] == first).all()
    assert np.abs(first - iso.render(lens, photos[0], frame, distance_mm=1200, min_psnr_db=60)[0]).max() < 0.2
    bent = lens.replace({"surface[1].thickness": 6.2})
    assert np.abs(iso.render(bent, photos[0], plan=plan)[0] - first).max() > 1e-4
    with pytest.raises(ValueError, match="photo: 20 × 10 pixels; 180 × 120 pixels, which its plan was made for"):
        iso.render(lens, photo[:, :10, :20], plan=plan)
    with pytest.raises(ValueError, match="plan: given beside what it decides"):
        iso.render(lens, photo, plan=plan, min_psnr_db=40)
    with pytest.raises(ValueError, match="frame: .*; the frame that the plan was made for, or none"):
        iso.render(lens, photo, iso.Frame(4, 4, 1.0), plan=plan)
    with pytest.raises(ValueError, match="photos: 20 × 10 pixels beside 180 × 120; one size"):
        iso.render.plan(lens, [photo, photo[:, :10, :20]], frame)


def test_truths_have_no_aliases():
    """Of three texels a pixel, one in nine of them light: means, not single texels; by records, too, whose gradient is that of differences."""
    lens, frame = iso.Lens("cooke_triplet"), iso.Frame(120, 80, 300.0)
    fine = np.zeros((3, 240, 360))
    fine[:, ::3, ::3] = 9.0
    record = iso.render.record(lens, fine, frame, min_psnr_db=20)[1]
    for truth in (iso.render(lens, fine, frame, min_psnr_db=20)[1], record.truth):
        middle = np.asarray(truth)[:, 20:-20, 30:-30]
        assert middle.mean() == pytest.approx(1, abs=0.02) and middle.max() < 5
    rows, columns = np.mgrid[:240, :360]
    smooth = np.broadcast_to(1 + 0.5 * np.cos(rows / 9) * np.sin(columns / 7), (3, 240, 360))
    picture, record = iso.render.record(lens, smooth, frame, min_psnr_db=40)
    bar = np.broadcast_to(np.sin(np.arange(120) / 20) * np.cos(np.arange(80) / 15)[:, None], picture.shape)
    # Shorter than what lies between the kinks of a sampled scene.
    name, step = "surface[0].curvature", 1e-8
    found = record.vjp(np.zeros_like(bar), bar)[name]

    def loss(by):
        changed = lens.replace({name: lens.parameters[name] + by})
        return (iso.render.record(changed, smooth, plan=record.plan)[1].truth * bar).sum()

    assert found == pytest.approx((loss(step) - loss(-step)) / (2 * step), rel=1e-5)


def test_a_record_is_the_picture_and_a_region_a_part_of_it(photo):
    lens, frame = iso.Lens("cooke_triplet"), iso.Frame(48, 32, 750.0)
    picture, truth = iso.render(lens, photo, frame, min_psnr_db=35)
    value, record = iso.render.record(lens, photo, frame, min_psnr_db=35)
    assert value == pytest.approx(picture, abs=1e-5) and record.truth == pytest.approx(truth, abs=1e-5)
    part, of_part = iso.render.record(lens, photo, plan=record.plan, region=(4, 8, 20, 30))
    assert part.shape == (3, 20, 30) and part == pytest.approx(value[:, 4:24, 8:38], abs=1e-5)
    # A gradient of a part is that of the whole with zeros around.
    bar = np.zeros_like(value)
    bar[:, 4:24, 8:38] = 1 / bar.size
    whole, some = record.vjp(bar), of_part.vjp(bar[:, 4:24, 8:38])
    for name, slope in whole.items():
        assert some[name] == pytest.approx(slope, rel=1e-2, abs=1e-3 * max(map(abs, whole.values()))), name
    with pytest.raises(ValueError, match="region: .*within 32 rows and 48 columns"):
        iso.render.record(lens, photo, frame, region=(0, 0, 33, 1))


@pytest.mark.parametrize("distance", [900.0, np.inf])
@pytest.mark.parametrize("name", ["cooke_triplet", "double_gauss", "two_element"])
def test_gradients_are_those_of_differences(name, distance):
    lens = iso.Lens(name).replace(distance_mm=distance)
    own = lens.frame
    # A part of the field half way to the corner, at pixels that blur covers several of.
    pitch = float(np.hypot(own.columns, own.rows) * own.pitch_um / 1200)
    frame = iso.Frame(40, 28, pitch, axis_px=(-120.0, 160.0))
    photo = iso.scene("mixed", 60, 90).astype(np.float64)
    value, record = iso.render.record(lens, photo, frame, min_psnr_db=30, texels_per_pixel=1.5)
    rng = np.random.default_rng(7)
    bars = [rng.normal(size=value.shape) for _ in range(3)]
    gradient = record.vjp(*bars)
    assert gradient.keys() == lens.parameters.keys()

    def loss(other):
        picture, seen = iso.render.record(other, photo, plan=record.plan)
        assert picture.dtype == np.float64
        return sum(float((a * b).sum()) for a, b in zip([picture, seen.truth, seen.illumination], bars))

    assert loss(lens) == sum(float((a * b).sum()) for a, b in zip([value, record.truth, record.illumination], bars))
    for seed in [1, 2]:
        along = direction(lens, gradient, seed)
        assert len(along) >= 10
        ours = sum(gradient[name] * step for name, step in along.items())
        found, apart = difference(lambda by: loss(moved(lens, along, by)), 1e-3)
        assert ours == pytest.approx(found, rel=1e-6), (name, distance, seed, apart)


def test_what_cannot_be_rendered_is_refused(photo):
    lens, frame = iso.Lens("cooke_triplet"), iso.Frame(24, 16, 1500.0)
    for wrong, kind, text in [
        (np.moveaxis(photo, 0, -1), ValueError, r"photo: shape \(120, 180, 3\); \[3, row, col\]: np.moveaxis"),
        (photo[:2], ValueError, r"photo: shape \(2, 120, 180\)"),
        (photo[:, :0], ValueError, "photo: shape"),
        (np.float32(1), ValueError, r"photo: shape \(\)"),
        ((photo * 255).astype(np.uint8), TypeError, "photo: dtype uint8; linear light as float32 or float64"),
        (photo.astype(complex), TypeError, "photo: dtype complex128"),
        (photo * np.nan, ValueError, "NaN; finite"),
        ("photo.png", TypeError, "photo: dtype <U9"),
    ]:
        with pytest.raises(kind, match=text):
            iso.render(lens, wrong, frame)
    for wrong, text in [
        (dict(distance_mm=0), "distance_mm: 0; a positive distance in mm, or inf"),
        (dict(min_psnr_db=900), "min_psnr_db: 900; 10 to 80 dB"),
        (dict(min_psnr_db=float("nan")), "min_psnr_db: NaN"),
        (dict(texels_per_pixel=0), "texels_per_pixel: 0; a positive number"),
        (dict(illuminant="candle"), "illuminant: candle; "),
    ]:
        with pytest.raises(ValueError, match=text):
            iso.render(lens, photo, frame, **wrong)
    with pytest.raises(ValueError, match="memory: .*needed"):
        iso.render(lens, photo, iso.Frame(65536, 65536, 1.0))
    with pytest.raises(TypeError):
        iso.render("cooke_triplet", photo, frame)
    value, record = iso.render.record(lens, photo, frame, min_psnr_db=30)
    for bar, kind, text in [
        (value[0], ValueError, r"picture_bar: shape \(16, 24\); that of the picture, \(3, 16, 24\)"),
        (value * np.inf, ValueError, "cotangent, channel 0, row 0, column 0: "),
        (value.astype(object), TypeError, "picture_bar: dtype object"),
    ]:
        with pytest.raises(kind, match=text):
            record.vjp(bar)


def test_a_promise_that_does_not_hold_warns(photo):
    lens, frame = iso.Lens("cooke_triplet"), iso.Frame(12, 8, 3000.0)
    with pytest.warns(UserWarning, match="predicted to reach .* dB, not the 80 dB of min_psnr_db and a margin"):
        iso.render(lens, photo, frame, min_psnr_db=80)


def test_a_capture_is_the_command_s(command, tmp_path, photo):
    iso.write_picture(tmp_path / "photo.npy", photo)
    lens, frame = iso.Lens("cooke_triplet"), iso.Frame(48, 32, 750.0)
    taken = iso.capture(lens, photo, frame, distance_mm=1500, samples=16, seed=4)
    assert taken.raw.dtype == np.uint16 and taken.raw.shape == taken.clean.shape == (32, 48) and taken.cfa == "RGGB"
    again = iso.capture(lens, photo, frame, distance_mm=1500, samples=16, seed=4)
    assert (again.raw == taken.raw).all()
    taken.save(tmp_path / "ours.dng")
    with pytest.raises(FileExistsError):
        taken.save(tmp_path / "ours.dng")
    command("capture", "cooke_triplet", "photo.npy", "-o", "theirs.dng", "--columns", 48, "--rows", 32, "--pitch-um", 750, "--depth-mm", 1500,
            "--samples", 16, "--seed", 4)
    raw = taken.raw.astype("<u2").tobytes()
    for name in ["ours.dng", "theirs.dng"]:
        assert raw in (tmp_path / name).read_bytes(), name
    # Signal and raw values are one: clean is what noise and rounding leave.
    scale = taken.white_level - taken.black_level
    assert np.std((taken.raw - taken.black_level) / scale - taken.clean) < 3 * taken.sensor_noise
    for wrong in [dict(exposure=-1), dict(glare=2), dict(samples=0), dict(sensor=tmp_path / "none.toml")]:
        with pytest.raises((ValueError, FileNotFoundError)):
            iso.capture(lens, photo, frame, **wrong)


def test_pictures_in_files(tmp_path, photo):
    iso.write_picture(tmp_path / "a.png", photo)
    assert np.abs(iso.read_picture(tmp_path / "a.png") - photo).max() < 1e-4
    iso.write_picture(tmp_path / "a.tif", photo, float=True)
    assert (iso.read_picture(tmp_path / "a.tif") == photo).all()
    with pytest.raises(FileExistsError):
        iso.write_picture(tmp_path / "a.png", photo)
    for name, kwargs in [("a.gif", {}), ("b.png", dict(float=True))]:
        with pytest.raises(ValueError):
            iso.write_picture(tmp_path / name, photo, **kwargs)
    with pytest.raises(FileNotFoundError, match="none.png"):
        iso.read_picture(tmp_path / "none.png")
    (tmp_path / "bad.png").write_bytes(b"no picture")
    with pytest.raises(ValueError, match="bad.png"):
        iso.read_picture(tmp_path / "bad.png")
    with pytest.raises(ValueError, match="kind: `street`; dead_leaves"):
        iso.scene("street", 4, 4)
    assert {p.name for p in tmp_path.iterdir()} == {"a.png", "a.tif", "bad.png"}


def test_what_is_hardly_meant_is_refused_or_told():
    lens, photo, frame = iso.Lens("cooke_triplet"), iso.scene("text", 32, 48), iso.Frame(24, 16, 1500)
    for distance in (20, 1):
        with pytest.raises(ValueError, match="no real image"):
            iso.render(lens, photo, frame, distance_mm=distance)
        with pytest.raises(ValueError, match="no real image"):
            lens.psf_map("grid", frame, distance_mm=distance)
    with pytest.warns(UserWarning, match="1 is white"):
        iso.render(lens, 255 * photo, frame, min_psnr_db=10)
    assert "min_psnr_db" in iso.render.__doc__ and "distance_mm" in iso.render.__doc__
