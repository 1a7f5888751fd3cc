//! (to come)

/// Shape.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shape;
