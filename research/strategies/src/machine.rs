//! Description of the machine on which times are measured.

use serde::{Deserialize, Serialize};

/// Machine and compiler, on which times depend.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// The processor, as the system names it.
    pub processor: String,
    /// Threads that can run at the same time.
    pub threads: usize,
    /// The vector units that the memories use.
    pub vector_units: String,
    /// System and architecture.
    pub system: String,
    /// Compiler, and level of optimisation.
    pub compiler: String,
    /// Version of this library.
    pub version: String,
}

impl Machine {
    /// The current machine.
    pub fn here() -> Self {
        let processors = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let model = processors.lines().find_map(|line| line.strip_prefix("model name"));
        let model = model.map(|rest| rest.trim_start_matches([' ', '\t', ':']).trim().to_owned());
        Self {
            processor: model.unwrap_or_else(|| "unknown processor".to_owned()),
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            vector_units: fvi_fft::vector_units().to_owned(),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            compiler: format!("{}, optimisation {}", env!("COMPILER"), env!("OPTIMISATION")),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        }
    }
}
