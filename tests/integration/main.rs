//! Tests across modules, in the order of the data flow.

mod adjoints;
mod cli;
mod golden;
mod layering;
mod renderers;
mod support;
