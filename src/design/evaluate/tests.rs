use super::zones::{angle_deg, bounds, check, height_at, places, zones};
use super::*;
use crate::design::task::{Task, TaskSensor};
use isoplanat_network::UnetConfig;
use isoplanat_optics::lens::catalogue::Glasses;

pub(super) fn settings(fields: usize, patch: usize) -> Settings {
    Settings {
        fields,
        to_deg: None,
        means_deg: Vec::new(),
        depths_mm: vec![1000.0],
        patch,
        seed: 3,
        fineness: Fineness::DESIGN,
        rays: None,
        texels: TEXELS_PER_PIXEL,
        through: None,
    }
}

pub(super) fn lens() -> Subject {
    let sensor = Some(TaskSensor { columns: 240, rows: 160, pitch_um: 80.0, axis_px: Some([0.0, 0.0]) });
    let mut task = Task::demo();
    task.frame.raster = sensor;
    task.subject(Glasses::shipped()).expect("valid")
}

/// A network whose last layer is nought returns its input.
pub(super) fn identity(scales: usize) -> Reconstructor {
    let mut net = Reconstructor::new(UnetConfig::bare(2, scales), 1).expect("valid");
    net.set_parameter("output.weight", &[0.0; 3 * 2 * 9]).expect("as many");
    net.set_parameter("output.bias", &[0.0; 3]).expect("as many");
    net
}

/// Image heights between five zones of equal width.
const FIFTHS: [f64; 6] = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0];

/// Zones by field angle: their bounds see the angles, places beyond the last are nobody's, and means to an angle are those of the zones
/// within it.
#[test]
fn zones_by_angle_and_means_to_an_angle() {
    let (lens, sensor) = (lens(), Sensor::generic());
    let frame = lens.frame().expect("valid");
    let by_angle = Settings { to_deg: Some(12.0), means_deg: vec![4.0, 6.0], ..settings(3, 32) };
    let renderer = at_depths(&lens, &sensor, &by_angle).expect("images");
    let map = &renderer.optics.maps[0];
    let between = bounds(map, &frame, &by_angle).expect("seen");
    for (k, share) in between.iter().enumerate() {
        assert!((angle_deg(map, &frame, *share) - 4.0 * k as f64).abs() < 1e-9, "{k}: {share}");
    }
    assert!(between[3] < 0.9 && height_at(map, &frame, 80.0).is_none());
    let far = places(&frame, &between, 32).into_iter().flatten();
    let reach = far.map(|(r, c)| frame.radius_mm(c as f64 + 16.0, r as f64 + 16.0)).fold(0.0, f64::max);
    assert!(reach <= between[3] * frame.max_radius_mm() && reach > 0.95 * between[3] * frame.max_radius_mm());
    for bad in
        [Settings { to_deg: Some(60.0), ..by_angle.clone() }, Settings { means_deg: vec![70.0], ..by_angle.clone() }]
    {
        let text = bounds(map, &frame, &bad).expect_err("not seen").to_string();
        assert!(text.contains("corner"), "{text}");
    }
    assert!(check(&frame, &Settings { to_deg: Some(-1.0), ..by_angle.clone() }).is_err());
    let bare = Guide::bare(&frame);
    let pictures = Pictures::BuiltIn(SceneKind::Facades, 2);
    let judged = evaluate(&lens, (&identity(3), &bare), &sensor, &pictures, &by_angle, false, &mut |_| ());
    let rows = judged.expect("judges").0.rows;
    let db: Vec<f64> = rows.iter().map(|r| r.capture.psnr_db.mean).collect();
    assert_eq!(rows.iter().map(|r| r.zone).collect::<Vec<_>>(), [1, 2, 3, 0, 0, 0]);
    assert!((db[3] - db[0]).abs() < 1e-12, "to the first zone's end");
    assert!((db[4] - (db[0] + 0.5 * db[1]) / 1.5).abs() < 1e-9, "half of the second");
    assert!((db[5] - db[..3].iter().sum::<f64>() / 3.0).abs() < 1e-9);
    assert_eq!((rows[3].patches, rows[4].patches, rows[5].patches), (2, 4, 6));
    assert!((rows[5].angle_deg[1] - 12.0).abs() < 1e-9 && (rows[4].angle_deg[1] - 6.0).abs() < 1e-12);
}

