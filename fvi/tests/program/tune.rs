//! `fvi tune`: margins by a scan written here, loops by runs of the plant, refusals.

use crate::workplace::{Workplace, text};
use fvi_core::min_or_nan;
use fvi_fft::sums::max_or_nan;
use serde_json::Value;
use std::f64::consts::PI;
use std::fs;

/// A complex number, by itself: nothing of the program's arithmetic takes part.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Complex(pub(crate) f64, pub(crate) f64);

impl Complex {
    pub(crate) fn plus(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }

    pub(crate) fn times(self, other: Self) -> Self {
        Self(self.0 * other.0 - self.1 * other.1, self.0 * other.1 + self.1 * other.0)
    }

    pub(crate) fn scaled(self, factor: f64) -> Self {
        Self(self.0 * factor, self.1 * factor)
    }

    pub(crate) fn inverse(self) -> Self {
        let size = self.0 * self.0 + self.1 * self.1;
        Self(self.0 / size, -self.1 / size)
    }

    pub(crate) fn size(self) -> f64 {
        self.0.hypot(self.1)
    }

    pub(crate) fn phase(self) -> f64 {
        self.1.atan2(self.0)
    }

    pub(crate) fn power(self, exponent: f64) -> Self {
        let (size, phase) = (self.size().powf(exponent), exponent * self.phase());
        Self(size * phase.cos(), size * phase.sin())
    }

    /// Its power, for a number of size 1.
    pub(crate) fn power_of_a_turn(self, exponent: i32) -> Self {
        let phase = f64::from(exponent) * self.phase();
        Self(phase.cos(), phase.sin())
    }
}

const ONE: Complex = Complex(1.0, 0.0);

