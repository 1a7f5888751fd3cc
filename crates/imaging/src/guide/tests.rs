use ndarray::{Array2, Array3, Array4, s};

use super::*;
use crate::metrics::psnr;
use crate::plane::mirrored;
use crate::render::node_grid::NodeGrid;
use crate::render::{Channels, Settings};
use crate::scene::{SceneKind, generate};
use crate::sensor::Sensor;
use crate::sensor::noise::Noise;
use crate::sensor::spectrum::SpectralDensity;
use isoplanat_optics::lens::builtin;

const BOTH: Inputs = Inputs { wiener: true, field: true, ..Inputs::BARE };
const ALL: Inputs = Inputs { wiener: true, levels: true, field: true, psf: true };

/// What `inputs` need, of no lens.
fn facts(inputs: Inputs) -> Facts {
    let bank = |wanted: bool, half: usize| wanted.then(|| random(half));
    let levels = bank(inputs.levels, 5).zip(bank(inputs.levels, 4)).map(|(a, b)| Box::new([a, b]));
    Facts { filters: bank(inputs.wiener, 6), levels, spread: inputs.psf.then(spread), vergences: Vec::new() }
}

/// Widths, elongation and light that change along the radius.
fn spread() -> Spread {
    let numbers = ndarray::arr2(&[[1.0, 1.1, 1.4, 0.0, 1.0], [2.0, 2.5, 3.0, 0.4, 0.8], [5.0, 6.0, 8.0, -0.6, 0.3]]);
    Spread::from_parts(vec![0.0, 15.0, 50.0], numbers).expect("valid")
}

/// Filters of random steps on four nodes.
fn random(half: usize) -> Filters {
    let rng = &mut fastrand::Rng::with_seed(5);
    let size = 2 * half + 1;
    let mut steps = Array4::from_shape_simple_fn((4, 3, size, size), || rng.i16(-1000..1000));
    let mut scales = Array2::zeros((4, 3));
    for node in 0..4 {
        for channel in 0..3 {
            let mut filter = steps.slice_mut(s![node, channel, .., ..]);
            filter[[half, half]] = 32_000;
            let sum: i64 = filter.iter().map(|v| i64::from(*v)).sum();
            scales[[node, channel]] = 1.0 / sum as f32;
        }
    }
    let grid = NodeGrid { row_knots: vec![4, 40], col_knots: vec![0, 50] };
    Filters::from_parts(grid, steps, scales).expect("valid")
}

fn picture(rows: usize, cols: usize) -> Array3<f32> {
    let rng = &mut fastrand::Rng::with_seed(8);
    Array3::from_shape_simple_fn((3, rows, cols), || rng.f32())
}

/// The sum by its definition, windows of the nodes times filters, mirrored at the edges; and a part of the picture with the margin
/// that it asks for gives what the whole gives.
#[test]
fn filters_are_the_plain_sum_on_tiles_or_not() {
    let (filters, image) = (random(6), picture(48, 60));
    let whole = Region { row: 0, col: 0, rows: 48, cols: 60 };
    let all = filters.over(image.view(), whole, whole);
    let value = |filters: &Filters, c: usize, r: usize, q: usize| {
        let mut sum = 0.0;
        for node in 0..4 {
            let window = filters.grid.window(node, r.cast_signed(), q.cast_signed());
            for ((i, j), step) in filters.steps.slice(s![node, c, .., ..]).indexed_iter() {
                let row = mirrored(r.cast_signed() - (i.cast_signed() - 6), 48);
                let col = mirrored(q.cast_signed() - (j.cast_signed() - 6), 60);
                let weight = f64::from(*step) * f64::from(filters.scales[[node, c]]);
                sum += window * weight * f64::from(image[[c, row, col]]);
            }
        }
        sum
    };
    for (c, r, q) in [(0, 0, 0), (1, 47, 59), (2, 20, 30), (0, 4, 50), (1, 33, 1)] {
        let (ours, plain) = (f64::from(all[[c, r, q]]), value(&filters, c, r, q));
        assert!((ours - plain).abs() < 2e-6, "{c} {r} {q}: {ours} {plain}");
    }
    let part = Region { row: 17, col: 22, rows: 11, cols: 9 };
    let around = part.grown(6);
    let cut = image.slice(s![.., 11..11 + around.rows, 16..16 + around.cols]);
    let some = filters.over(cut, around, part);
    let worst = (&some - &all.slice(s![.., 17..28, 22..31])).iter().fold(0f32, |m, v| m.max(v.abs()));
    assert!(worst < 2e-6, "{worst}");
}

