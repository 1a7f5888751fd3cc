//! Charts: fits against another program's on its own corners, corners against another program's, known cameras, and what is no chart.

use glam::{DMat3, DVec2, DVec3};
use isoplanat::calibrate::View;
use isoplanat::calibrate::model::{Pinhole, Pose};
use isoplanat::calibrate::solve::{Settings, solve};
use isoplanat::testing::{between, shared};
use serde_json::Value;

/// The reference, and its corners picture by picture. OpenCV counts from the centre of the first pixel.
fn reference() -> Option<(Value, Vec<(String, View)>)> {
    let file = shared("data/calibration/carnd_opencv_reference.json")?;
    let read = |p: &std::path::Path| std::fs::read_to_string(p).expect("reads");
    let text = read(&file.with_file_name("carnd_opencv_reference_corners.csv"));
    let mut views: Vec<(String, View)> = Vec::new();
    for line in text.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |k: usize| cells[k].parse::<f64>().expect("a number");
        if views.last().is_none_or(|v| v.0 != cells[0]) {
            views.push((cells[0].to_owned(), View { board: Vec::new(), seen: Vec::new() }));
        }
        let view = &mut views.last_mut().expect("one").1;
        view.board.push(DVec2::new(number(2), number(1)));
        view.seen.push(DVec2::new(number(3), number(4)) + 0.5);
    }
    Some((serde_json::from_str(&read(&file)).expect("JSON"), views))
}

fn settings(terms: usize) -> Settings {
    Settings { size: [1280, 720], terms, centre_px: None, focal_px: None, oblong_pixels: true }
}

/// The same corners, the same model: the same camera.
#[test]
fn fits_agree_with_opencv_on_its_own_corners() {
    let Some((reference, views)) = reference() else { return };
    let views: Vec<View> = views.into_iter().map(|v| v.1).collect();
    for (name, terms) in [("k1", 1), ("k1k2", 2)] {
        let model = &reference["models"][name];
        let number = |v: &Value| v.as_f64().expect("a number");
        let fit = solve(&views, &settings(terms)).expect("fits");
        let (rms, expected) = (fit.rms_px(), number(&model["rms_px"]));
        assert!((rms / expected - 1.0).abs() < 1e-5, "{name}: {rms} against {expected}");
        let [fx, fy] = ["fx", "fy"].map(|k| number(&model[k]));
        let centre = DVec2::new(number(&model["cx"]) + 0.5, number(&model["cy"]) + 0.5);
        let off = (fit.camera.focal_px - DVec2::new(fx, fy)).abs().max_element();
        assert!(off < 0.05, "{name}: focal lengths off by {off} px");
        assert!((fit.camera.centre_px - centre).length() < 0.05, "{name}: {} against {centre}", fit.camera.centre_px);
        for k in 0..terms {
            let expected = number(&model["dist_k1k2p1p2k3"][k]);
            assert!((fit.camera.k[k] - expected).abs() < 2e-4, "{name}: k{} {} {expected}", k + 1, fit.camera.k[k]);
        }
    }
}