/// Tunes; the record.
pub(crate) fn tune(place: &Workplace, problem: &str) -> Value {
    place.write("plant.toml", problem);
    let output = place.fvi(&["tune", "plant.toml", "--out", "out"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    serde_json::from_str(&fs::read_to_string(place.path("out").join("tune.json")).unwrap()).unwrap()
}

pub(crate) fn number(record: &Value, path: &str) -> f64 {
    let value = path.split('.').fold(record, |value, key| &value[key]);
    value.as_f64().unwrap_or_else(|| panic!("{path}: {value}"))
}

/// C(iω) of a record in the parallel form without filter.
fn law(record: &Value) -> impl Fn(f64) -> Complex + use<> {
    let [kp, ki, lambda, kd, mu] = ["kp", "ki", "lambda", "kd", "mu"].map(|key| number(record, key));
    move |omega| {
        let s = Complex(0.0, omega);
        Complex(kp, 0.0).plus(s.power(-lambda).scaled(ki)).plus(s.power(mu).scaled(kd))
    }
}

/// The example of the repository, with a band in place of a frequency.
fn liquid_level() -> String {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/tunings/liquid-level.toml");
    let text = fs::read_to_string(file).unwrap();
    assert!(text.contains("at = 10,") && text.contains("sample = 1.0"));
    // With samples as short as these the sampled loop is nearly that in continuous time.
    text.replace("at = 10,", "from = 10, to = 100,").replace("sample = 1.0", "sample = 1e-3")
}

#[test]
fn margins_are_those_of_a_dense_scan() {
    let place = Workplace::new();
    let record = tune(&place, &liquid_level());
    let law = law(&record);
    let open = |omega: f64| {
        let plant = Complex(1.0, 433.33 * omega).inverse().scaled(3.13);
        plant.times(Complex((50.0 * omega).cos(), -(50.0 * omega).sin())).times(law(omega))
    };
    let crossed = open(0.008);
    assert!((crossed.size() - 1.0).abs() < 1e-5, "{crossed:?}");
    assert!((crossed.phase().to_degrees() + 120.0).abs() < 1e-3);
    let slope = (open(0.008 * 1.0001).phase() - open(0.008 / 1.0001).phase()) / (2.0 * 1.0001f64.ln());
    assert!(slope.abs() < 1e-5, "{slope}");
    let sensitivity = |omega: f64| ONE.plus(open(omega)).size().recip();
    let complementary = |omega: f64| open(omega).size() * sensitivity(omega);
    assert!(20.0 * sensitivity(0.001).log10() <= -20.0 + 1e-3);
    let scan = |from: f64, to: f64| (0..=200_000).map(move |k| from * (to / from).powf(f64::from(k) / 2e5));
    assert!(scan(10.0, 100.0).all(|omega| 20.0 * complementary(omega).log10() <= -20.0));
    let largest = |size: &dyn Fn(f64) -> f64| scan(1e-5, 10.0).map(size).fold(0.0, max_or_nan);
    for (key, found) in [("margins.ms", largest(&sensitivity)), ("margins.mt", largest(&complementary))] {
        assert!((number(&record, key) / found - 1.0).abs() < 1e-6, "{key}: {found}");
    }
    // The gain margin: the first frequency at which L is a negative number.
    let before: Vec<f64> = scan(0.008, 1.0).collect();
    let pair = before.windows(2).find(|pair| open(pair[0]).1 < 0.0 && open(pair[1]).1 >= 0.0).unwrap();
    let margin = open(pair[0]).size().recip();
    assert!((number(&record, "margins.gain_margin") / margin - 1.0).abs() < 1e-3, "{margin}");
    let delay = 60f64.to_radians() / 0.008;
    assert!((number(&record, "margins.delay_margin") / delay - 1.0).abs() < 1e-4);
    for name in ["controller.toml", "loop.csv", "steps.csv", "bode-magnitude.svg", "nyquist.svg", "step.svg"]
    {
        assert!(fs::metadata(place.path("out").join(name)).unwrap().len() > 100, "{name}");
    }
}

/// A first-order plant as a scenario: p' = −p/2 + 3 u, seen as 0.5 p, and the time that a run has.
const FIRST_ORDER: &str = "
[system]
mass = [1.0]
potential = \"0\"
[[system.damping]]
order = 1.0
coefficient = [0.5]
[time]
step = 0.005
end = 12.0
";

#[test]
fn a_run_of_the_plant_with_the_controller_makes_the_step_that_was_foretold() {
    let place = Workplace::new();
    place.write("plant-alone.toml", FIRST_ORDER);
    let problem = "
plant = { scenario = \"plant-alone.toml\", measures = \"0.5*p0\", drives = [3.0], dead_time = 0.1 }
controller = { structure = \"pi\", sample = 0.005, setpoint_weights = [0.6, 0.0] }
specification = { crossover = 2.0, phase_margin = 65, flat_phase = true }
";
    let record = tune(&place, problem);
    // The same plant by its formula.
    let formula = problem.replace(
        "scenario = \"plant-alone.toml\", measures = \"0.5*p0\", drives = [3.0], dead_time = 0.1",
        "transfer = \"1.5*exp(-0.1*s)/(s + 0.5)\"",
    );
    let by_formula = tune(&Workplace::new(), &formula);
    for key in ["kp", "ki", "lambda", "margins.ms", "margins.phase_margin", "sampled_margins.ms"] {
        let (one, other) = (number(&record, key), number(&by_formula, key));
        assert!((one / other - 1.0).abs() < 1e-9, "{key}: {one} {other}");
    }
    let controller = fs::read_to_string(place.path("out").join("controller.toml")).unwrap();
    place.write("loop.toml", &format!("{FIRST_ORDER}\n{controller}"));
    let output = place.fvi(&["run", "loop.toml", "--out", "run"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let rows = |path: &str| -> Vec<Vec<f64>> {
        let table = fs::read_to_string(place.path(path)).unwrap();
        table
            .lines()
            .skip(1)
            .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
            .collect()
    };
    let (motion, foretold) = (rows("run/trajectory.csv"), rows("out/steps.csv"));
    let (mut compared, mut worst) = (0, 0f64);
    for row in &foretold {
        let Some(step) = motion.iter().rposition(|state| state[0] <= row[0] + 1e-9) else { continue };
        if step + 1 < motion.len() {
            let part = (row[0] - motion[step][0]) / 0.005;
            let [before, after] = [step, step + 1].map(|step| 0.5 * motion[step][2]);
            worst = max_or_nan(worst, (before + part * (after - before) - row[1]).abs());
            compared += 1;
        }
    }
    // Samples of 5 ms make some hundredths of a unit at a crossover of 2.
    assert!(compared > 100 && worst < 0.02, "{compared} {worst}");
}

#[test]
fn samples_that_make_a_loop_unstable_are_refused_and_runs_agree() {
    let place = Workplace::new();
    place.write("plant-alone.toml", FIRST_ORDER);
    // A rule, whose gains do not know the samples.
    let problem = |sample: f64| {
        format!(
            "plant = {{ scenario = \"plant-alone.toml\", measures = \"p0\", drives = [1.0], dead_time = 0.3 }}\n\
             controller = {{ structure = \"pi\", sample = {sample} }}\n\
             specification = {{ rule = \"ziegler-nichols\" }}\n"
        )
    };
    // The largest sample time that is taken, by halves.
    let accepted = |sample: f64| {
        place.write("plant.toml", &problem(sample));
        let output = place.fvi(&["tune", "plant.toml", "--out", "out"]);
        let message = text(&output.stderr);
        assert!(output.status.success() || message.contains("controller.sample"), "{message}");
        output.status.success()
    };
    assert!(accepted(0.05) && !accepted(0.9));
    let (mut good, mut bad) = (0.05, 0.9);
    while bad - good > 0.006 {
        let middle = f64::round((good + bad) / 2.0 / 0.005) * 0.005;
        if accepted(middle) { good = middle } else { bad = middle }
    }
    assert!(accepted(0.005));
    let controller = fs::read_to_string(place.path("out").join("controller.toml")).unwrap();
    // The size of the last oscillations against those before, at sample times on either side.
    let grows = |sample: f64| {
        let controller = controller.replace("sample = 0.005", &format!("sample = {sample}"));
        let plant = FIRST_ORDER.replace("end = 12.0", "end = 400.0");
        place.write("loop.toml", &format!("{plant}\n{controller}"));
        let output = place.fvi(&["run", "loop.toml", "--out", "run"]);
        let table = fs::read_to_string(place.path("run").join("trajectory.csv")).unwrap();
        let outputs: Vec<f64> =
            table.lines().skip(1).map(|line| line.split(',').nth(4).unwrap().parse().unwrap()).collect();
        let spread = |part: &[f64]| {
            part.iter().copied().fold(f64::NEG_INFINITY, max_or_nan)
                - part.iter().copied().fold(f64::INFINITY, min_or_nan)
        };
        let quarter = outputs.len() / 4;
        let [before, after] = [quarter, 3 * quarter].map(|at| spread(&outputs[at..at + quarter]));
        !output.status.success() || after > before
    };
    let step = |sample: f64, part: f64| f64::round(sample * part / 0.005) * 0.005;
    assert!(!grows(step(good, 0.97)) && grows(step(bad, 1.03)), "{good} {bad}");
}

#[test]
fn rules_and_bounds_give_what_they_say() {
    let place = Workplace::new();
    let plant =
        |rest: &str| format!("plant = {{ gain = 2.0, time_constant = 1.0, dead_time = 0.2 }}\n{rest}");
    // Lambda tuning: the loop is e^{−Ls}/((λ + L) s).
    let record = tune(
        &place,
        &plant(
            "controller = { structure = \"pi\", sample = 1e-3 }\n\
             specification = { rule = \"lambda\", closed_loop_time = 0.3 }\n",
        ),
    );
    assert!((number(&record, "kp") - 1.0).abs() < 1e-12 && (number(&record, "ki") - 1.0).abs() < 1e-12);
    assert!((number(&record, "margins.gain_margin") - 0.5 * PI / 0.2 * 0.5).abs() < 1e-6);
    // SIMC with its own closed loop time, L.
    let record = tune(
        &place,
        &plant("controller = { structure = \"pi\", sample = 1e-3 }\nspecification = { rule = \"simc\" }\n"),
    );
    assert!((number(&record, "kp") - 1.0 / (2.0 * 0.4)).abs() < 1e-12);
    assert!((number(&record, "kp") / number(&record, "ki") - 1.0).abs() < 1e-12);
    // Ziegler and Nichols: the ultimate point solves tan(ωL) = −ωT.
    let record = tune(
        &place,
        &plant("controller = { sample = 1e-3 }\nspecification = { rule = \"ziegler-nichols\" }\n"),
    );
    let omega = number(&record, "ultimate.frequency");
    assert!((omega * 0.2 + omega.atan() - PI).abs() < 1e-9);
    assert!((number(&record, "kp") - 0.6 * omega.hypot(1.0) / 2.0).abs() < 1e-9);
    // Ms: the largest integral gain, so that a little more breaks it.
    let record = tune(
        &place,
        &plant(
            "controller = { structure = \"pi\", lambda = 0.9, sample = 1e-6 }\nspecification = { ms = 1.4 }\n",
        ),
    );
    assert!((number(&record, "margins.ms") - 1.4).abs() < 1e-3, "{record}");
    assert!(number(&record, "sampled_margins.ms") <= 1.4 + 1e-6, "{record}");
    let [kp, ki] = ["kp", "ki"].map(|key| number(&record, key));
    let largest = |kp: f64, ki: f64| {
        let size = |k: u32| {
            let omega = 1e-3 * 1e6f64.powf(f64::from(k) / 4e4);
            let law = Complex(kp, 0.0).plus(Complex(0.0, omega).power(-0.9).scaled(ki));
            let plant = Complex(1.0, omega).inverse().scaled(2.0);
            let open = law.times(plant).times(Complex((0.2 * omega).cos(), -(0.2 * omega).sin()));
            ONE.plus(open).size().recip()
        };
        (0..=40_000).map(size).fold(0.0, max_or_nan)
    };
    for share in [-0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04] {
        assert!(largest(kp * (1.0 + share), 1.01 * ki) > 1.4, "{share}");
    }
    // A rod that is heated at one end and seen at the other: poles at −π²(n + ½)², none lost to overflow.
    let record = tune(
        &place,
        "plant = { transfer = \"1/cosh(sqrt(s))\" }\ncontroller = { structure = \"pi\", sample = 1e-3 }\n\
         specification = { ms = 1.5 }\n",
    );
    assert!((number(&record, "sampled_margins.ms") - 1.5).abs() < 1e-3, "{record}");
    // cosh((1 + i) x) = cosh x cos x + i sinh x sin x is a negative number at x = √(ω/2) = π.
    assert!((number(&record, "ultimate.frequency") - 2.0 * PI * PI).abs() < 1e-9);
    // The series form with its filter goes into the table of a scenario.
    let record = tune(
        &place,
        &plant(
            "controller = { sample = 1e-3 }\n\
             specification = { rule = \"padula-visioli\", ms = 2.0, purpose = \"load\" }\n",
        ),
    );
    assert_eq!(record["form"], "series");
    let table = fs::read_to_string(place.path("out").join("controller.toml")).unwrap();
    for key in ["form = \"series\"", "integral_time", "derivative_time", "filter_ratio", "mu = 1.1"] {
        assert!(table.contains(key), "{key}: {table}");
    }
}

/// The filter that a refusal advises is one that the rule takes.
#[test]
fn a_rule_with_a_derivative_takes_a_filter() {
    let place = Workplace::new();
    let problem = |filter: &str| {
        format!(
            "plant = {{ gain = 1.0, time_constant = 1.0, dead_time = 5.0 }}\n\
             controller = {{ structure = \"pid\", sample = 0.1{filter} }}\n\
             specification = {{ rule = \"ziegler-nichols\" }}\n"
        )
    };
    place.write("plant.toml", &problem(""));
    let output = place.fvi(&["tune", "plant.toml", "--out", "out"]);
    let message = text(&output.stderr);
    assert!(!output.status.success() && message.contains("controller.derivative_filter"), "{message}");
    let record = tune(&place, &problem(", derivative_filter = 0.5"));
    assert!(number(&record, "kd") > 0.0 && number(&record, "sampled_margins.ms") > 1.0);
    assert_eq!(number(&record, "derivative_filter.time"), 0.5);
}

#[test]
fn a_rule_leads_to_the_same_loop_whatever_the_unit_of_time_is() {
    let place = Workplace::new();
    let of = |unit: f64, structure: &str, rule: &str| {
        let problem = format!(
            "plant = {{ gain = 2.0, time_constant = {:?}, dead_time = {:?} }}\n\
             controller = {{ structure = {structure:?}, sample = {:?} }}\nspecification = {{ {rule} }}\n",
            1.5 * unit,
            0.9 * unit,
            1e-3 * unit
        );
        let record = tune(&place, &problem);
        ["margins.ms", "margins.phase_margin", "sampled_margins.ms"].map(|key| number(&record, key))
    };
    for (structure, rule) in [
        ("pid", "rule = \"padula-visioli\", ms = 2.0, purpose = \"load\""),
        ("pid", "rule = \"padula-visioli\", ms = 1.4, purpose = \"setpoint\""),
        ("pi", "rule = \"simc\""),
        ("pi", "rule = \"ziegler-nichols\""),
    ] {
        let seconds = of(1.0, structure, rule);
        for unit in [1e-3, 60.0, 1e6] {
            for (one, other) in of(unit, structure, rule).into_iter().zip(seconds) {
                assert!((one / other - 1.0).abs() < 1e-6, "{rule}, {unit}: {one}, {other}");
            }
        }
    }
}

#[test]
fn a_relay_finds_the_ultimate_point_of_a_scenario() {
    let place = Workplace::new();
    place.write("plant-alone.toml", &FIRST_ORDER.replace("step = 0.005", "step = 0.002"));
    let record = tune(
        &place,
        "plant = { scenario = \"plant-alone.toml\", measures = \"p0\", drives = [1.0], dead_time = 0.3 }\n\
         controller = { structure = \"pi\", sample = 0.002 }\n\
         specification = { rule = \"ziegler-nichols\" }\n\
         relay = { amplitude = 2.0 }\n",
    );
    // p' = −p/2 + u, 0.3 later. Under a relay p rises for the dead time and falls as long, between ±a:
    // a = d (1 − e^{−L/T}) T and T_u = 2 (L + T ln(2 − e^{−L/T})), T = 2.
    let share = (-0.15f64).exp();
    let period = 2.0 * (0.3 + 2.0 * (2.0 - share).ln());
    let amplitude = 2.0 * 2.0 * (1.0 - share);
    let found = [number(&record, "relay.frequency"), number(&record, "relay.oscillation")];
    assert!((found[0] * period / (2.0 * PI) - 1.0).abs() < 0.01, "{found:?} {period}");
    assert!((found[1] / amplitude - 1.0).abs() < 0.02, "{found:?} {amplitude}");
    let describing = number(&record, "relay.describing_gain");
    assert!((describing - 4.0 * 2.0 / (PI * found[1])).abs() < 1e-9);
    // The describing function is off by what it leaves out, here by less than a fifth.
    let exact = number(&record, "ultimate.gain");
    assert!((describing / exact - 1.0).abs() < 0.25, "{describing} {exact}");
    assert!((number(&record, "kp") - 0.45 * describing).abs() < 1e-9);
}

/// A plant K Π(s + a_i)/Π(s + b_j)/Π(s² + c_k s + d_k) e^{−L s}, L a number of samples, with simple poles.
struct Plant<'a> {
    gain: f64,
    zeros: &'a [f64],
    poles: &'a [f64],
    pairs: &'a [(f64, f64)],
    delay: u32,
}

impl Plant<'_> {
    fn formula(&self, sample: f64) -> String {
        let real = |roots: &[f64]| roots.iter().map(|root| format!("*(s + ({root:?}))")).collect::<String>();
        let pairs: String = self.pairs.iter().map(|(c, d)| format!("*(s^2 + {c:?}*s + {d:?})")).collect();
        let delay = f64::from(self.delay) * sample;
        format!("{:?}{}/(1{}{pairs})*exp(-{delay:?}*s)", self.gain, real(self.zeros), real(self.poles))
    }

    /// Poles, and residues there.
    fn fractions(&self) -> Vec<(Complex, Complex)> {
        let mut poles: Vec<Complex> = self.poles.iter().map(|&b| Complex(-b, 0.0)).collect();
        for &(c, d) in self.pairs {
            let beside = (d - 0.25 * c * c).sqrt();
            poles.extend([Complex(-0.5 * c, beside), Complex(-0.5 * c, -beside)]);
        }
        let residue = |index: usize| {
            let mut value = Complex(self.gain, 0.0);
            for &a in self.zeros {
                value = value.times(poles[index].plus(Complex(a, 0.0)));
            }
            for (other, pole) in poles.iter().enumerate() {
                if other != index {
                    value = value.times(poles[index].plus(pole.scaled(-1.0)).inverse());
                }
            }
            value
        };
        (0..poles.len()).map(|index| (poles[index], residue(index))).collect()
    }
}

fn exponential(z: Complex) -> Complex {
    Complex(z.0.exp() * z.1.cos(), z.0.exp() * z.1.sin())
}

/// The largest |S| and |T| of the sampled loop of a record, the least phase margin of all crossovers in
/// degrees, and the highest of them, by 40 000 frequencies: the plant behind a hold from its poles.
fn sampled(plant: &Plant<'_>, sample: f64, record: &Value) -> [f64; 4] {
    let [kp, ki, lambda, kd, mu] = ["kp", "ki", "lambda", "kd", "mu"].map(|key| number(record, key));
    let filter = record["derivative_filter"]["time"].as_f64();
    let fractions = plant.fractions();
    let open = |omega: f64| {
        let z = exponential(Complex(0.0, omega * sample));
        // From a pole p with residue c, held for h: c (e^{ph} − 1)/p/(z − e^{ph}).
        let mut held = Complex(0.0, 0.0);
        for &(pole, residue) in &fractions {
            let grown = exponential(pole.scaled(sample));
            let share = if pole.size() == 0.0 {
                Complex(sample, 0.0)
            } else {
                grown.plus(Complex(-1.0, 0.0)).times(pole.inverse())
            };
            held = held.plus(residue.times(share).times(z.plus(grown.scaled(-1.0)).inverse()));
        }
        let difference = ONE.plus(z.inverse().scaled(-1.0)).scaled(1.0 / sample);
        let mut law = Complex(kp, 0.0).plus(difference.power(-lambda).scaled(ki));
        if kd != 0.0 {
            let through = ONE.plus(difference.scaled(filter.unwrap_or(0.0)));
            law = law.plus(difference.power(mu).scaled(kd).times(through.inverse()));
        }
        held.times(law).times(exponential(Complex(0.0, -f64::from(plant.delay) * omega * sample)))
    };
    let (low, high) = (1e-5 / sample, PI / sample * (1.0 - 1e-12));
    let mut found = [0.0, 0.0, f64::INFINITY, 0.0];
    let mut last: Option<Complex> = None;
    for k in 0..=40_000 {
        let omega = low * (high / low).powf(f64::from(k) / 4e4);
        let value = open(omega);
        let below = ONE.plus(value).size();
        found[0] = max_or_nan(found[0], 1.0 / below);
        found[1] = max_or_nan(found[1], value.size() / below);
        if last.is_some_and(|last| (last.size() > 1.0) != (value.size() > 1.0)) {
            found[2] = min_or_nan(found[2], value.scaled(-1.0).phase().to_degrees().abs());
            found[3] = omega;
        }
        last = Some(value);
    }
    found
}

/// Plant, sample, structure, crossover, phase margin, Ms and Mt, and whether there is such a controller.
type Case<'a> = (Plant<'a>, f64, &'a str, [Option<f64>; 4], bool);

#[test]
fn bounds_hold_for_the_sampled_loop_at_all_frequencies_or_the_exit_code_is_1() {
    let plain = Plant { gain: 1.0, zeros: &[], poles: &[], pairs: &[], delay: 0 };
    let oscillator = Plant { gain: 9.0, poles: &[1.0], pairs: &[(2.0, 9.0)], ..plain };
    let slow = Plant { gain: 1.0, poles: &[0.9, 1.0, 1.1, 1.3], ..plain };
    let cases: [Case<'_>; 14] = [
        (
            Plant { gain: 0.0506, poles: &[0.0], delay: 12, ..plain },
            0.5,
            "pi",
            [None, None, Some(1.4), None],
            true,
        ),
        (Plant { poles: &[0.0], ..plain }, 0.01, "pi", [None, None, Some(1.4), None], true),
        (Plant { poles: &[0.0, 1.0], ..plain }, 0.01, "pi", [None, None, Some(1.4), Some(1.4)], true),
        (Plant { poles: &[0.0, 1.0], ..plain }, 0.01, "pd", [None, None, Some(1.7), None], true),
        (
            Plant { zeros: &[-1.0], gain: -1.0, poles: &[0.9, 1.0, 1.1], ..plain },
            0.02,
            "pi",
            [None, None, Some(1.4), None],
            true,
        ),
        (Plant { ..oscillator }, 0.01, "pid", [Some(1.0), Some(60.0), Some(1.7), None], true),
        (Plant { ..oscillator }, 0.05, "pid", [Some(6.0), Some(60.0), Some(1.7), None], true),
        (Plant { ..oscillator }, 0.01, "pi", [Some(0.8), Some(60.0), None, None], true),
        (
            Plant { gain: 4.0, pairs: &[(0.2, 4.0)], ..plain },
            0.01,
            "pi",
            [Some(0.5), Some(60.0), None, None],
            false,
        ),
        (Plant { ..slow }, 0.1, "pid", [Some(0.5), Some(60.0), Some(1.6), None], true),
        (Plant { ..slow }, 0.1, "pi", [Some(3.0), Some(60.0), None, None], false),
        (
            Plant { gain: 0.02, poles: &[0.02], delay: 20, ..plain },
            0.5,
            "pid",
            [Some(0.1), Some(50.0), None, None],
            true,
        ),
        (
            Plant { gain: 0.02, poles: &[0.02], delay: 2, ..plain },
            5.0,
            "pi",
            [Some(0.03), Some(60.0), Some(1.5), None],
            true,
        ),
        (
            Plant { poles: &[-0.5], delay: 20, ..plain },
            0.01,
            "pid",
            [Some(2.0), Some(45.0), Some(1.9), None],
            true,
        ),
    ];
    let place = Workplace::new();
    for (index, (plant, sample, structure, [crossover, margin, ms, mt], exists)) in
        cases.into_iter().enumerate()
    {
        let filter = if structure == "pi" { "" } else { "derivative_filter = 0.02\n" };
        let mut problem = format!(
            "[plant]\ntransfer = \"{}\"\n[controller]\nstructure = \"{structure}\"\nsample = {sample:?}\n{filter}[specification]\n",
            plant.formula(sample)
        );
        let keys = [("crossover", crossover), ("phase_margin", margin), ("ms", ms), ("mt", mt)];
        for (key, value) in keys {
            problem += &value.map_or_else(String::new, |value| format!("{key} = {value:?}\n"));
        }
        place.write("plant.toml", &problem);
        let output = place.fvi(&["tune", "plant.toml", "--out", "out"]);
        let message = text(&output.stderr);
        let code = if exists { 0 } else { 1 };
        assert_eq!(output.status.code(), Some(code), "{index}: {problem}\n{message}");
        if !exists {
            assert!(
                message.contains(" instead of at ") || message.contains("no gains"),
                "{index}: {message}"
            );
            continue;
        }
        let record = fs::read_to_string(place.path("out").join("tune.json")).unwrap();
        let record: Value = serde_json::from_str(&record).unwrap();
        let [largest_s, largest_t, least_margin, highest] = sampled(&plant, sample, &record);
        let said = format!("{index}: {largest_s} {largest_t} {least_margin} {highest}: {record}");
        assert!(largest_s <= ms.unwrap_or(3.0) + 1e-3 && largest_t <= mt.unwrap_or(3.5) + 1e-3, "{said}");
        assert!((number(&record, "sampled_margins.ms") / largest_s - 1.0).abs() < 1e-3, "{said}");
        if let (Some(crossover), Some(margin)) = (crossover, margin) {
            assert!(least_margin >= margin - 0.1 && (highest / crossover - 1.0).abs() < 1e-3, "{said}");
        } else {
            // The largest gain, so that the bound is reached.
            assert!(largest_s > 0.995 * ms.unwrap() || largest_t > 0.995 * mt.unwrap(), "{said}");
        }
    }
    // The integrator with dead time has the gains of its bound, not those of a loop that hardly moves.
    let problem = "plant = { transfer = \"0.0506*exp(-6*s)/s\" }\ncontroller = { structure = \"pi\", sample = 0.5 }\n\
                   specification = { ms = 1.4 }\n";
    let record = tune(&place, problem);
    assert!(
        (number(&record, "kp") - 0.89).abs() < 0.03 && (number(&record, "ki") - 0.0211).abs() < 5e-4,
        "{record}"
    );
}

/// Far beyond the crossover numerator and denominator are zero: their quotient is the plant all the same.
#[test]
fn parts_of_a_plant_that_vanish_together_leave_their_quotient() {
    let place = Workplace::new();
    let gains = |transfer: &str| {
        let record = tune(
            &place,
            &format!(
                "plant = {{ transfer = \"{transfer}\" }}\n\
                 controller = {{ structure = \"pi\", lambda = 1.0, sample = 1e-9 }}\nspecification = {{ ms = 1.4 }}\n"
            ),
        );
        ["kp", "ki", "sampled_margins.ms"].map(|key| number(&record, key))
    };
    let plain = gains("exp(-s)/(s + 1)");
    for (found, known) in gains("exp(-s)*exp(-s^0.5)/(exp(-s^0.5)*(s + 1))").into_iter().zip(plain) {
        assert!((found / known - 1.0).abs() < 1e-6, "{found} instead of {known}");
    }
}

#[test]
fn what_cannot_be_met_is_said_with_what_is_missed() {
    let place = Workplace::new();
    let cases = [
        (liquid_level().replacen("below = -20", "below = -60", 1), "|S(iω)| in dB at ω = 0.001 is -"),
        (
            "plant = { transfer = \"1/(s - 1)\" }\ncontroller = { structure = \"pi\", sample = 0.01 }\n\
             specification = { ms = 1.5 }\n"
                .to_owned(),
            "motions that grow",
        ),
        (
            "plant = { transfer = \"1/s^2\" }\ncontroller = { structure = \"pi\", sample = 1e-6 }\n\
             specification = { crossover = 1.0, phase_margin = 45 }\n"
                .to_owned(),
            "would have to turn it by 45.00°",
        ),
        (
            "plant = { transfer = \"exp(-s)/(s + 1)\" }\ncontroller = { structure = \"pd\", mu = 1.5, sample = 0.01 }\n\
             specification = { crossover = 0.5, phase_margin = 170 }\n"
                .to_owned(),
            "the highest crossover is",
        ),
    ];
    for (problem, part) in cases {
        place.write("plant.toml", &problem);
        let output = place.fvi(&["tune", "plant.toml", "--out", "out"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{problem}: {message}");
        assert!(message.contains("plant.toml") && message.contains(part), "{problem}: {message}");
        assert!(!place.path("out").join("tune.json").exists());
    }
}

#[test]
fn an_unstable_plant_is_tuned_although_unstable_loops_keep_the_bounds() {
    let place = Workplace::new();
    // The right gains of a plant that grows keep |S| and |T| as small as some that leave it growing do.
    for structure in ["pid", "pi"] {
        let problem = format!(
            "plant = {{ transfer = \"1/(s - 0.5)\", dead_time = 0.2 }}\n\
             controller = {{ structure = \"{structure}\", sample = 1e-3 }}\n\
             specification = {{ crossover = 2.0, phase_margin = 45 }}\n"
        );
        let record = tune(&place, &problem);
        let law = law(&record);
        let open = |omega: f64| {
            let plant =
                Complex(-0.5, omega).inverse().times(Complex((0.2 * omega).cos(), -(0.2 * omega).sin()));
            plant.times(law(omega))
        };
        // Up to what samples of 1 ms make of it.
        assert!((open(2.0).size() - 1.0).abs() < 2e-3, "{structure}");
        assert!((open(2.0).phase().to_degrees() + 135.0).abs() < 0.2, "{structure}");
        let ms =
            (1..100_000).map(|k| ONE.plus(open(1e-3 * f64::from(k))).inverse().size()).fold(0.0, max_or_nan);
        assert!(
            ms <= 2.0 + 5e-3 && (ms / number(&record, "margins.ms") - 1.0).abs() < 1e-4,
            "{structure}: {ms}"
        );
        // Nyquist: with one growing motion of the plant and L(0) = −∞ (iω)^(−λ), 1 + L turns by π + λ π/2 on
        // the way from ω = 0 to ∞, and by 2π less for each two motions of the loop that grow.
        let ends: Vec<Complex> =
            (0..40_000).map(|k| ONE.plus(open(1e-5 * (f64::from(k) * 5e-4).exp()))).collect();
        let turned: f64 = ends.windows(2).map(|pair| pair[1].times(pair[0].inverse()).phase()).sum();
        let expected = std::f64::consts::PI * (1.0 + 0.5 * number(&record, "lambda"));
        assert!((turned - expected).abs() < 0.5, "{structure}: {turned} {expected}");
    }
}

#[test]
fn mistakes_are_named_with_file_key_and_value() {
    let place = Workplace::new();
    place.write("plant-alone.toml", FIRST_ORDER);
    let base = "[plant]\ngain = 2.0\ntime_constant = 1.0\ndead_time = 0.2\n[controller]\nstructure = \"pid\"\n\
                sample = 0.01\n[specification]\ncrossover = 1.0\nphase_margin = 60\n";
    let cases = [
        ("gain = 2.0", "gain = 0", "plant.gain = 0"),
        ("time_constant = 1.0", "time_constant = -1.0", "plant.time_constant = -1.0"),
        ("time_constant = 1.0\n", "", "time_constant"),
        ("time_constant = 1.0", "time_constant = 1.0\ntransfer = \"1/s\"", "plant.transfer"),
        ("dead_time = 0.2", "dead_time = -0.2", "plant.dead_time = -0.2"),
        ("gain = 2.0\ntime_constant = 1.0", "transfer = \"exp(s)\"", "plant.transfer = \"exp(s)\""),
        ("gain = 2.0\ntime_constant = 1.0", "transfer = \"1/(s + q)\"", "q"),
        (
            "gain = 2.0\ntime_constant = 1.0",
            "scenario = \"none.toml\"\nmeasures = \"q0\"\ndrives = [1.0]",
            "none.toml",
        ),
        (
            "gain = 2.0\ntime_constant = 1.0",
            "scenario = \"plant-alone.toml\"\nmeasures = \"q1\"\ndrives = [1.0]",
            "plant.measures = \"q1\"",
        ),
        (
            "gain = 2.0\ntime_constant = 1.0",
            "scenario = \"plant-alone.toml\"\nmeasures = \"q0\"\ndrives = [1.0, 2.0]",
            "plant.drives",
        ),
        ("\"pid\"", "\"pip\"", "controller.structure = \"pip\""),
        ("\"pid\"", "\"pd\"\nlambda = 0.5", "controller.lambda"),
        ("\"pid\"", "\"pid\"\nmu = 2.0", "controller.mu = 2.0"),
        ("sample = 0.01", "sample = 0", "controller.sample = 0"),
        ("sample = 0.01\n", "", "sample"),
        ("crossover = 1.0", "crossover = 400", "specification.crossover = 400"),
        ("phase_margin = 60", "phase_margin = 180", "specification.phase_margin = 180"),
        ("phase_margin = 60", "phase_margin = 60\nms = 0.9", "specification.ms = 0.9"),
        ("phase_margin = 60", "phase_margin = 60\nsensitivity = [{ at = 0.1 }]", "below"),
        ("phase_margin = 60", "phase_margin = 60\nsensitivity = [{ from = 2, to = 1, below = 0 }]", "to = 1"),
        ("crossover = 1.0\nphase_margin = 60", "ms = 1.4", "specification.ms"),
        ("crossover = 1.0\nphase_margin = 60", "rule = \"simc\"", "specification.rule = \"simc\""),
        (
            "crossover = 1.0\nphase_margin = 60",
            "rule = \"padula-visioli\"\nms = 1.5\npurpose = \"load\"",
            "ms = 1.5",
        ),
        ("phase_margin = 60", "phase_margin = 60\nrule = \"simc\"", "specification"),
        ("phase_margin = 60", "phase_margin = 60\n[relay]\namplitude = 1.0", "relay"),
        ("phase_margin = 60", "phase_margins = 60", "specification.phase_margins"),
    ];
    for (written, mistake, part) in cases {
        assert!(base.contains(written));
        place.write("plant.toml", &base.replace(written, mistake));
        let output = place.fvi(&["tune", "plant.toml", "--out", "out"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{mistake}: {message}");
        assert!(message.contains("plant.toml") && message.contains(part), "{mistake}: {message}");
    }
    assert!(!place.path("out").exists());
}

/// Each command on the file of the one before: the plant is tuned, the loop runs with limits, noise, two
/// setpoints and a load, and its constants are those of the law that ran.
#[test]
fn a_plant_is_tuned_run_and_made_into_constants_by_one_file() {
    let place = Workplace::new();
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/tunings/two-tanks.toml");
    let output = place.fvi(&["tune", example, "--out", "tanks"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    assert!(said.contains("sought by default: Ms ≤ 2.000; sought by default: Mt ≤ 1.300"), "{said}");
    let output = place.fvi(&["run", "tanks/loop.toml", "--out", "run"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let trajectory = fs::read_to_string(place.path("run").join("trajectory.csv")).unwrap();
    let rows: Vec<Vec<f64>> = trajectory
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
        .collect();
    let at = |time: f64| rows.iter().rfind(|row| row[0] <= time).unwrap();
    let last = |row: &[f64], back: usize| row[row.len() - back];
    // At rest under both setpoints, with the steady output u = y/P(0) = y 0.0005/0.008, less the load.
    for (time, known, load) in [(299.0, 1.0, 0.0), (599.0, 2.0, 0.0), (900.0, 2.0, 0.5)] {
        let row = at(time);
        let [u, y] = [last(row, 3), last(row, 1)];
        assert!((y - known).abs() < 0.05, "{time}: {y}");
        assert!((u + load - 0.0625 * known).abs() < 0.02, "{time}: {u}");
    }
    assert!(rows.iter().all(|row| last(row, 3).abs() <= 1.0), "limits");
    // The tuned orders are in the constants.
    let output = place.fvi(&["controller", "tanks/loop.toml", "--format", "c", "--name", "tanks"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let record: Value =
        serde_json::from_str(&fs::read_to_string(place.path("tanks").join("tune.json")).unwrap()).unwrap();
    let constants = text(&output.stdout);
    let lambda = record["lambda"].as_f64().unwrap();
    assert!(constants.contains(&format!(".lambda = {lambda:e},")), "{lambda}: {constants}");
    assert!(constants.contains(".limits = {-1e0f, 1e0f},"), "{constants}");
}

/// Samples turn the phase of an integrator to −180° at π/h, whatever the gain: h z⁻¹/(1 − z⁻¹) is −h/2 there,
/// and the integral of order 1 is h/2.
#[test]
fn a_loop_that_crosses_at_the_end_of_its_band_has_a_gain_margin() {
    let place = Workplace::new();
    let sample = 0.05;
    let record = tune(
        &place,
        &format!(
            "[plant]\ntransfer = \"1/s\"\n[controller]\nstructure = \"pi\"\nsample = {sample}\n\
             [specification]\nms = 1.4\n"
        ),
    );
    let known = 2.0 / (sample * (number(&record, "kp") + 0.5 * sample * number(&record, "ki")));
    let margin = number(&record, "sampled_margins.gain_margin");
    assert!((margin / known - 1.0).abs() < 1e-3, "{margin}, {known}");
}

/// A resonance lifts |L| over 1 by 2·10⁻⁴ at twice the crossover, in an interval of 0.4 %: that is the
/// highest crossover.
#[test]
fn a_crossover_that_is_grazed_is_seen() {
    let place = Workplace::new();
    place.write(
        "plant.toml",
        "[plant]\ntransfer = \"0.11642543*exp(-0.24626731213277941*s)/(1.13275344*s^3 + 0.21058675*s^2 + s)\"\n\
         [controller]\nstructure = \"pid\"\nderivative_filter = 0.211286\nsample = 0.2112863355977637\n\
         [specification]\ncrossover = 0.473291\nphase_margin = 55\n",
    );
    let output = place.fvi(&["tune", "plant.toml", "--out", "out"]);
    if output.status.code() == Some(1) {
        return assert!(text(&output.stderr).contains("the highest crossover"), "{}", text(&output.stderr));
    }
    let record: Value =
        serde_json::from_str(&fs::read_to_string(place.path("out").join("tune.json")).unwrap()).unwrap();
    let size = |omega: f64| {
        // Sampled law and hold, without aliases, which are 10⁻³ of the rest here; the filter is beside the
        // law.
        let h = 0.211_286_335_597_763_7;
        let s = Complex(1.0 - (h * omega).cos(), (h * omega).sin()).scaled(1.0 / h);
        let [kp, ki, kd] = ["kp", "ki", "kd"].map(|key| number(&record, key));
        let filter = ONE.plus(s.scaled(0.211_286)).inverse();
        let derived = s.power(number(&record, "mu")).scaled(kd).times(filter);
        let control = Complex(kp, 0.0).plus(s.power(-number(&record, "lambda")).scaled(ki)).plus(derived);
        let i = Complex(0.0, omega);
        let below = i.times(ONE.plus(i.scaled(0.210_586_75)).plus(i.times(i).scaled(1.132_753_44)));
        let held = s.scaled(1.0 / omega).size();
        control.times(below.inverse()).size() * 0.116_425_43 * held
    };
    let scan = (0..=100_000).map(|k| 0.6 + 1.4e-5 * f64::from(k)).map(size);
    let largest = scan.fold(0.0, max_or_nan);
    assert!(largest < 1.0 + 1e-3 && largest > 0.5, "{largest}");
}

/// A run of `loop.toml` follows the step that `steps.csv` has of the loop in continuous time, for every form
/// of plant with polynomials.
#[test]
fn the_loop_that_runs_is_the_one_that_was_tuned() {
    for (plant, sample, crossover) in [
        ("gain = 3.13\ntime_constant = 43.0\ndead_time = 5.0", 0.1, 0.08),
        // A dead time that ends at no part of a sample.
        ("gain = 1.0\ntime_constant = 2.0\ndead_time = 0.31830988", 0.02, 0.5),
        ("gain = -2.0\ntime_constants = [2.0, 0.5]", 0.005, 1.0),
        ("frequency = 3.0\ndamping = 0.3\ndead_time = 0.1", 0.005, 1.0),
        ("poles = [0.0, [-1.0, 2.0]]\nzeros = [-3.0]\ngain = 2.0", 0.005, 0.5),
    ] {
        let place = Workplace::new();
        tune(
            &place,
            &format!(
                "[plant]\n{plant}\n[controller]\nstructure = \"pi\"\nsample = {sample}\n\
                 [specification]\ncrossover = {crossover}\nphase_margin = 60\n"
            ),
        );
        let output = place.fvi(&["run", "out/loop.toml", "--out", "run"]);
        assert!(output.status.success(), "{plant}: {}", text(&output.stderr));
        let read = |file: &str| -> Vec<Vec<f64>> {
            let content = fs::read_to_string(place.path(file)).unwrap();
            content
                .lines()
                .skip(1)
                .map(|l| l.split(',').map(|cell| cell.parse().unwrap()).collect())
                .collect()
        };
        let (ran, known) = (read("run/trajectory.csv"), read("out/steps.csv"));
        for step in &known {
            let row = ran.iter().find(|row| row[0] >= step[0]).unwrap();
            let apart = (row[row.len() - 1] - step[1]).abs();
            assert!(apart < 0.03, "{plant} at {}: {apart}", step[0]);
        }
    }
}

/// The motion of x′ = p x + u over a time t under a constant u.
fn held(pole: f64, x: f64, u: f64, t: f64) -> f64 {
    (pole * t).exp() * x + u * (pole * t).exp_m1() / pole
}

/// Each measured value of a run is that of the plant's modes under the outputs that the run says it had: slow
/// and stiff plants, dead times between two samples, plants by their formula.
#[test]
fn the_plant_of_a_loop_moves_as_its_modes_do() {
    for (plant, sample, crossover, dead_time, modes) in [
        (
            "gain = 3.13\ntime_constant = 43.0\ndead_time = 5.0",
            0.1,
            0.08,
            5.0,
            vec![(-1.0 / 43.0, 3.13 / 43.0)],
        ),
        (
            "poles = [-0.5, -800.0]\ngain = 400.0",
            0.1,
            0.5,
            0.0,
            vec![(-0.5, 400.0 / 799.5), (-800.0, -400.0 / 799.5)],
        ),
        ("transfer = \"2*exp(-0.35*s)/(s^2 + 3*s + 2)\"", 0.1, 0.5, 0.35, vec![(-1.0, 2.0), (-2.0, -2.0)]),
    ] {
        let place = Workplace::new();
        tune(
            &place,
            &format!(
                "[plant]\n{plant}\n[controller]\nstructure = \"pi\"\nsample = {sample}\n\
                 [specification]\ncrossover = {crossover}\nphase_margin = 60\n"
            ),
        );
        let output = place.fvi(&["run", "out/loop.toml", "--out", "run"]);
        assert!(output.status.success(), "{plant}: {}", text(&output.stderr));
        let content = fs::read_to_string(place.path("run/trajectory.csv")).unwrap();
        let rows: Vec<Vec<f64>> = content
            .lines()
            .skip(1)
            .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
            .collect();
        let samples = (rows.last().unwrap()[0] / sample).round() as usize;
        let parts = (rows.len() - 1) / samples;
        let at = |k: usize, back: usize| rows[k * parts][rows[k * parts].len() - back];
        let whole = (dead_time / sample + 1e-9_f64).floor();
        let late = dead_time - whole * sample;
        let output = |k: usize, before: usize| if k < before { 0.0 } else { at(k - before, 3) };
        let mut states = vec![0.0; modes.len()];
        let mut largest: f64 = 0.0;
        for k in 0..samples {
            for (state, &(pole, _)) in states.iter_mut().zip(&modes) {
                *state = held(pole, *state, output(k, whole as usize + 1), late);
                *state = held(pole, *state, output(k, whole as usize), sample - late);
            }
            let known: f64 = states.iter().zip(&modes).map(|(state, (_, residue))| state * residue).sum();
            let found = at(k + 1, 1);
            assert!((found - known).abs() < 1e-7, "{plant} at sample {}: {found} for {known}", k + 1);
            largest = largest.max(found.abs());
        }
        assert!(largest > 0.9, "{plant}: the loop follows its setpoint");
    }
}

#[test]
fn what_the_loop_cannot_have_is_named() {
    let place = Workplace::new();
    let problem = |plant: &str, of_loop: &str| {
        format!(
            "[plant]\n{plant}\n[controller]\nstructure = \"pi\"\nsample = 0.1\n\
             [specification]\ncrossover = 0.5\nphase_margin = 60\n[loop]\n{of_loop}\n"
        )
    };
    let tanks = "poles = [-1.0, -2.0]";
    for (problem, named) in [
        (problem(tanks, "rate_limit = -2.0"), "loop.rate_limit"),
        (problem(tanks, "load = \"stp(t)\""), "loop.load"),
        (problem(tanks, "sample = 0.1"), "loop.sample"),
        (problem("poles = [-1.0]\nzeros = [-2.0]", "end = 3.0"), "plant.poles"),
        (problem("poles = [[-1.0, 0.0]]", "end = 3.0"), "plant.poles"),
        (problem("transfer = \"1/(s^1.5 + 1)\"", "end = 3.0"), "a quotient of polynomials in s"),
        (problem("frequency = 1e6\ndamping = 1e-7", "end = 3.0"), "moves too fast for samples of 0.1"),
    ] {
        place.write("plant.toml", &problem);
        let output = place.fvi(&["tune", "plant.toml", "--out", "out"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{problem}: {message}");
        assert!(message.contains(named), "{named}: {message}");
    }
}