/// Of frames of all kinds: every patch lies in the frame, its centre in its zone; every place belongs to one zone; a zone has
/// smaller patches only where it has room for none of the size asked for.
#[test]
fn zones_share_the_places_of_the_frame() {
    for (columns, rows, axis) in
        [(640, 480, [320.0, 240.0]), (960, 640, [0.0, 0.0]), (4096, 512, [0.0, 512.0]), (480, 320, [0.0, 0.0])]
    {
        let frame = Frame::centred(columns, rows, 0.01).and_then(|f| f.with_axis(axis)).expect("valid");
        let corner =
            [0.0, 1.0].map(|x| [0.0, 1.0].map(|y| (x * columns as f64 - axis[0]).hypot(y * rows as f64 - axis[1])));
        let corner = corner.as_flattened().iter().fold(0f64, |m, v| m.max(*v));
        let zones = zones(&frame, &FIFTHS, 256).expect("room");
        for (z, zone) in zones.iter().enumerate() {
            assert!(!zone.starts.is_empty(), "{columns} × {rows}: zone {z}");
            for (row, col) in &zone.starts {
                assert!(row + zone.patch <= rows && col + zone.patch <= columns && row % 4 == 0 && col % 4 == 0);
                let half = zone.patch as f64 / 2.0;
                let height = (*col as f64 + half - axis[0]).hypot(*row as f64 + half - axis[1]) / corner;
                assert!(height >= z as f64 / 5.0 - 1e-12 && height <= (z + 1) as f64 / 5.0 + 1e-12, "{z}: {height}");
            }
        }
        let whole = places(&frame, &FIFTHS, 256);
        let counts: Vec<usize> = whole.iter().map(Vec::len).collect();
        assert_eq!(counts.iter().sum::<usize>(), ((rows - 256) / 4 + 1) * ((columns - 256) / 4 + 1));
        for (zone, count) in zones.iter().zip(counts) {
            assert_eq!(zone.patch == 256, count > 0, "{columns} × {rows}: {zone:?}", zone = zone.patch);
        }
    }
    // A frame smaller than the patch, and one with room for nothing.
    let tiny = Frame::centred(90, 70, 0.01).expect("valid");
    assert_eq!(zones(&tiny, &[0.0, 0.5, 1.0], 256).expect("room")[0].patch, 68);
    assert!(check(&Frame::centred(90, 8, 0.01).expect("valid"), &settings(2, 256)).is_err());
    for (fields, patch) in [(0, 256), (101, 256), (5, 0), (5, 30), (5, 4096)] {
        assert!(check(&tiny, &settings(fields, patch)).is_err(), "{fields} {patch}");
    }
}

/// A network that changes nothing: reconstruction and capture agree to the last bit, on any number of threads, and the mean
/// over the zones is the zones' mean.
#[test]
fn an_identity_restores_nothing() {
    let (lens, sensor) = (lens(), Sensor::generic());
    let bare = Guide::bare(&lens.frame().expect("valid"));
    let judge = || {
        // Nodes near enough to tell the axis from the field, on pixels of 80 µm.
        let fineness = Fineness { node_error: 0.05, ..Fineness::DESIGN };
        let settings = Settings { depths_mm: vec![1000.0, 700.0], fineness, ..settings(3, 64) };
        evaluate(
            &lens,
            (&identity(3), &bare),
            &sensor,
            &Pictures::BuiltIn(SceneKind::Facades, 2),
            &settings,
            true,
            &mut |_| (),
        )
        .expect("judges")
    };
    let (result, sheets) = judge();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    let again = one.install(judge).0;
    assert_eq!(result.csv(), again.csv());
    assert_eq!((result.rows.len(), sheets.len(), result.count), (8, 6, 2));
    for row in &result.rows {
        assert_eq!(row.capture, row.reconstruction, "depth {} zone {}", row.depth_mm, row.zone);
        assert_eq!(row.gain_db, Figure { mean: 0.0, standard_error: 0.0 });
        let c = row.capture;
        assert!((10.0..50.0).contains(&c.psnr_db.mean) && (0.05..1.0).contains(&c.ssim.mean), "{c:?}");
        assert!(c.psnr_db.standard_error.is_finite());
        assert!(c.delta_e.mean > c.colour_shift.mean && c.colour_shift.mean > 0.0, "{c:?}");
    }
    for rows in result.rows.chunks(4) {
        let mean = rows[..3].iter().map(|r| r.capture.psnr_db.mean).sum::<f64>() / 3.0;
        assert!(rows[3].zone == 0 && (rows[3].capture.psnr_db.mean - mean).abs() < 1e-12);
    }
    // The sensor stands where the axis is sharpest for a metre; further out the field is curved towards nearer scenes.
    assert!(result.rows[4].capture.psnr_db.mean < result.rows[0].capture.psnr_db.mean);
    // Two rows of four pictures, 6 pixels apart, below the columns' names.
    assert_eq!(sheets[0].image.dim(), (3, 20 + 2 * 64 + 6, 4 * 64 + 18));
}