/// The cotangent at the capture is the channels' exact transpose, within the frame and where the capture is mirrored at its edges.
#[test]
fn channels_pull_back_to_the_capture() {
    let frame = Frame::centred(60, 48, 0.01).expect("valid");
    let told = |inputs: Inputs| Guide::from_parts(inputs, &frame, facts(inputs)).expect("valid");
    for guide in [
        told(BOTH),
        told(ALL),
        told(Inputs { levels: true, ..Inputs::BARE }),
        told(Inputs { field: true, ..Inputs::BARE }),
        Guide::bare(&frame),
    ] {
        for (at, wanted) in [
            (Region { row: 8, col: 8, rows: 32, cols: 36 }, Region { row: 16, col: 20, rows: 12, cols: 16 }),
            (Region { row: 0, col: 0, rows: 48, cols: 60 }, Region { row: 0, col: 0, rows: 48, cols: 60 }),
            (Region { row: 24, col: 40, rows: 24, cols: 20 }, Region { row: 32, col: 48, rows: 16, cols: 12 }),
        ] {
            let [x, dx] = [0, 1].map(|k| picture(at.rows, at.cols) * (1.0 - 1.7 * k as f32));
            let (told, record) = guide.over_recorded(x.view(), at, wanted);
            let worst = (&told - &guide.over(x.view(), at, wanted)).iter().fold(0f32, |m, v| m.max(v.abs()));
            assert!(worst < 2e-6, "{worst}");
            let rng = &mut fastrand::Rng::with_seed(3);
            let bar = Array3::from_shape_simple_fn(told.raw_dim(), || rng.f32() - 0.5);
            // Differences of something linear but for a constant.
            let moved = guide.over((&x + &dx).view(), at, wanted) - &told;
            let dot = |a: &Array3<f32>, b: &Array3<f32>| -> f64 {
                a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
            };
            let (forth, back) = (dot(&moved, &bar), dot(&guide.over_vjp(&record, bar.view()), &dx));
            let size = dot(&moved.mapv(f32::abs), &bar.mapv(f32::abs));
            assert!((forth - back).abs() < 1e-5 * size, "{forth} {back} of {size}");
        }
    }
}

