//! `isoplanat psf --form`: files that other programs read, options that belong to other forms.

use std::fs::File;

use ndarray::{Array1, Array2, Array3, Array4, Array5};
use ndarray_npy::{NpzReader, ReadableElement};
use serde_json::Value;

use crate::support::Workplace;

struct Archive(NpzReader<File>);

impl Archive {
    fn open(place: &Workplace, name: &str) -> Self {
        Self(NpzReader::new(File::open(place.path(name)).expect(name)).expect("an archive"))
    }

    fn get<T: ReadableElement, D: ndarray::Dimension>(&mut self, name: &str) -> ndarray::Array<T, D> {
        self.0.by_name(name).unwrap_or_else(|e| panic!("{name}: {e}"))
    }
}

const FRAME: &str = "--columns 96 --rows 64 --pitch-um 375 --rays 2000";

#[test]
fn heights_are_one_lens_of_a_training_set() {
    let place = Workplace::new();
    let ran = place.run(&format!("psf cooke_triplet -o h.npz --form heights --png h.png --csv h.csv --json {FRAME}"));
    let json: Value = serde_json::from_str(&ran.done()).expect("JSON");
    assert_eq!((json["form"].as_str(), json["kernels"].as_u64()), (Some("heights"), Some(64)));
    let mut npz = Archive::open(&place, "h.npz");
    let psf: Array4<f32> = npz.get("psf");
    let (light, distortion, height): (Array1<f64>, Array1<f64>, Array1<f64>) =
        (npz.get("illumination"), npz.get("distortion"), npz.get("height_mm"));
    let outside: Array2<f64> = npz.get("outside");
    assert_eq!(
        (psf.shape()[..2].to_vec(), light.len(), distortion.len(), outside.dim()),
        (vec![64, 3], 64, 64, (64, 3))
    );
    assert_eq!((light[0], distortion[0], height[0]), (1.0, 0.0, 0.0));
    assert!((height[63] - 0.375 * 48f64.hypot(32.0)).abs() < 1e-9);
    let about: Array1<u8> = npz.get("about");
    let about = String::from_utf8(about.to_vec()).expect("text");
    for expected in ["towards the last row", "convolution", "1 - outside", "no diffraction"] {
        assert!(about.contains(expected), "{about}");
    }
    assert!(place.path("h.png").is_file());
    let csv = std::fs::read_to_string(place.path("h.csv")).expect("values");
    assert_eq!(csv.lines().count(), 65);
    assert!(
        csv.starts_with("row_px,col_px,height_mm,distortion,relative_illumination,outside\n,,0,0,1,"),
        "{csv:.200}"
    );
    // The distortion that the analysis states at the same height.
    let shown = place.run("distortion cooke_triplet --json").done();
    let curve: Value = serde_json::from_str(&shown).expect("JSON");
    let text = curve.to_string();
    assert!(text.contains("distortion"), "{text:.300}");
}

#[test]
fn grids_and_filters_stand_over_the_frame() {
    let place = Workplace::new();
    let text = place.run(&format!("psf double_gauss -o g.npz --form grid --grid 3,5 --depth-mm 2000 {FRAME}")).done();
    assert!(text.contains("15 kernels of"), "{text}");
    let mut npz = Archive::open(&place, "g.npz");
    let psf: Array5<f32> = npz.get("psf");
    assert_eq!(psf.shape()[..3], [3, 5, 3]);
    assert_eq!(npz.get::<i64, ndarray::Ix1>("row_px").to_vec(), [0, 32, 63]);
    assert_eq!(npz.get::<i64, ndarray::Ix1>("col_px").to_vec(), [0, 24, 48, 71, 95]);
    assert_eq!(npz.get::<f64, ndarray::Ix0>("distance_mm").into_scalar(), 2000.0);
    let light: Array3<f64> = npz.get("illumination");
    assert!(light[[1, 2, 1]] > 0.999 && light[[0, 0, 1]] < 0.95, "{light}");

    let text = place.run(&format!("psf double_gauss -o f.npz --form filters --grid 2,3 {FRAME}")).done();
    assert!(text.contains("6 kernels of") && text.contains("multipliers: 6 × 3 × 64 × 96"), "{text}");
    let mut npz = Archive::open(&place, "f.npz");
    let (filters, multipliers): (Array5<f32>, Array5<f32>) = (npz.get("filters"), npz.get("multipliers"));
    assert_eq!((filters.shape()[..3].to_vec(), multipliers.shape().to_vec()), (vec![1, 3, 6], vec![1, 3, 6, 64, 96]));
    // Windows sum to one: what is left is the light.
    let sum = multipliers.sum_axis(ndarray::Axis(2));
    assert!((sum[[0, 1, 32, 48]] - 1.0).abs() < 1e-3 && sum[[0, 1, 0, 0]] < 0.95, "{}", sum[[0, 1, 0, 0]]);
    place.run(&format!("psf double_gauss -o f.npz --form filters {FRAME}")).refused(&["f.npz", "--force"]);
    place.run(&format!("psf double_gauss -o f.npz --form filters --node-error 0.2 --force {FRAME}")).done();
}

