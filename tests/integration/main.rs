//! Tests across modules, in the order of the data flow.

mod adjoints;
mod bending;
mod calibrate;
#[cfg(feature = "deploy")]
mod calibrate_sensor;
#[cfg(feature = "deploy")]
mod camera;
#[cfg(feature = "deploy")]
mod children;
mod cli;
mod command_line;
mod commands;
#[cfg(feature = "train")]
mod comparing;
#[cfg(all(target_os = "linux", feature = "train", feature = "deploy"))]
mod costs;
mod dataset;
#[cfg(feature = "train")]
mod designing;
mod diffraction;
#[cfg(all(unix, feature = "train", feature = "deploy", feature = "calibrate"))]
mod documents;
mod examples;
mod extremes;
mod fast_lenses;
#[cfg(all(target_os = "linux", feature = "train", feature = "deploy"))]
mod faults;
mod from_scratch;
#[cfg(all(feature = "train", feature = "deploy"))]
mod fuzz_corpus;
#[cfg(feature = "deploy")]
mod glare;
mod golden;
mod gradients;
#[cfg(all(feature = "train", feature = "deploy"))]
mod guided;
mod hostile;
mod kernel_edges;
mod lens_files;
mod lenses;
mod library;
#[cfg(all(unix, feature = "train", feature = "deploy", feature = "calibrate"))]
#[path = "../structure/manual.rs"]
mod manual;
#[cfg(all(feature = "train", feature = "deploy", feature = "calibrate"))]
mod measured_lens;
mod memory;
mod one_way;
mod optimize;
mod outputs;
#[cfg(all(feature = "train", feature = "deploy"))]
mod parity;
mod picture;
mod prescriptions;
mod properties;
mod psf_forms;
#[cfg(unix)]
mod random_lenses;
mod refusals;
mod renderers;
mod report;
#[cfg(all(feature = "train", feature = "deploy"))]
mod runs;
mod sheets;
mod skips;
mod slanted_edge;
mod stiff;
mod support;
#[cfg(target_os = "linux")]
mod threads;
mod throughput;
mod tolerance;
#[cfg(feature = "train")]
mod training;
mod view;
mod view_hostile;
mod vignetting;
mod white;
mod white_axis;
mod white_oracle;
mod windows;
mod zemax_database;
mod zemax_files;
