//! Lenses and places at the ends of what is legal, through the program's commands: a picture, or one line that says why not.

use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::render::{Renderer, Settings};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::variables::Variables;
use isoplanat::psf::SensorMap;
use isoplanat::psf::table::{Adapted, STEEPEST, Tolerance};
use isoplanat::trace::aim::Aimer;
use isoplanat::trace::object::ObjectPoint;
use isoplanat::trace::{System, sequential::trace};
use ndarray::Array3;

use crate::support::{Workplace, lens_file, root};

const FISHEYE: &str = "benches/lenses/fisheye_200.toml";

/// A lens file: `[radius (0 flat), thickness, index (1 air), semi-diameter]`, the stop's number, the rest of the file.
fn lens(rows: &[[f64; 4]], stop: usize, head: &str) -> String {
    let mut text = format!(
        "schema = 1\nname = \"made for a test\"\nsource = \"this test\"\n{head}\n\
         wavelengths = {{ nm = [486.1, 587.6, 656.3], weights = [1.0, 1.0, 1.0], primary_nm = 587.6 }}\n"
    );
    for (i, [radius, thickness, index, semi]) in rows.iter().enumerate() {
        let radius = if *radius == 0.0 { "inf".to_owned() } else { format!("{radius:?}") };
        let medium = if *index == 1.0 { "\"air\"".to_owned() } else { format!("{{ n_d = {index:?}, v_d = 60.0 }}") };
        text += &format!(
            "\n[[surface]]\nradius_mm = {radius}\nthickness_mm = {thickness:?}\nmedium = {medium}\nsemi_diameter_mm = {semi:?}\n"
        );
        if i == stop {
            text += "stop = true\n";
        }
    }
    text
}

/// Focal length 50.85 mm, 49.15 mm from either vertex.
const BACK: f64 = 49.1525;

fn head(aperture: f64, distance: f64, columns: usize) -> String {
    format!(
        "aperture = {{ stop_semi_diameter_mm = {aperture:?} }}\nobject = {{ distance_mm = {distance:?} }}\n\
         field = {{ max_angle_deg = 6.0 }}\nsensor = {{ columns = {columns}, rows = {}, pitch_um = 30.0 }}",
        columns * 3 / 4
    )
}

/// Two equal lenses, an object and its image in their outer foci: magnification −1. `gap` from lens to stop.
fn relay(gap: f64, aperture: f64) -> String {
    let rows = [
        [50.0, 5.0, 1.5, 14.0],
        [-50.0, gap, 1.0, 14.0],
        [0.0, gap, 1.0, aperture],
        [50.0, 5.0, 1.5, 14.0],
        [-50.0, BACK, 1.0, 14.0],
    ];
    lens(&rows, 2, &head(aperture, BACK, 400))
}

/// A lens with its stop in the rear focal plane: chief rays run parallel to the axis before it.
fn telecentric(distance: f64) -> String {
    let rows = [[50.0, 5.0, 1.5, 14.0], [-50.0, BACK, 1.0, 14.0], [0.0, 25.63, 1.0, 2.0]];
    lens(&rows, 2, &head(2.0, distance, 200))
}

/// Rows of `psf`'s table: depth, field angle, sensor radius, relative illumination, per cent outside.
fn table(text: &str) -> Vec<[f64; 5]> {
    let row = |line: &str| -> Option<[f64; 5]> {
        let numbers: Option<Vec<f64>> = line.split_whitespace().map(|v| v.parse().ok()).collect();
        numbers?.try_into().ok()
    };
    text.lines().filter_map(row).collect()
}

/// The picture of a command that went well: finite, not black, not brighter than its scene.
fn picture(place: &Workplace, arguments: &str) -> Array3<f32> {
    place.run(&format!("render {arguments} -o x.tif --force")).done();
    let image = isoplanat::imaging::files::read_linear(&place.path("x.tif")).expect("a picture");
    let brightest = image.iter().copied().fold(0.0, f32::max);
    assert!(image.iter().all(|v| v.is_finite()) && brightest > 0.01 && brightest <= 1.0, "{arguments}: {brightest}");
    image
}