/// Where the margin is the receptive radius a patch is restored as within the whole picture; at the picture's end the margin
/// is its mirror image.
#[test]
fn a_patch_is_restored_as_within_the_picture() {
    let rng = &mut fastrand::Rng::with_seed(4);
    let net = Reconstructor::new(UnetConfig::bare(4, 3), 8).expect("valid");
    let picture = Array3::from_shape_simple_fn((3, 128, 160), || rng.f32());
    let whole = net.forward(picture.view().insert_axis(Axis(0))).expect("fits");
    let part = restored(&net, picture.view(), [40, 64], [32, 48], 24).expect("fits");
    let expected = whole.slice(s![0, .., 40..72, 64..112]);
    let worst = part.iter().zip(expected).fold(0f32, |m, (a, b)| m.max((a - b).abs()));
    assert!(worst <= 2e-6, "{worst}");
    let unlike = restored(&net, picture.view(), [40, 64], [32, 48], 0).expect("fits");
    let off = unlike.iter().zip(&part).fold(0f32, |m, (a, b)| m.max((a - b).abs()));
    assert!(off > 1e-4, "without a margin the border differs: {off}");
    let indices: Vec<usize> = (0..12).map(|i| mirrored(i - 3, 5)).collect();
    assert_eq!(indices, [3, 2, 1, 0, 1, 2, 3, 4, 3, 2, 1, 0]);
}

/// Truths of one picture in different zones show the same; of another part of the picture they would not.
#[test]
fn every_zone_shows_the_same_part_of_a_picture() {
    let (lens, settings) = (lens(), Settings { depths_mm: vec![1000.0, 700.0], ..settings(3, 64) });
    let frame = lens.frame().expect("valid");
    let renderer = at_depths(&lens, &Sensor::generic(), &settings).expect("images");
    let picture = Pictures::BuiltIn(SceneKind::Facades, 1).load(0).expect("made");
    let camera = Camera::of(&lens, &Sensor::generic(), &renderer, &settings).expect("its own");
    let depths = renderer.optics.maps;
    // The middle of the truth, whatever place, patch, context and depth.
    let truth = |row: isize, col: isize, part: u64, side: usize, context: usize, depth: &SensorMap| {
        let region = Region { row, col, rows: side, cols: side };
        let scene = Shot { region, whole: 64, context, part, noise_seed: 1, camera: &camera, texels: TEXELS_PER_PIXEL }
            .scene(&frame, depth, &picture);
        let truth = isoplanat_imaging::render::source::warp::<f32>(&scene, depth, &frame, region, &[0, 1, 2]);
        let from = side / 2 - 16;
        truth.slice(s![.., from..from + 32, from..from + 32]).to_owned()
    };
    let (a, other) = (truth(8, 8, 5, 64, 24, &depths[0]), truth(8, 8, 6, 64, 24, &depths[0]));
    let unlike = metrics::psnr(a.view(), other.view());
    for b in [
        truth(80, 160, 5, 64, 24, &depths[0]),
        truth(8, 8, 5, 64, 64, &depths[1]),
        truth(80, 160, 5, 32, 24, &depths[0]),
        truth(40, 20, 5, 32, 64, &depths[1]),
    ] {
        let same = metrics::psnr(a.view(), b.view());
        assert!(same > 20.0 && same > unlike + 6.0, "{same:.1} dB, {unlike:.1} dB");
    }
}

/// Through another lens the ideal picture stays: its own lens in the other's place changes nothing, nor much pixels of another size; a lens out of focus
/// does, and a frame of another size is refused.
#[test]
fn captures_through_another_lens_are_judged_by_the_ideal_picture_of_its_own() {
    let (own, sensor) = (lens(), Sensor::generic());
    let frame = own.frame().expect("valid");
    let bare = Guide::bare(&frame);
    let judge = |rays: Option<usize>, through: Option<Subject>| {
        let settings = Settings { rays, through, ..settings(2, 32) };
        let pictures = Pictures::BuiltIn(SceneKind::Facades, 1);
        evaluate(&own, (&identity(3), &bare), &sensor, &pictures, &settings, false, &mut |_| ()).map(|e| e.0)
    };
    let db = |rays, through| {
        judge(rays, through).expect("judges").rows.iter().map(|r| r.capture.psnr_db.mean).collect::<Vec<_>>()
    };
    for rays in [None, Some(16)] {
        assert_eq!(db(rays, None), db(rays, Some(own.clone())), "{rays:?}");
    }
    let Subject::Lens(lens) = &own else { unreachable!("a prescription") };
    let changed =
        |change: fn(&mut isoplanat_optics::lens::Prescription)| Subject::from(lens.changed(change).expect("a lens"));
    let worse = db(None, Some(changed(|l| l.surfaces.iter_mut().rev().take(1).for_each(|s| s.thickness += 2.0))));
    assert!(worse[0] < db(None, None)[0] - 0.5, "out of focus: {worse:?}");
    // Pixels a fiftieth smaller see a larger picture; it is made as large as the ideal one.
    let larger = db(None, Some(changed(|l| l.sensor.pitch_um *= 0.98)));
    assert!(larger.iter().zip(db(None, None)).all(|(a, b)| (a - b).abs() < 1.0), "{larger:?}");
    let other = judge(None, Some(changed(|l| l.sensor.columns = 250))).expect_err("another size").to_string();
    assert!(other.contains("240 x 160") && other.contains("250 x 160"), "{other}");
}
