//! Data sets: pairs of capture and truth of many lenses and photographs, for networks that are trained elsewhere.
//!
//! [`make`] fills a folder as [`Settings`] say. A pair is numbered: lens after lens, distance after distance, photograph after photograph, crop after
//! crop, and depends on the settings and its number alone. So work can be split ([`Part`]) and gone on with after a kill, and the bits are the same.
//!
//! To read: `settings` (what is asked for), `layout` (numbers, files, parts), `stage` (a lens at a distance, planned once), `pair` (one capture and
//! its truth), `judge` (rays), `form`, `write` (files), `folder`, `record` (what is whole, `pairs.csv`), `work` (all of it).

mod folder;
mod form;
mod judge;
mod layout;
mod pair;
mod record;
mod settings;
mod stage;
mod work;
mod write;

pub use folder::MARKER;
pub use form::Form;
pub use pair::Exposure;
pub use record::{COLUMNS, Judged, Row};
pub use settings::{Crops, Judging, Part, Settings};
pub use work::{Made, Planned, make};