#[test]
fn relays_and_object_space_telecentric_lenses_are_lenses() {
    let place = Workplace::new();
    place.write("relay.toml", relay(10.0, 2.0)).write("four_f.toml", relay(BACK, 2.0));
    place.write("telecentric.toml", telecentric(150.0));
    for (name, magnification) in [("relay", 1.0), ("four_f", 1.0), ("telecentric", 0.504)] {
        let shown = place.run(&format!("psf {name}.toml -o k.npz --force --fields 3 --rays 400")).done();
        let rows = table(&shown);
        assert_eq!(rows.len(), 3, "{shown}");
        // The sensor's corner, or 6° before it.
        let corner = match name {
            "relay" => 6.9407,
            // Telecentric in object space: 6° are those at the first vertex.
            "four_f" => BACK * 6f64.to_radians().tan(),
            _ => 3.75,
        };
        assert!((rows[2][2] - corner).abs() < 1e-3, "{shown}");
        assert!(rows.iter().all(|r| r[3] > 0.5 && r[3] < 1.5 && r[4] < 0.2), "{shown}");
        // Object slope at the corner: height over distance.
        let mut npz =
            ndarray_npy::NpzReader::new(std::fs::File::open(place.path("k.npz")).expect("opens")).expect("npz");
        let slope: ndarray::Array2<f64> = npz.by_name("object_slope").expect("slopes");
        let distance = if name == "telecentric" { 150.0 } else { BACK };
        let paraxial = slope[[0, 1]] * distance * magnification / rows[1][2];
        assert!((paraxial - 1.0).abs() < 0.05, "{name}: {paraxial} of the paraxial height");
        picture(&place, &format!("{name}.toml facades:3 --columns 24 --rows 18 --pitch-um 240"));
    }
    // At infinity a telecentric lens shows one point: no picture.
    for command in
        ["psf telecentric.toml -o n.npz --depth-mm 150,inf", "render telecentric.toml text -o n.png --depth-mm inf"]
    {
        place.run(command).refused(&["height"]);
    }
    assert!(!place.path("n.npz").exists() && !place.path("n.png").exists(), "one depth that fails leaves nothing");
}

/// A stop forty times as large as what comes through, a depth inside the focal length, focus inside the caustic, a PSF wider
/// than the frame.
#[test]
fn stops_depths_and_blurs_out_of_proportion_have_pictures() {
    let place = Workplace::new();
    place.write("wide_open.toml", relay(10.0, 80.0).replace("semi_diameter_mm = 80.0", "semi_diameter_mm = 90.0"));
    let shown = place.run("psf wide_open.toml -o k.npz --fields 2 --rays 400 --size 31").done();
    assert!(table(&shown).iter().all(|r| r.iter().all(|v| v.is_finite())), "{shown}");
    picture(&place, "wide_open.toml facades:3 --columns 32 --rows 24 --pitch-um 300");
    let frame = "--columns 48 --rows 32 --pitch-um 60";
    for depth in ["20", "1", "0.01"] {
        let shown =
            place.run(&format!("psf two_element -o k.npz --force --size 31 --rays 200 --depth-mm {depth}")).done();
        assert!(table(&shown).iter().all(|r| r.iter().all(|v| v.is_finite())), "{depth}: {shown}");
        picture(&place, &format!("two_element facades:3 {frame} --depth-mm {depth}"));
    }
    let text = std::fs::read_to_string(root().join("models/lenses/al2550_a.toml")).expect("shipped");
    let last = text.rfind("thickness_mm = ").expect("a last surface") + "thickness_mm = ".len();
    let end = last + text[last..].find('\n').expect("a line");
    let back: f64 = text[last..end].trim().parse().expect("a number");
    for step in [-0.8, -0.2, 0.2] {
        place.write("caustic.toml", format!("{}{:?}{}", &text[..last], back + step, &text[end..]));
        picture(&place, &format!("caustic.toml facades:3 {frame}"));
    }
    let json = place
        .run("render ac254_050_a facades:3 -o w.png --columns 48 --rows 32 --pitch-um 6 --depth-mm 300 --json")
        .done();
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let of = |key: &str| json["figures"][key].as_u64().expect("a number");
    assert!(of("kernel_cells") * of("pixels_per_cell") > 48, "{json}");
}

