//! Enumerations of the library as values of command-line options.

use clap::ValueEnum;
use clap::builder::PossibleValue;
use fvi_fft::memory::Engine;
use fvi_host::results::trajectory::Format;
use fvi_simulation::simulation::Precision;

/// An enumeration of another crate, as a value of a command-line option.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Choice<T>(pub(super) T);

impl ValueEnum for Choice<Engine> {
    fn value_variants<'a>() -> &'a [Self] {
        &[
            Self(Engine::Direct),
            Self(Engine::BlockFft),
            Self(Engine::RealTime),
            Self(Engine::ExponentialSum),
            Self(Engine::ExponentialSumCore),
            Self(Engine::AnyStep),
        ]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let help = match self.0 {
            Engine::Direct => "The plain sum over a ring of samples",
            Engine::BlockFft => "Block transforms, amortised",
            Engine::RealTime => "Block transforms spread evenly over the steps",
            Engine::ExponentialSum => "A short head and decaying exponentials, in chunks and vector code",
            Engine::ExponentialSumCore => {
                "The same by the core's own memory, a sample at a time: what firmware runs, with its bits"
            }
            Engine::AnyStep => {
                "Exponentials in continuous time: Runge–Kutta quadrature on steps of any length"
            }
        };
        Some(PossibleValue::new(self.0.name()).help(help))
    }
}

impl ValueEnum for Choice<Precision> {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self(Precision::F64), Self(Precision::F32)]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let (name, help) = match self.0 {
            Precision::F64 => ("f64", "Double precision"),
            Precision::F32 => ("f32", "Single precision, the twin of a microcontroller"),
        };
        Some(PossibleValue::new(name).help(help))
    }
}

impl ValueEnum for Choice<Format> {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self(Format::Csv), Self(Format::Npz)]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let (name, help) = match self.0 {
            Format::Csv => ("csv", "trajectory.csv: a row of text for each time"),
            Format::Npz => ("npz", "trajectory.npz: NumPy arrays t, q, p and energy"),
        };
        Some(PossibleValue::new(name).help(help))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_options_take_the_words_of_files() {
        let words = |engine: &Choice<Engine>| engine.to_possible_value().unwrap().get_name().to_owned();
        let options: Vec<String> = Choice::<Engine>::value_variants().iter().map(words).collect();
        assert_eq!(options, Engine::NAMES.map(|(name, _)| name));
    }
}
