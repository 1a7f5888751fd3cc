//! The demo's captures, what becomes of them, and the fast renderer's error.

use std::path::Path;
use std::time::Instant;

use isoplanat::deploy::child::Helper;
use isoplanat::deploy::kit::Kit;
use isoplanat::deploy::network_process::Apart;
use isoplanat::deploy::raw_process;
use isoplanat::deploy::reconstruct::{Camera, Steps};
use isoplanat::deploy::session::Options;
use isoplanat::deploy::tiles::{self, Tiling};
use isoplanat::imaging::capture::{CaptureSettings, capture};
use isoplanat::imaging::develop::distortion::Distortion;
use isoplanat::imaging::develop::undistort::captured_radius;
use isoplanat::imaging::develop::{self, Balance, Development, Rendering};
use isoplanat::imaging::dng::{DngInfo, write_dng};
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::guide::Guide;
use isoplanat::imaging::metrics::wiener::{LocalPsfs, tune};
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::reference::halves::psnr_against_halves;
use isoplanat::imaging::reference::{Channels, Sampling, Settings as Reference, render_halves};
use isoplanat::imaging::render::node_grid::NodeGrid;
use isoplanat::imaging::render::{Channels as Lit, Renderer};
use isoplanat::imaging::scene::generate;
use isoplanat::imaging::scene::placement::{Placement, Scale};
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::Lens;
use isoplanat::network::Reconstructor;
use isoplanat::psf::SensorMap;
use isoplanat::report::demo::{Crop, DemoReport, MethodResult, SceneResult};
use isoplanat::{Error, Result};
use ndarray::{Array3, ArrayView4, s};

use super::settings::{Settings, Unseen};
use crate::progress::Bar;

/// An unseen scene that fills the frame at about one texel a pixel.
fn scene(frame: &Frame, map: &SensorMap, unseen: Unseen) -> Plane {
    let texture = generate(unseen.kind, unseen.seed, frame.rows * 13 / 10, frame.columns * 13 / 10);
    // The axis is at the frame's first corner.
    Placement { texel: [0.0, 0.0], pixel: frame.axis_px, scale: Scale::OnAxis(1.1) }.by(map, frame, texture)
}