/// A field that ends between two of the places that are looked at ends where the light does, to a thousandth.
#[test]
fn a_field_ends_with_its_light() {
    let place = Workplace::new();
    let two = std::fs::read_to_string(root().join("models/lenses/two_element.toml")).expect("shipped");
    let wide = two.replace("max_angle_deg = 30.0", "max_angle_deg = 89.0").replace("columns = 4096", "columns = 12000");
    place.write("wide.toml", wide);
    let rows = table(&place.run("psf wide.toml -o k.npz --fields 4 --size 31 --rays 200").done());
    let lens = isoplanat::lens::prescription::load(&place.path("wide.toml")).expect("valid");
    let lit = |r: f64| isoplanat::psf::table::chief_slopes(&lens, lens.object_vergence, &[r]).is_ok();
    let edge = rows.last().expect("rows")[2];
    assert!(edge < lens.sensor.radius_mm() && lit(0.999 * edge) && !lit(1.001 * edge), "{rows:?}");
}

/// The map of a 200° lens against chief rays aimed from the scene, at infinity and before a plane: 1e-3 pixel of 12 µm to 85°, and
/// what it states to 89°.
#[test]
#[ignore = "ends at 87°: beyond, rays of this lens's beam cross the horizon"]
fn the_map_of_a_fisheye_reaches_the_horizon() {
    let lens = lens_file(FISHEYE);
    let system = System::new(&lens, lens.wavelengths.primary_nm);
    let aimer = Aimer::new(&system).expect("a stop");
    let pitch = 0.012;
    for vergence in [0.0, 1.0 / 300.0] {
        let tolerance = Tolerance { landing_mm: 0.02 * pitch, weight: 1e-4 };
        let table = Adapted::compute(&lens, vergence, &[480.0, 620.0], 7, 8.0, tolerance).expect("traces").table;
        let map = SensorMap::fit(&lens, &table, vergence).expect("grows");
        let last = map.slope(map.radius_mm);
        assert!(last > 0.8 * STEEPEST && table.edge_mm < 8.0, "ends at {last}");
        let mut near = None;
        for tenth in 1..=178 {
            let degrees = 0.5 * f64::from(tenth);
            let object = ObjectPoint::from_angle(degrees.to_radians(), std::f64::consts::FRAC_PI_2, vergence);
            let aimed = aimer.aim(object, glam::DVec2::ZERO, near.as_ref()).expect("aims");
            let mut hits = Vec::new();
            let landed = trace(&system, aimed.ray, system.image(), &mut hits).expect("lands");
            let radius = landed.at.point.truncate().length();
            near = Some(aimed);
            let off = (map.radius(degrees.to_radians().tan(), 0.9 * radius) - radius).abs() / pitch;
            if [10.0, 45.0, 80.0, 85.0, 89.0].contains(&degrees) {
                eprintln!("1/v {:.0} mm, {degrees}°: {radius:.4} mm, off by {off:.1e} px", 1.0 / vergence);
            }
            assert!(off <= 1e-3, "{degrees}°: {off:e} px");
        }
        eprintln!("stated residual {:.1e} px, map to {:.2}°", map.residual_mm / pitch, last.atan().to_degrees());
        assert!(map.residual_mm <= 1e-3 * pitch, "{:e}", map.residual_mm);
        // The inverse undoes the map out to its end and beyond.
        for k in 0..=110 {
            let r = map.radius_mm * f64::from(k) / 100.0;
            assert!((map.radius(map.slope(r), 0.5 * r) - r).abs() < 1e-9 * map.radius_mm, "{r}");
        }
    }
}