/// Cameras that are known come back from noisy corners within their standard errors: wide, long, oblong boards, centres held and free.
#[test]
fn known_cameras_come_back_within_their_errors() {
    let rng = &mut fastrand::Rng::with_seed(5);
    for (focal, k, noise) in [
        (700.0, [-0.3, 0.12, -0.02], 0.1),
        (420.0, [-0.25, 0.07, -0.008], 0.1),
        (1150.0, [-0.25, 0.0, 0.0], 0.3),
        (6000.0, [1.5, 0.0, 0.0], 0.1),
        (900.0, [0.1, 0.05, 0.0], 0.0),
    ] {
        let camera = Pinhole { focal_px: DVec2::splat(focal), centre_px: DVec2::new(655.0, 348.0), k };
        let terms = k.iter().filter(|v| **v != 0.0).count();
        let mut views = Vec::new();
        while views.len() < 14 {
            // Tilted by up to 40°, somewhere in the frame.
            let tilt = DVec2::new(between(rng, -0.7, 0.7), between(rng, -0.7, 0.7));
            let turn = DMat3::from_rotation_y(tilt.x)
                * DMat3::from_rotation_x(tilt.y)
                * DMat3::from_rotation_z(between(rng, -0.3, 0.3));
            let distance = 12.0 * focal / 1000.0;
            let slope = DVec2::new(between(rng, -0.45, 0.45) * 1280.0, between(rng, -0.45, 0.45) * 720.0) / focal;
            let pose = Pose {
                turn,
                at: DVec3::new(slope.x * distance, slope.y * distance, distance) - turn * DVec3::new(4.0, 2.5, 0.0),
            };
            let mut view = View { board: Vec::new(), seen: Vec::new() };
            for i in 0..54 {
                let board = DVec2::new(f64::from(i % 9), f64::from(i / 9));
                let Some(slope) = Pinhole::slopes(board, &pose) else { continue };
                let seen = camera.land(slope);
                let inside = seen.x > 5.0 && seen.x < 1275.0 && seen.y > 5.0 && seen.y < 715.0;
                // Only where the polynomial does not fold.
                if inside && camera.growth(slope.length()) > 0.2 {
                    let mut normal = || (0..12).map(|_| rng.f64()).sum::<f64>() - 6.0;
                    view.board.push(board);
                    view.seen.push(seen + noise * DVec2::new(normal(), normal()));
                }
            }
            if view.board.len() >= 20 {
                views.push(view);
            }
        }
        for held in [false, true] {
            let centre_px = held.then_some(camera.centre_px);
            let fit = solve(&views, &Settings { centre_px, oblong_pixels: false, ..settings(terms) }).expect("fits");
            let check = |found: f64, truth: f64, error: f64, what: &str| {
                let allowed = 4.0 * error + 1e-6 * truth.abs() + 1e-9;
                assert!((found - truth).abs() <= allowed, "f {focal}, {what}: {found} against {truth} ± {error}");
            };
            check(fit.camera.focal_px.x, focal, fit.errors.focal_px.x, "focal length");
            for axis in 0..2 {
                check(fit.camera.centre_px[axis], camera.centre_px[axis], fit.errors.centre_px[axis], "centre");
            }
            for ((found, truth), error) in fit.camera.k.iter().zip(k).zip(fit.errors.k) {
                check(*found, truth, error, "term");
            }
            // Every number that is fitted takes a residual's worth of noise.
            let residuals = 2 * views.iter().map(|v| v.seen.len()).sum::<usize>();
            let fitted = 1 + if held { 0 } else { 2 } + terms + 6 * views.len();
            let square = fit.rms_px().powi(2) * residuals as f64 / 2.0;
            let rms = (square / (residuals - fitted) as f64).sqrt();
            assert!((rms - noise).abs() <= 0.05 * noise + 1e-6, "f {focal}: noise {rms} against {noise}");
            assert!(noise == 0.0 || fit.errors.k[0] > 0.0);
            assert_eq!(fit.errors.centre_px == DVec2::ZERO, held);
        }
    }
}

/// A board that always faces the camera does not tell the focal length, unless it is given.
#[test]
fn boards_seen_square_on_are_refused_by_reason() {
    let camera = Pinhole { focal_px: DVec2::splat(1000.0), centre_px: DVec2::new(640.0, 360.0), k: [-0.2, 0.0, 0.0] };
    let rng = &mut fastrand::Rng::with_seed(1);
    let views: Vec<View> = (0..4)
        .map(|i| {
            let pose = Pose { turn: DMat3::IDENTITY, at: DVec3::new(-4.0 + f64::from(i), -2.5, 12.0) };
            let board: Vec<DVec2> = (0..54).map(|i| DVec2::new(f64::from(i % 9), f64::from(i / 9))).collect();
            let land = |b: &DVec2| camera.land(Pinhole::slopes(*b, &pose).expect("before it"));
            let seen = board.iter().map(|b| land(b) + DVec2::new(rng.f64() - 0.5, rng.f64() - 0.5)).collect();
            View { board, seen }
        })
        .collect();
    let given = Settings { oblong_pixels: false, ..settings(1) };
    let error = solve(&views, &given).expect_err("not told").to_string();
    assert!(error.contains("tilted"), "{error}");
    let fit = solve(&views, &Settings { focal_px: Some(1000.0), ..given }).expect("fits");
    assert!((fit.camera.k[0] + 0.2).abs() < 5.0 * fit.errors.k[0], "{} ± {}", fit.camera.k[0], fit.errors.k[0]);
    assert_eq!(fit.camera.focal_px.x, 1000.0);
}