/// Photographs a scene, writes the DNG, and develops it four ways.
#[expect(clippy::too_many_arguments, reason = "the demo's state")]
pub(crate) fn photograph(
    folder: &Path,
    settings: &Settings,
    lens: &Lens,
    kit: &Kit,
    bare: &Reconstructor,
    renderer: &Renderer,
    options: &Options,
    unseen: Unseen,
    runtime: &mut String,
) -> Result<SceneResult> {
    let (frame, sensor) = (&kit.frame, &kit.sensor);
    let plane = scene(frame, &renderer.optics.maps[0], unseen);
    // RAW, by rays from the sensor.
    let bar = Bar::new(&format!("capture: {}", unseen.name));
    let how = CaptureSettings { samples: settings.samples, seed: unseen.seed, ..CaptureSettings::default() };
    let taken = capture(lens, &plane, sensor, frame, how, Some(&|share| bar.set(share, String::new())))?;
    bar.done(format!("render noise {:.1e} beside sensor noise {:.1e}", taken.render_noise, taken.sensor_noise));
    let dng = folder.join(format!("{}.dng", unseen.name));
    let info = DngInfo {
        software: concat!("isoplanat ", env!("CARGO_PKG_VERSION")).into(),
        description: format!("built-in scene {} seed {}", unseen.kind, unseen.seed),
        lens: lens.name.clone(),
        model: String::new(),
    };
    write_dng(&dng, taken.dn.view(), sensor, &info)?;
    // The camera, with and without its network.
    let bar = Bar::new(&format!("camera: {}", unseen.name));
    let mut camera = |network: bool| -> Result<Array3<f32>> {
        let helper = Helper::current()?;
        let apart = Apart::new(helper.clone());
        let camera = Camera::with_kit_apart(kit.clone(), Steps { network, undistort: true }, options, &apart)?;
        if let Some(session) = camera.network() {
            *runtime = session.runtime().to_string();
        }
        #[expect(clippy::cast_precision_loss, reason = "tile counts")]
        let progress = |done: usize, all: usize| bar.set(done as f64 / all.max(1) as f64, String::new());
        let (raw, _) = raw_process::decode(&helper, &dng, crate::memory::limit())?;
        Ok(camera.reconstruct(raw, &dng, &progress)?.image)
    };
    let developed = camera(false)?;
    let reconstruction = camera(true)?;
    bar.done(String::new());
    // The Wiener filter in the network's place, tuned against the truth of this very capture.
    let bar = Bar::new(&format!("Wiener filter: {}", unseen.name));
    let whole = Region::whole(frame);
    let ideal: Array3<f32> = renderer.truth(&plane, 0, whole, &Lit::from_scene(&plane));
    let development = Development {
        balance: Balance::from_sensor(sensor),
        flat_field: Some((frame, &kit.shading)),
        distortion: Some((frame, &kit.distortion)),
        srgb_from_camera: sensor.srgb_from_camera,
        rendering: Rendering::default(),
    };
    let mosaic = taken.dn.mapv(f32::from);
    // The network that sees the capture alone, in the other one's place.
    let radius = bare.config().receptive_radius_px();
    let tiling =
        Tiling::new(settings.tile, radius.next_multiple_of(bare.config().multiple()), bare.config().multiple())?;
    let alone = develop::develop(mosaic.view(), sensor.cfa, &development, |input| {
        let run = |tile: ArrayView4<'_, f32>| bare.forward(tile);
        tiles::run(input, Region::whole(frame), &Guide::bare(frame), tiling, 1, &run, &|_, _| ())
    })?
    .image;
    let psfs = local_psfs(renderer, settings.wiener_spacing)?;
    let mut tuned = String::new();
    let wiener = develop::develop(mosaic.view(), sensor.cfa, &development, |input| {
        let best = tune(input.view(), ideal.view(), &psfs)?;
        tuned = format!("noise to signal {:.1e}, {} prior", best.nsr, best.prior.name());
        Ok(best.image)
    })?
    .image;
    bar.done(tuned);
    // Truth: what a lens without distortion or blur would show.
    let truth = straight(&plane, kit.distortion.sensor_from_slope_derivative(0.0), frame);
    // Compared where the undistorted frame has a source, clear of the border by 8 pixels.
    let (rows, cols) = valid(frame, &kit.distortion);
    let cut = |a: &Array3<f32>| a.slice(s![.., 8..rows, 8..cols]).to_owned();
    let crops = [
        Crop { row: rows / 8, column: cols / 8, size: cols / 7 },
        Crop { row: rows / 2, column: cols / 2, size: cols / 7 },
        Crop { row: rows * 3 / 4, column: cols * 5 / 6, size: cols / 7 },
    ];
    SceneResult::measure(
        unseen.name,
        cut(&developed),
        cut(&wiener),
        cut(&alone),
        cut(&reconstruction),
        cut(&truth),
        &crops,
    )
}

/// The largest part of the frame, from the axis corner, whose undistorted pixels all have a source.
fn valid(frame: &Frame, distortion: &Distortion) -> (usize, usize) {
    for percent in (50..=100).rev() {
        let (rows, cols) = (frame.rows * percent / 100, frame.columns * percent / 100);
        #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
        let inside = |r: usize, c: usize| {
            let [dx, dy] = [c as f64 - frame.axis_px[0], r as f64 - frame.axis_px[1]];
            let rho = dx.hypot(dy) * frame.pitch_mm;
            let k = if rho > 0.0 { captured_radius(distortion, rho) / rho } else { 1.0 };
            dx * k + frame.axis_px[0] <= frame.columns as f64 - 8.0
                && dy * k + frame.axis_px[1] <= frame.rows as f64 - 8.0
        };
        if (0..=20).all(|i| inside(rows, cols * i / 20) && inside(rows * i / 20, cols)) {
            return (rows.min(frame.rows - 8), cols.min(frame.columns - 8));
        }
    }
    (frame.rows / 2, frame.columns / 2)
}

/// The scene at pixel centres through a lens of focal length `focal_mm` without distortion or blur.
fn straight(plane: &Plane, focal_mm: f64, frame: &Frame) -> Array3<f32> {
    let per_pixel = frame.pitch_mm / focal_mm * plane.texels_per_slope;
    let whole = Region::whole(frame);
    let last = plane.texture.dim().0 - 1;
    Array3::from_shape_fn((3, frame.rows, frame.columns), |(c, i, j)| {
        let [x, y] = whole.offset(frame, i, j);
        let texel = [plane.axis_texel[0] + x * per_pixel, plane.axis_texel[1] + y * per_pixel];
        #[expect(clippy::cast_possible_truncation, reason = "a picture")]
        let value = plane.sample(c.min(last), texel).0 as f32;
        value
    })
}