/// White stays white, whatever the filter, and the file brings the same numbers back.
#[test]
fn white_stays_white_and_files_come_back() {
    let filters = random(6);
    let white = Array3::ones((3, 48, 60));
    let whole = Region { row: 0, col: 0, rows: 48, cols: 60 };
    let told = filters.over(white.view(), whole, whole);
    assert!(told.iter().all(|v| (v - 1.0).abs() < 1e-4));
    let path = std::path::Path::new("kit/filters.npz");
    let none = Facts::default().to_npz().expect("writes");
    for inputs in [BOTH, ALL, Inputs { psf: true, ..Inputs::BARE }, Inputs { levels: true, ..Inputs::BARE }] {
        let known = Facts { vergences: vec![0.001, 0.0], ..facts(inputs) };
        assert_eq!(known.depths_mm(), [1000.0, f64::INFINITY]);
        let bytes = known.to_npz().expect("writes");
        assert_eq!(Facts::from_npz(&bytes, path).expect("reads"), known);
        for broken in [&bytes[..bytes.len() / 2], b"".as_slice(), b"PK\x03\x04 no file", &none] {
            let error = Facts::from_npz(broken, path).expect_err("broken");
            assert!(error.exit_code() == 2 && error.to_string().contains("filters.npz"), "{error}");
        }
    }
    let mut grey = filters.clone();
    grey.scales *= 0.5;
    let error = Filters::from_parts(grey.grid, grey.steps, grey.scales).expect_err("grey").to_string();
    assert!(error.contains("sum"), "{error}");
    let frame = Frame::centred(60, 48, 0.01).expect("valid");
    for (inputs, known, said) in [
        (BOTH, Inputs::BARE, "Wiener filters"),
        (Inputs::BARE, BOTH, "Wiener filters"),
        (ALL, BOTH, "other noise"),
        (Inputs { psf: true, ..BOTH }, BOTH, "point spread functions"),
        (BOTH, Inputs { psf: true, ..BOTH }, "point spread functions"),
    ] {
        let error = Guide::from_parts(inputs, &frame, facts(known)).expect_err("another's").to_string();
        assert!(error.contains(said), "{error}");
    }
    let wide = Frame::centred(120, 80, 0.01).expect("valid");
    let psf = Inputs { psf: true, ..Inputs::BARE };
    let error = Guide::from_parts(psf, &wide, facts(psf)).expect_err("a table that ends").to_string();
    assert!(error.contains("known to 50.0 pixels"), "{error}");
    let mut lonely = facts(ALL);
    let noisy = lonely.levels.as_mut().expect("named");
    let halves = [noisy[0].clone(), noisy[1].clone()];
    let npz = lonely.to_npz().expect("writes");
    assert_eq!(Facts::from_npz(&npz, path).expect("reads").levels.map(|l| *l), Some(halves));
    // The name of one of the two levels' arrays is another's.
    let mut renamed = npz.clone();
    let (from, to) = (b"quiet_steps", b"quite_steps");
    let places: Vec<usize> = (0..npz.len() - from.len()).filter(|i| npz[*i..].starts_with(from)).collect();
    places.iter().for_each(|i| renamed[*i..i + to.len()].copy_from_slice(to));
    let error = Facts::from_npz(&renamed, path).expect_err("one level").to_string();
    assert!(error.contains("one of the two"), "{error}");
    let rng = &mut fastrand::Rng::with_seed(9);
    for _ in 0..300 {
        let mut changed = npz.clone();
        changed[rng.usize(0..npz.len())] = rng.u8(..);
        if let Err(error) = Facts::from_npz(&changed, path) {
            assert!(error.exit_code() == 2 && error.to_string().contains("filters.npz"), "{error}");
        }
    }
    let tiny = Frame::centred(12, 8, 0.01).expect("valid");
    assert!(Guide::from_parts(BOTH, &tiny, facts(BOTH)).expect_err("outside").to_string().contains("node at 40"));
}

/// A picture through a lens, by the filters made for it: several dB nearer to the truth, and nearer the less noise there is.
#[test]
fn filters_of_a_lens_undo_its_blur() {
    let lens = builtin::lens("two_element").expect("shipped");
    let frame = Frame::centred(320, 240, 0.06).expect("valid");
    let sensor = Sensor::generic();
    let density = SpectralDensity::new(&sensor);
    let renderer =
        Renderer::planned(&lens, &frame, &density, &[lens.object_vergence], Settings::TRAINING).expect("traces");
    let quiet = Electronics { noise: Noise { shot: 1e-6, read: 1e-4 }, ..Electronics::from_sensor(&sensor) };
    let guide = Guide::new(BOTH, &renderer, &quiet).expect("filters");
    let scene = crate::plane::Plane {
        texture: generate(SceneKind::Facades, 3, 300, 400),
        texels_per_slope: 1.05 * 50.0 / 0.06,
        axis_texel: [200.0, 150.0],
        vergence: lens.object_vergence,
    };
    let region = Region { row: 0, col: 0, rows: 240, cols: 320 };
    let channels = Channels::from_scene(&scene);
    let (mut image, _) = renderer.picture::<f32>(&scene, 0, region, &channels, &|_| {});
    image /= &renderer.light.over::<f32>(&frame, region, &[0, 1, 2]);
    let truth: Array3<f32> = renderer.truth(&scene, 0, region, &channels);
    let told = guide.over(image.view(), region, region);
    assert_eq!(told.dim(), (9, 240, 320));
    assert_eq!(told.slice(s![..3, .., ..]), image);
    let [capture, wiener] = [0, 3].map(|k| psnr(told.slice(s![k..k + 3, .., ..]), truth.view()));
    assert!(wiener > capture + 8.0, "{capture} {wiener}");
    // Each filter is the better one for the noise that it was made for.
    let noisy = Electronics { noise: Noise { shot: 1e-2, read: 1e-2 }, ..quiet.clone() };
    let soft = Guide::new(BOTH, &renderer, &noisy).expect("filters");
    let mut grainy = image.clone();
    for (k, mut plane) in grainy.outer_iter_mut().enumerate() {
        plane += &(0.07 * crate::sensor::noise::standard_normal::<f32>(k as u64, (240, 320)));
    }
    let restored = |guide: &Guide, image: &Array3<f32>| {
        psnr(guide.over(image.view(), region, region).slice(s![3..6, .., ..]), truth.view())
    };
    let [clean, noise] = [&image, &grainy].map(|i| [&guide, &soft].map(|g| restored(g, i)));
    let before = psnr(grainy.view(), truth.view());
    eprintln!("capture {capture:.2} dB: {clean:.2?}; with noise {before:.2} dB: {noise:.2?}");
    assert!(clean[0] > clean[1] + 3.0 && noise[1] > noise[0] + 3.0 && noise[1] > before + 1.0, "{clean:?} {noise:?}");
    // The place: nothing on the axis, one at the corner.
    let at = |k: usize, r: usize, c: usize| told[[6 + k, r, c]];
    assert!(at(0, 120, 160).abs() < 0.01 && at(2, 120, 160) < 1e-4 && (at(2, 0, 0) - 1.0).abs() < 0.02);
    assert!(at(0, 120, 0) < -0.7 && at(1, 239, 160) > 0.5);
}

