//! Lenses, frames and scenes that pictures are judged on.

use std::path::PathBuf;

use isoplanat::imaging::files::read_linear;
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::Plane;
use isoplanat::imaging::render::{PlanOptions, Request, ScenePlan, frame_of, plan};
use isoplanat::imaging::scene::placement::{Placement, Scale};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::{Lens, builtin};
use ndarray::Array3;

/// The three lenses: blurred, fair, sharp.
pub(crate) const LENSES: [&str; 3] = ["two_element", "cooke_triplet", "phone"];

/// A lens, a part of its frame, a scene.
pub(crate) struct Case {
    pub(crate) lens: Lens,
    pub(crate) frame: Frame,
    pub(crate) scene: Plane,
    pub(crate) density: SpectralDensity,
}

impl Case {
    /// The case's plan, from the lens on.
    pub(crate) fn plan(&self, request: Request, explain: bool) -> ScenePlan {
        let scenes = std::slice::from_ref(&self.scene);
        plan(&self.lens, scenes, &self.frame, &self.density, request, PlanOptions { explain, ..PlanOptions::RAYS })
            .expect("plans")
    }

    /// Its scene through a plan.
    pub(crate) fn picture(&self, plan: &ScenePlan) -> Array3<f32> {
        plan.picture(&self.scene, &|_| ()).expect("renders").0
    }
}

/// A part of `name`'s frame of `[columns, rows]` pixels, half way between axis and corner.
pub(crate) fn part(name: &str, [columns, rows]: [usize; 2]) -> (Lens, Frame) {
    let lens = builtin::lens(name).expect("shipped");
    let frame = frame_of(&lens).expect("valid");
    let start = |axis: f64, n: usize, part: usize| {
        let end = if axis < 0.5 * n as f64 { n as f64 } else { 0.0 };
        (0.5 * (axis + end) - 0.5 * part as f64).clamp(0.0, (n - part) as f64).floor()
    };
    let axis = [
        frame.axis_px[0] - start(frame.axis_px[0], frame.columns, columns),
        frame.axis_px[1] - start(frame.axis_px[1], frame.rows, rows),
    ];
    let frame = Frame::centred(columns, rows, frame.pitch_mm).and_then(|f| f.with_axis(axis)).expect("valid");
    (lens, frame)
}

/// `texture` before a part of a lens's frame: a texel a pixel in the middle, middle on middle.
pub(crate) fn place(name: &str, size: [usize; 2], texture: Array3<f32>) -> Case {
    let (lens, frame) = part(name, size);
    let (_, rows, cols) = texture.dim();
    let placement = Placement::centred([rows, cols], &frame, Scale::There(1.0));
    let scene = placement.before(&lens, &frame, texture).expect("light");
    Case { lens, frame, scene, density: SpectralDensity::new(&Sensor::generic()) }
}

/// A built-in scene before a lens.
pub(crate) fn built_in(name: &str, size: [usize; 2]) -> Case {
    place(name, size, generate(SceneKind::Facades, 3, size[1], size[0]))
}

/// Photograph `number` of the evaluation set; `None` where the data folder is absent.
pub(crate) fn photograph(number: usize) -> Option<Array3<f32>> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data/photos/eval");
    let path = root.join(format!("{number:02}.png"));
    path.exists().then(|| read_linear(&path).expect("a photograph"))
}

/// A field of bright points on black, one every 32 texels, as long as the photographs.
pub(crate) fn points() -> Array3<f32> {
    Array3::from_shape_fn((3, 512, 768), |(_, i, j)| if i % 32 == 16 && j % 32 == 16 { 1.0 } else { 0.0 })
}