/// A lens that sees beyond 90°: kernels out to 80°, one reason where a blur crosses the horizon, and a picture of a frame that reaches
/// beyond it, black there.
#[test]
fn a_fisheye_is_pictured() {
    let place = Workplace::new();
    let text = std::fs::read_to_string(root().join(FISHEYE)).expect("there");
    place
        .write("fisheye.toml", &text)
        .write("to_80.toml", text.replace("max_angle_deg = 100.0", "max_angle_deg = 80.0"));
    let rows = table(&place.run("psf to_80.toml -o k.npz --fields 3 --rays 400").done());
    assert!((rows[2][1] - 80.0).abs() < 1e-2 && (rows[2][2] - 5.4109).abs() < 1e-3, "{rows:?}");
    assert!(rows.iter().all(|r| r[4] < 0.2 && r[3] > 0.8 && r[3] <= 1.0), "{rows:?}");
    place.run("psf fisheye.toml -o n.npz --fields 6 --rays 400").refused(&[
        "fisheye.toml",
        "kernel size",
        "a stated size",
    ]);
    let image = picture(&place, "fisheye.toml facades:3 --columns 120 --rows 80 --pitch-um 120");
    assert!(image[[1, 0, 0]] == 0.0 && image[[1, 40, 60]] > 0.0, "the corner lies beyond the horizon");
}

/// A frame that sees 90° and more has a picture: white to the edge of its light, black beyond, and finite gradients.
#[test]
#[ignore = "no kernels beyond 84°: rays of this lens's beam cross the horizon"]
fn a_fisheye_has_kernels_pictures_and_gradients() {
    let place = Workplace::new();
    place.write("fisheye.toml", std::fs::read(root().join(FISHEYE)).expect("there"));
    let rows = table(&place.run("psf fisheye.toml -o k.npz --fields 6 --rays 400").done());
    let last = rows.last().expect("rows");
    assert!(last[1] > 88.9 && last[1] < 89.1 && rows.iter().all(|r| r[4] < 0.2 && r[3] > 0.0), "{rows:?}");
    let image = picture(&place, "fisheye.toml facades:3 --columns 120 --rows 80 --pitch-um 120");
    assert!(image[[1, 0, 0]] == 0.0 && image[[1, 40, 60]] > 0.0, "the corner lies beyond the horizon");
    let lens = lens_file(FISHEYE);
    let frame = Frame::centred(120, 80, 0.12).expect("valid");
    let density = SpectralDensity::new(&Sensor::generic());
    for vergence in [0.0, 1.0 / 300.0] {
        let settings = Settings { wavelengths: 3, dense: 200, ..Settings::DESIGN };
        let renderer = Renderer::planned(&lens, &frame, &density, &[vergence], settings).expect("traces");
        let white = Plane { texture: Array3::ones((1, 2, 2)), texels_per_slope: 1.0, axis_texel: [1.0; 2], vergence };
        let whole = Region { row: 0, col: 0, rows: 80, cols: 120 };
        let rendered = renderer.record::<f64>(&white, 0, whole);
        let off = (&rendered.image - &rendered.illumination).iter().fold(0.0f64, |m, v| m.max(v.abs()));
        assert!(off <= 2.0 * settings.outside, "white: {off:e}");
        let (edge, light) = (renderer.optics.table().edge_mm, rendered.image.slice(ndarray::s![1, 40, ..]));
        let dark = light.iter().enumerate().filter(|(j, _)| frame.radius_mm(*j as f64 + 0.5, 40.5) > edge + 0.12);
        assert!(dark.clone().count() > 2 && dark.clone().all(|(_, v)| *v == 0.0), "black beyond {edge} mm");
        let street = Plane {
            texture: isoplanat::imaging::scene::generate(isoplanat::imaging::scene::SceneKind::Facades, 3, 160, 240),
            texels_per_slope: 20.0,
            axis_texel: [120.0, 80.0],
            vergence,
        };
        let rendered = renderer.record::<f64>(&street, 0, whole);
        let bar = rendered.image.mapv(|v| v - 0.3);
        let bar = renderer.vjp(&street, &rendered, bar.view(), bar.view(), bar.view());
        let gradient = Variables::all(&lens).gradient(&renderer.lens_gradient(&lens, &bar));
        let largest = gradient.iter().fold(0.0f64, |m, g| m.max(g.abs()));
        assert!(gradient.iter().all(|g| g.is_finite()) && largest > 0.0, "{gradient:?}");
        eprintln!(
            "1/v {:.0} mm: light to {edge:.2} mm, white off by {off:.1e}, kept {:.2}",
            1.0 / vergence,
            renderer.optics.table().kept()
        );
    }
}

