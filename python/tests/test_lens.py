"""Lenses: numbers, files, pickles, notebooks."""

import copy
import pickle
from pathlib import Path

import numpy as np
import pytest

import isoplanat as iso


def test_every_shipped_lens_loads_and_comes_back_the_same():
    names = iso.lenses()
    assert len(names) >= 16
    for name in names:
        lens = iso.Lens(name)
        for again in [pickle.loads(pickle.dumps(lens)), copy.copy(lens), copy.deepcopy(lens)]:
            assert again == lens and again.parameters == lens.parameters and hash(again) == hash(lens)
            assert again.file == lens.file == name and again.sha256 == lens.sha256
        assert iso.Lens.from_toml(lens.to_toml()) == lens


def test_numbers_are_read_and_replaced():
    lens = iso.Lens("cooke_triplet")
    assert lens.parameters["surface[0].curvature"] == 1 / 22.01359
    bent = lens.replace({"surface[0].curvature": 0.04, "surface[1].thickness": 6.5}, distance_mm=700)
    assert bent.parameters["surface[0].curvature"] == 0.04 and bent.parameters["surface[1].thickness"] == 6.5
    assert bent.distance_mm == pytest.approx(700, rel=1e-15) and lens.distance_mm == np.inf
    assert bent != lens and lens.parameters["surface[0].curvature"] == 1 / 22.01359
    assert lens.replace() == lens
    for numbers, text in [
        ({"surface[9].curvature": 0.1}, "cooke_triplet: surface[9].curvature: no such number; a name in its parameters"),
        ({"surface[1].thickness": -3.0}, "surface[1].thickness_mm: -3"),
        ({"surface[0].curvature": float("nan")}, "surface[0].curvature_per_mm: NaN"),
    ]:
        with pytest.raises(ValueError) as error:
            lens.replace(numbers)
        assert text in str(error.value)
    with pytest.raises(TypeError, match="surface\\[0\\].curvature: .*a number"):
        lens.replace({"surface[0].curvature": "much"})
    with pytest.raises(ValueError, match="distance_mm: -1; a positive distance"):
        lens.replace(distance_mm=-1)


def test_files_go_out_and_come_back(tmp_path):
    lens = iso.Lens("cooke_triplet")
    for ending in ["toml", "zmx", "seq"]:
        path = tmp_path / f"lens.{ending}"
        lens.save(path)
        again = iso.Lens(path)
        assert again.file == str(path)
        assert again.inspect()["effective_focal_length_mm"] == pytest.approx(lens.inspect()["effective_focal_length_mm"], rel=1e-9)
        before = path.read_bytes()
        with pytest.raises(FileExistsError, match="exists already; name another output or pass force=True"):
            lens.save(path)
        assert path.read_bytes() == before
        lens.save(str(path), force=True)
    with pytest.raises(ValueError, match="the ending `png`"):
        lens.save(tmp_path / "lens.png")
    with pytest.raises(FileNotFoundError, match="absent.zmx: reading: "):
        iso.Lens(tmp_path / "absent.zmx")
    with pytest.raises(ValueError, match="built-in lens: name: `no_such_lens`; one of .*cooke_triplet"):
        iso.Lens("no_such_lens")
    (tmp_path / "bad.toml").write_text("schema = 1\n")
    with pytest.raises(ValueError, match="bad.toml: "):
        iso.Lens(tmp_path / "bad.toml")
    assert {p.name for p in tmp_path.iterdir()} == {"lens.toml", "lens.zmx", "lens.seq", "bad.toml"}


def test_figures_are_the_published_ones():
    told = iso.Lens("cooke_triplet").inspect()
    assert told["effective_focal_length_mm"] == pytest.approx(50.0213507194, abs=1e-9)
    assert len(told["surfaces"]) == 6 and told["object_distance_mm"] is None
    with pytest.raises(ValueError, match="wavelength_nm: 5; 200 to 20000 nm"):
        iso.Lens("cooke_triplet").inspect(wavelength_nm=5)