#[cfg(feature = "calibrate")]
mod program {
    use super::*;
    use crate::support::Workplace;
    use isoplanat::calibrate::file::MeasuredDistortion;

    fn charts() -> Option<String> {
        let folder = shared("data/calibration/carnd_camera_cal")?;
        let mut all: Vec<String> = std::fs::read_dir(folder)
            .expect("lists")
            .map(|e| e.expect("an entry").path().display().to_string())
            .filter(|p| p.ends_with(".jpg"))
            .collect();
        all.sort();
        Some(all.join(" "))
    }

    /// Photographs against another program's corners and figures: found at least where it found them, reprojection within a tenth,
    /// straightness by 1.1.
    #[test]
    fn photographs_of_charts_give_what_opencv_gives() {
        let (Some((reference, views)), Some(charts)) = (reference(), charts()) else { return };
        let used: Vec<&str> = views.iter().map(|v| v.0.as_str()).collect();
        let place = Workplace::new();
        let both = |options: &str| {
            let text = place.run(&format!("calibrate {charts} {options} --json")).done();
            serde_json::from_str::<Value>(&text).expect("JSON")
        };
        let found = both("--terms 2 -o d.toml --svg d.svg --csv d.csv --camera Phone --lens Wide");
        let pictures: Vec<&str> = found["pictures"]
            .as_array()
            .expect("pictures")
            .iter()
            .map(|p| p["picture"].as_str().and_then(|p| p.rsplit('/').next()).expect("a name"))
            .collect();
        assert!(used.iter().all(|name| pictures.contains(name)), "{pictures:?}");
        // On the same pictures.
        let same: Vec<&str> =
            charts.split(' ').filter(|p| used.iter().any(|u| p.ends_with(&format!("/{u}")))).collect();
        let text = place.run(&format!("calibrate {} --terms 2 --json --csv same.csv", same.join(" "))).done();
        let on_same: Value = serde_json::from_str(&text).expect("JSON");
        let rms = on_same["rms_px"].as_f64().expect("a number");
        let expected = reference["models"]["k1k2"]["rms_px"].as_f64().expect("a number");
        assert!((rms / expected - 1.0).abs() < 0.1, "{rms} against {expected}");
        // Every corner of the reference has one of ours.
        let ours = std::fs::read_to_string(place.path("same.csv")).expect("reads");
        let ours: Vec<(String, DVec2)> = ours
            .lines()
            .skip(1)
            .map(|line| {
                let cells: Vec<&str> = line.split(',').collect();
                let number = |k: usize| cells[k].parse::<f64>().expect("a number");
                (cells[0].rsplit('/').next().expect("a name").to_owned(), DVec2::new(number(3), number(4)))
            })
            .collect();
        let (mut sum, mut square, mut count, mut far) = (DVec2::ZERO, 0.0, 0.0, 0);
        for (name, view) in &views {
            for seen in &view.seen {
                let own = ours.iter().filter(|o| &o.0 == name).map(|o| o.1 - *seen);
                let off = own.min_by(|a, b| a.length().total_cmp(&b.length())).expect("corners");
                if off.length() > 2.0 {
                    far += 1;
                    continue;
                }
                (sum, square, count) = (sum + off, square + off.length_squared(), count + 1.0);
            }
        }
        assert!(far <= 3 && count > 800.0, "{far} corners are missing, {count} found");
        let (mean, spread) = (sum / count, f64::sqrt(square / count));
        assert!(mean.length() < 0.05 && spread < 0.4, "off by {mean} on the mean, {spread} rms");
        // Lines of the reference's own corners, straightened by our camera and by the reference's.
        let model = &reference["models"]["k1k2"];
        let number = |v: &Value| v.as_f64().expect("a number");
        let theirs = Pinhole {
            focal_px: DVec2::new(number(&model["fx"]), number(&model["fy"])),
            centre_px: DVec2::new(number(&model["cx"]) + 0.5, number(&model["cy"]) + 0.5),
            k: [number(&model["dist_k1k2p1p2k3"][0]), number(&model["dist_k1k2p1p2k3"][1]), 0.0],
        };
        let file = std::fs::read_to_string(place.path("d.toml")).expect("written");
        let measured = MeasuredDistortion::parse(&file, "d.toml").expect("valid");
        let ours = Pinhole {
            focal_px: DVec2::splat(measured.focal_length_px),
            centre_px: measured.centre_px.into(),
            k: measured.k,
        };
        let bend = |camera: &Pinhole| {
            let of = |v: &View| {
                let straight = |p: &DVec2| camera.slope(*p, 1.0) * 1158.0;
                v.bend(&v.seen.iter().map(straight).collect::<Vec<_>>()).powi(2)
            };
            (views.iter().map(|v| of(&v.1)).sum::<f64>() / views.len() as f64).sqrt()
        };
        let before = views.iter().map(|v| v.1.bend(&v.1.seen).powi(2)).sum::<f64>() / views.len() as f64;
        let (a, b) = (bend(&ours), bend(&theirs));
        assert!(a <= 1.1 * b, "lines {a} px from straight, {b} by the reference");
        assert!(a < 0.5 * before.sqrt(), "{a} px of {}", before.sqrt());
        assert_eq!((measured.camera.as_str(), measured.lens.as_str()), ("Phone", "Wide"));
        assert!(std::fs::read_to_string(place.path("d.svg")).expect("written").starts_with("<svg"));
    }

