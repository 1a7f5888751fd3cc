//! Pictures through a lens.
//!
//! `y(p) = a(p) Σ_n w_n(p) [k_n * s](p)`: the scene `s`, warped by the lens's distortion ([`source`]), is blurred by the kernels of
//! the nodes around every pixel ([`crate::imaging::render::blur`]) and multiplied by the relative illumination there ([`light`]). Kernels,
//! distortion and illumination are read from one value, [`crate::psf::Optics`]; a [`mod@plan`] says how finely, [`renderer`] does
//! it and pulls cotangents back. Wide kernels go by coarser cells ([`coarse`]).

pub mod blur;
pub mod choose;
pub mod coarse;
pub mod cost;
mod draft;
mod explain;
pub mod gradient_error;
mod inputs;
pub mod light;
mod measure;
pub mod memory;
pub mod needs;
pub mod node_grid;
pub mod nodes;
pub mod plan;
mod planning;
pub mod probe;
pub mod renderer;
pub mod scene_plan;
pub mod source;
pub mod stands;

pub use inputs::Seen;
pub use needs::Channels;
pub use plan::{RenderPlan, Settings, frame_of};
pub use planning::plan;
pub use renderer::{Rendered, Renderer};
pub use scene_plan::{Request, ScenePlan, Skip};
