//! Whole frames that no training meets, captured once: built-in scenes, and photographs of the shared folder, continued by their mirror images.

use std::path::Path;

use isoplanat::design::chain::{Patch, forward};
use isoplanat::design::evaluate::FINENESS;
use isoplanat::design::subject::Subject;
use isoplanat::imaging::develop::simulate::Electronics;
use isoplanat::imaging::guide::Guide;
use isoplanat::imaging::metrics;
use isoplanat::imaging::plane::Region;
use isoplanat::imaging::scene::photos::Photos;
use isoplanat::imaging::scene::placement::{Placement, Scale};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::network::Reconstructor;
use ndarray::{Array3, Axis, s};

/// Texels a pixel on the axis.
const TEXELS: f64 = 1.2;

/// Photographs of the training folder that are judged beside those of the evaluation folder: networks here are trained on built-in scenes. Landscapes, and what has skies or soft grounds.
const SOFT: [&str; 12] = [
    "cc_beacon-street-sunset",
    "cc_blue-periwinkle",
    "cc_canyon-wren",
    "cc_extreme-desert-hike",
    "cc_lake-sherburne",
    "cc_morskie_oko",
    "cc_oakland-zoo-otters",
    "cc_perched-osprey",
    "cc_singaporean-cityscape",
    "cc_snow-capped_mountain",
    "cc_sunset_by_the_pier",
    "cc_tj_holowaychuk",
];

/// A network and what it is told.
pub(crate) struct Told {
    pub(crate) network: Reconstructor,
    pub(crate) guide: Guide,
}

struct Frame {
    name: String,
    truth: Array3<f32>,
    capture: Array3<f32>,
    /// Mean of the truth's steps from pixel to pixel, as seen, ×1000: small where it is smooth.
    detail: f64,
}

/// The frames.
pub(crate) struct Frames(Vec<Frame>, Region);

impl Frames {
    /// Captures of the lens, by the fast renderer.
    pub(crate) fn of(subject: &Subject, sensor: &Sensor, every: usize) -> Self {
        let renderer = subject
            .renderer(&SpectralDensity::new(sensor), &[subject.vergence()], FINENESS)
            .expect("a lens that images");
        let electronics = Electronics::from_sensor(sensor);
        let frame = &renderer.plan.frame;
        let whole = Region::whole(frame);
        let map = &renderer.optics.maps[0];
        // From the frame's first row and column on, wherever the axis is.
        let texel = frame.axis_px.map(|v| v * TEXELS);
        let placement = Placement { texel, pixel: frame.axis_px, scale: Scale::OnAxis(TEXELS) };
        let size = [frame.rows, frame.columns].map(|n| (n as f64 * TEXELS * 1.1) as usize);
        let frames = pictures(size).into_iter().enumerate().step_by(every).map(|(i, (name, texture))| {
            let plane = placement.by(map, frame, texture);
            let done =
                forward::<f32>(&renderer, &electronics, &Patch::whole(plane, whole, 77 + i as u64)).expect("renders");
            let steps = |axis: usize| {
                let n = done.truth.len_of(Axis(axis));
                let (a, b) = (
                    done.truth.slice_axis(Axis(axis), (1..).into()),
                    done.truth.slice_axis(Axis(axis), (..n - 1).into()),
                );
                a.iter().zip(b.iter()).map(|(a, b)| f64::from((encoded(*a) - encoded(*b)).abs())).sum::<f64>()
                    / a.len() as f64
            };
            let detail = 500.0 * (steps(1) + steps(2));
            Frame { name, detail, truth: done.truth, capture: done.developed }
        });
        Self(frames.collect(), whole)
    }

    /// A line a frame: name, detail, PSNR and SSIM of the capture, of what the network makes of it.
    pub(crate) fn judged(&self, told: &Told) -> Vec<String> {
        let judge = |frame: &Frame| {
            let input = told.guide.over(frame.capture.view(), self.1, self.1).insert_axis(Axis(0));
            let output = told.network.forward_padded(input.view()).expect("fits");
            let of = |p: ndarray::ArrayView3<'_, f32>| {
                let (psnr, ssim) = (metrics::psnr(p, frame.truth.view()), metrics::ssim(p, frame.truth.view()));
                format!("{psnr:.4},{:.5}", ssim.expect("one size"))
            };
            let capture = of(frame.capture.view());
            format!("{},{:.3},{capture},{}", frame.name, frame.detail, of(output.slice(s![0, .., .., ..])))
        };
        self.0.iter().map(judge).collect()
    }
}

/// Roughly as sRGB encodes it.
fn encoded(linear: f32) -> f32 {
    linear.clamp(0.0, 1.0).powf(1.0 / 2.2)
}

/// Pictures of at least `[rows, columns]`, with their names.
fn pictures([rows, columns]: [usize; 2]) -> Vec<(String, Array3<f32>)> {
    let kinds = [SceneKind::DeadLeaves, SceneKind::Facades, SceneKind::ColorChart];
    let built = kinds.into_iter().flat_map(|kind| [900_001, 900_002].map(|seed| (kind, seed)));
    let mut all: Vec<(String, Array3<f32>)> =
        built.map(|(kind, seed)| (format!("built-in {kind} {seed}"), generate(kind, seed, rows, columns))).collect();
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/photos");
    for folder in ["eval", "train"] {
        let Ok(photos) = Photos::open(&shared.join(folder)) else {
            eprintln!("no photographs in ../shared/data/photos/{folder}: judged without them");
            continue;
        };
        for (i, path) in photos.paths().iter().enumerate() {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            if folder == "eval" || SOFT.contains(&name.as_str()) {
                all.push((format!("photo {name}"), mirrored(&photos.load(i).expect("a photograph"), rows, columns)));
            }
        }
    }
    all
}

/// The picture, continued by its mirror images.
fn mirrored(picture: &Array3<f32>, rows: usize, columns: usize) -> Array3<f32> {
    let (_, h, w) = picture.dim();
    let at = |i: usize, n: usize| if (i / n).is_multiple_of(2) { i % n } else { n - 1 - i % n };
    Array3::from_shape_fn((3, rows, columns), |(c, i, j)| picture[[c, at(i, h), at(j, w)]])
}
