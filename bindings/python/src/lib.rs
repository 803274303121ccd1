//! The compiled part of the Python package `fvi`: the interface between Rust and Python.
//!
//! Python code in `python/fvi` checks arguments and formats results; this module calls fvi-host. Panics
//! become exceptions.

mod batch;
mod controller;
mod convolver;
mod derivative;
mod documents;
mod engines;
mod errors;
mod exponentials;
mod fit;
mod gradient;
mod loads;
mod memory;
mod native;
mod response;
mod run;
mod studies;
mod sweep;
mod terms;
mod tune;
mod velocities;
mod watch;
mod weights;

use pyo3::prelude::*;

#[pymodule(gil_used = false)]
mod _fvi {
    #[pymodule_export]
    use super::batch::Batch;
    #[pymodule_export]
    use super::controller::FractionalPid;
    #[pymodule_export]
    use super::convolver::Convolver;
    #[pymodule_export]
    use super::derivative::derivative;
    #[pymodule_export]
    use super::engines::{Memory, Operator};
    #[pymodule_export]
    use super::exponentials::exponentials;
    #[pymodule_export]
    use super::fit::fit;
    #[pymodule_export]
    use super::gradient::{Recording, record};
    #[pymodule_export]
    use super::loads::Loads;
    #[pymodule_export]
    use super::memory::kernel_facts;
    #[pymodule_export]
    use super::response::response;
    #[pymodule_export]
    use super::run::{Prepared, Record, RunSnapshot, past_nodes, run, run_in};
    #[pymodule_export]
    use super::studies::{compare_engines, converge, extremal};
    #[pymodule_export]
    use super::sweep::{Ledger, Sweep, vector_units};
    #[pymodule_export]
    use super::tune::tune;
    #[pymodule_export]
    use super::velocities::velocities;
    #[pymodule_export]
    use super::weights::weights;
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("KEYS", fvi_scenario::scenario::KEYS.map(|(table, keys)| (table, keys.to_vec())))?;
        module.add("DATA_KEYS", fvi_host::fit::DATA_KEYS)?;
        #[cfg(debug_assertions)]
        module.setattr("_panic", wrap_pyfunction!(super::errors::_panic, module)?)?;
        Ok(())
    }
}
