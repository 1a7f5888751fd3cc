//! Isoplanat designs a camera lens and its reconstruction network together.
//!
//! Light and gradients run along one line of floors, each a crate of its own that is found here under its modules' names; a floor uses only those
//! before it:
//!
//! ```text
//! prescription ─► lens ─► trace ─► psf ─► imaging ─► network ─► loss
//!      ▲                                                          │
//!      └────────── design ◄── adjoints, stage by stage ◄──────────┘
//!                                   imaging ─► capture.dng ─► deploy: RAW ► ONNX ► undistort ► picture
//! ```
//!
//! | here | crate |
//! |---|---|
//! | [`error`], [`atomic`], [`units`], [`math`] | `isoplanat-base` |
//! | [`lens`], [`mod@trace`], [`interchange`], [`mod@optimize`], [`psf`], [`analysis`] | `isoplanat-optics` |
//! | [`imaging`], [`calibrate`] | `isoplanat-imaging` |
//! | [`network`] | `isoplanat-network` (feature `train`), its contract with the camera `isoplanat-card` |
//! | `deploy` | `isoplanat-camera` (feature `deploy`) |
//! | [`report`], [`dataset`], `design` (feature `train`) | this one |
//!
//! What most programs need stands at this crate's root, in the order of the light; everything stays under its floor's path as well.
//!
//! ```
//! use isoplanat::{Frame, Limits, PlanOptions, Problem, Request, SceneKind, Sensor, SpectralDensity, builtin, fill_frame, generate, optimize, plan};
//!
//! // A shipped lens, made better.
//! let lens = builtin::lens("cooke_triplet")?;
//! let found = optimize(&Problem::standard(&lens), Limits { iterations: 10, ..Limits::default() }, &mut |_| true)?;
//! assert!(found.rms_mm[1] < found.rms_mm[0]);
//! // A street seen through it: the cheapest settings that hold 45 dB.
//! let frame = Frame::centred(48, 32, 0.2)?;
//! let scene = fill_frame(&found.lens, &frame, generate(SceneKind::Facades, 1, 64, 96))?;
//! let planned = plan(&found.lens, &[scene.clone()], &frame, &SpectralDensity::new(&Sensor::generic()), Request::Psnr(45.0), PlanOptions::default())?;
//! let (picture, _) = planned.picture::<f32>(&scene, &|_| ())?;
//! assert!(planned.holds && picture.dim() == (3, 32, 48));
//! # Ok::<(), isoplanat::Error>(())
//! ```
//!
//! The folder `examples` holds six short programs on it.
//!
//! | feature | default | adds |
//! |---|---|---|
//! | `train` | yes | training, design, ONNX export: [`network`], `design` |
//! | `deploy` | yes | RAW decoding (LGPL), ONNX inference: `deploy`, the program `isoplanat-camera` |
//! | `calibrate` | yes | chessboards in photographs: [`calibrate`] of pictures |
//! | `cuda`, `wgpu` | no | training on a GPU; `cuda` fetches LLVM while it builds |
//!
//! Units are mm, radians in code, degrees in files (`_deg`), wavelengths in nm in files (`_nm`) and µm in
//! dispersion formulas (`_um`). `z` runs along the light, `+y` is up. Images are `[channel, row, col]` in linear light.

pub use isoplanat_base::{Error, Result, atomic, error, figures, math, refusing, terminal, units};
#[doc(hidden)]
pub use isoplanat_base::{stop, testing, threads};

pub use isoplanat_optics::{analysis, interchange, lens, optimize, psf, trace};

pub use isoplanat_imaging as imaging;
pub use isoplanat_imaging::calibrate;

#[doc(hidden)]
pub mod report;

#[doc(hidden)]
pub mod dataset;

/// The reconstruction network: the contract with the camera without burn; model, training and export behind the feature `train`.
pub mod network {
    pub use isoplanat_card::{self as card, Blocks};
    #[cfg(feature = "train")]
    pub use isoplanat_network::*;
}

#[cfg(feature = "train")]
pub mod design;

#[cfg(feature = "deploy")]
pub use isoplanat_camera as deploy;

// The front door, in the order of the light.

// Lenses as numbers.
pub use isoplanat_optics::lens::catalogue::Glasses;
pub use isoplanat_optics::lens::paraxial::first_order;
pub use isoplanat_optics::lens::{Lens, LensGradient, Parameter, Prescription, Surface, builtin};

// Lens files.
pub use isoplanat_optics::interchange::{Imported, lens_or_file};

// Rays through them.
pub use isoplanat_optics::trace::aim::Aimer;
pub use isoplanat_optics::trace::sequential::{HitBar, trace, trace_vjp};
pub use isoplanat_optics::trace::{ObjectPoint, Ray, System, SystemGradient};

// Better lenses.
pub use isoplanat_optics::optimize::{Limits, Merit, Outcome, Problem, optimize};

// Point spread functions.
pub use isoplanat_optics::psf::Optics;
pub use report::atlas::KernelSet;
pub use report::kernels::KernelRequest;

// Sensors.
pub use isoplanat_imaging::frame::Frame;
pub use isoplanat_imaging::plane::{Plane, Region};
pub use isoplanat_imaging::sensor::Sensor;
pub use isoplanat_imaging::sensor::spectrum::SpectralDensity;

// Scenes and pictures of them.
pub use isoplanat_imaging::capture::{CaptureSettings, capture};
pub use isoplanat_imaging::files::{Encoding, read_linear, write_picture};
pub use isoplanat_imaging::render::{Diffraction, PlanOptions, Renderer, Request, Settings, frame_of, plan};
pub use isoplanat_imaging::scene::{SceneKind, fill_frame, generate};

// Captures, and what pictures are worth.
pub use isoplanat_imaging::dng::{DngInfo, write_dng};
pub use isoplanat_imaging::metrics::{psnr_linear, ssim};

// Networks.
#[cfg(feature = "train")]
pub use isoplanat_network::{Reconstructor, UnetConfig};

// Lens and network designed together.
#[cfg(feature = "train")]
pub use design::{opened::Run, subject::Subject, task::Task};

// The camera side.
#[cfg(feature = "deploy")]
pub use isoplanat_camera::{
    kit::{Kit, LensEntry},
    raw::{RawCapture, decode},
    reconstruct::Camera,
};

/// The arrays that pictures and kernels are.
pub use ndarray;

/// The vectors that rays are made of.
pub use glam;
