//! Every kernel that the program offers on every engine, through the memory that the program runs, and whole
//! random scenarios.
//!
//! `PROPTEST_CASES` sets the number of cases; a long search takes thousands.

use fvi_core::{BdfOrder, ConvolutionWeights, Memory, RungeKutta};
use fvi_fft::baseline::{Signal, memory_term};
use fvi_fft::memory::{Engine, History};
use fvi_fft::memory::{LEAST_ON_INCREMENTS, Memories, MemoryRequest};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::quadrature::multistep_weights::multistep_weights;
use fvi_fft::quadrature::runge_kutta_weights::RungeKuttaWeights;
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::transfer::multistep_rule::MultistepRule;
use fvi_scenario::language::{Document, InputError};
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::{GridState, Precision, Simulation};
use fvi_tests::conformance::Bound;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use std::path::Path;

const ENGINES: [Engine; 5] =
    [Engine::Direct, Engine::BlockFft, Engine::RealTime, Engine::ExponentialSum, Engine::ExponentialSumCore];

/// Few by default: the search is long where a machine has the time.
fn cases(few: u32) -> ProptestConfig {
    let cases = std::env::var("PROPTEST_CASES").ok().and_then(|count| count.parse().ok()).unwrap_or(few);
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

/// A memory that the program may be asked for, and what it is fed with.
#[derive(Clone, Debug)]
struct Case {
    family: ConvolutionFamily,
    exponent: f64,
    step_size: f64,
    coordinates: usize,
    length: usize,
    signal: Signal,
    starting: Vec<f64>,
}

fn families() -> impl Strategy<Value = ConvolutionFamily> {
    prop_oneof![
        6 => (1..=6usize).prop_map(|order| ConvolutionFamily::Bdf { order }),
        3 => (1..=3usize).prop_map(|stages| ConvolutionFamily::RadauIia { stages }),
        3 => (2..=4usize).prop_map(|stages| ConvolutionFamily::LobattoIiic { stages }),
    ]
}

/// Damping orders: anywhere in [0, 2), whole, and so near to a whole number that digits may be lost.
fn damping_orders() -> impl Strategy<Value = f64> {
    let near = (0..=2u8, -15.0..-1.0f64, any::<bool>()).prop_map(|(whole, digits, above)| {
        let distance = 10f64.powf(digits);
        let order = f64::from(whole) + if above { distance } else { -distance };
        if (0.0..2.0).contains(&order) { order } else { 1.0 + distance }
    });
    prop_oneof![6 => 0.0..2.0f64, 1 => Just(0.0), 1 => Just(1.0), 2 => near]
}

/// Lengths at which blocks of the engines begin and end, and others.
fn lengths() -> impl Strategy<Value = usize> {
    let blocks = prop_oneof![Just(16usize), Just(64), Just(128), Just(512), Just(1024)];
    let around = (blocks, 0..=2usize).prop_map(|(block, offset)| block + offset - 1);
    prop_oneof![around, 1..40usize, 1..1500usize]
}

fn memories() -> impl Strategy<Value = Case> {
    let signal = proptest::sample::select(&Signal::ALL[..]);
    let steps = prop_oneof![Just(1.0), 1e-3..10.0f64];
    let starting = prop_oneof![
        3 => Just(Vec::new()),
        1 => proptest::sample::subsequence(vec![0.0, 0.5, 1.0, 1.5, 2.0], 1..=3),
    ];
    (families(), damping_orders(), steps, 1..=3usize, lengths(), signal, starting).prop_map(
        |(family, exponent, step_size, coordinates, length, signal, starting)| {
            let bdf = matches!(family, ConvolutionFamily::Bdf { .. });
            let starting = if bdf { starting } else { Vec::new() };
            Case { family, exponent, step_size, coordinates, length, signal, starting }
        },
    )
}

impl Case {
    fn stages(&self) -> usize {
        match self.family {
            ConvolutionFamily::Bdf { .. } | ConvolutionFamily::Trapezoidal => 1,
            ConvolutionFamily::RadauIia { stages }
            | ConvolutionFamily::LobattoIiic { stages }
            | ConvolutionFamily::Gauss { stages } => stages,
        }
    }

    /// The weights of the definition, matrix by matrix, row by row: on the differences that the program's
    /// memories act on.
    fn weights(&self) -> Vec<f64> {
        // As many as the engines make: the last digits of matrix weights depend on their number.
        fn matrices<const R: usize>(method: &RungeKutta<R>, case: &Case) -> Vec<f64> {
            let count = case.length + 1;
            let make = if case.exponent >= LEAST_ON_INCREMENTS {
                RungeKuttaWeights::on_rises
            } else {
                RungeKuttaWeights::new
            };
            let weights = make(method, case.exponent, case.step_size, count).unwrap();
            let planes = weights.planes();
            (0..count * R * R).map(|index| planes[index % (R * R) * count + index / (R * R)]).collect()
        }
        match self.family {
            ConvolutionFamily::Bdf { order } => {
                let order = BdfOrder::new(order).unwrap();
                let on_values = ConvolutionWeights::bdf(order, self.exponent, self.step_size).unwrap();
                let weights =
                    if self.exponent >= LEAST_ON_INCREMENTS { on_values.on_increments() } else { on_values };
                weights.take(self.length + 1).collect()
            }
            ConvolutionFamily::Gauss { .. } => unreachable!("the memory of mechanisms has other engines"),
            ConvolutionFamily::Trapezoidal => {
                let power = TransferFunction::power(self.exponent).unwrap();
                let on_increments = self.exponent >= LEAST_ON_INCREMENTS;
                let (rule, count) = (MultistepRule::Trapezoidal, self.length + 1);
                multistep_weights(&power, rule, self.step_size, on_increments, count).unwrap()
            }
            ConvolutionFamily::RadauIia { stages: 1 } => {
                matrices(&RungeKutta::<1>::radau_iia().unwrap(), self)
            }
            ConvolutionFamily::RadauIia { stages: 2 } => {
                matrices(&RungeKutta::<2>::radau_iia().unwrap(), self)
            }
            ConvolutionFamily::RadauIia { .. } => matrices(&RungeKutta::<3>::radau_iia().unwrap(), self),
            ConvolutionFamily::LobattoIiic { stages: 2 } => {
                matrices(&RungeKutta::<2>::lobatto_iiic().unwrap(), self)
            }
            ConvolutionFamily::LobattoIiic { stages: 3 } => {
                matrices(&RungeKutta::<3>::lobatto_iiic().unwrap(), self)
            }
            ConvolutionFamily::LobattoIiic { .. } => {
                matrices(&RungeKutta::<4>::lobatto_iiic().unwrap(), self)
            }
        }
    }

    fn memory<T: Memories>(&self, engine: Engine) -> impl Memory<T> + use<T> {
        let request = MemoryRequest {
            end: None,
            family: self.family,
            starting: &self.starting,
            transfer: &TransferFunction::power(self.exponent).unwrap(),
            step_size: self.step_size,
            coordinates: self.coordinates,
            motions: 1,
            samples: self.length,
            given: false,
            history: &History { engine: Some(engine), ..History::default() },
        };
        let memory = request.build::<T>().unwrap_or_else(|error| panic!("{engine:?}: {error}"));
        assert_eq!(memory.engine(), engine);
        memory
    }

    /// All memory terms of an engine, one after the other.
    fn terms<T: Memories>(&self, engine: Engine, samples: &[T]) -> Vec<T> {
        let channels = self.coordinates * self.stages();
        let mut memory = self.memory::<T>(engine);
        let mut terms = vec![T::of(f64::NAN); samples.len()];
        for (sample, term) in samples.chunks(channels).zip(terms.chunks_mut(channels)) {
            memory.next_term(term).expect("room for the whole run");
            memory.push(sample).expect("room for the whole run");
        }
        terms
    }
}

/// Steps whose terms are compared: the first, the last, and some in between.
fn compared(length: usize) -> impl Iterator<Item = usize> {
    (0..length).filter(move |&k| k < 4 || k + 3 > length || k % (length / 12 + 1) == 0 || k % 64 < 2)
}

/// All engines against the double sum of the definition.
fn agree_with_the_double_sum<T: Memories>(case: &Case) -> Result<(), TestCaseError> {
    let channels = case.coordinates * case.stages();
    let samples: Vec<T> = case.signal.samples(channels, case.length);
    let weights = case.weights();
    let exact: Vec<f64> = samples.iter().map(|x| x.to_f64()).collect();
    let references: Vec<_> = compared(case.length)
        .map(|k| (k, memory_term(&weights, case.stages(), &exact, channels, k)))
        .collect();
    for engine in ENGINES {
        let terms = case.terms(engine, &samples);
        for (k, reference) in &references {
            for (term, reference) in terms[k * channels..].iter().zip(reference) {
                let error = (term.to_f64() - reference.sum).abs();
                let unit = 0.5 * T::EPSILON.to_f64() * reference.absolute;
                prop_assert!(
                    error <= Bound::of(engine).on(case.signal) * unit,
                    "{engine:?} at k = {k}: {term:?} instead of {}, {:.1} u",
                    reference.sum,
                    error / unit
                );
            }
        }
    }
    Ok(())
}

/// D^β t^ν = Γ(ν+1)/Γ(ν+1−β) t^{ν−β}; zero at the poles of the denominator.
fn derivative_of_power(nu: f64, order: f64, time: f64) -> f64 {
    let denominator = nu + 1.0 - order;
    if denominator <= 0.0 && denominator.fract() == 0.0 {
        return 0.0;
    }
    libm::tgamma(nu + 1.0) / libm::tgamma(denominator) * time.powf(nu - order)
}

/// With starting weights, behind the first samples: the double sum and the corrections of their definition,
/// solved anew at each step.
fn agree_with_the_definition_of_starting_weights(case: &Case) -> Result<(), TestCaseError> {
    let (channels, count) = (case.coordinates, case.starting.len());
    let first = usize::from(!case.starting.contains(&0.0));
    let samples: Vec<f64> = case.signal.samples(channels, case.length);
    let ConvolutionFamily::Bdf { order } = case.family else { unreachable!("plain weights") };
    let weights = ConvolutionWeights::bdf(BdfOrder::new(order).unwrap(), case.exponent, case.step_size);
    let weights: Vec<f64> = weights.unwrap().take(case.length + 1).collect();
    let time = |k: usize| k as f64 * case.step_size;
    let powers = DMatrix::from_fn(count, count, |row, column| time(first + column).powf(case.starting[row]));
    let solver = powers.transpose().lu();
    let mut expected = Vec::new();
    for k in compared(case.length).filter(|&k| k >= first + count) {
        let quadrature = |nu: f64| (0..=k).map(|n| weights[n] * time(k - n).powf(nu)).sum::<f64>();
        let defects = DVector::from_fn(count, |row, _| {
            let nu = case.starting[row];
            derivative_of_power(nu, case.exponent, time(k)) - quadrature(nu)
        });
        // ϖ: powers · ϖ = defects.
        let corrections = powers.clone().lu().solve(&defects).expect("distinct exponents");
        let size: f64 = weights[..=k].iter().map(|weight| weight.abs()).sum();
        let lost = case.starting.iter().map(|&nu| size * time(k).powf(nu)).fold(0.0, max_or_nan);
        let inverse = solver.solve(&DMatrix::identity(count, count)).expect("distinct exponents").amax();
        for channel in 0..channels {
            let known: Vec<f64> = (0..count).map(|j| samples[(first + j) * channels + channel]).collect();
            let reference = memory_term(&weights, 1, &samples, channels, k)[channel];
            let sum = reference.sum + corrections.iter().zip(&known).map(|(w, x)| w * x).sum::<f64>();
            let largest = known.iter().fold(0.0, |largest, x| max_or_nan(largest, x.abs()));
            let allowed = 1e-13 * (reference.absolute + lost * inverse * largest * count as f64);
            expected.push((k, channel, sum, allowed));
        }
    }
    let on_increments = case.exponent >= LEAST_ON_INCREMENTS;
    let before =
        |index: usize| if on_increments && index >= channels { samples[index - channels] } else { 0.0 };
    let increments: Vec<f64> = samples.iter().enumerate().map(|(index, x)| x - before(index)).collect();
    for engine in ENGINES {
        let terms = case.terms(engine, &increments);
        for &(k, channel, sum, allowed) in &expected {
            let index = k * channels + channel;
            let term = terms[index] - weights[0] * before(index);
            prop_assert!(
                (term - sum).abs() <= allowed,
                "{engine:?} at k = {k}: {term:e} instead of {sum:e} ± {allowed:e}"
            );
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(cases(40))]

    #[test]
    fn every_kernel_of_the_program_on_every_engine_is_the_plain_sum(case in memories()) {
        if case.starting.is_empty() {
            agree_with_the_double_sum::<f64>(&case)?;
            agree_with_the_double_sum::<f32>(&case)?;
        } else {
            agree_with_the_definition_of_starting_weights(&case)?;
        }
    }
}

/// A whole scenario as text, without `[history]`.
fn scenarios() -> impl Strategy<Value = String> {
    let schemes = prop_oneof![
        (0.0..=1.0f64).prop_map(|kappa| format!("kind = \"low-order\"\nkappa = {kappa}")),
        Just("kind = \"implicit-euler\"".to_owned()),
        Just("kind = \"explicit-euler\"".to_owned()),
        (1..=3usize).prop_map(|degree| format!("kind = \"galerkin\"\ndegree = {degree}")),
    ];
    let derivatives = prop_oneof![Just("caputo"), Just("riemann-liouville")];
    let potentials = prop_oneof![
        Just("1.0 - cos(q0) + 0.5*q1^2"),
        Just("0.5*q0^2 + 0.25*q1^4 + 0.1*(q0 - q1)^2"),
        Just("2*q0^2 + q1^2"),
    ];
    let damping = (damping_orders(), 0.01..0.5f64, derivatives);
    // Without a word: at the nodes, where the scheme has some.
    let forms = prop_oneof![Just(""), Just("\nat = \"main-nodes\"")];
    let convolution = (families(), forms);
    (schemes, convolution, proptest::collection::vec(damping, 1..=2), potentials, 0.002..0.02f64, 1..=250usize)
        .prop_map(|(scheme, (family, at), damping, potential, step, steps)| {
            let family = match family {
                ConvolutionFamily::Bdf { order } => format!("family = \"bdf\"\norder = {order}{at}"),
                ConvolutionFamily::Trapezoidal => "symbol = \"trapezoidal\"".to_owned(),
                ConvolutionFamily::RadauIia { stages } => format!("family = \"radau-iia\"\nstages = {stages}"),
                ConvolutionFamily::LobattoIiic { stages } => {
                    format!("family = \"lobatto-iiic\"\nstages = {stages}")
                }
                ConvolutionFamily::Gauss { .. } => "family = \"gauss\"".to_owned(),
            };
            // Damping at the stages needs polynomials on the stages.
            let scheme = match family.contains("bdf") {
                true => scheme,
                false => "kind = \"galerkin\"\ndegree = 1".to_owned(),
            };
            let terms: String = damping
                .iter()
                .map(|(order, coefficient, derivative)| {
                    format!(
                        "[[system.damping]]\norder = {order}\ncoefficient = [{coefficient}, 0.1]\nderivative = \"{derivative}\"\n"
                    )
                })
                .collect();
            format!(
                "[system]\nmass = [1.0, 2.0]\npotential = \"{potential}\"\n{terms}\n\
                 [initial]\nposition = [0.5, -0.25]\nmomentum = [0.0, 1.0]\n\
                 [scheme]\n{scheme}\n[convolution]\n{family}\n[time]\nstep = {step}\nsteps = {steps}\n"
            )
        })
}

/// Positions and momenta over a run, or why it cannot be made or goes no further.
fn run(text: &str, engine: Engine, precision: Precision) -> Result<(Vec<f64>, Option<usize>), InputError> {
    let mut scenario = Scenario::from_document(Document::new("random.toml", Path::new("."), text))?;
    scenario.history.choose(engine);
    let mut simulation = Simulation::new(&scenario, precision)?;
    let mut state = GridState { position: vec![0.0; 2], momentum: vec![0.0; 2], ..GridState::default() };
    let mut motion = Vec::new();
    for step in 0..scenario.time.steps {
        if simulation.step(&[]).is_err() {
            return Ok((motion, Some(step)));
        }
        simulation.read(&mut state);
        motion.extend(state.position.iter().chain(&state.momentum));
    }
    assert_eq!(simulation.engines(), vec![engine; scenario.system.damping.len()]);
    Ok((motion, None))
}

proptest! {
    #![proptest_config(cases(16))]

    #[test]
    fn a_whole_scenario_moves_alike_on_every_engine(text in scenarios()) {
        for (precision, allowed) in [(Precision::F64, 1e-10), (Precision::F32, 1e-2)] {
            let plain = run(&text, Engine::Direct, precision).map_err(|error| error.to_string());
            for engine in ENGINES {
                let found = run(&text, engine, precision).map_err(|error| error.to_string());
                match (&plain, found) {
                    (Ok((plain, None)), Ok((motion, None))) => {
                        let size = plain.iter().fold(1.0, |size, x| max_or_nan(size, x.abs()));
                        let error = plain.iter().zip(&motion).fold(0.0, |e, (a, b)| max_or_nan(e, (a - b).abs()));
                        prop_assert!(error <= allowed * size, "{engine:?}, {precision:?}: {error:e} of {size}");
                    }
                    (Ok((_, step)), Ok((_, found))) => prop_assert_eq!(*step, found, "{:?}", engine),
                    (plain, found) => prop_assert_eq!(
                        plain.as_ref().err(), found.as_ref().err(), "{:?}, {:?}", engine, precision
                    ),
                }
            }
        }
    }
}
