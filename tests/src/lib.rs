//! Shared problems and measures of the cross-crate tests.
