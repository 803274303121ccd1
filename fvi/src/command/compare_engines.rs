//! `fvi compare-engines`: memory engines side by side, the shortest form of `fvi strategies`.

use super::{CommandError, terminal};
use fvi_core::BdfOrder;
use fvi_host::results::output_directory::OutputDirectory;
use fvi_strategies::engines::{
    Comparison, ComparisonError, strategies, text_table, write_pictures, write_table,
};
use std::io::IsTerminal;
use std::path::PathBuf;

/// Arguments of `fvi compare-engines`.
#[derive(Debug, clap::Args)]
pub(crate) struct CompareEnginesArguments {
    /// Numbers of steps, as powers of two
    #[arg(long, value_name = "POWERS", value_delimiter = ',', default_value = "10,14,17,20",
          value_parser = clap::value_parser!(u32).range(0..=28))]
    lengths: Vec<u32>,
    /// Orders of the backward differentiation formula, each combined with every exponent
    #[arg(long, value_name = "ORDERS", value_delimiter = ',', default_value = "1", value_parser = order)]
    order: Vec<BdfOrder>,
    /// Exponents of the convolution quadrature, greater than −1 and less than 2
    #[arg(long, value_name = "EXPONENTS", value_delimiter = ',', default_value = "0.5", value_parser = exponent,
          allow_hyphen_values = true)]
    exponent: Vec<f64>,
    /// Rounds, in each of which every engine is made anew and timed [default: 5 to 50, more for shorter runs]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    repetitions: Option<u32>,
    /// Where the files go
    #[arg(long, value_name = "DIR", default_value = "out/compare-engines")]
    out: PathBuf,
    /// Nothing on the terminal
    #[arg(long)]
    quiet: bool,
}

fn order(text: &str) -> Result<BdfOrder, String> {
    let order = text.parse().map_err(|_| format!("{text} is not a whole number"))?;
    BdfOrder::new(order).map_err(|error| error.to_string())
}

fn exponent(text: &str) -> Result<f64, String> {
    let exponent = text.parse().map_err(|_| format!("{text} is not a number"))?;
    fvi_core::ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, exponent, 1.0)
        .map_err(|error| error.to_string())?;
    Ok(exponent)
}

impl CompareEnginesArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let directory = OutputDirectory::claim(&self.out)?;
        let kernels =
            self.order.iter().flat_map(|&order| self.exponent.iter().map(move |&exponent| (order, exponent)));
        let comparison = Comparison {
            lengths: self.lengths.iter().map(|power| 1 << power).collect(),
            kernels: kernels.collect(),
            repetitions: self.repetitions.map(|count| count as usize),
        };
        let announce = !self.quiet && std::io::stderr().is_terminal();
        let measurements = comparison.run(&strategies(), &mut |task| {
            if announce {
                terminal::mention(&format!("{task}\n"));
            }
        });
        let measurements = measurements.map_err(|error| match error {
            ComparisonError::NoRoom { .. } => CommandError::NoRoom(format!("--lengths: {error}")),
            other => CommandError::Failed(other.to_string()),
        })?;
        write_table(&measurements, &directory.join("engines.csv"))?;
        write_pictures(&measurements, directory.path())?;
        if !self.quiet {
            let table = text_table(&measurements);
            terminal::say(&format!("{table}written to {}\n", self.out.display()))?;
        }
        Ok(())
    }
}
