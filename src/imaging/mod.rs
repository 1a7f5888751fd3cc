//! From scene to RAW, and the pixel-domain tools both sides share.
//!
//! Images are `ndarray::Array3` `[channel, row, col]`, linear light, channel 0 = R, 1 = G, 2 = B.

pub mod blur;
pub mod cfa;
pub mod color;
pub mod demosaic;
pub mod develop;
pub mod distortion;
pub mod dng;
pub mod expose;
pub mod files;
pub mod frame;
pub mod haze;
pub mod illuminant;
pub mod metrics;
pub mod monte_carlo;
pub mod ms_ssim;
pub mod node_grid;
pub mod noise;
pub mod render;
pub mod scene;
pub mod sensor;
pub mod shading;
pub mod simulate;
pub mod spectrum;
pub mod undistort;
pub mod warp;
pub mod white;
pub mod wiener;
