//! The keys of the tables for the integration of a system.

/// Keys of `[initial]`.
pub(super) const INITIAL: [&str; 5] = ["position", "momentum", "velocity", "past", "project"];

/// Keys of `[history]`.
pub(super) const HISTORY: [&str; 7] =
    ["engine", "tolerance", "horizon", "capacity", "overflow", "states", "threads"];

/// Keys of `[output]`.
pub(super) const OUTPUT: [&str; 9] =
    ["every", "momentum", "coordinates", "snapshots", "times", "memory_energy", "labels", "units", "picture"];

/// Keys of `output.units`.
pub(super) const UNITS: [&str; 4] = ["time", "position", "momentum", "energy"];

/// Keys of `output.picture`.
pub(super) const PICTURE: [&str; 3] = ["width", "height", "font"];

/// Keys of `[scheme]`, for all kinds.
const SCHEME: [&str; 6] = ["kind", "kappa", "degree", "quadrature", "points", "tolerance"];

/// Keys of `[convolution]`, for all families.
const CONVOLUTION: [&str; 6] = ["family", "symbol", "order", "stages", "at", "starting"];

/// Keys of `[time]`, for all grids.
const TIME: [&str; 16] = [
    "grid",
    "start",
    "step",
    "steps",
    "end",
    "must_hit",
    "allow_unstable",
    "energy_guard",
    "exponent",
    "first",
    "ratio",
    "longest",
    "shortest",
    "tolerance",
    "scale",
    "points",
];

/// The tables by name, each with its keys.
pub const KEYS: [(&str, &[&str]); 6] = [
    ("initial", &INITIAL),
    ("scheme", &SCHEME),
    ("convolution", &CONVOLUTION),
    ("history", &HISTORY),
    ("time", &TIME),
    ("output", &OUTPUT),
];
