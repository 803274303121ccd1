//! The kernels of a race.

use fvi_core::{BdfOrder, ParameterError};
use fvi_fft::memory::LEAST_ON_INCREMENTS;
use fvi_fft::quadrature::multistep_weights::multistep_weights;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::transfer::laplace::on_a_line;
use fvi_scenario::language::InputError;
use fvi_scenario::language::document::{Table, Value};
use fvi_scenario::scenario::{kernel_of_table, weights_of};

/// A kernel with the quadrature that gives its weights.
#[derive(Clone, Debug)]
pub(crate) struct Kernel {
    pub(crate) name: String,
    pub(crate) source: Source,
    pub(crate) order: BdfOrder,
    pub(crate) step: f64,
    /// True if the samples are differences, as in a run, and the weights act on these.
    pub(crate) on_increments: bool,
}

/// Origin of the weights.
#[derive(Clone, Debug)]
pub(crate) enum Source {
    Transfer(TransferFunction),
    Table(Vec<f64>),
    /// w_n = ξ_n (1 + n)^{−decay} with ξ_n spread evenly over (−1, 1).
    Random {
        decay: f64,
        seed: u64,
    },
}

impl Kernel {
    /// s^β at step 1, in the form used by the memory of a run.
    pub(crate) fn of_a_run(order: BdfOrder, exponent: f64) -> Result<Self, ParameterError> {
        Ok(Self {
            name: format!("s^{exponent}"),
            source: Source::Transfer(TransferFunction::power(exponent)?),
            order,
            step: 1.0,
            on_increments: exponent >= LEAST_ON_INCREMENTS,
        })
    }

    /// β of s^β.
    pub(crate) fn exponent(&self) -> Option<f64> {
        match &self.source {
            Source::Transfer(transfer) => transfer.exponent(),
            Source::Table(_) | Source::Random { .. } => None,
        }
    }

    /// The first `count` weights.
    pub(crate) fn weights(&self, count: usize) -> Result<Vec<f64>, ParameterError> {
        match &self.source {
            Source::Transfer(transfer) => {
                multistep_weights(transfer, self.order, self.step, self.on_increments, count)
            }
            Source::Table(weights) => Ok(weights[..count.min(weights.len())].to_vec()),
            Source::Random { decay, seed } => {
                let mut noise = fastrand::Rng::with_seed(*seed);
                let weight = |n: usize| (2.0 * noise.f64() - 1.0) * (1.0 + n as f64).powf(-decay);
                Ok((0..count).map(weight).collect())
            }
        }
    }

    /// |Σ w_n x_{N−n} − K(d/dt) t²| / Σ|w||x| on x = t² after as many steps as there are weights, those of
    /// this kernel or of another quadrature; `None` where K(d/dt) t² is not known to the digits that this
    /// needs.
    pub(crate) fn quadrature_error(&self, weights: &[f64]) -> Option<f64> {
        // What a hundred times the error of the inverse transform is less than.
        const KNOWN: f64 = 1e-5;
        let Source::Transfer(transfer) = &self.source else { return None };
        if self.on_increments || transfer.spring() != 0.0 || transfer.active().is_some() {
            return None;
        }
        let end = weights.len() as f64 * self.step;
        let exact = match transfer.exponent() {
            Some(order) => 2.0 * end.powf(2.0 - order) / libm::tgamma(3.0 - order),
            None => on_a_line(end, |s| transfer.value(s) * 2.0 / (s * s * s)),
        };
        let (mut sum, mut absolute) = (0.0, 0.0);
        for (n, weight) in weights.iter().enumerate().rev() {
            let product = weight * ((weights.len() - n) as f64 * self.step).powi(2);
            sum += product;
            absolute += product.abs();
        }
        let difference = (sum - exact).abs();
        let is_known = transfer.exponent().is_some() || difference > KNOWN * exact.abs();
        is_known.then_some(difference / absolute).filter(|error| error.is_finite())
    }

    /// A number that tells weights from others: of all that are in a table, of the first of a formula.
    pub(crate) fn fingerprint(&self) -> u64 {
        const LOOKED_AT: usize = 256;
        let computed;
        let weights: &[f64] = match &self.source {
            Source::Table(weights) => weights,
            _ => {
                computed = self.weights(LOOKED_AT).unwrap_or_default();
                &computed
            }
        };
        hash(weights.iter().flat_map(|weight| weight.to_bits().to_le_bytes()))
    }

