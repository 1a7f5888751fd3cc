//! Tests across modules, in the order of the data flow.

mod golden;
