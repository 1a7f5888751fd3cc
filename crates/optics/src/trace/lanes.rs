//! The fast trace: many rays at once, the same rays as [`crate::trace::sequential`].
//!
//! Rays lie as structure of arrays in tiles of [`TILE`] that stay in cache through all surfaces; the kernels of
//! `forward.rs` and `adjoint.rs` run on explicit lanes of the instruction set that the processor has ([`Level`]). Planes,
//! spheres, conics and even aspheres in their nominal places go through lanes; other surfaces, and single rays for which
//! the lanes' root is not certainly the first (slopes, then `prove.rs`), go ray by ray through the plain trace. Whatever the instruction set, the
//! result agrees with the plain trace to 1e-12 mm and 1e-13 in direction; tests hold it. Results do not depend on the
//! number of threads; between instruction sets they differ by rounding.

mod adjoint;
mod batch;
mod bends;
mod dispatch;
mod forward;
mod gradient;
mod mend;
mod program;
mod prove;
mod rows;
mod run;
mod terms;
#[cfg(test)]
mod tests;
mod tile;
mod vector;

pub use batch::{GROUPS, trace_batch};
pub use gradient::{LaunchBars, trace_gradient};
pub use isoplanat_base::math::simd::Level;
pub use program::{Options, Program, index_ratios};
pub use rows::{Number, Rows};
pub use tile::{Bundle, Rays, Status, TILE, Tile};