/// What a training shows of a mirrored crop is what the mirrored place shows.
#[test]
fn turned_channels_are_those_of_the_mirrored_place() {
    let frame = Frame::centred(64, 64, 0.01).expect("valid");
    let inputs = Inputs { field: true, psf: true, ..Inputs::BARE };
    let guide = Guide::from_parts(inputs, &frame, facts(inputs)).expect("valid");
    let whole = Region { row: 0, col: 0, rows: 64, cols: 64 };
    let blank = Array3::zeros((3, 64, 64));
    let there = |row, col| guide.over(blank.view(), whole, Region { row, col, rows: 8, cols: 8 });
    for (turns, row, col) in [
        ([false; 3], 4, 20),
        ([true, false, false], 52, 20),
        ([false, true, false], 4, 36),
        ([false, false, true], 20, 4),
        ([true, true, true], 36, 52),
        ([true, false, true], 20, 52),
    ] {
        let mut told = there(4, 20);
        guide.turned(&mut told, turns);
        let worst = (&told - &there(row, col)).iter().fold(0f32, |m, v| m.max(v.abs()));
        assert!(worst < 1e-6, "{turns:?}: {worst}");
    }
}

/// The lens, its frame and what its filters are made of.
fn renderer(lens: &isoplanat_optics::lens::Lens, frame: &Frame, settings: Settings) -> Renderer {
    let density = SpectralDensity::new(&Sensor::generic());
    Renderer::planned(lens, frame, &density, &[lens.object_vergence], settings).expect("traces")
}

/// A white square on black, developed: what saturation leaves of a lamp.
fn lamp(rows: usize, cols: usize) -> Array3<f32> {
    Array3::from_shape_fn((3, rows, cols), |(_, r, c)| {
        f32::from(u8::from(r.abs_diff(rows / 2) < 20 && c.abs_diff(cols / 2) < 20))
    })
}