    /// A RAW file of a chart: the same corners as in the picture that its mosaic was cut from, as seen in cells of four pixels.
    #[cfg(feature = "deploy")]
    #[test]
    fn charts_may_be_raw_files() {
        use isoplanat::imaging::dng::{DngInfo, write_dng};
        use isoplanat::imaging::files::read_planes;
        use isoplanat::imaging::sensor::Sensor;

        let Some(charts) = charts() else { return };
        let place = Workplace::new();
        let sensor = Sensor::generic();
        // Boards that fill much of the frame.
        let some = ["calibration2.jpg", "calibration3.jpg", "calibration12.jpg"];
        let mut names = Vec::new();
        for chart in charts.split(' ').filter(|p| some.iter().any(|s| p.ends_with(&format!("/{s}")))) {
            let planes = read_planes(std::path::Path::new(chart), None).expect("reads").values;
            let (_, rows, columns) = planes.dim();
            let range = sensor.white_level - sensor.black_level;
            let value = |(r, c): (usize, usize)| {
                let light = planes[[sensor.cfa.channel(r, c), r, c]];
                (sensor.black_level + 0.9 * range * light).round() as u16
            };
            let mosaic = ndarray::Array2::from_shape_fn((rows, columns), value);
            let name = format!("{}.dng", names.len());
            write_dng(&place.path(&name), mosaic.view(), &sensor, &DngInfo::default()).expect("writes");
            names.push((name, chart));
        }
        let corners = |pictures: &str, csv: &str| -> Vec<(String, DVec2)> {
            place.run(&format!("calibrate {pictures} --terms 1 --centre middle --csv {csv}")).done();
            let text = std::fs::read_to_string(place.path(csv)).expect("written");
            let cells = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<_>>();
            let number = |text: &str| text.parse::<f64>().expect("a number");
            text.lines().skip(1).map(cells).map(|c| (c[0].clone(), DVec2::new(number(&c[3]), number(&c[4])))).collect()
        };
        let list = |k: usize| names.iter().map(|n| [n.0.as_str(), n.1][k]).collect::<Vec<_>>().join(" ");
        let (raw, there) = (corners(&list(0), "raw.csv"), corners(&list(1), "jpg.csv"));
        let (mut sum, mut square, mut count) = (DVec2::ZERO, 0.0, 0.0);
        for (name, chart) in &names {
            for (_, at) in there.iter().filter(|c| c.0 == *chart) {
                let own = raw.iter().filter(|c| c.0 == *name).map(|c| c.1 - *at);
                let off = own.min_by(|a, b| a.length().total_cmp(&b.length())).expect("corners");
                if off.length() < 3.0 {
                    (sum, square, count) = (sum + off, square + off.length_squared(), count + 1.0);
                }
            }
        }
        assert!(count > 0.95 * there.len() as f64, "{count} of {}", there.len());
        let (mean, spread) = (sum / count, f64::sqrt(square / count));
        assert!(mean.length() < 0.1 && spread < 0.6, "off by {mean} on the mean, {spread} rms");
    }

