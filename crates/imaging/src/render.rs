//! Pictures through a lens.
//!
//! `y(p) = a(p) Σ_n w_n(p) [k_n * s](p)`: the scene `s`, warped by the lens's distortion ([`source`]), is blurred by the kernels of
//! the nodes around every pixel ([`crate::render::blur`]) and multiplied by the relative illumination there ([`light`]). Kernels,
//! distortion and illumination are read from one value, [`isoplanat_optics::psf::Optics`]; a [`mod@plan`] says how finely, [`renderer`] does
//! it and pulls cotangents back. Wide kernels go by coarser cells (`coarse`).
//!
//! ```
//! use isoplanat_imaging::frame::Frame;
//! use isoplanat_imaging::plane::{Plane, Region};
//! use isoplanat_imaging::render::{PlanOptions, Request, plan};
//! use isoplanat_imaging::scene::{SceneKind, generate};
//! use isoplanat_imaging::sensor::{Sensor, spectrum::SpectralDensity};
//! use isoplanat_optics::lens::builtin;
//! use ndarray::Array3;
//!
//! let lens = builtin::lens("cooke_triplet")?;
//! let frame = Frame::centred(48, 32, 0.2)?;
//! // A painted wall at the lens's object distance, a texel a pixel.
//! let texture = generate(SceneKind::Text, 1, 48, 64);
//! let scene = Plane { texture, texels_per_slope: 250.0, axis_texel: [32.0, 24.0], vergence: lens.object_vergence };
//! let density = SpectralDensity::new(&Sensor::generic());
//! let planned = plan(&lens, std::slice::from_ref(&scene), &frame, &density, Request::Psnr(45.0), PlanOptions::default())?;
//! assert!(planned.holds);
//! let (picture, _) = planned.picture::<f32>(&scene, &|_| ())?;
//! assert_eq!(picture.dim(), (3, 32, 48));
//! // A region that can be pulled back: from a cotangent on its pixels to every number of the lens.
//! let region = Region { row: 8, col: 8, rows: 16, cols: 16 };
//! let rendered = planned.renderer.record::<f32>(&scene, 0, region);
//! let (ones, zeros) = (Array3::ones((3, 16, 16)), Array3::zeros((3, 16, 16)));
//! let bar = planned.renderer.vjp(&scene, &rendered, ones.view(), zeros.view(), zeros.view());
//! assert!(planned.renderer.lens_gradient(&lens, &bar).surfaces[0].shape.curvature != 0.0);
//! # Ok::<(), isoplanat_base::error::Error>(())
//! ```

mod bending;
#[doc(hidden)]
pub mod blur;
pub(crate) mod choose;
pub(crate) mod coarse;
pub(crate) mod cost;
mod draft;
mod explain;
#[doc(hidden)]
pub mod gradient_error;
mod inputs;
#[doc(hidden)]
pub mod light;
mod measure;
#[doc(hidden)]
pub mod memory;
#[doc(hidden)]
pub mod needs;
#[doc(hidden)]
pub mod node_grid;
pub(crate) mod nodes;
pub mod plan;
mod planning;
pub(crate) mod probe;
pub mod psf_map;
pub mod renderer;
pub(crate) mod scene_plan;
mod shared;
#[doc(hidden)]
pub mod source;
#[doc(hidden)]
pub mod stands;

pub use bending::Diffraction;
pub use inputs::Seen;
pub use needs::Channels;
pub use plan::{RenderPlan, Settings, frame_of};
pub use planning::{PlanOptions, plan};
#[doc(hidden)]
pub use planning::{enough_diffraction, lacking};
pub use psf_map::{PsfMap, PsfMapRequest, PsfPlaces};
pub use renderer::{Rendered, Renderer};
#[doc(hidden)]
pub use scene_plan::shortfall;
pub use scene_plan::{Request, ScenePlan, Skip};