/// Saturated places, noise a hundred times the stated, a PSF wider than the widest filter, darkness: finite filters that keep white, no
/// ringing beyond the bound, and the noisier the less of it.
#[test]
fn extremes_stay_within_the_stated_bound() {
    let lens = builtin::lens("two_element").expect("shipped");
    let frame = Frame::centred(240, 160, 0.06).expect("valid");
    let (sensor, whole) = (Sensor::generic(), Region { row: 0, col: 0, rows: 160, cols: 240 });
    let electronics = Electronics::from_sensor(&sensor);
    let noise = electronics.noise;
    let noisier = |factor: f64| Electronics {
        noise: Noise { shot: noise.shot * factor * factor, read: noise.read * factor },
        ..electronics.clone()
    };
    // Out of focus by 4 mm: circles of a millimetre, 17 pixels; of 4 µm, 250 of them.
    let mut prescription = (*lens).clone();
    prescription.surfaces.last_mut().expect("some").thickness += 4.0;
    let far = isoplanat_optics::lens::Lens::new(prescription, "defocused").expect("a lens");
    let fine = Frame::centred(240, 160, 0.004).expect("valid");
    let mut bounds = Vec::new();
    for (what, lens, frame, factor) in [
        ("stated noise", &lens, &frame, 1.0),
        ("noise × 100", &lens, &frame, 100.0),
        ("out of focus", &far, &frame, 1.0),
        ("wider than a filter", &far, &fine, 1.0),
        ("no noise", &lens, &frame, 0.0),
    ] {
        let banks = Filters::compute(&renderer(lens, frame, Settings::TRAINING), &noisier(factor), &[1.0]).expect(what);
        let filters = &banks[0];
        let bound = filters.overshoot();
        let white = filters.over(Array3::ones((3, 160, 240)).view(), whole, whole);
        assert!(white.iter().all(|v| (v - 1.0).abs() < 1e-3), "{what}: white stays white");
        let restored = filters.over(lamp(160, 240).view(), whole, whole);
        let (low, high) = restored.iter().fold((0f32, 1f32), |(a, b), v| (a.min(*v), b.max(*v)));
        let ringing = f64::from((-low).max(high - 1.0));
        eprintln!("{what}: filters of {} pixels, ringing {ringing:.3} of at most {bound:.3}", 2 * filters.reach() + 1);
        assert!(bound.is_finite() && ringing <= bound + 1e-4, "{what}: {ringing} {bound}");
        assert!(filters.reach() <= Filters::WIDEST, "{what}");
        bounds.push((bound, ringing));
    }
    assert!(bounds[1].1 < 0.5 * bounds[0].1, "noise damps: {bounds:?}");
}

/// Where no light arrives there is nothing to undo: the filter of a kernel of zeros, and of darkness, is none.
#[test]
fn darkness_has_no_filter() {
    let fft = isoplanat_base::math::fft::RealFft2::<f64>::new(64, 64);
    for nsr in [1e-6, 10.0] {
        let filter = filters::Spectra::of(&fft, 64, &[Array2::zeros((9, 9))]).wiener(&fft, nsr, 12);
        assert_eq!((filter[[12, 12]], filter.iter().map(|v| v.abs()).sum::<f64>()), (1.0, 1.0));
    }
    assert_eq!(filters::nsr(&Electronics::from_sensor(&Sensor::generic()), 1, 0.0, 1.0), 10.0);
}

#[test]
fn inputs_have_names() {
    assert_eq!(
        (Inputs::BARE.channels(), BOTH.channels(), BOTH.base(), BOTH.names()),
        (3, 9, 3, vec!["wiener", "field"])
    );
    assert_eq!((ALL.channels(), ALL.names()), (21, vec!["wiener", "levels", "field", "psf"]));
    assert_eq!(Inputs::of_names(["field", "wiener"]).expect("known"), BOTH);
    for wrong in [vec!["smell"], vec!["field", "field"]] {
        let error = Inputs::of_names(wrong.iter().copied()).expect_err("refused").to_string();
        assert!(error.contains("wiener, levels, field, psf"), "{error}");
    }
}

