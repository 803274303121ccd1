//! Closed forms of the linearised system: receptances and moduli over frequencies, creep and relaxation over
//! time.

use super::data::{Answer, Observed, Over};
use super::no_prediction::NoPrediction;
use fvi_core::{Instant, Mechanics};
use fvi_fft::transfer::TransferFunction;
use fvi_fft::transfer::laplace::{on_a_line, on_talbots_contour, relaxation, whole};
use fvi_scenario::scenario::Scenario;
use fvi_simulation::model::{Matrix, Model as System};
use fvi_simulation::simulation::response::Linearised;
use nalgebra::{Complex, DMatrix};

/// What is asked of a system, prepared for all frequencies or times.
pub(super) enum Closed<'s> {
    /// H(ω) of these coordinates, times (iω)ⁿ.
    Receptance { linearised: Box<Linearised>, input: usize, output: usize, derivative: u8 },
    /// K(s) = spring + Σ ρ_m (K_m(s) − K_m(0)): the spring, with those of kernels, and the terms.
    Modulus { spring: f64, terms: Vec<(f64, &'s TransferFunction)> },
}

impl<'s> Closed<'s> {
    pub(super) fn new(
        scenario: &'s Scenario,
        answer: Answer,
        position: &[f64],
    ) -> Result<Self, NoPrediction> {
        Ok(match answer {
            Answer::Receptance { input, output, derivative } => {
                let linearised = Box::new(Linearised::new(scenario, position)?);
                Self::Receptance { linearised, input, output, derivative }
            }
            Answer::Kernel { term } => {
                let Some(term) = scenario.system.damping.get(term) else {
                    return Err(NoPrediction::Refused(format!("there is no damping term {term}")));
                };
                Self::Modulus { spring: term.transfer.spring(), terms: vec![(1.0, &term.transfer)] }
            }
            Answer::Modulus { input, output } => {
                let stiffness = static_stiffness(scenario, position)?;
                let entry = |term: &'s fvi_scenario::scenario::Damping| {
                    let entries = fvi_simulation::model::matrix::<f64>(&term.coefficient).entries();
                    let here =
                        entries.into_iter().filter(|&(row, column, _)| (row, column) == (output, input));
                    (here.map(|(.., entry)| entry).sum::<f64>(), &term.transfer)
                };
                let terms = scenario.system.damping.iter().map(entry).collect();
                Self::Modulus { spring: stiffness[(output, input)], terms }
            }
        })
    }

    /// Writes the values of columns at a frequency or a time.
    pub(super) fn write(
        &self,
        over: Over,
        place: f64,
        columns: impl Iterator<Item = Observed>,
        into: &mut [f64],
    ) -> Result<(), NoPrediction> {
        let value = match over {
            Over::Frequency => self.at(place)?,
            Over::Time => Complex::ZERO,
        };
        for (what, into) in columns.zip(into) {
            *into = match what {
                Observed::Real => value.re,
                Observed::Imaginary => value.im,
                Observed::Magnitude => value.re.hypot(value.im),
                Observed::Decibels => 20.0 * libm::log10(value.re.hypot(value.im)),
                Observed::LossFactor => value.im / value.re,
                Observed::Relaxation => self.relaxation(place)?,
                Observed::Creep => self.creep(place)?,
                Observed::Position(_)
                | Observed::Momentum(_)
                | Observed::Velocity(_)
                | Observed::Acceleration(_)
                | Observed::Energy => {
                    let said = "a closed form has no states of a motion: responses and moduli alone";
                    return Err(NoPrediction::Refused(said.to_owned()));
                }
            };
        }
        Ok(())
    }

    fn at(&self, omega: f64) -> Result<Complex<f64>, NoPrediction> {
        let s = Complex::new(0.0, omega);
        match self {
            Self::Receptance { linearised, input, output, derivative } => {
                let answer = linearised.response(omega, *input).map_err(NoPrediction::Refused)?[*output];
                Ok((0..*derivative).fold(answer, |answer, _| answer * s))
            }
            Self::Modulus { .. } => Ok(self.modulus(s)),
        }
    }

    fn modulus(&self, s: Complex<f64>) -> Complex<f64> {
        let Self::Modulus { spring, terms } = self else { return Complex::ZERO };
        // A kernel's spring is already part of the stiffness.
        let term =
            |(entry, transfer): &(f64, &TransferFunction)| (whole(transfer, s) - transfer.spring()) * *entry;
        terms.iter().map(term).sum::<Complex<f64>>() + *spring
    }

    /// The terms, if each has a relaxation function.
    fn passive_terms(&self) -> Result<&[(f64, &'s TransferFunction)], NoPrediction> {
        let Self::Modulus { terms, .. } = self else { return Ok(&[]) };
        let is_without =
            |transfer: &TransferFunction| transfer.active().is_some() || transfer.table().is_some();
        match terms.iter().position(|(_, transfer)| is_without(transfer)) {
            Some(term) => Err(NoPrediction::Refused(format!(
                "system.damping[{term}]: neither creep nor relaxation are computed of a kernel of weights or one that is not passive"
            ))),
            None => Ok(terms),
        }
    }

    fn relaxation(&self, time: f64) -> Result<f64, NoPrediction> {
        let terms = self.passive_terms()?;
        let Self::Modulus { spring, .. } = self else { return Ok(f64::NAN) };
        let of = |(entry, transfer): &(f64, &TransferFunction)| -> Result<f64, NoPrediction> {
            let own = relaxation(transfer, time).ok_or_else(|| {
                NoPrediction::Refused(format!("the relaxation of a kernel at t = {time} is not finite"))
            })?;
            Ok(entry * (own - transfer.spring()))
        };
        terms.iter().try_fold(*spring, |sum, term| Ok(sum + of(term)?))
    }

    fn creep(&self, time: f64) -> Result<f64, NoPrediction> {
        let on_the_axis = self.passive_terms()?.iter().all(|(_, transfer)| transfer.is_relaxation());
        let image = |s: Complex<f64>| (s * self.modulus(s)).inv();
        let creep = if on_the_axis { on_talbots_contour(time, image) } else { on_a_line(time, image) };
        if creep.is_finite() {
            return Ok(creep);
        }
        Err(NoPrediction::Refused(format!("the creep at t = {time} is not finite")))
    }
}

/// K = ∂²U/∂q² − ∂F/∂q at t = 0, with the springs of kernels.
fn static_stiffness(scenario: &Scenario, position: &[f64]) -> Result<DMatrix<f64>, NoPrediction> {
    if scenario.system.has_forces_of_velocity() {
        return Err(NoPrediction::Refused(
            "system.force: a modulus of a system with forces of the velocity, which it leaves out; linear damping is \
             `[[system.damping]]` with `order` = 1"
                .to_owned(),
        ));
    }
    if scenario.system.gyroscopic.is_some() {
        return Err(NoPrediction::Refused(
            "system.gyroscopic: a modulus of a system with gyroscopic forces, which it leaves out; give the \
             modulus by a scenario without them"
                .to_owned(),
        ));
    }
    if scenario.system.is_mechanism() {
        return Err(NoPrediction::Refused(
            "system: a modulus of a mechanism, whose springs and dampers act along its elongations; a receptance              (`input`, `output`) is that of the mechanism at rest"
                .to_owned(),
        ));
    }
    let size = scenario.coordinates();
    let mut system =
        System::<f64>::new(scenario).map_err(|error| NoPrediction::Refused(error.to_string()))?;
    let mut stiffness = system.stiffness();
    let mut pull = vec![0.0; size];
    system.linearise(Instant::in_step(0.0, 0.5, 0.0), &position.to_vec(), &mut pull, &mut stiffness);
    let mut dense = DMatrix::zeros(size, size);
    for (row, column, entry) in Matrix::entries(&stiffness) {
        dense[(row, column)] = entry;
    }
    Ok(dense)
}
