//! What is measured and stated in tables: calibrations and tolerances in TOML, filters and point spread functions in NumPy's archives. What is read comes
//! back from what is written of it.

use std::path::Path;

use isoplanat::analysis::fabrication::tolerances::Tolerances;
use isoplanat::calibrate::file::MeasuredDistortion;
use isoplanat::calibrate::shading::{MeasuredShading, Rings};
use isoplanat::imaging::guide::{Facts, Spread};
use isoplanat::imaging::sensor::{Sensor, SpectralResponse};
use isoplanat::lens::builtin;
use isoplanat::optimize::spec::Spec;
use isoplanat::psf::measured::{MeasuredPsf, Moves};
use ndarray::Array2;

use super::{again, read};

/// Every reader takes the same text: a file is of one kind at most.
pub(super) fn tables(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let file = "a.toml";
    if let Some(found) = read(file, MeasuredDistortion::parse(text, file)) {
        let text = again(found.text(), text);
        assert_eq!(again(MeasuredDistortion::parse(&text, file), &text), found);
    }
    if let Some(found) = read(file, MeasuredShading::parse(text, file)) {
        let text = again(found.text(), text);
        assert_eq!(again(MeasuredShading::parse(&text, file), &text), found);
    }
    if let Some(found) = read(file, Sensor::parse(text, file)) {
        let path = super::place("sensor.toml");
        again(found.save(&path), text);
        assert_eq!(again(Sensor::load(&path), text), found);
    }
    read(file, Tolerances::parse(text, file));
    if let Some(found) = read(file, Spec::from_toml(text, file)) {
        read(file, found.problem(&builtin::lens("cooke_triplet").expect("shipped"), file));
    }
}

/// A sensor with a short response.
pub(super) fn sensor() -> Sensor {
    let response = SpectralResponse {
        wavelength_nm: vec![450.0, 550.0, 650.0],
        red: vec![0.0, 0.2, 1.0],
        green: vec![0.1, 1.0, 0.1],
        blue: vec![1.0, 0.2, 0.0],
    };
    Sensor { spectral_response: response, ..Sensor::generic() }
}

pub(super) fn starts() -> Vec<Vec<u8>> {
    let distortion = "schema = 1\ncamera = \"c\"\nlens = \"l\"\nsource = \"s\"\ncolumns = 640\nrows = 480\nfocal_length_px = 500.0\n\
                      centre_px = [320.0, 240.0]\nk = [-0.2, 0.01, 0.0]\nmax_slope = 0.7\nrms_px = 0.1\n";
    let tolerances = "schema = 1\ntest_wavelength_nm = 632.8\n[assembly]\nair_mm = 0.05\ntilt_arcmin = 2.0\n[element.all]\nthickness_mm = 0.05\n\
                      [surface.all]\nradius_percent = 0.2\nirregularity_fringes = 0.5\n[surface.1]\npower_fringes = 3.0\n";
    let spec = "vary = [\"surface[*].curvature\"]\nfix = [\"surface[0].thickness\"]\nfields = [0.0, 0.7, 1.0]\nfield_weights = [1.0, 1.0, 0.5]\n\
                depths_mm = [inf, 500.0]\nrings = 4\narms = 6\nquality = \"wavefront\"\nreference = \"chief\"\napertures = \"stated\"\n\
                [bounds]\n\"surface[1].thickness\" = [0.5, 9.0]\n[constraints]\nfocal_length = 50.0\nback_focus = [30.0, inf]\n\
                [targets]\ndistortion = { value = 0.0, weight = 0.01 }\n";
    let shading = MeasuredShading {
        schema: 1,
        camera: "c".into(),
        lens: "l".into(),
        source: "s".into(),
        columns: 64,
        rows: 48,
        centre_px: [32.0, 24.0],
        rms: 0.01,
        illumination: Rings {
            radius_px: vec![0.0, 20.0, 40.0],
            red: vec![1.0, 0.9, 0.6],
            green: vec![1.0, 0.9, 0.7],
            blue: vec![1.0, 0.8, 0.6],
        },
    };
    let path = super::place("sensor.toml");
    sensor().save(&path).expect("writes");
    let mut all = vec![std::fs::read(&path).expect("reads"), shading.text().expect("valid").into_bytes()];
    all.extend([distortion, tolerances, spec].map(|text| text.as_bytes().to_vec()));
    all
}

/// Both readers of archives take the same bytes.
pub(super) fn npz(bytes: &[u8]) {
    let path = Path::new("a.npz");
    if let Some(found) = read("a.npz", Facts::from_npz(bytes, path)) {
        assert_eq!(again(Facts::from_npz(&again(found.to_npz(), ""), path), ""), found);
    }
    if let Some(found) = read("a.npz", MeasuredPsf::from_npz(bytes, path)) {
        assert_eq!(again(MeasuredPsf::from_npz(&again(found.to_npz(), ""), path), ""), found);
    }
}

pub(super) fn npz_starts() -> Vec<Vec<u8>> {
    let numbers = Array2::from_shape_fn((3, 5), |(k, n)| if n == 3 { 0.1 } else { 1.0 + k as f64 });
    let spread = Spread::from_parts(vec![0.0, 20.0, 90.0], numbers).expect("valid");
    let moves = Moves::within(1.0, 1.0).expect("valid");
    let even: f64 = moves.iter().map(|(_, n)| n).sum();
    let weights = vec![vec![vec![1.0 / even; moves.len()]; 3]; 2];
    let psf = MeasuredPsf::new([64, 48], [32.0, 24.0], moves, vec![0.0, 40.0], weights).expect("valid");
    let facts = Facts { spread: Some(spread), vergences: vec![0.0, 0.001], ..Facts::default() };
    vec![facts.to_npz().expect("writes"), psf.to_npz().expect("writes")]
}
