//! Finite responses and an endless stream: partitions planned by a cost model, work spread over the samples.

mod convolver;
mod error;
mod history;
mod near;
mod partition;
mod prepared;
mod responses;
mod stage;

pub use convolver::{Convolver, Exchanged};
pub use error::{ExchangeError, StreamError};
pub use partition::Stream;
pub use prepared::{PreparedResponses, Preparer};
pub use responses::Responses;
