//! Results a person looks at: text, tables, drawings, plots, pages. Plain data in, text or pixels out; no physics.
//!
//! [`listing`] prints a prescription with its first-order data, [`library`] many lenses beside each other, [`table`] aligns them, [`columns`] says what a row is to people and to machines. [`drawing`] and [`plot`] make SVG
//! that is readable on light and dark pages, [`atlas`] makes one picture of many kernels, [`html`] binds all of it into
//! one self-contained page, [`sheets`] is a workshop's, [`as_built`] says what tolerances cost, [`demo`] is the page of the demonstration and [`design`] that of a joint design; [`evaluation`] has how good a run is, [`paired`] how much better than another, `drawn` how it stands lenses as built, [`comparison`] many beside each other. [`field`] picks the places along the field
//! that the others show.

pub mod accuracy;
pub mod as_built;
pub mod atlas;
pub mod columns;
pub mod comparison;
pub mod demo;
#[cfg(feature = "train")]
pub mod design;
pub mod drawing;
pub mod drawn;
pub mod evaluation;
pub mod field;
pub mod gradient_accuracy;
pub mod health;
pub mod html;
pub mod kernels;
pub mod lens;
pub mod lens_view;
pub mod library;
pub mod listing;
pub mod measured;
pub mod paired;
#[cfg(feature = "train")]
pub(crate) mod picture_sheet;
pub mod plot;
pub mod residuals;
pub mod sheets;
pub mod svg;
pub mod table;
pub mod verdict;
