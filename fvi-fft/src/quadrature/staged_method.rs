//! The Runge–Kutta methods of convolution quadrature by family and number of stages, known at run time.

/// A method of one of the families. Family and number of stages are converted to a
/// [`RungeKutta`](fvi_core::RungeKutta) only by [`with_staged_method!`](crate::with_staged_method).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StagedMethod {
    /// Radau IIA of 1, 2, 3, 5 or 7 stages R, of order 2R − 1, L-stable.
    RadauIia(usize),
    /// Lobatto IIIC of 2 to 4 stages R, of order 2R − 2, L-stable.
    LobattoIiic(usize),
}

impl StagedMethod {
    /// The numbers of stages of Radau IIA.
    pub const STAGES_OF_RADAU_IIA: [usize; 5] = [1, 2, 3, 5, 7];

    /// Number of stages R.
    pub fn stages(self) -> usize {
        match self {
            Self::RadauIia(stages) | Self::LobattoIiic(stages) => stages,
        }
    }

    /// Order of the method, and of its convolution quadrature on smooth signals.
    pub fn order(self) -> usize {
        match self {
            Self::RadauIia(stages) => 2 * stages - 1,
            Self::LobattoIiic(stages) => 2 * stages - 2,
        }
    }

    /// Order of the values at its stages.
    pub fn stage_order(self) -> usize {
        match self {
            Self::RadauIia(stages) => stages,
            Self::LobattoIiic(stages) => stages - 1,
        }
    }

    /// The family's name in headings and tables.
    pub fn family(self) -> &'static str {
        match self {
            Self::RadauIia(_) => "Radau IIA",
            Self::LobattoIiic(_) => "Lobatto IIIC",
        }
    }

    /// The error for a number of stages that does not exist in the family.
    pub fn unknown(self) -> fvi_core::ParameterError {
        let allowed = match self {
            Self::RadauIia(_) => "1, 2, 3, 5 or 7 with the family radau-iia",
            Self::LobattoIiic(_) => "2, 3 or 4 with the family lobatto-iiic",
        };
        fvi_core::ParameterError { parameter: "stages", value: self.stages() as f64, allowed }
    }
}

/// Evaluates an expression with the `RungeKutta<R>` of a [`StagedMethod`](crate::quadrature::StagedMethod),
/// where R is known at compile time: `with_staged_method!(staged, method => stages_of(&method))`.
///
/// Returns a `Result`, an error if the family has no method with that number of stages. The crate that calls
/// it must
/// depend on `fvi_core`.
#[macro_export]
macro_rules! with_staged_method {
    ($staged:expr, $method:ident => $value:expr) => {{
        use ::fvi_core::RungeKutta;
        use $crate::quadrature::StagedMethod;
        match $staged {
            StagedMethod::RadauIia(1) => RungeKutta::<1>::radau_iia().map(|$method| $value),
            StagedMethod::RadauIia(2) => RungeKutta::<2>::radau_iia().map(|$method| $value),
            StagedMethod::RadauIia(3) => RungeKutta::<3>::radau_iia().map(|$method| $value),
            StagedMethod::RadauIia(5) => RungeKutta::<5>::radau_iia().map(|$method| $value),
            StagedMethod::RadauIia(7) => RungeKutta::<7>::radau_iia().map(|$method| $value),
            StagedMethod::LobattoIiic(2) => RungeKutta::<2>::lobatto_iiic().map(|$method| $value),
            StagedMethod::LobattoIiic(3) => RungeKutta::<3>::lobatto_iiic().map(|$method| $value),
            StagedMethod::LobattoIiic(4) => RungeKutta::<4>::lobatto_iiic().map(|$method| $value),
            unknown => Err(unknown.unknown()),
        }
    }};
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_have_the_stages_they_are_asked_for_and_others_are_refused() {
        for stages in 0..=9 {
            let families: [(_, &[usize]); 2] = [
                (StagedMethod::RadauIia(stages), &StagedMethod::STAGES_OF_RADAU_IIA),
                (StagedMethod::LobattoIiic(stages), &[2, 3, 4]),
            ];
            for (staged, allowed) in families {
                let found = with_staged_method!(staged, method => method.quadrature().nodes().len());
                match allowed.contains(&stages) {
                    true => assert_eq!(found, Ok(stages), "{staged:?}"),
                    false => assert_eq!(found.unwrap_err().value, stages as f64, "{staged:?}"),
                }
            }
        }
    }
}
