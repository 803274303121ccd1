//! Laws of motion with kernels of every form, whose parameters are drawn to their edges: the balance of
//! energy, orders of position, momentum and energy, tolerances, poles. A failure shows its scenario.

use super::creep::talbot;
use super::kernel_forms::{Drawn, FORMS, draw};
use crate::variable_steps::noise;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::motion::Motion;
use fvi_simulation::simulation::response::Linearised;
use fvi_simulation::simulation::{GridState, Precision};
use nalgebra::{Complex, DVector};

/// An oscillator with a unit mass on a unit spring, damped by ρ K.
struct Oscillator {
    kernel: Drawn,
    rho: f64,
    position: f64,
    velocity: f64,
    riemann_liouville: bool,
}

impl Oscillator {
    fn text(&self, rest: &str) -> String {
        let derivative = if self.riemann_liouville { "riemann-liouville" } else { "caputo" };
        format!(
            "[system]\nmass = [1.0]\nstiffness = [1.0]\n[[system.damping]]\nkernel = {}\ncoefficient = [{:?}]\n\
             derivative = \"{derivative}\"\n[initial]\nposition = [{:?}]\nvelocity = [{:?}]\n{rest}",
            self.kernel.keys, self.rho, self.position, self.velocity
        )
    }

    /// s² + 1 + ρ K(s)
    fn characteristic(&self, s: Complex<f64>) -> Complex<f64> {
        s * s + 1.0 + (self.kernel.symbol)(s) * self.rho
    }

    /// q, p and the energy.
    fn exact(&self, time: f64) -> [f64; 3] {
        let (rest, speed) = (self.position, self.velocity);
        let [q, p] = talbot(time, |s| {
            let kept = if self.riemann_liouville { 0.0.into() } else { (self.kernel.symbol)(s) / s };
            let q = (s * rest + speed + kept * (self.rho * rest)) / self.characteristic(s);
            DVector::from_column_slice(&[q, s * q - rest])
        })[..] else {
            unreachable!("two transforms")
        };
        [q, p, 0.5 * (q * q + p * p)]
    }
}

/// All states of a run, or why there are none.
fn run(text: &str) -> Result<Vec<GridState>, String> {
    let scenario: Scenario = text.parse().map_err(|error| format!("{error}"))?;
    let mut motion = Motion::start(&scenario, Precision::F64).map_err(|error| error.to_string())?;
    let mut states = vec![motion.state().clone()];
    while !motion.is_done() {
        motion.advance().map_err(|failure| failure.reason)?;
        states.push(motion.state().clone());
    }
    Ok(states)
}

/// What was found wrong, each with its scenario.
#[derive(Default)]
struct Wrong(Vec<String>);

impl Wrong {
    fn note(&mut self, what: &str, text: &str) {
        self.0.push(format!("{what}\n{text}"));
    }

    fn none(&self, of: usize) {
        assert!(self.0.is_empty(), "{} of {of}:\n\n{}", self.0.len(), self.0.join("\n\n"));
    }
}

/// The larger of two numbers, or NaN.
fn max_or_nan(one: f64, other: f64) -> f64 {
    if one.is_nan() || one > other { one } else { other }
}

/// The midpoint rule, with a rule for the memory and the energies of memories.
fn with_energies(rule: &str) -> String {
    format!(
        "[scheme]\nkind = \"low-order\"\nkappa = 0.5\n[convolution]\n{rule}\nat = \"nodes\"\n[output]\nmemory_energy = true\n"
    )
}

const RULES: [&str; 3] = ["order = 1", "order = 2", "symbol = \"trapezoidal\""];

#[test]
fn energy_is_what_there_is_and_what_memories_store_and_dissipate() {
    let mut numbers = noise(21);
    let mut wrong = Wrong::default();
    const DRAWS: usize = 12 * FORMS;
    for index in 0..DRAWS {
        let kernel = draw(index, &mut numbers);
        let rule = RULES[index / FORMS % RULES.len()];
        // The trapezoidal rule has no jump of a kernel without a glass modulus.
        let riemann_liouville = index % 2 == 1 && (rule != RULES[2] || kernel.growth == 0.0);
        let step = [0.02, 0.3, 1e-3][index / 4 % 3];
        let oscillator = Oscillator { rho: 0.5, position: 1.0, velocity: 0.3, riemann_liouville, kernel };
        let text = oscillator.text(&format!("{}[time]\nstep = {step:?}\nsteps = 150\n", with_energies(rule)));
        let states = match run(&text) {
            Err(_) if oscillator.kernel.is_narrow => continue,
            Err(reason) => {
                wrong.note(&format!("refused: {reason}"), &text);
                continue;
            }
            Ok(states) => states,
        };
        let total = |state: &GridState| state.energy + state.columns[0] + state.columns[1];
        let worst = states
            .iter()
            .map(|state| (total(state) - total(&states[0])).abs())
            .fold(0.0, |w, e| max_or_nan(e, w));
        let grows = states.windows(2).all(|pair| pair[1].columns[1] >= pair[0].columns[1]);
        let is_positive = states.iter().all(|state| state.columns[0] >= 0.0);
        if !(worst <= 1e-12 * total(&states[0]) && grows && is_positive) {
            wrong.note(&format!("{worst:e} of {}, {grows}, {is_positive}", total(&states[0])), &text);
        }
    }
    wrong.none(DRAWS);
}

