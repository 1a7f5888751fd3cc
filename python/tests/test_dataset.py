"""Data sets and PSF maps: the command's bits, what reads them, what is refused."""

import pickle

import numpy as np
import pytest

import isoplanat as iso


@pytest.fixture
def photos(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    iso.write_picture(folder / "a.png", iso.scene("facades", 80, 120, seed=3))
    iso.write_picture(folder / "b.png", iso.scene("mixed", 90, 120, seed=2))
    return folder


def test_pairs_are_the_commands(photos, tmp_path, command):
    heard = []
    data = iso.dataset(
        [iso.Lens("cooke_triplet"), iso.Lens("double_gauss")], photos, tmp_path / "py", frame=(96, 64), noise="generic", judge=0.5,
        progress=lambda share, what: heard.append((share, what)),
    )
    options = ["--columns", 96, "--rows", 64, "--whole-field", "--noise", "generic", "--judge", 0.5, "--form", "npy", "-o", "cli"]
    command("dataset", "cooke_triplet", "double_gauss", "--photos", photos, *options)
    assert len(data) == 4 and data.made["made"] == 4 and data.made["judged"] == 2 and 0 <= heard[0][0] <= heard[-1][0] <= 1
    for name in ["pairs.csv", "dataset.json", *(f"{kind}/{k:05}.npy" for kind in ("capture", "truth") for k in range(2))]:
        assert (tmp_path / "py" / name).read_bytes() == (tmp_path / "cli" / name).read_bytes(), name
    capture, truth = data[-1]
    assert capture.shape == truth.shape == (3, 64, 96) and capture.dtype == np.float32
    assert 1e-4 < np.mean((capture - truth) ** 2) < 0.1
    row = data.rows[1]
    assert row["photo"] == "b.png" and row["distance_mm"] == np.inf and row["seed"] > 0 and data.settings["seed"] == 1
    assert {d for lens in data.settings["lenses"] for d in lens["distances_mm"]} == {np.inf} == {p["distance_mm"] for p in data.made["plans"]}
    # What is whole stays.
    again = iso.dataset([iso.Lens("cooke_triplet"), iso.Lens("double_gauss")], photos, tmp_path / "py", frame=(96, 64), noise="generic", judge=0.5)
    assert again.made["kept"] == 4 and again.made["made"] == 0


@pytest.mark.parametrize("form", ["npy", "npz", "tiff", "png"])
def test_every_form_is_read_and_pickled(form, photos, tmp_path):
    lens = iso.Lens("cooke_triplet")
    data = iso.dataset(lens, photos, tmp_path / "set", frame=iso.Frame(96, 64, 375), form=form)
    float_form = iso.dataset({"cooke_triplet": lens}, photos, tmp_path / "other", frame=iso.Frame(96, 64, 375))
    copied = pickle.loads(pickle.dumps(data))
    for pair, other, wanted in zip(data, copied, float_form, strict=True):
        for a, b, c in zip(pair, other, wanted):
            assert (a == b).all() and a.flags.c_contiguous
            # PNG has 16 bits between black and white.
            assert np.abs(a - (np.clip(c, 0, 1) if form == "png" else c)).max() < (2e-5 if form == "png" else 1e-9)
    assert len(data[0:2]) == 2 and "2 pairs of 1 lens" in repr(data)


def test_what_cannot_be_made_is_refused(photos, tmp_path):
    lens = iso.Lens("cooke_triplet")
    out = tmp_path / "set"
    small = {"frame": (48, 32)}
    for change, kind, words in [
        ({"distances_mm": [10]}, ValueError, "front focal point"),
        ({"distances_mm": [float("nan")]}, ValueError, "positive distances"),
        ({"form": "jpg"}, ValueError, "png, tiff, npy, npz"),
        ({"crop": 500}, ValueError, "^crop: .*500x500"),
        ({"noise_level": 2}, ValueError, "without noise"),
        ({"noise": "generik"}, FileNotFoundError, "generic"),
        ({"noise": 0.1}, TypeError, "generic"),
        ({"noise": tmp_path / "none.toml"}, FileNotFoundError, "none.toml"),
        ({"judge": 2}, ValueError, "share"),
        ({"frame": "wide"}, TypeError, "frame"),
        ({"index": 3, "of": 2}, ValueError, "3"),
    ]:
        with pytest.raises(kind, match=words):
            iso.dataset(lens, photos, out, **{**small, **change})
        assert not out.exists(), change
    with pytest.raises(TypeError, match="lenses"):
        iso.dataset(["cooke_triplet"], photos, out, **small)
    with pytest.raises(FileNotFoundError):
        iso.dataset(lens, tmp_path / "nowhere", out, **small)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="empty"):
        iso.dataset(lens, tmp_path / "empty", out, **small)
    with pytest.raises(FileNotFoundError, match=r"dataset\.json"):
        iso.Dataset(tmp_path)

    def cross(share, what):
        raise ArithmeticError(what)

    with pytest.raises(ArithmeticError):
        iso.dataset(lens, photos, out, **small, progress=cross)
    with pytest.raises(RuntimeError, match="must not call it"):
        iso.dataset(lens, photos, out, **small, progress=lambda share, what: lens.svg())
    # What was begun is gone on with; something else is refused.
    assert iso.dataset(lens, photos, out, **small).made["pairs"] == 2
    with pytest.raises(ValueError, match="form"):
        iso.dataset(lens, photos, out, **small, form="npz")


