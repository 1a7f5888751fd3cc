//! Nothing: the targets are the tests.