    /// One photograph is one picture, under however many names.
    #[test]
    fn photographs_given_twice_are_refused() {
        let (Some((_, views)), Some(charts)) = (reference(), charts()) else { return };
        let chart = charts.split(' ').find(|p| p.ends_with(&format!("/{}", views[0].0))).expect("a chart");
        let place = Workplace::new();
        std::fs::copy(chart, place.path("copy.jpg")).expect("copied");
        for (pictures, named) in [
            (format!("{chart} {chart} {chart}"), [chart, ": contents: given twice"]),
            (format!("{chart} copy.jpg"), ["copy.jpg: contents: the same as", chart]),
        ] {
            let ran = place.run(&format!("calibrate {pictures} -o d.toml"));
            assert_eq!(ran.code, 2, "{}", ran.err);
            assert!(named.iter().all(|text| ran.err.contains(text)), "{named:?}: {}", ran.err);
            assert_eq!(place.files(), ["copy.jpg"]);
        }
    }

    /// Pictures without a chart are left out and told, pictures of another size refused; nothing is overwritten.
    #[test]
    fn what_is_no_chart_is_told() {
        let Some(charts) = charts() else { return };
        let place = Workplace::new();
        isoplanat::imaging::files::write_png8(
            &place.path("grey.png"),
            &ndarray::Array3::from_elem((3, 720, 1280), 0.2f32),
        )
        .expect("writes");
        isoplanat::imaging::files::write_png8(&place.path("black.png"), &ndarray::Array3::zeros((3, 720, 1280)))
            .expect("writes");
        place.write("text.jpg", "no picture");
        // Pictures of any size, noise among them.
        let rng = &mut fastrand::Rng::with_seed(4);
        for (rows, columns) in [(1, 1), (50, 1), (1, 50), (3, 200), (31, 33), (33, 32), (60, 300), (200, 200)] {
            let noise = ndarray::Array3::from_shape_fn((3, rows, columns), |_| rng.f32());
            isoplanat::imaging::files::write_png8(&place.path("noise.png"), &noise).expect("writes");
            let ran = place.run("calibrate noise.png");
            assert_eq!(ran.code, 2, "{columns} × {rows}: {}", ran.err);
            assert!(ran.err.contains("left out: noise.png") && !ran.err.contains("panicked"), "{}", ran.err);
        }
        let some: Vec<&str> = charts.split(' ').take(8).collect();
        let ran = place.run(&format!("calibrate grey.png black.png text.jpg gone.jpg {} -o d.toml", some.join(" ")));
        assert_eq!(ran.code, 0, "{}", ran.err);
        for name in ["grey.png", "black.png", "text.jpg", "gone.jpg"] {
            assert!(ran.err.contains(&format!("left out: {name}")), "{name}: {}", ran.err);
        }
        let again = place.run(&format!("calibrate {} -o d.toml", some.join(" ")));
        assert!(again.code == 2 && again.err.contains("d.toml"), "{}", again.err);
        let none = place.run("calibrate grey.png");
        assert!(none.code == 2 && none.err.contains("no chessboard"), "{}", none.err);
        for options in [
            "--terms 4",
            "--centre here",
            "--focal-px -3",
            "--focal-px nan",
            "--psf k.npz --reach 0",
            "--psf k.npz --reach nan",
            "--psf-picture k.png",
            "--psf k.npz --psf-picture k.bmp",
            "--psf k.npz --psf-picture k.npz",
        ] {
            let ran = place.run(&format!("calibrate grey.png {options}"));
            assert_eq!(ran.code, 2, "{options}: {}", ran.err);
        }
        // Two of the photographs are a pixel larger than the others.
        let ran = place.run(&format!("calibrate {charts}"));
        assert_eq!(ran.code, 0, "{}", ran.err);
        for name in ["calibration7.jpg", "calibration15.jpg"] {
            let line = ran.err.lines().find(|l| l.contains(name)).expect("told");
            assert!(line.contains("left out") && line.contains("1281 × 721") && line.contains("1280 × 720"), "{line}");
        }
    }
}