/// Energies that a Maxwell element (1, 1) has stored and dissipated at t = 2, by a Runge–Kutta method for
/// q̈ = −q − e/2, ė = q̇ − e, S = e²/4, Ḋ = e²/2.
fn of_a_maxwell_element() -> [f64; 2] {
    const STEPS: usize = 2000;
    let slope = |[q, p, e, _]: [f64; 4]| [p, -q - 0.5 * e, p - e, 0.5 * e * e];
    let moved = |y: [f64; 4], by: f64, k: [f64; 4]| [0, 1, 2, 3].map(|i| y[i] + by * k[i]);
    let h = 2.0 / STEPS as f64;
    let mut y = [1.0, 0.3, 0.0, 0.0];
    for _ in 0..STEPS {
        let first = slope(y);
        let second = slope(moved(y, 0.5 * h, first));
        let third = slope(moved(y, 0.5 * h, second));
        let fourth = slope(moved(y, h, third));
        y = [0, 1, 2, 3].map(|i| y[i] + h / 6.0 * (first[i] + 2.0 * (second[i] + third[i]) + fourth[i]));
    }
    [0.25 * y[2] * y[2], y[3]]
}

#[test]
fn with_bdf_2_what_is_stored_and_what_is_dissipated_are_of_first_order_and_their_sum_of_second() {
    let exact = of_a_maxwell_element();
    let errors = |rule: &str, steps: u32| {
        let text = format!(
            "[system]\nmass = [1.0]\nstiffness = [1.0]\n[[system.damping]]\ncoefficient = [0.5]\n\
             kernel = {{ form = \"prony\", strengths = [1.0], times = [1.0] }}\n[initial]\nposition = [1.0]\n\
             velocity = [0.3]\n{}[time]\nstep = {:?}\nsteps = {steps}\n",
            with_energies(rule),
            2.0 / f64::from(steps)
        );
        let states = run(&text).unwrap_or_else(|reason| panic!("{reason}\n{text}"));
        let columns = &states.last().expect("a state").columns;
        let [stored, dissipated] = [0, 1].map(|k| columns[k] - exact[k]);
        [stored, dissipated, stored + dissipated]
    };
    for (rule, orders) in [(RULES[1], [1.0, 1.0, 2.0]), (RULES[2], [2.0; 3])] {
        let (coarse, fine) = (errors(rule, 200), errors(rule, 400));
        for k in 0..3 {
            let order = (coarse[k] / fine[k]).log2();
            assert!((order - orders[k]).abs() < 0.1, "{rule}, {k}: {order}, {coarse:?} {fine:?}");
        }
        assert!(rule != RULES[1] || fine[0] * fine[1] < 0.0, "{fine:?}");
    }
}

/// Schemes with their order in q, p and the energy for a start at rest in Caputo's form.
const SCHEMES: [(&str, f64); 3] = [
    ("[scheme]\nkind = \"low-order\"\nkappa = 0.5\n[convolution]\norder = 2\nat = \"nodes\"\n", 2.0),
    ("[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 2\n", 3.0),
    ("[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 2\n", 3.0),
];

#[test]
fn position_momentum_and_energy_have_the_order_of_the_scheme() {
    let mut numbers = noise(22);
    let mut wrong = Wrong::default();
    const DRAWS: usize = 12 * FORMS;
    for index in 0..DRAWS {
        let kernel = draw(index, &mut numbers);
        let (scheme, order) = SCHEMES[index / FORMS % SCHEMES.len()];
        let riemann_liouville = index % 2 == 1;
        // Stages of order 2 follow a jump to the order 3 − µ, where their sums are of the variational scheme.
        let order = if riemann_liouville && scheme == SCHEMES[1].0 { order - kernel.growth } else { order };
        let oscillator = Oscillator { rho: 0.4, position: 0.8, velocity: 0.3, riemann_liouville, kernel };
        let exact = oscillator.exact(2.0);
        let mut errors = Vec::new();
        let mut shown = String::new();
        for steps in [100, 200] {
            shown = oscillator
                .text(&format!("{scheme}[time]\nstep = {:?}\nsteps = {steps}\n", 2.0 / f64::from(steps)));
            match run(&shown) {
                Ok(states) => {
                    let last = states.last().expect("a state");
                    let found = [last.position[0], last.momentum[0], last.energy];
                    errors.push([0, 1, 2].map(|k| (found[k] - exact[k]).abs()));
                }
                Err(_) if oscillator.kernel.is_narrow => break,
                Err(reason) => {
                    wrong.note(&format!("refused: {reason}"), &shown);
                    break;
                }
            }
        }
        let [coarse, fine] = errors[..] else { continue };
        for k in 0..3 {
            // Errors that change their sign between the two steps are told by their size.
            let step = 2.0 / 200.0_f64;
            let bound = max_or_nan(coarse[k] / 2f64.powf(order - 0.5), 0.05 * step.powf(order));
            let is_of_the_order = fine[k] <= max_or_nan(bound, 1e-11);
            if !is_of_the_order {
                wrong.note(
                    &format!("{}: {:e} after {:e}", ["q", "p", "energy"][k], fine[k], coarse[k]),
                    &shown,
                );
            }
        }
    }
    wrong.none(DRAWS);
}

