use super::*;
use isoplanat_optics::lens::builtin;
use serde_json::json;

/// A picture of shapes, and the same blurred and with noise.
fn scene(name: &str, seed: u64) -> SceneResult {
    let truth = Array3::from_shape_fn((3, 120, 160), |(k, r, c)| {
        let (x, y) = (c as f32 / 160.0 - 0.5, r as f32 / 120.0 - 0.5);
        let ring = (40.0 * (x * x + y * y).sqrt() + seed as f32).sin() * 0.25 + 0.4;
        if (r / 15 + c / 15) % 4 == 0 { ring * [1.0, 0.6, 0.3][k] } else { ring * [0.4, 0.7, 1.0][k] }
    });
    let rng = &mut fastrand::Rng::with_seed(seed);
    let mut changed = |width: usize, noise: f32| {
        Array3::from_shape_fn(truth.dim(), |(k, r, c)| {
            let (r1, c1) = ((r + width).min(119), (c + width).min(159));
            let part = truth.slice(s![k, r.saturating_sub(width)..=r1, c.saturating_sub(width)..=c1]);
            (part.mean().unwrap_or(0.0) + noise * (rng.f32() - 0.5)).max(0.0)
        })
    };
    let (capture, wiener, bare, network) = (changed(4, 0.06), changed(2, 0.05), changed(2, 0.01), changed(1, 0.01));
    let crops = [Crop { row: 30, column: 40, size: 32 }, Crop { row: 999, column: 999, size: 32 }];
    SceneResult::measure(name, capture, wiener, bare, network, truth, &crops).expect("measures")
}

fn report() -> DemoReport {
    let (before, after) =
        (builtin::lens("two_element").expect("shipped"), builtin::lens("cooke_triplet").expect("shipped"));
    let curve = |name: &str, floor: f64| LossCurve {
        name: name.into(),
        points: (0..200).map(|i| (f64::from(i), floor + (-0.03 * f64::from(i)).exp())).collect(),
    };
    let method = |name: &str, seconds: f64, psnr_db: f64, note: &str| MethodResult {
        name: name.into(),
        seconds,
        psnr_db,
        relative_l2: 10f64.powf(-psnr_db / 20.0) * 3.0,
        note: note.into(),
    };
    DemoReport {
        title: "Isoplanat: synthetic report".into(),
        summary: "Figures made up for the test of this page; the lenses and their kernels are real.".into(),
        runtime: "2 threads, no inference".into(),
        settings: vec![("seed".into(), "1".into()), ("photographs".into(), "<built in>".into())],
        before: Some(LensView::new(&before, 1000.0, 5, true).expect("traces")),
        after: Some(LensView::new(&after, 1000.0, 5, true).expect("traces")),
        loss: vec![curve("Joint design: image loss", 0.02), curve("Final network: image loss", 0.5)],
        scenes: vec![scene("Rings", 1), scene("More rings", 2)],
        methods: vec![
            method("PSF grid, m = 1", 0.04, 48.2, ""),
            method("PSF grid, m = 2", 0.13, 56.1, "chosen: cheapest above 50 dB"),
            method("Monte Carlo, 64 samples", 21.0, 33.0, ""),
            method("Monte Carlo, converged", 900.0, f64::INFINITY, "judge"),
        ],
        psnr_fast_vs_reference_db: 56.1,
        seconds_fast: 0.13,
        seconds_reference: 21.0,
        seconds_total: 421.7,
        stages: vec![("render".into(), 12.0), ("design".into(), 220.55)],
        left_out: vec!["Depth: every scene is a plane at 1 m".into(), "Surfaces 0, 1: they vignette nothing".into()],
    }
}

/// `ISOPLANAT_KEEP_REPORT=path` keeps the page for looking at.
#[test]
fn the_page_holds_everything_and_loads_nothing() {
    let report = report();
    let page = report.to_html().expect("renders");
    if let Ok(path) = std::env::var("ISOPLANAT_KEEP_REPORT") {
        std::fs::write(path, &page).expect("writes");
    }
    assert_eq!(page.matches("http").count(), page.matches("xmlns=\"http://www.w3.org/2000/svg\"").count());
    // Two atlases, two scenes of five pictures and two crops of five.
    assert_eq!(page.matches("<img").count(), 2 + 2 * (5 + 2 * 5));
    for text in [
        "Before",
        "colour shift",
        "Wiener",
        "56.1 dB",
        "7 min 02 s",
        "Left out",
        "&lt;built in&gt;",
        "PSNR against run time",
        "dB against the network of the capture alone",
    ] {
        assert!(page.contains(text), "{text}");
    }
    // Pictures come first, then the lens, then curves.
    let places =
        ["<h2>Pictures<", "<figcaption>Before<", "<h2>Training<"].map(|heading| page.find(heading).expect(heading));
    assert!(places.is_sorted(), "{places:?}");
    assert!(DemoReport::default().verdict().is_none());
    DemoReport::default().to_html().expect("an empty report is a page, too");
}

#[test]
fn the_summary_has_its_keys_in_every_scene_and_at_the_top() {
    let report = report();
    let summary = report.summary_json();
    assert_eq!(summary["schema"], json!(1));
    let scenes = summary["scenes"].as_array().expect("list");
    assert_eq!((scenes.len(), &scenes[1]["name"]), (2, &json!("More rings")));
    for key in [
        "psnr_capture_db",
        "psnr_wiener_db",
        "psnr_bare_db",
        "psnr_reconstruction_db",
        "ssim_capture",
        "ssim_wiener",
        "ssim_bare",
        "ssim_reconstruction",
        "delta_e_capture",
        "delta_e_reconstruction",
        "colour_shift_capture",
        "colour_shift_wiener",
        "colour_shift_bare",
        "colour_shift_reconstruction",
        "psnr_fast_vs_reference_db",
        "seconds_fast",
        "seconds_reference",
        "seconds_total",
    ] {
        let number = |v: &Value| v[key].as_f64().unwrap_or_else(|| panic!("{key} in {v}"));
        let mean = 0.5 * (number(&scenes[0]) + number(&scenes[1]));
        assert!((number(&summary) - mean).abs() < 1e-9 * mean.abs(), "{key}");
    }
    assert!(summary["runtime"].is_string() && scenes[0]["runtime"].is_string());
    assert!(summary["psnr_reconstruction_db"].as_f64() > summary["psnr_capture_db"].as_f64());
    assert_eq!(DemoReport::default().summary_json()["scenes"], json!([]));
}

#[test]
fn pictures_of_different_shapes_are_refused() {
    let [a, b] = [16, 20].map(|n| Array3::<f32>::zeros((3, n, 20)));
    let error = SceneResult::measure("x", a.clone(), a.clone(), a.clone(), a, b, &[]).expect_err("shapes differ");
    assert_eq!(error.exit_code(), 2);
}
