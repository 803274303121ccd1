//! Responses as spectra, made away from the stream.

use std::sync::Arc;

use fvi_core::{ParameterError, fingerprint};
use pulp::Arch;
use rustfft::num_complex::Complex;

use crate::engines::plans::Plans;
use crate::engines::scalar::Scalar;
use crate::engines::stream::near::NearFilter;
use crate::engines::stream::partition::{Partition, StagePlan};
use crate::engines::stream::responses::{Path, Responses};
use crate::engines::transform::{Packet, Transform};

/// The partition of a convolver with its transforms, shared by all that is prepared for it.
pub(crate) struct Geometry<T: Scalar> {
    pub(crate) partition: Partition,
    pub(crate) transforms: Vec<Transform<T>>,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    pub(crate) unit: Arch,
}

impl<T: Scalar> Geometry<T> {
    pub(crate) fn new(partition: Partition, inputs: usize, outputs: usize) -> Self {
        let (mut plans, unit, grain) = (Plans::new(), Arch::new(), partition.grain);
        let transform = |stage: &StagePlan| {
            // What is done at once is not divided.
            let leaf = if stage.nearest == 0 { stage.block } else { grain.leaf };
            Transform::in_own_precision(stage.block, leaf, grain.piece, &mut plans, unit)
        };
        let transforms = partition.stages.iter().map(transform).collect();
        Self { partition, transforms, inputs, outputs, unit }
    }

    /// Packets of a tile of the spectra of a stage.
    pub(crate) fn tile(&self, index: usize) -> usize {
        self.partition.grain.tile.min(self.transforms[index].packets())
    }

    /// Scratch for every transform.
    pub(crate) fn scratch(&self) -> Vec<Complex<f64>> {
        let most = self.transforms.iter().map(Transform::scratch).max();
        vec![Complex::default(); most.unwrap_or(0)]
    }

    /// Samples before a block that the near part reads.
    pub(crate) fn back(&self) -> usize {
        if self.partition.at_once { 0 } else { self.partition.first }
    }
}

/// Makes responses ready for a convolver, on any thread: [`Convolver::preparer`](super::Convolver::preparer).
#[derive(Clone)]
pub struct Preparer<T: Scalar> {
    geometry: Arc<Geometry<T>>,
}

/// Responses ready for a convolver: their spectra. They can be sent to the thread of the stream, which
/// [exchanges](super::Convolver::exchange) them for its own without allocation.
pub struct PreparedResponses<T: Scalar> {
    pub(crate) geometry: Arc<Geometry<T>>,
    /// The near weights of each response.
    pub(crate) near: Vec<NearFilter<T>>,
    /// For each stage the spectra of each response, tile by tile, at each block distance; they include the
    /// factor 1/B.
    pub(crate) spectra: Vec<Vec<Packet<T>>>,
    paths: Vec<Path>,
    /// For each output the end of its paths.
    ends: Vec<usize>,
    pub(crate) fingerprint: u64,
}

impl<T: Scalar> Preparer<T> {
    pub(crate) fn new(geometry: Arc<Geometry<T>>) -> Self {
        Self { geometry }
    }

    /// The responses, ready for the convolver.
    ///
    /// # Errors
    /// If they are not from as many inputs to as many outputs as those of the convolver, or longer than it
    /// was planned for.
    pub fn prepare(&self, responses: &Responses<T>) -> Result<PreparedResponses<T>, ParameterError> {
        let Geometry { partition, inputs, outputs, .. } = &*self.geometry;
        for (parameter, found, planned) in
            [("inputs", responses.inputs(), *inputs), ("outputs", responses.outputs(), *outputs)]
        {
            if found != planned {
                let allowed = "as many as the convolver has";
                return Err(ParameterError { parameter, value: found as f64, allowed });
            }
        }
        if responses.longest() > partition.lags - partition.latency {
            let (parameter, allowed) =
                ("samples of a response", "at most those the convolver was planned for");
            return Err(ParameterError { parameter, value: responses.longest() as f64, allowed });
        }
        let latency = vec![T::zero(); partition.latency];
        let filters: Vec<Vec<T>> =
            responses.filters().iter().map(|taps| [&*latency, &**taps].concat()).collect();
        let near = self.geometry.back() + partition.first;
        let near = filters.iter().map(|weights| NearFilter::new(weights, near)).collect();
        let mut scratch = self.geometry.scratch();
        let stages = partition.stages.iter().zip(&self.geometry.transforms).enumerate();
        let spectra = stages.map(|(index, (stage, transform))| {
            spectra(stage, transform, self.geometry.tile(index), &filters, &mut scratch)
        });
        let paths = responses.paths().to_vec();
        let ends = (0..*outputs).map(|output| paths.partition_point(|path| path.output <= output));
        Ok(PreparedResponses {
            geometry: self.geometry.clone(),
            near,
            spectra: spectra.collect(),
            ends: ends.collect(),
            fingerprint: fingerprint_of(responses),
            paths,
        })
    }
}