/// What a place's point spread function is like, against the moments of the whole kernel there by their definition; banks of other noise are the filters that
/// such noise gives.
#[test]
fn spreads_are_the_moments_of_the_kernels() {
    let lens = builtin::lens("two_element").expect("shipped");
    let frame = Frame::centred(320, 240, 0.06).and_then(|f| f.with_axis([20.0, 30.0])).expect("valid");
    let (renderer, electronics) =
        (renderer(&lens, &frame, Settings::TRAINING), Electronics::from_sensor(&Sensor::generic()));
    let guide = Guide::new(ALL, &renderer, &electronics).expect("facts");
    let grid = NodeGrid { row_knots: vec![30, 150, 239], col_knots: vec![20, 90, 319] };
    let kernels: Array4<f64> = renderer.pixel_kernels(0, &grid);
    let blank = Array3::zeros((3, 240, 320));
    let whole = Region { row: 0, col: 0, rows: 240, cols: 320 };
    let mut longest = 0.0f64;
    for node in 0..grid.len() {
        let (row, col) = grid.pixel(node);
        let at = Region { row: row.min(239), col: col.min(319), rows: 1, cols: 1 };
        let told = guide.over(blank.view(), whole, at);
        let means = guide.facts().and_then(|f| f.spread.as_ref()).expect("named").means();
        let shown: Vec<f64> = told.slice(s![15.., 0, 0]).iter().zip(means).map(|(v, m)| f64::from(v + m)).collect();
        let moments = |channel: usize| {
            let kernel = kernels.slice(s![node, channel, .., ..]);
            let half = (kernel.nrows() / 2) as f64;
            let mean = |of: &dyn Fn(f64, f64) -> f64| {
                kernel.indexed_iter().map(|((i, j), v)| v * of(j as f64 - half, i as f64 - half)).sum::<f64>()
                    / kernel.sum()
            };
            let [x, y] = [mean(&|x, _| x), mean(&|_, y| y)];
            [mean(&|a, _| (a - x).powi(2)), mean(&|a, b| (a - x) * (b - y)), mean(&|_, b| (b - y).powi(2))]
        };
        let all = [0, 1, 2].map(moments);
        for (channel, [xx, _, yy]) in all.iter().enumerate() {
            let width = 0.25 * 64f64.powf(shown[channel]);
            let expected = (0.5 * (xx + yy)).sqrt();
            // Straight lines over 32 steps of the radius, and a turned kernel lies on its pixels otherwise.
            assert!((width / expected - 1.0).abs() < 0.03, "node {node}, channel {channel}: {width} {expected}");
        }
        let sum = |k: usize| all.iter().map(|m| m[k]).sum::<f64>();
        let [long, slant] = [(sum(0) - sum(2)) / (sum(0) + sum(2)), 2.0 * sum(1) / (sum(0) + sum(2))];
        assert!(
            (shown[3] - long).abs() < 0.05 && (shown[4] - slant).abs() < 0.05,
            "node {node}: {shown:?} {long} {slant}"
        );
        assert!(told.slice(s![15.., 0, 0]).iter().all(|v| v.abs() < 0.7), "what differs: {told}");
        longest = longest.max(long.hypot(slant));
        let light = renderer.light.over::<f64>(&frame, at, &[0, 1, 2]).mean().expect("three");
        assert!((shown[5] - light).abs() < 0.01, "node {node}: {} {light}", shown[5]);
    }
    assert!(longest > 0.2, "a lens whose spread has a direction somewhere: {longest}");
    for (k, times) in [0.1f64, 10.0].into_iter().enumerate() {
        let Noise { shot, read } = electronics.noise;
        let noise = Noise { shot: times * shot, read: times.sqrt() * read };
        let other = Electronics { noise, ..electronics.clone() };
        let alone = Guide::new(Inputs { wiener: true, ..Inputs::BARE }, &renderer, &other).expect("facts");
        let [levels, one] = [&guide, &alone].map(|g| g.facts().expect("some"));
        let apart = &levels.levels.as_ref().expect("named")[k].steps - &one.filters.as_ref().expect("named").steps;
        // The same but for the last digit of the noise.
        assert!(apart.iter().all(|v| v.abs() <= 1), "{times} of the noise");
    }
}

#[test]
fn spreads_that_are_none_are_refused() {
    let good = spread();
    let with = |radii: &[f64], change: (usize, f64)| {
        let mut numbers = good.numbers.clone();
        numbers[[1, change.0]] = change.1;
        Spread::from_parts(radii.to_vec(), numbers).map_err(|e| e.to_string())
    };
    assert!(with(&[0.0, 15.0, 50.0], (3, -1.0)).is_ok());
    for (radii, change, said) in [
        (&[0.0, 15.0][..], (0, 1.0), "numbers at 2"),
        (&[1.0, 15.0, 50.0], (0, 1.0), "grow from 0"),
        (&[0.0, 15.0, 15.0], (0, 1.0), "grow from 0"),
        (&[0.0, 15.0, f64::INFINITY], (0, 1.0), "grow from 0"),
        (&[0.0, 15.0, 50.0], (0, f64::NAN), "NaN at distance 1"),
        (&[0.0, 15.0, 50.0], (3, 1.5), "elongation"),
        (&[0.0, 15.0, 50.0], (4, -0.1), "light"),
    ] {
        let error = with(radii, change).expect_err("refused");
        assert!(error.contains(said), "{error}");
    }
}