#[cfg(all(feature = "calibrate", feature = "deploy"))]
pub(crate) mod kernels {
    use super::*;
    use crate::support::Workplace;
    use isoplanat::imaging::files::{Encoding, write_picture};
    use isoplanat::imaging::sensor::Sensor;
    use isoplanat::imaging::sensor::spectrum::Spectrum;
    use isoplanat::lens::builtin;
    use isoplanat::psf::measured::MeasuredPsf;
    use isoplanat::psf::splat::Raster;
    use isoplanat::psf::{Optics, Quadrature, SensorPoint};
    use rayon::prelude::*;

    pub(crate) const SIZE: [usize; 2] = [640, 432];
    /// Texels of the board's picture along a pixel: their own blur is a variance of 0.007 square pixels.
    const FINE: usize = 6;

    /// A board without end, in perspective: what stands before the lens. Squares of some 32 pixels.
    fn board(turn: DMat3) -> ndarray::Array3<f32> {
        let [columns, rows] = SIZE.map(|n| n * FINE * 6 / 5);
        let focal = 333.0 * FINE as f64;
        let distance = focal / (32.0 * FINE as f64);
        let pose = Pose { turn, at: DVec3::new(0.3, 0.2, distance) };
        let back = pose.turn.transpose();
        let origin = back * pose.at;
        let even = |x: f64, y: f64| {
            let slope = DVec2::new(x - 0.5 * columns as f64, y - 0.5 * rows as f64) / focal;
            let along = back * slope.extend(1.0);
            let place = (origin.z / along.z * along - origin).truncate().floor();
            (place.x + place.y).rem_euclid(2.0) == 0.0
        };
        let mut light = ndarray::Array3::zeros((3, rows, columns));
        light.axis_iter_mut(ndarray::Axis(1)).into_par_iter().enumerate().for_each(|(r, mut row)| {
            for c in 0..columns {
                let inside = (0..4).filter(|k| {
                    let (x, y) = (f64::from(k % 2) + 0.5, f64::from(k / 2) + 0.5);
                    even(c as f64 + x / 2.0, r as f64 + y / 2.0)
                });
                let value = 0.04 + 0.8 * inside.count() as f32 / 4.0;
                (0..3).for_each(|k| row[[k, c]] = value);
            }
        });
        light
    }

    /// RAW captures of a board by rays, as of a real lens, and what `calibrate --psf` with `options` makes of them: `d.toml`, `psf.npz`, `psf.png`.
    pub(crate) fn photographed(place: &Workplace, name: &str, pitch_mm: f64, options: &str) {
        let mut names = Vec::new();
        for (k, [y, x, z]) in
            [[0.35, -0.1, 0.1], [-0.3, 0.25, -0.3], [0.1, 0.35, 0.5], [-0.2, -0.35, 0.8]].iter().enumerate()
        {
            let turn = DMat3::from_rotation_y(*y) * DMat3::from_rotation_x(*x) * DMat3::from_rotation_z(*z);
            write_picture(&place.path("board.png"), &board(turn), Encoding::Srgb).expect("writes");
            let [columns, rows] = SIZE;
            let frame = format!("--columns {columns} --rows {rows} --pitch-um {}", 1e3 * pitch_mm);
            let more = format!("--samples 48 --texels-per-pixel {FINE} --exposure 0.9 --seed {k}");
            place.run(&format!("capture {name} board.png -o {k}.dng {frame} {more}")).done();
            names.push(format!("{k}.dng"));
        }
        let files = "--psf psf.npz --psf-picture psf.png -o d.toml";
        let ran = place.run(&format!("calibrate {} {files} {options}", names.join(" ")));
        eprintln!("{name}\n{}{}", ran.out, ran.err);
        assert_eq!(ran.code, 0);
    }

