//! The figures and tables of the papers, computed again and set beside the printed values.
//!
//! An [`Exhibit`] is one figure or table: a name, where it is printed, and the function that computes its
//! [`Findings`]. [`exhibits`] lists them all. [`write()`] turns findings into pictures, CSV files and a page
//! with comparisons.

mod accuracy;
mod any_length;
mod automatic;
mod equations;
mod error_curve;
mod exact_oscillator;
mod findings;
mod hjo;
mod jo;
mod materials;
mod methods;
mod motion;
mod node_form;
mod page;
mod podlubny_matrix;
mod problems;
mod roots_of_time;
mod runge_kutta_orders;
mod table;
mod tuning;
mod work_precision;

pub use error_curve::ErrorCurve;
pub use findings::{Comparison, Findings, Picture};
pub use page::{PAGE, write};
pub use table::{Cell, Column, Format, Table};

use fvi_core::ParameterError;
use fvi_host::converge::ConvergeError;
use fvi_scenario::language::InputError;
use std::sync::atomic::AtomicBool;

/// Where an exhibit is printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// In a paper.
    Printed {
        /// Its key in `REFERENCES.md`, such as `HJO`.
        paper: &'static str,
        /// Figure or table, such as `Table 1`.
        number: &'static str,
    },
    /// Nowhere: a measurement that goes beyond the papers.
    Beyond,
}

/// A figure or table that can be computed again.
#[derive(Clone, Copy, Debug)]
pub struct Exhibit {
    /// Its name on the command line and at the head of its files' names, such as `hjo-table-1`.
    pub name: &'static str,
    /// Where it is printed.
    pub origin: Origin,
    /// Caption.
    pub title: &'static str,
    /// Computes it; the flag ends the computation early with [`ReproduceError::Stopped`].
    pub compute: Compute,
    /// Name of the page that it is on.
    pub page: &'static str,
}

/// Computes the findings of an exhibit.
type Compute = fn(&AtomicBool) -> Result<Findings, ReproduceError>;

impl Exhibit {
    const fn printed(
        paper: &'static str,
        name: &'static str,
        number: &'static str,
        title: &'static str,
        compute: Compute,
    ) -> Self {
        Self { name, origin: Origin::Printed { paper, number }, title, compute, page: PAGE }
    }

    const fn beyond(name: &'static str, title: &'static str, compute: Compute) -> Self {
        Self { name, origin: Origin::Beyond, title, compute, page: PAGE }
    }

    /// The exhibit on a page of another name.
    const fn on_page(mut self, page: &'static str) -> Self {
        self.page = page;
        self
    }

    /// Where it is printed and what it shows, in one line.
    pub fn heading(&self) -> String {
        match self.origin {
            Origin::Printed { paper, number } => format!("[{paper}] {number}: {}", self.title),
            Origin::Beyond => format!("Beyond the papers: {}", self.title),
        }
    }
}

/// Why an exhibit could not be computed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReproduceError {
    /// A scenario of the exhibit cannot be run.
    #[error(transparent)]
    Scenario(#[from] InputError),
    /// Errors over step sizes could not be measured.
    #[error("{0}")]
    Converge(ConvergeError),
    /// A parameter is outside its range.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// A step of a run failed.
    #[error("{reason}")]
    Run {
        /// Which step, and why.
        reason: String,
    },
    /// It was stopped.
    #[error("stopped")]
    Stopped,
}

impl From<ConvergeError> for ReproduceError {
    fn from(error: ConvergeError) -> Self {
        match error {
            ConvergeError::Stopped => Self::Stopped,
            ConvergeError::Input(error) => Self::Scenario(error),
            other => Self::Converge(other),
        }
    }
}

/// All exhibits, in the order of the page.
pub fn exhibits() -> Vec<Exhibit> {
    [
        jo::EXHIBITS.as_slice(),
        hjo::EXHIBITS.as_slice(),
        node_form::EXHIBITS.as_slice(),
        roots_of_time::EXHIBITS.as_slice(),
        runge_kutta_orders::EXHIBITS.as_slice(),
        work_precision::EXHIBITS.as_slice(),
        any_length::EXHIBITS.as_slice(),
        tuning::EXHIBITS.as_slice(),
        accuracy::EXHIBITS.as_slice(),
        materials::EXHIBITS.as_slice(),
        equations::EXHIBITS.as_slice(),
        automatic::EXHIBITS.as_slice(),
    ]
    .concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_say_where_the_exhibit_is_printed() {
        let exhibits = exhibits();
        let mut names: Vec<&str> = exhibits.iter().map(|exhibit| exhibit.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), exhibits.len());
        for exhibit in exhibits {
            let Origin::Printed { paper, number } = exhibit.origin else { continue };
            let printed = format!("{paper} {number}").to_lowercase().replace(". ", "-").replace(' ', "-");
            assert_eq!(exhibit.name, printed);
        }
    }
}
