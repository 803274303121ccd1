//! The names that a program with a simulation in it needs: `use fvi_host::prelude::*;`.
//!
//! ```
//! use fvi_host::prelude::*;
//! use std::convert::Infallible;
//! use std::sync::atomic::AtomicBool;
//!
//! let pendulum = Scenario::builder([1.0])
//!     .potential("-9.81*cos(q0)")
//!     .damper(Damper::of_order(0.5, [0.3])?)
//!     .position([2.0])
//!     .until(0.01, 20.0)
//!     .build()?;
//! let mut run = Run::of(&pendulum).start()?;
//! let Ok(end) = run.drive(&AtomicBool::new(false), |portion| {
//!     portion.states(|_, state| Ok::<_, Infallible>(assert!(state.position[0] <= 2.0)))
//! });
//! assert_eq!(end, RunEnd::Completed);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub use crate::batch::{Batch, MemberRun};
pub use crate::run::{Portion, Run, RunEnd, RunOptions, RunSummary, run};
pub use fvi_fft::memory::{Engine, Tables};
pub use fvi_fft::quadrature::ConvolutionFamily;
pub use fvi_fft::transfer::TransferFunction;
pub use fvi_scenario::language::InputError;
pub use fvi_scenario::scenario::{
    Action, Damper, Derivative, Direction, Members, Scenario, ScenarioBuilder, Scheme,
};
pub use fvi_simulation::simulation::{GridState, Precision};
