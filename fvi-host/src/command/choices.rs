//! Words of the library that options of the command line take.

use crate::results::trajectory::Format;
use crate::scenario::Engine;
use crate::simulation::Precision;
use clap::ValueEnum;
use clap::builder::PossibleValue;

impl ValueEnum for Engine {
    fn value_variants<'a>() -> &'a [Self] {
        &[
            Self::Direct,
            Self::BlockFft,
            Self::RealTime,
            Self::ExponentialSum,
            Self::ExponentialSumCore,
            Self::AnyStep,
        ]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let help = match self {
            Self::Direct => "The plain sum over a ring of samples",
            Self::BlockFft => "Block transforms, amortised",
            Self::RealTime => "Block transforms spread evenly over the steps",
            Self::ExponentialSum => "A short head and decaying exponentials, in chunks and vector code",
            Self::ExponentialSumCore => {
                "The same by the core's own memory, a sample at a time: what firmware runs, with its bits"
            }
            Self::AnyStep => "Exponentials in continuous time: Runge–Kutta quadrature on steps of any length",
        };
        Some(PossibleValue::new(self.name()).help(help))
    }
}

impl ValueEnum for Precision {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::F64, Self::F32]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let (name, help) = match self {
            Self::F64 => ("f64", "Double precision"),
            Self::F32 => ("f32", "Single precision, the twin of a microcontroller"),
        };
        Some(PossibleValue::new(name).help(help))
    }
}

impl ValueEnum for Format {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::Csv, Self::Npz]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let (name, help) = match self {
            Self::Csv => ("csv", "trajectory.csv: a row of text for each time"),
            Self::Npz => ("npz", "trajectory.npz: NumPy arrays t, q, p and energy"),
        };
        Some(PossibleValue::new(name).help(help))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_options_take_the_words_of_files() {
        let words = |engine: &Engine| engine.to_possible_value().unwrap().get_name().to_owned();
        let options: Vec<String> = Engine::value_variants().iter().map(words).collect();
        assert_eq!(options, Engine::NAMES.map(|(name, _)| name));
    }
}
