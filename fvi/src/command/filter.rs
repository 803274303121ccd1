//! `fvi filter`: rational filters of the literature for s^β over a band.

use super::CommandError;
use super::listing::{emit, parameter_error};
use fvi_fft::exponentials::band_filter::{BandFilter, Design};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Arguments of `fvi filter`.
#[derive(Debug, clap::Args)]
pub(crate) struct FilterArguments {
    /// Which filter
    #[arg(long, value_enum)]
    design: Name,
    /// β of s^β, between -1 and 1
    #[arg(long, allow_negative_numbers = true)]
    exponent: f64,
    /// Sampling time
    #[arg(long)]
    step: f64,
    /// Lowest and highest frequency, in Hz for a sampling time in seconds
    #[arg(long, num_args = 2, value_names = ["LOW", "HIGH"], required = true)]
    band: Vec<f64>,
    /// Number of poles
    #[arg(long)]
    order: usize,
    /// What is listed, with 17 significant digits
    #[arg(long, value_enum, default_value_t)]
    form: Form,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Designs by their names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Name {
    /// Corners in geometric sequence
    Oustaloup,
    /// Continued fraction through the magnitudes at frequencies in geometric sequence
    Matsuda,
}

/// What is listed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum Form {
    /// Zeros and poles in rad/s, the gain in the first row of its column
    Poles,
    /// Sections of first order by Tustin's rule, one after the other: y_k = b0 x_k + b1 x_{k-1} - a1 y_{k-1}
    #[default]
    Sections,
    /// One difference equation, y_k = sum b_n x_{k-n} - sum_{n>0} a_n y_{k-n}; H(z) = sum b_n z^-n/sum a_n z^-n
    Transfer,
}

impl FilterArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let design = match self.design {
            Name::Oustaloup => Design::Oustaloup,
            Name::Matsuda => Design::Matsuda,
        };
        let [low, high] = [self.band[0], self.band[1]];
        let filter = BandFilter::new(design, self.exponent, self.step, [low, high], self.order);
        let filter = filter.map_err(parameter_error)?;
        let [size, phase] = filter.errors();
        let mut text = format!(
            "# s^{} from {low} to {high} Hz, step {}, {} poles: within {size:.1e} dB, {phase:.1e} degrees of the operator after Tustin's rule\n",
            self.exponent, self.step, self.order
        );
        match self.form {
            Form::Poles => {
                text += "gain,zero,pole\n";
                for (i, (zero, pole)) in filter.zeros.iter().zip(&filter.poles).enumerate() {
                    let gain = if i == 0 { format!("{:.16e}", filter.gain) } else { String::new() };
                    // Writing to a string cannot fail.
                    let _ = writeln!(text, "{gain},{:.16e},{:.16e}", -zero, -pole);
                }
            }
            Form::Sections => {
                text += "b0,b1,a1\n";
                for [b0, b1, a1] in filter.sections() {
                    let _ = writeln!(text, "{b0:.16e},{b1:.16e},{a1:.16e}");
                }
            }
            Form::Transfer => {
                text += "n,b,a\n";
                let [above, below] = filter.transfer_function().map_err(parameter_error)?;
                for (n, (b, a)) in above.iter().zip(&below).enumerate() {
                    let _ = writeln!(text, "{n},{b:.16e},{a:.16e}");
                }
            }
        }
        emit(|out| out.write_all(text.as_bytes()), self.out.as_deref())
    }
}