    /// Description as text.
    pub(crate) fn description(&self) -> String {
        let formula = format!("BDF of order {}, h = {}", self.order.get(), self.step);
        match &self.source {
            Source::Transfer(transfer) => match transfer.exponent() {
                Some(exponent) => format!("s^{exponent}, {formula}"),
                None => format!("{transfer}, {formula}"),
            },
            Source::Table(weights) => format!("a table of {} weights", weights.len()),
            Source::Random { decay, seed } => {
                format!("random weights that decay as n^−{decay}, seed {seed}")
            }
        }
    }
}

/// Keys in addition to those of the kernel itself; `order` is one of them for kernels without an order of
/// their own.
const BESIDE: [&str; 3] = ["name", "family", "step"];
const BESIDE_WITH_ORDER: [&str; 4] = ["name", "family", "step", "order"];

/// Reads a `[[kernel]]`; `longest` is the largest number of weights needed.
pub(crate) fn read_kernel(
    table: &Table<'_>,
    parameters: Option<&Value<'_>>,
    longest: usize,
) -> Result<Kernel, InputError> {
    let name_value = table.required("name")?;
    let name = name_value.text()?.trim().to_owned();
    if name.is_empty() || name.chars().any(char::is_control) {
        return Err(name_value.out_of_range("a name without control characters"));
    }
    if let Some(family) = table.optional("family") {
        family.choice(&[("bdf", ())])?;
    }
    let step = match table.optional("step") {
        None => 1.0,
        Some(value) => match value.number()? {
            step if step > 0.0 => step,
            _ => return Err(value.out_of_range("a number > 0")),
        },
    };
    let nested = match table.optional("kernel") {
        Some(value) => Some(value.table()?),
        None => None,
    };
    if nested.is_some() {
        table.allow(&["name", "family", "step", "order", "kernel"])?;
    }
    let of = nested.as_ref().unwrap_or(table);
    let form = of.optional("form").map(|form| form.text()).transpose()?;
    let bare = ["form", "symbol", "relaxation", "weights"].iter().all(|key| of.optional(key).is_none());
    let form_has_order = form.is_some_and(|form| form != "prony" && form != "random");
    let own_order = nested.is_none() && (bare || form_has_order);
    let beside: &'static [&'static str] = match &nested {
        Some(_) => &[],
        None if own_order => &BESIDE,
        None => &BESIDE_WITH_ORDER,
    };
    let source = if let Some(value) = of.optional("weights") {
        of.beside(beside).allow(&["weights"])?;
        Source::Table(read_weights(&value, longest)?)
    } else if form == Some("random") {
        of.beside(beside).allow(&["form", "decay", "seed"])?;
        let decay = of.required("decay")?;
        let seed = of.optional("seed").map_or(Ok(1), |seed| seed.whole(0..=usize::MAX))?;
        match decay.number()? {
            number if (0.0..=10.0).contains(&number) => Source::Random { decay: number, seed: seed as u64 },
            _ => return Err(decay.out_of_range("a number from 0 to 10")),
        }
    } else if bare {
        of.beside(beside).allow(&["order"])?;
        let order = of.required("order")?;
        let refused = || order.out_of_range("the order of a kernel s^β, 0 ≤ β < 2, where no `form` is given");
        let number = order.number()?;
        if number < 0.0 {
            return Err(refused());
        }
        Source::Transfer(TransferFunction::power(number).map_err(|_| refused())?)
    } else {
        Source::Transfer(kernel_of_table(of, beside, parameters)?)
    };
    let order = match table.optional("order").filter(|_| !own_order) {
        None => BdfOrder::GRUNWALD_LETNIKOV,
        Some(value) => {
            BdfOrder::new(value.whole(1..=6)?).map_err(|error| value.out_of_range(error.allowed))?
        }
    };
    let kernel = Kernel { name, source, order, step, on_increments: false };
    // Missing weights are an error of the file, not of a strategy.
    let first = kernel
        .weights(2)
        .map_err(|error| name_value.out_of_range(format!("a kernel with weights: {error}")))?;
    if first.iter().any(|weight| !weight.is_finite()) {
        return Err(name_value.out_of_range("a kernel whose weights are finite at this step"));
    }
    Ok(kernel)
}

/// A file with the columns `n,weight`, or a list.
fn read_weights(value: &Value<'_>, longest: usize) -> Result<Vec<f64>, InputError> {
    let weights = weights_of(value)?;
    if weights.len() < longest {
        return Err(value.out_of_range(format!(
            "at least {longest} weights, as many as the longest of `lengths`; there are {}",
            weights.len()
        )));
    }
    Ok(weights)
}
/// FNV-1a
pub(crate) fn hash(bytes: impl Iterator<Item = u8>) -> u64 {
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}
