//! The picture of a whole frame: what a scene needs is decided first, and only that is computed.
//!
//! [`settings`] says how finely each approximation is made, [`source`] samples the warped scene, [`bank`] makes a node's
//! kernels, [`nodes`] places the nodes by measured interpolation error, [`probe`] measures what every setting costs in
//! error at a few places of the scene itself, [`choose`] takes the cheapest that holds, [`plan`] leaves out what the scene
//! does not need and says so, [`render`] does the rest.

pub mod bank;
pub mod choose;
pub mod cost;
mod explain;
pub mod needs;
pub mod nodes;
pub mod plan;
pub mod probe;
pub mod render;
pub mod settings;
pub mod source;
