"""`develop`: the program does the work, or says how to get it."""

import numpy as np
import pytest

import isoplanat as iso
from conftest import program


def test_without_the_program_it_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.delenv("ISOPLANAT_CAMERA", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FileNotFoundError, match="isoplanat-camera: not found in PATH; `cargo install --path .`"):
        iso.develop("a.dng")
    monkeypatch.setenv("ISOPLANAT_CAMERA", str(tmp_path / "absent"))
    (tmp_path / "a.dng").write_bytes(b"")
    with pytest.raises(FileNotFoundError, match="absent: "):
        iso.develop(tmp_path / "a.dng")


def test_a_capture_is_developed(monkeypatch, tmp_path):
    monkeypatch.setenv("ISOPLANAT_CAMERA", str(program("isoplanat-camera")))
    lens, frame = iso.Lens("cooke_triplet"), iso.Frame(96, 64, 375.0)
    grey = np.full((3, 8, 12), 0.4, np.float32)
    iso.capture(lens, grey, frame, samples=16, exposure=0.9).save(tmp_path / "grey.dng")
    picture = iso.develop(tmp_path / "grey.dng")
    assert picture.shape == (3, 64, 96) and picture.dtype == np.float32
    middle = picture[:, 24:40, 36:60].mean((1, 2))
    # Exposed at 0.9 and grey in every channel.
    assert middle == pytest.approx(np.full(3, 0.36), rel=0.05)
    with pytest.raises(FileNotFoundError, match="none.dng: reading: "):
        iso.develop(tmp_path / "none.dng")
    (tmp_path / "bad.dng").write_bytes(b"no DNG")
    with pytest.raises(ValueError, match="bad.dng"):
        iso.develop(tmp_path / "bad.dng")