#[test]
fn tolerances_are_kept() {
    let mut numbers = noise(23);
    let mut wrong = Wrong::default();
    const DRAWS: usize = 5 * FORMS;
    for index in 0..DRAWS {
        let kernel = draw(index, &mut numbers);
        let tolerance = [1e-4, 1e-7, 1e-9][index % 3];
        let oscillator =
            Oscillator { rho: 0.3, position: 1.0, velocity: 0.3, riemann_liouville: index % 2 == 1, kernel };
        let text = oscillator.text(&format!(
            "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 3\n\
             [time]\ngrid = \"adaptive\"\nend = 3.0\ntolerance = {tolerance:e}\n"
        ));
        match run(&text) {
            Err(_) if oscillator.kernel.is_narrow => {}
            Err(reason) => wrong.note(&format!("refused: {reason}"), &text),
            Ok(states) => {
                let last = states.last().expect("a state");
                let [q, p, _] = oscillator.exact(last.time);
                let error = max_or_nan((last.position[0] - q).abs(), (last.momentum[0] - p).abs());
                if !(last.time == 3.0 && error <= 10.0 * tolerance) {
                    wrong.note(&format!("{error:e} at {}", last.time), &text);
                }
            }
        }
    }
    wrong.none(DRAWS);
}

/// How often a function turns around 0 along a path, to whole numbers.
fn turns(of: &dyn Fn(Complex<f64>) -> Complex<f64>, path: &dyn Fn(f64) -> Complex<f64>) -> f64 {
    let (mut place, mut step, mut sum) = (0.0_f64, 1e-3, 0.0);
    let mut before = of(path(0.0));
    while place < 1.0 {
        let next = (place + step).min(1.0);
        let value = of(path(next));
        let turn = (value / before).arg();
        if turn.abs() > 0.3 && step > 1e-12 {
            step *= 0.5;
            continue;
        }
        (sum, place, before) = (sum + turn, next, value);
        step = (2.0 * step).min(2e-3);
    }
    sum / std::f64::consts::TAU
}

#[test]
fn poles_are_as_many_as_the_argument_principle_says() {
    const BETWEEN: f64 = std::f64::consts::PI - 1e-3;
    let (smallest, largest) = (1e-8_f64, 1e8_f64);
    let mut numbers = noise(24);
    let mut wrong = Wrong::default();
    const DRAWS: usize = 12 * FORMS;
    for index in 0..DRAWS {
        let kernel = draw(index, &mut numbers);
        let rho = [0.02, 0.5, 5.0, 200.0][index / FORMS % 4];
        let oscillator = Oscillator { rho, position: 1.0, velocity: 0.0, riemann_liouville: false, kernel };
        let text = oscillator.text("[time]\nstep = 0.01\nsteps = 1\n");
        let f = |s: Complex<f64>| oscillator.characteristic(s);
        let ray = |x: f64, angle: f64| Complex::from_polar(smallest * (largest / smallest).powf(x), angle);
        // Around the upper half-plane without a thin sector at the cut.
        let around = turns(&f, &|x| ray(x, 0.0))
            + turns(&f, &|x| Complex::from_polar(largest, x * BETWEEN))
            + turns(&f, &|x| ray(1.0 - x, BETWEEN))
            + turns(&f, &|x| Complex::from_polar(smallest, (1.0 - x) * BETWEEN));
        let scenario: Scenario = text.parse().unwrap_or_else(|error| panic!("{error}\n{text}"));
        let linearised = Linearised::new(&scenario, &[0.0]).unwrap();
        match linearised.poles() {
            // K is infinite where its cut begins.
            Err(reason) if oscillator.kernel.keys.contains("order = 1.0, power") => {
                assert!(reason.contains("cannot be told apart"), "{reason}\n{text}");
            }
            Err(reason) => wrong.note(&format!("refused: {reason}"), &text),
            Ok(poles) => {
                let above = poles.iter().filter(|pole| pole.place.im > 0.0 && pole.place.arg() < BETWEEN);
                let count = above.clone().count();
                let is_root = |s: Complex<f64>| {
                    f(s).norm() <= 1e-8 * (s.norm_sqr() + 1.0 + (f(s) - s * s - 1.0).norm())
                };
                if (around - count as f64).abs() > 1e-6 || !above.clone().all(|pole| is_root(pole.place)) {
                    let found: Vec<_> = poles.iter().map(|pole| pole.place).collect();
                    wrong.note(&format!("{around} around, {count} found: {found:?}"), &text);
                }
            }
        }
    }
    wrong.none(DRAWS);
}