    /// Kernels of a lens that was photographed: they come back as they are traced, their place along the meridian aside. Mean
    /// and largest distance, L2, of the kernel's own, at five radii and three colours.
    fn recovered(name: &str, pitch_mm: f64, options: &str) -> [f64; 2] {
        let place = Workplace::new();
        photographed(&place, name, pitch_mm, options);
        if let Some(keep) = std::env::var_os("ISOPLANAT_KEEP") {
            let to = std::path::Path::new(&keep).join(format!("{name}.png"));
            std::fs::copy(place.path("psf.png"), to).expect("copies");
        }
        let psf = MeasuredPsf::load(&place.path("psf.npz")).expect("reads");
        let lens = builtin::lens(name).expect("shipped");
        let spectrum = Spectrum::quadrature(&Sensor::generic(), 9);
        let quadrature = Quadrature { nm: spectrum.wavelength_nm, weight: spectrum.weight.to_vec() };
        let far_mm = psf.radii_px[psf.radii_px.len() - 1] * pitch_mm;
        let optics = Optics::even(&lens, far_mm, vec![lens.object_vergence], quadrature, 64).expect("traces");
        let size = 2 * psf.moves.reach_px.ceil() as usize + 9;
        let form = optics.form(4000, size, 1, pitch_mm);
        let raster = Raster { size, samples: 1 };
        let (mut worst, mut sum) = (0.0f64, 0.0);
        for share in [0.1, 0.3, 0.5, 0.7, 0.9] {
            let radius_mm = share * far_mm;
            let mut traced = vec![0.0; 3 * raster.len()];
            optics.kernels(&form, 0, SensorPoint::along([1.0, 0.0], radius_mm), &mut traced);
            for (channel, expected) in traced.chunks(raster.len()).enumerate() {
                let weights = psf.at(radius_mm / pitch_mm, channel);
                // Where corners are seen and where chief rays land need not be the same.
                let off = |shift: f64| {
                    let mut found = vec![0.0; raster.len()];
                    let all = psf.moves.iter().zip(&weights).flat_map(|(([a, b], n), w)| {
                        let one = ([a + shift, b], *w);
                        std::iter::once(one).chain((n > 1.0).then_some(([a + shift, -b], *w)))
                    });
                    raster.splat(&mut found, &[(0, 1.0)], all);
                    let square: f64 = found.iter().zip(expected).map(|(a, b)| (a - b).powi(2)).sum();
                    (square / expected.iter().map(|v| v * v).sum::<f64>()).sqrt()
                };
                let all = (-150..=150).map(|k| f64::from(k) * 0.02);
                let best = all.min_by(|a, b| off(*a).total_cmp(&off(*b))).expect("some");
                eprintln!("{share} {channel}: {:.4} moved by {best:.2} px, {:.4} as it is", off(best), off(0.0));
                assert!(best.abs() < 1.0, "{name} {share} {channel}: moved by {best} px");
                worst = worst.max(off(best));
                sum += off(best);
            }
        }
        let mean = sum / 15.0;
        eprintln!("{name}: {mean:.3} on the mean, {worst:.3} at worst");
        [mean, worst]
    }

    #[test]
    fn kernels_of_a_lens_come_back_from_captures_of_a_board() {
        let [mean, worst] = recovered("landscape", 0.0064, "--terms 2");
        assert!(mean < 0.04 && worst < 0.1, "kernels off by {mean} on the mean, {worst} at worst, L2");
    }

    #[test]
    #[ignore = "prints figures of other lenses"]
    fn kernels_of_other_lenses() {
        for (name, pitch_mm, options) in
            [("petzval", 0.045, ""), ("heliar", 0.1, ""), ("double_gauss", 0.03, ""), ("sonnar", 0.05, "--reach 11")]
        {
            recovered(name, pitch_mm, options);
        }
    }
}
