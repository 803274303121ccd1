//! What a convolver convolves with: finite responses between inputs and outputs.

use fvi_core::ParameterError;

use crate::engines::scalar::Scalar;

/// Longest response, in samples.
const LONGEST: usize = 1 << 28;

/// Finite responses from inputs to outputs, whose sums are the outputs:
///
/// y_o(k) = Σ_i Σ_{n=0}^{L−1} w_{oi}(n) x_i(k−n) .
///
/// Pairs of an input and an output without a response cost nothing; a response that several pairs share is
/// transformed and stored once.
#[derive(Clone, Debug, PartialEq)]
pub struct Responses<T> {
    inputs: usize,
    outputs: usize,
    /// The distinct responses.
    filters: Vec<Vec<T>>,
    /// In the order of their outputs.
    paths: Vec<Path>,
}

/// A pair with a response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Path {
    pub(crate) output: usize,
    pub(crate) input: usize,
    pub(crate) filter: usize,
}

fn check(taps: &[impl Scalar]) -> Result<(), ParameterError> {
    if taps.len() > LONGEST {
        let (parameter, allowed) = ("samples of a response", "at most 268435456");
        return Err(ParameterError { parameter, value: taps.len() as f64, allowed });
    }
    match taps.iter().find(|tap| !tap.is_finite()) {
        None => Ok(()),
        Some(tap) => {
            let (parameter, allowed) = ("response", "finite numbers");
            Err(ParameterError { parameter, value: tap.to_f64(), allowed })
        }
    }
}

fn empty() -> ParameterError {
    ParameterError { parameter: "samples of a response", value: 0.0, allowed: "at least 1" }
}

impl<T: Scalar> Responses<T> {
    /// One input, one output.
    ///
    /// # Errors
    /// If the response is empty, longer than 2²⁸ samples or not finite.
    pub fn one(response: &[T]) -> Result<Self, ParameterError> {
        Self::shared(response, 1)
    }

    /// The same response for each of `channels` inputs, which are convolved to as many outputs.
    ///
    /// # Errors
    /// As [`one`](Self::one), and if there is no channel.
    pub fn shared(response: &[T], channels: usize) -> Result<Self, ParameterError> {
        let paths = (0..channels).map(|channel| Path { output: channel, input: channel, filter: 0 });
        Self::checked(channels, channels, vec![response.to_vec()], paths.collect())
    }

    /// A response for each channel: input i is convolved with the i-th to output i.
    ///
    /// # Errors
    /// As [`one`](Self::one) for each of them, and if there is none.
    pub fn each(responses: &[impl AsRef<[T]>]) -> Result<Self, ParameterError> {
        let filters = responses.iter().map(|response| response.as_ref().to_vec()).collect();
        let channels = responses.len();
        let paths = (0..channels).map(|channel| Path { output: channel, input: channel, filter: channel });
        Self::checked(channels, channels, filters, paths.collect())
    }

    /// A matrix, row by row: the responses of input 0 to all `outputs`, then those of input 1, …. An empty
    /// one stands for no response.
    ///
    /// # Errors
    /// As [`one`](Self::one) for those that are not empty; if all are, or if they are not a whole number of
    /// rows.
    pub fn matrix(outputs: usize, responses: &[impl AsRef<[T]>]) -> Result<Self, ParameterError> {
        if outputs == 0 || !responses.len().is_multiple_of(outputs) {
            let (parameter, allowed) =
                ("responses", "a whole number of rows of as many as there are outputs");
            return Err(ParameterError { parameter, value: responses.len() as f64, allowed });
        }
        let (mut filters, mut paths) = (Vec::new(), Vec::new());
        for (place, response) in responses.iter().enumerate().filter(|(_, taps)| !taps.as_ref().is_empty()) {
            paths.push(Path { output: place % outputs, input: place / outputs, filter: filters.len() });
            filters.push(response.as_ref().to_vec());
        }
        Self::checked(responses.len() / outputs, outputs, filters, paths)
    }

    fn checked(
        inputs: usize,
        outputs: usize,
        filters: Vec<Vec<T>>,
        mut paths: Vec<Path>,
    ) -> Result<Self, ParameterError> {
        if inputs == 0 {
            return Err(ParameterError { parameter: "channels", value: 0.0, allowed: "at least 1" });
        }
        if filters.iter().all(Vec::is_empty) || paths.iter().any(|path| filters[path.filter].is_empty()) {
            return Err(empty());
        }
        filters.iter().try_for_each(|taps| check(taps))?;
        paths.sort_by_key(|path| (path.output, path.input));
        Ok(Self { inputs, outputs, filters, paths })
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Samples of the longest response.
    pub fn longest(&self) -> usize {
        self.filters.iter().map(Vec::len).max().unwrap_or(0)
    }

    pub(crate) fn filters(&self) -> &[Vec<T>] {
        &self.filters
    }

    pub(crate) fn paths(&self) -> &[Path] {
        &self.paths
    }
}