def test_a_notebook_shows_drawing_and_figures():
    html = iso.Lens("cooke_triplet")._repr_html_()
    assert html.count("<svg") == 1 and "50.021351" in html and "effective focal length" in html
    named = iso.Lens.from_toml(iso.Lens("cooke_triplet").to_toml().replace("Cooke triplet", "<script>"))
    assert "<script>" not in named._repr_html_()


def test_frames_are_values(tmp_path):
    frame = iso.Frame(columns=1024, rows=768, pitch_um=3.45)
    assert (frame.columns, frame.rows, frame.pitch_um, frame.axis_px) == (1024, 768, 3.45, (512, 384))
    assert frame == iso.Frame(1024, 768, 3.45, (512, 384)) and hash(frame) == hash(iso.Frame(1024, 768, 3.45))
    corner = iso.Frame(4, 3, 2.0, axis_px=(0, 3))
    assert corner != frame and pickle.loads(pickle.dumps(corner)) == corner == copy.deepcopy(corner)
    for wrong, text in [
        (dict(columns=0, rows=3, pitch_um=1.0), "columns: 0; 1 to 65536 pixels"),
        (dict(columns=3, rows=3, pitch_um=float("nan")), "pitch_um: NaN; a positive number of µm"),
        (dict(columns=3, rows=3, pitch_um=1.0, axis_px=(float("inf"), 0)), "axis_px"),
    ]:
        with pytest.raises(ValueError, match=text):
            iso.Frame(**wrong)
    assert iso.Lens("cooke_triplet").frame.columns == 6000


def test_a_better_lens_is_better():
    lens = iso.Lens("cooke_triplet")
    found = lens.optimize(iterations=30, constraints={"track": (None, 70)}, bounds={"surface[*].thickness": (0.5, None)})
    before, after = found.rms_um
    assert after < before and found.lens != lens and not found.broken
    assert found.held["track"][0] <= 70 * (1 + 1e-6) and found.held["track"][2] == 70
    focal_length = [l.inspect()["effective_focal_length_mm"] for l in [lens, found.lens]]
    assert focal_length[1] == pytest.approx(focal_length[0], rel=1e-6)
    name, (old, new) = next((n, m) for n, m in found.moved.items() if m[0] != m[1])
    assert lens.parameters[name] == old and found.lens.parameters[name] == new
    for wrong in [dict(vary=["surface[77].curvature"]), dict(constraints={"weight": 3}), dict(iterations=0), dict(minutes=-1)]:
        with pytest.raises(ValueError):
            lens.optimize(**wrong)
    with pytest.raises(TypeError, match="constraints: track: "):
        lens.optimize(constraints={"track": [1, 2, 3]})


def test_analyses_are_arrays_and_a_page(tmp_path):
    lens = iso.Lens("cooke_triplet")
    spot = lens.spot(rays=400)
    assert spot["rays"].shape[-1] == 5 and len(spot["fields"]) == len(spot["field_angle_deg"])
    field = spot["fields"][-1]
    # The rms radius about the centroid, from the rays themselves.
    rays, share = spot["rays"][-1], spot["weight"]
    weight = rays[..., 4] * share[:, None]
    at = np.nan_to_num(rays[..., :2])
    mean = (weight[..., None] * at).sum((0, 1)) / weight.sum()
    rms = np.sqrt((weight * ((at - mean) ** 2).sum(-1)).sum() / weight.sum())
    assert field["rms_mm"] == pytest.approx(rms, rel=0.02)
    mtf = lens.mtf(rays=400)
    assert mtf["mtf"].shape == (len(mtf["shift_mm"]), len(mtf["fields"]), len(mtf["cycles_per_mm"]), 2)
    assert mtf["mtf"][:, :, 0].max() <= 1 + 1e-12
    bent = lens.distortion()["angle_height_percent"]
    assert bent[0, 2] == 0 and bent.shape[1] == 3
    page = tmp_path / "lens.html"
    told = lens.report(page, rays=400)
    assert "<html" in page.read_text() and told["lens"]["name"] == lens.name
    with pytest.raises(FileExistsError):
        lens.report(page, rays=400)
    with pytest.raises(ValueError, match="rays: 3; 16 to 1000000"):
        lens.spot(rays=3)


def test_the_package_is_typed():
    assert (Path(iso.__file__).parent / "py.typed").is_file()