def test_work_is_split(photos, tmp_path):
    lens, out = iso.Lens("cooke_triplet"), tmp_path / "set"
    split = {"frame": (48, 32), "form": "npz", "shard": 1, "of": 2}
    assert iso.dataset(lens, photos, out, **split, index=0) is None
    with pytest.raises(FileNotFoundError, match="all parts"):
        iso.Dataset(out)
    assert len(iso.dataset(lens, photos, out, **split, index=1)) == 2
    with pytest.raises(ValueError, match="seed"):
        iso.dataset(lens, photos, out, **split, seed=5)


@pytest.mark.parametrize("form", ["heights", "grid", "filters"])
def test_maps_are_the_commands(form, tmp_path, command):
    lens = iso.Lens("cooke_triplet")
    own = {"heights": {"heights": 5}, "grid": {"grid": (3, 4)}, "filters": {"node_error": 0.1}}[form]
    options = {"heights": ["--fields", 5], "grid": ["--grid", "3,4"], "filters": ["--node-error", 0.1]}[form]
    found = lens.psf_map(form, iso.Frame(96, 64, 375), distance_mm=2000, **own)
    command("psf", "cooke_triplet", "--form", form, "--columns", 96, "--rows", 64, "--pitch-um", 375, "--depth-mm", 2000, *options, "-o", "m.npz")
    with np.load(tmp_path / "m.npz") as wanted:
        assert set(wanted) == set(found)
        for name in wanted:
            if name == "about":
                assert bytes(wanted[name]).decode() == found[name] and "convolution" in found[name]
            else:
                assert wanted[name].dtype == found[name].dtype and (wanted[name] == found[name]).all(), name


def test_maps_that_are_refused():
    lens = iso.Lens("cooke_triplet")
    frame = iso.Frame(96, 64, 375)
    for form, options, words in [
        ("wavelengths", {}, "heights, grid or filters"),
        ("heights", {"grid": (2, 2)}, "form grid or filters"),
        ("grid", {"heights": 3}, "form heights"),
        ("filters", {"grid": (2, 2), "node_error": 0.1}, "one of the two"),
        ("heights", {"size": 4}, "odd"),
        ("heights", {"heights": 0}, "1 to 4096"),
        ("heights", {"distance_mm": -1}, "positive distance"),
    ]:
        with pytest.raises(ValueError, match=words):
            lens.psf_map(form, frame, **options)
