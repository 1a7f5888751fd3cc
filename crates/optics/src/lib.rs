//! Lenses without pictures and networks: prescriptions, rays and their adjoints, lens files of other programs, damped least squares, point spread functions,
//! analyses.
//!
//! In the order of the light, each module uses only those before it: [`lens`] (numbers, checked), [`trace`] (rays through them), [`interchange`] (files of
//! other programs), [`optimize`], [`psf`] (a lens as image formation reads it), [`analysis`]. Units are mm, radians in code, degrees in files (`_deg`),
//! wavelengths nm in files (`_nm`) and µm in dispersion formulas (`_um`); `z` runs along the light, `+y` is up.

pub mod lens;

pub mod trace;

pub mod interchange;

pub mod optimize;

pub mod psf;

pub mod analysis;