/// The optics' PSFs for the Wiener filter, `spacing` pixels apart.
fn local_psfs(renderer: &Renderer, spacing: usize) -> Result<LocalPsfs> {
    let frame = &renderer.plan.frame;
    let whole = Region::whole(frame);
    let grid = NodeGrid::uniform(whole, spacing);
    #[expect(clippy::cast_precision_loss, reason = "pixel positions")]
    let line = |knots: &[isize]| knots.iter().map(|k| *k as f64).collect();
    LocalPsfs::new(line(&grid.row_knots), line(&grid.col_knots), renderer.pixel_kernels(0, &grid))
}

/// Renders parts of the street scene by both renderers and puts error and run time into the report.
pub(crate) fn compare(
    settings: &Settings,
    lens: &Lens,
    renderer: &Renderer,
    density: &SpectralDensity,
    report: &mut DemoReport,
) -> Result<()> {
    let bar = Bar::new("fast against reference");
    let frame = &renderer.plan.frame;
    let plane = scene(frame, &renderer.optics.maps[0], settings.unseen()[1]);
    let side = settings.compared;
    let places = [(8, 8), (frame.rows / 2, frame.columns / 2), (frame.rows - side - 8, frame.columns - side - 8)];
    // The lens is traced once for all places.
    let clock = Instant::now();
    let fresh = Renderer::new(lens, &renderer.plan)?;
    let mut fast_seconds = clock.elapsed().as_secs_f64();
    let (mut mse, mut square, mut reference_seconds) = (0.0, 0.0, 0.0);
    let (mut fast_energy, mut reference_energy) = (0.0, 0.0);
    for (i, (row, col)) in places.into_iter().enumerate() {
        let region = Region { row: row.cast_signed(), col: col.cast_signed(), rows: side, cols: side };
        let clock = Instant::now();
        let fast: Array3<f32> = fresh.picture(&plane, 0, region, &Lit::from_scene(&plane), &|_| {}).0;
        fast_seconds += clock.elapsed().as_secs_f64();
        let clock = Instant::now();
        let how = Reference {
            samples: settings.reference_samples,
            seed: 17,
            channels: Channels::All,
            sampling: Sampling::Bounded,
        };
        #[expect(clippy::cast_precision_loss, reason = "three places")]
        let progress = |share: f64| bar.set((i as f64 + share) / places.len() as f64, String::new());
        let halves = render_halves(lens, &plane, density, frame, region, how, Some(&progress))?;
        reference_seconds += clock.elapsed().as_secs_f64();
        mse += psnr_against_halves(fast.view(), &halves).mean_square / 3.0;
        let mean = (&halves[0].mean + &halves[1].mean) * 0.5;
        let n = mean.len() as f64;
        square += mean.iter().map(|v| f64::from(v * v)).sum::<f64>() / n / 3.0;
        fast_energy += fast.iter().map(|v| f64::from(*v)).sum::<f64>();
        reference_energy += mean.iter().map(|v| f64::from(*v)).sum::<f64>();
    }
    if !(mse.is_finite() && reference_energy > 0.0) {
        return Err(Error::Internal("the reference renderer gave no light".into()));
    }
    report.psnr_fast_vs_reference_db = -10.0 * mse.max(1e-12).log10();
    (report.seconds_fast, report.seconds_reference) = (fast_seconds, reference_seconds);
    let energy = fast_energy / reference_energy - 1.0;
    report.methods = vec![
        MethodResult {
            name: format!("PSF grid, {0} × {0} kernels", renderer.plan.depths[0].size()),
            seconds: fast_seconds,
            psnr_db: report.psnr_fast_vs_reference_db,
            relative_l2: (mse.max(0.0) / square).sqrt(),
            note: format!(
                "three regions of {side} × {side} pixels, centre to corner, PSF tracing included; energy {energy:+.1e}"
            ),
        },
        MethodResult {
            name: format!("Reference, {} rays a pixel and channel", settings.reference_samples),
            seconds: reference_seconds,
            psnr_db: f64::INFINITY,
            relative_l2: 0.0,
            note: "rays from the sensor; its own noise is taken out by two independent halves".into(),
        },
    ];
    bar.done(format!("{:.1} dB", report.psnr_fast_vs_reference_db));
    Ok(())
}