/// A design whose frame reaches beyond the light: patches in the dark have losses and gradients that are numbers.
#[cfg(feature = "train")]
#[test]
fn a_design_with_patches_in_the_dark_goes_on() {
    let place = Workplace::new();
    let task = "schema = 1\nlens = \"two_element\"\nscenes = 1\nsteps = 20\npatch_px = 32\nbatch = 4\nbase_width = 4\n\
                sensor = { columns = 96, rows = 96, pitch_um = 900.0, axis_px = [0.0, 0.0] }\n";
    place.write("task.toml", task);
    place.run("design task.toml -o run").done();
    let log = std::fs::read_to_string(place.path("run/log.csv")).expect("written");
    let losses: Vec<f64> =
        log.lines().skip(1).map(|l| l.split(',').nth(1).expect("loss").parse().expect("a number")).collect();
    assert!(losses.len() == 2 && losses.iter().all(|l| l.is_finite() && *l > 0.0), "{log}");
    // The lens that was designed is one.
    place.run("inspect run/lens.toml").done();
}

/// A lens that is telecentric in object space to rounding, with an entrance pupil at 7e16 mm: spots by tracing the light from the object to
/// the stop (another program's figures), from its own file and from two Zemax files.
#[test]
fn a_pupil_at_infinity_has_the_spots_of_its_rays() {
    let (Some(own), Some(obna), Some(floa)) = (
        isoplanat::testing::shared("cases/tele_exact.toml"),
        isoplanat::testing::shared("cases/tele_exact_obna.zmx"),
        isoplanat::testing::shared("cases/tele_exact_floa.zmx"),
    ) else {
        return;
    };
    let place = Workplace::new();
    let axis = |path: &std::path::Path| {
        let shown = place.run(&format!("spot {} --json", path.display())).done();
        let found: serde_json::Value = serde_json::from_str(&shown).expect("JSON");
        let axis = &found["fields"][0];
        [axis["rms_mm"].as_f64().expect("a number"), axis["best_focus_mm"][2].as_f64().expect("a number")]
    };
    for path in [own, floa] {
        let [rms, focus] = axis(&path);
        assert!((rms - 0.0700).abs() < 1e-4 && (focus + 5.91).abs() < 0.01, "{}: {rms} {focus}", path.display());
    }
    // NA 0.05 in object space: the marginal ray meets the stop at f tan u, more than the 3 mm of the others.
    let [rms, _] = axis(&obna);
    assert!(rms > 0.0, "{rms}");
    let shown = place.run(&format!("inspect {} --json", obna.display())).done();
    let found: serde_json::Value = serde_json::from_str(&shown).expect("JSON");
    let stop = found["stop_semi_diameter_mm"].as_f64().expect("a number");
    let expected = 49.043_002 * (0.05f64.asin()).tan();
    assert!((stop / expected - 1.0).abs() < 1e-6, "{stop} for {expected}");
}

/// What a picture cannot be planned for in seconds is refused: kernels far wider than any frame.
#[test]
fn kernels_wider_than_any_frame_are_refused() {
    let place = Workplace::new();
    for number in ["1e4", "1e5"] {
        let render =
            format!("render cooke_triplet text -o a.png --columns 384 --rows 256 --pitch-um 10 --f-number {number} -q");
        place.run(&render).refused(&["cooke_triplet", "blur", "pixels wide", "at most 12288 pixels"]);
    }
    assert!(place.files().is_empty());
}