#[test]
fn options_of_other_forms_are_refused() {
    let place = Workplace::new();
    for (options, expected) in [
        ("--columns 64", "--columns"),
        ("--form heights --wavelength-nm 550", "--wavelength-nm"),
        ("--form grid --fields 5", "--fields"),
        ("--form heights --grid 3,3", "--grid"),
        ("--form heights --depth-mm 500,inf", "one with --form heights"),
        ("--form grid --node-error 0.1", "--node-error"),
        ("--form filters --node-error 7", "node error"),
        ("--form filters --grid 3,3 --node-error 0.1", "--node-error"),
        ("--form grid --grid 0,3", "0 × 3"),
        ("--form grid --rows 0", "rows"),
        ("--form heights --size 40", "--size"),
        ("--form filters --memory-gib 1", "memory"),
        ("--form psfs", "psfs"),
    ] {
        place.run(&format!("psf cooke_triplet -o out.npz {options}")).refused(&[expected]);
    }
    assert!(place.files().is_empty(), "{:?}", place.files());
}

/// By diffraction: what a pixel of a closed lens gets is less than rays have it, light is counted, and what was done is told; in the colours of a sensor too.
#[test]
fn kernels_by_diffraction_are_wider_and_count_their_light() {
    let place = Workplace::new();
    let common = "psf cooke_triplet --f-number 16 --fields 2 --pitch-um 4 --rays 4000 --wavelength-nm 550";
    let waves = place.run(&format!("{common} -o w.npz --diffraction --json")).done();
    let rays = place.run(&format!("{common} -o r.npz --json")).done();
    let [waves, rays]: [Value; 2] = [waves, rays].map(|text| serde_json::from_str(&text).expect("JSON"));
    assert!(rays["diffraction"].is_null(), "{rays}");
    let told = &waves["diffraction"];
    assert!(told["residual_waves"].as_f64().is_some_and(|v| v < 1e-3) && told["of_rays"] == 0, "{told}");
    let mut peaks = Vec::new();
    for (name, diffraction) in [("w.npz", 1), ("r.npz", 0)] {
        let mut npz = Archive::open(&place, name);
        let (kernels, outside): (Array5<f32>, Array3<f64>) = (npz.get("kernels"), npz.get("outside"));
        assert_eq!(npz.get::<i64, ndarray::Ix0>("diffraction").into_scalar(), diffraction);
        for field in 0..2 {
            let sum: f64 = kernels.slice(ndarray::s![0, field, 0, .., ..]).iter().map(|v| f64::from(*v)).sum();
            assert!((sum + outside[[0, field, 0]] - 1.0).abs() < 1e-5, "{name} {field}: {sum}");
            // An automatic window holds 99 % of the light.
            assert!(outside[[0, field, 0]] < 0.015, "{name} {field}: {}", outside[[0, field, 0]]);
        }
        peaks.push(kernels.slice(ndarray::s![0, 0, 0, .., ..]).fold(0.0, |m: f32, v| m.max(*v)));
    }
    assert!(peaks[0] < peaks[1], "{peaks:?}");
    let text =
        place
        .run("psf double_gauss -o g.npz --form grid --grid 1,2 --diffraction --size 9 --columns 24 --rows 16 --pitch-um 6 --rays 500")
        .done();
    assert!(text.contains("by diffraction: paths to"), "{text}");
    let about: Array1<u8> = Archive::open(&place, "g.npz").get("about");
    assert!(String::from_utf8(about.to_vec()).expect("text").contains("By diffraction of scalar waves."));
    // A blur of thousands of waves is told to be of rays.
    let text = place.run("psf double_gauss -o b.npz --depth-mm 50 --fields 1 --size 9 --rays 500 --diffraction").done();
    assert!(text.contains("of rays, since their blur has hundreds of waves"), "{text}");
}