/// A number by which states of other responses are recognised: of the weights, and of where each begins.
fn fingerprint_of<T: Scalar>(responses: &Responses<T>) -> u64 {
    // In parts that are exact in either precision.
    let parts = |count: usize| [count >> 14, count & 0x3fff].map(|part| T::from_count(part as u64));
    let lengths = responses.filters().iter().flat_map(|weights| parts(weights.len()));
    let ends = |path: &Path| [path.output, path.input, path.filter];
    let places = responses.paths().iter().flat_map(ends).flat_map(parts);
    let arrangement: Vec<T> = lengths.chain(places).collect();
    fingerprint(responses.filters().iter().flatten().chain(&arrangement))
}

impl<T: Scalar> PreparedResponses<T> {
    /// The paths to an output.
    pub(crate) fn paths(&self, output: usize) -> &[Path] {
        let first = if output == 0 { 0 } else { self.ends[output - 1] };
        &self.paths[first..self.ends[output]]
    }

    /// Bytes of the spectra and of the near weights.
    pub fn bytes(&self) -> usize {
        let spectra = self.spectra.iter().map(|spectra| size_of_val(spectra.as_slice()));
        spectra.sum::<usize>() + self.near.iter().map(NearFilter::bytes).sum::<usize>()
    }
}

/// The spectra of the responses at every block distance d of a stage, from the weights of the lags
/// ((d−1)B, (d+1)B); those beyond the ends of a response are zero.
fn spectra<T: Scalar>(
    stage: &StagePlan,
    transform: &Transform<T>,
    tile: usize,
    filters: &[Vec<T>],
    scratch: &mut [Complex<f64>],
) -> Vec<Packet<T>> {
    let (block, packets) = (stage.block, transform.packets());
    let scale = T::of(1.0 / block as f64);
    let distances = stage.most_inputs();
    let mut spectra = vec![Packet::zero(); filters.len() * distances * packets];
    let mut spectrum = vec![Packet::zero(); packets];
    let mut polynomial = vec![Complex::new(T::zero(), T::zero()); block];
    let distances_of = |filter| (stage.nearest..=stage.reach).map(move |distance| (filter, distance));
    for (filter, distance) in (0..filters.len()).flat_map(distances_of) {
        let weights = &filters[filter];
        let weight =
            |lag: Option<usize>| lag.and_then(|lag| weights.get(lag)).map_or(T::zero(), |w| *w * scale);
        for (j, number) in polynomial.iter_mut().enumerate() {
            // No pair has the lag (d−1)B itself.
            let lower = if j == 0 { None } else { (distance * block + j).checked_sub(block) };
            *number = Complex::new(weight(lower), weight(Some(distance * block + j)));
        }
        for piece in 0..transform.pieces() {
            transform.forward_in_place(piece, &mut polynomial, &mut spectrum, scratch);
        }
        for (index, packets) in spectrum.chunks(tile).enumerate() {
            let tiles = filter * spectrum.len() / tile + index;
            let place = (tiles * distances + distance - stage.nearest) * tile;
            spectra[place..place + tile].copy_from_slice(packets);
        }
    }
    spectra
}