/// Strehl ratios and radii of the light by diffraction: the same in table, values and arrays of `psf`, and in `spot`, whose wavelengths are those of the lens.
#[test]
fn energy_by_diffraction_is_told_alike() {
    let place = Workplace::new();
    let said = place.run(
        "psf cooke_triplet -o e.npz --csv e.csv --f-number 11 --fields 3 --size 21 --rays 500 --diffraction --json",
    );
    let json: Value = serde_json::from_str(&said.done()).expect("JSON");
    let mut npz = Archive::open(&place, "e.npz");
    let (strehl, radii): (Array2<f64>, Array3<f64>) = (npz.get("strehl"), npz.get("encircled_50_80_95_mm"));
    assert_eq!((strehl.dim(), radii.dim()), ((1, 3), (1, 3, 3)));
    let csv = std::fs::read_to_string(place.path("e.csv")).expect("values");
    assert!(csv.lines().next().is_some_and(|l| l.ends_with("outside,strehl,encircled_50_mm,encircled_80_mm")), "{csv}");
    let number = |v: &Value| v.as_f64().expect("a number");
    for (field, row) in json["rows"].as_array().expect("rows").iter().enumerate() {
        let of = [strehl[[0, field]], radii[[0, field, 0]], radii[[0, field, 1]]];
        let told = ["strehl", "encircled_50_mm", "encircled_80_mm"].map(|k| number(&row[k]));
        assert!(told.iter().zip(&of).all(|(a, b)| (a / b - 1.0).abs() < 1e-12), "{told:?} {of:?}");
        assert!(of[0] > 0.0 && of[0] < 1.0 && of[1] > 0.0 && of[1] < of[2] && of[2] < radii[[0, field, 2]], "{of:?}");
    }
    let angle = number(&json["rows"][2]["field_angle_deg"]);
    let said = place.run(&format!("spot cooke_triplet --f-number 11 --max-angle-deg {angle} --json"));
    let spot: Value = serde_json::from_str(&said.done()).expect("JSON");
    let fields = spot["fields"].as_array().expect("fields");
    for (field, shown) in [(0, &fields[0]), (2, &fields[4])] {
        let found = [number(&shown["strehl"]), number(&shown["encircled_diffraction_50_80_95_mm"][1])];
        let expected = [strehl[[0, field]], radii[[0, field, 1]]];
        assert!(found.iter().zip(&expected).all(|(a, b)| (a / b - 1.0).abs() < 1e-3), "{found:?} {expected:?}");
    }
    let series = spot["plots"]["encircled_energy"]["series"].as_array().expect("curves");
    assert_eq!((series.len(), series[1]["name"].as_str()), (10, Some("0° by diffraction")));
    assert!(place.run("spot cooke_triplet").done().contains("80 % by diffraction/µm"));
    // Of rays alone there is neither, and where nothing is followed it is said why.
    let rays = place.run("psf cooke_triplet -o r.npz --fields 2 --size 21 --rays 500 --json").done();
    assert!(!rays.contains("strehl"), "{rays}");
    let far = place.run("spot double_gauss --depth-mm 50");
    assert!(far.code == 0 && far.err.contains("encircled energy by diffraction"), "{}", far.err);
    assert!(far.err.contains("hundreds of waves") && far.out.contains('–'), "{} {}", far.err, far.out);
}
