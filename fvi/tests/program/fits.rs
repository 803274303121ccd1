//! `fvi fit`: known truths are found again, intervals cover them as often as they say, and what the data do
//! not say is not made up.

use crate::workplace::{Workplace, text};
use fvi_host::fit::{Fit, FittedModel, fit};
use fvi_scenario::language::Document;
use serde_json::Value;
use std::f64::consts::PI;
use std::fmt::Write;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// A complex number, by itself: nothing of the program's arithmetic takes part.
#[derive(Clone, Copy, Debug)]
struct Complex(f64, f64);

impl Complex {
    fn plus(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }

    fn times(self, other: Self) -> Self {
        Self(self.0 * other.0 - self.1 * other.1, self.0 * other.1 + self.1 * other.0)
    }

    fn scaled(self, factor: f64) -> Self {
        Self(self.0 * factor, self.1 * factor)
    }

    fn inverse(self) -> Self {
        let size = self.0 * self.0 + self.1 * self.1;
        Self(self.0 / size, -self.1 / size)
    }

    fn power(self, exponent: f64) -> Self {
        let (size, angle) = (self.0.hypot(self.1).powf(exponent), exponent * self.1.atan2(self.0));
        Self(size * angle.cos(), size * angle.sin())
    }

    fn exponential(self) -> Self {
        Self(self.0.exp() * self.1.cos(), self.0.exp() * self.1.sin())
    }
}

/// q̈ + c D^β q + k q = 0 of Caputo's type.
#[derive(Clone, Copy)]
struct Oscillator {
    order: f64,
    coefficient: f64,
    stiffness: f64,
    position: f64,
    velocity: f64,
}

impl Oscillator {
    /// q(t), the inverse transform of (s q₀ + v₀ + c s^{β−1} q₀)/(s² + c s^β + k) along Talbot's contour
    /// (β < 1).
    fn position_at(&self, time: f64) -> f64 {
        if time == 0.0 {
            return self.position;
        }
        const NODES: i32 = 32;
        let scale = 2.0 * f64::from(NODES) / (5.0 * time);
        let sum: f64 = (0..NODES)
            .map(|k| {
                let angle = f64::from(k) * PI / f64::from(NODES);
                let (place, slope) = if k == 0 {
                    (Complex(scale, 0.0), Complex(0.5, 0.0))
                } else {
                    let cotangent = angle.cos() / angle.sin();
                    (
                        Complex(scale * angle * cotangent, scale * angle),
                        Complex(1.0, angle * (1.0 + cotangent * cotangent) - cotangent),
                    )
                };
                place.scaled(time).exponential().times(self.transform(place)).times(slope).0
            })
            .sum();
        sum * scale / f64::from(NODES)
    }

    fn transform(&self, s: Complex) -> Complex {
        let Self { order, coefficient, stiffness, position, velocity } = *self;
        let above = s
            .scaled(position)
            .plus(Complex(velocity, 0.0))
            .plus(s.power(order - 1.0).scaled(coefficient * position));
        let below = s.times(s).plus(s.power(order).scaled(coefficient)).plus(Complex(stiffness, 0.0));
        above.times(below.inverse())
    }
}

#[test]
fn the_reference_is_the_closed_form_where_there_is_one() {
    // q̈ + 0.3 q̇ + 4 q = 0.
    let classical =
        Oscillator { order: 1.0, coefficient: 0.3, stiffness: 4.0, position: 1.0, velocity: -0.5 };
    let frequency = (4.0f64 - 0.15 * 0.15).sqrt();
    for time in [0.1, 1.0, 3.0, 6.0f64] {
        let turn = (frequency * time).cos() + (-0.5 + 0.15) / frequency * (frequency * time).sin();
        let known = (-0.15 * time).exp() * turn;
        let found = classical.position_at(time);
        assert!((found - known).abs() < 1e-7, "{time}: {found} and {known}");
    }
}

/// Standard normal numbers of a seed, by the method of Box and Muller from a generator of Marsaglia's.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        ((self.0 >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    fn next(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (2.0 * PI * self.uniform()).cos()
    }
}

const OSCILLATOR: &str = r#"
[system]
mass = [1.0]
potential = "0.5*k*q0^2"
parameters = { k = 4.0, unused = 1.0 }
[[system.damping]]
order = 0.6
coefficient = [0.3]
[initial]
position = [1.0]
[convolution]
family = "bdf"
order = 2
[time]
step = 0.02
steps = 300
"#;

const FREE: &str = r#"
scenario = "scenario.toml"
[[free]]
path = "system.damping[0].order"
start = 0.8
bounds = [0.1, 1.0]
[[free]]
path = "system.damping[0].coefficient[0]"
start = 0.2
scale = "log"
[[free]]
path = "system.parameters.k"
start = 3.5
"#;

/// Runs a fit of files that are there, which must succeed, and reads its record.
fn fitted(place: &Workplace, fit: &str) -> Value {
    place.write("fit.toml", fit);
    let output = place.fvi(&["fit", "fit.toml", "--out", "out"]);
    assert!(output.status.success(), "{}{}", text(&output.stdout), text(&output.stderr));
    record(place)
}

fn record(place: &Workplace) -> Value {
    serde_json::from_str(&std::fs::read_to_string(place.path("out/fit.json")).unwrap()).unwrap()
}

fn estimate(record: &Value, path: &str) -> f64 {
    record["parameters"][path]["estimate"].as_f64().unwrap_or_else(|| panic!("{path}: {record:#}"))
}

/// Columns of a trajectory as data, every so many rows of it.
fn data_of_run(place: &Workplace, scenario: &str, columns: &[&str], every: usize) -> String {
    let run = place.run(scenario, &[]);
    let index = |name: &str| run.columns.iter().position(|own| own == name).unwrap();
    let places: Vec<usize> = columns.iter().map(|name| index(name)).collect();
    let mut table = columns.join(",") + "\n";
    for row in run.rows.iter().step_by(every) {
        let cells: Vec<String> = places.iter().map(|&place| format!("{:e}", row[place])).collect();
        table += &(cells.join(",") + "\n");
    }
    table
}

#[test]
fn a_truth_without_noise_is_found_again() {
    let schemes = [
        "",
        "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[history]\nengine = \"direct\"\n",
        "[scheme]\nkind = \"implicit-euler\"\n",
        // Where the derivative by the order is a difference of runs.
        "starting",
    ];
    for scheme in schemes {
        let place = Workplace::new();
        let scenario = match scheme {
            "starting" => {
                OSCILLATOR.replace("family = \"bdf\"\norder = 2", "order = 2\nstarting = [0.0, 1.0]")
            }
            _ => format!("{OSCILLATOR}{scheme}"),
        };
        let data = data_of_run(&place, &scenario, &["t", "q0"], 3);
        place.write("data.csv", &data);
        let found = fitted(&place, &format!("{FREE}[[data]]\nfile = \"data.csv\"\n"));
        for (path, truth) in [
            ("system.damping[0].order", 0.6),
            ("system.damping[0].coefficient[0]", 0.3),
            ("system.parameters.k", 4.0),
        ] {
            assert!((estimate(&found, path) - truth).abs() < 1e-8, "{scheme}: {path}: {found:#}");
        }
        let derivative = &found["parameters"]["system.damping[0].order"]["derivative"];
        assert_eq!(derivative, if scheme == "starting" { "differences" } else { "exact" });
        // What was found is a scenario that says what the fit does.
        let again = place.fvi(&["run", "out/fitted.toml", "--out", "again", "--quiet"]);
        assert!(again.status.success(), "{}", text(&again.stderr));
    }
}

/// A list of one number is named with or without its index.
#[test]
fn the_index_of_a_list_of_one_number_may_be_left_out() {
    let place = Workplace::new();
    let data = data_of_run(&place, OSCILLATOR, &["t", "q0"], 3);
    place.write("data.csv", &data);
    let free = FREE.replace("coefficient[0]", "coefficient");
    assert_ne!(free, FREE);
    let more = "[[free]]\npath = \"initial.position\"\nstart = 0.9\n";
    let found = fitted(&place, &format!("{free}{more}[[data]]\nfile = \"data.csv\"\n"));
    for (path, truth) in [("system.damping[0].coefficient", 0.3), ("initial.position", 1.0)] {
        assert!((estimate(&found, path) - truth).abs() < 1e-8, "{path}: {found:#}");
        assert_eq!(found["parameters"][path]["derivative"], "exact");
    }
}

#[test]
fn momenta_velocities_accelerations_and_energies_are_data() {
    let scenario = OSCILLATOR.replace("mass = [1.0]", "mass = [2.0]").replace("step = 0.02", "step = 0.01");
    let place = Workplace::new();
    let run = place.run(&scenario, &[]);
    let h = 0.01;
    let mut table = "t,p0,v0,a0,energy\n".to_owned();
    for index in (30..270).step_by(4) {
        let p = |offset: usize| run.rows[index + offset - 3][2];
        // The slope by differences of order six, where the program takes a polynomial through six points.
        let slope = (-p(0) + 9.0 * p(1) - 45.0 * p(2) + 45.0 * p(4) - 9.0 * p(5) + p(6)) / (60.0 * h);
        let row = &run.rows[index];
        writeln!(table, "{:e},{:e},{:e},{:e},{:e}", row[0], row[2], row[2] / 2.0, slope / 2.0, row[3])
            .unwrap();
    }
    place.write("data.csv", &table);
    let mass = "[[free]]\npath = \"system.mass[0]\"\nstart = 1.7\n";
    let deviation = "deviation = { p0 = 1.0, v0 = 1.0, a0 = 1.0, energy = 1.0 }\n";
    let found = fitted(&place, &format!("{FREE}{mass}[[data]]\nfile = \"data.csv\"\n{deviation}"));
    for (path, truth) in [
        ("system.damping[0].order", 0.6),
        ("system.damping[0].coefficient[0]", 0.3),
        ("system.parameters.k", 4.0),
        ("system.mass[0]", 2.0),
    ] {
        assert!((estimate(&found, path) - truth).abs() < 1e-6, "{path}: {found:#}");
    }
    for (path, _) in found["parameters"].as_object().unwrap() {
        assert_eq!(found["parameters"][path]["derivative"], "exact");
    }
}

/// Fits data at hand in this process.
fn fitted_here(scenario: &str, fit_text: &str, data: &str) -> FittedModel {
    let document = Document::new("fit", Path::new(""), fit_text).with_attached("data.csv", data.as_bytes());
    let plan = Fit::of_scenario(&document, Document::new("scenario", Path::new(""), scenario)).unwrap();
    let mut found = fit(&plan, &AtomicBool::new(false), &mut |_| ()).unwrap();
    found.models.remove(found.best)
}

/// 200 records with noise on the exact motion, whose size is known of every other one: each 95 % interval
/// covers the truth in 92 to 98 % of them.
#[test]
fn intervals_cover_the_truth_as_often_as_they_say() {
    let truth = Oscillator { order: 0.6, coefficient: 0.3, stiffness: 4.0, position: 1.0, velocity: 0.0 };
    let times = (1..=50).map(|k| 0.12 * f64::from(k));
    let exact: Vec<(f64, f64)> = times.map(|time| (time, truth.position_at(time))).collect();
    let mut noise = Noise(0x9E37_79B9_7F4A_7C15);
    let mut covered = [0; 3];
    for record in 0..200 {
        let mut data = "t,q0\n".to_owned();
        for (time, position) in &exact {
            writeln!(data, "{time},{}", position + 0.01 * noise.next()).unwrap();
        }
        let deviation = if record % 2 == 0 { "deviation = 0.01\n" } else { "" };
        let fit = format!("{FREE}[[data]]\nfile = \"data.csv\"\n{deviation}");
        let found = fitted_here(OSCILLATOR, &fit, &data);
        assert!(found.converged, "{found:#?}");
        let pairs = found.parameters.iter().zip([0.6, 0.3, 4.0]);
        for (count, ((path, estimate), truth)) in covered.iter_mut().zip(pairs) {
            let [low, high] = estimate.interval.unwrap_or_else(|| panic!("{path}: {found:#?}"));
            *count += usize::from((low..=high).contains(&truth));
        }
    }
    assert!(covered.iter().all(|count| (184..=196).contains(count)), "{covered:?} of 200");
}

#[test]
fn what_the_data_do_not_determine_is_said() {
    let place = Workplace::new();
    let data = data_of_run(&place, OSCILLATOR, &["t", "q0"], 3);
    place.write("data.csv", &data);
    // Of m, c and k a free motion tells the ratios only.
    let more = "[[free]]\npath = \"system.mass[0]\"\nstart = 1.1\n";
    let found = fitted(&place, &format!("{FREE}{more}[[data]]\nfile = \"data.csv\"\n"));
    let parameters = &found["parameters"];
    for path in ["system.mass[0]", "system.parameters.k", "system.damping[0].coefficient[0]"] {
        assert!(parameters[path]["interval"].is_null(), "{path}: {found:#}");
        assert!(parameters[path]["standard_error"].is_null(), "{path}: {found:#}");
    }
    assert!(!parameters["system.damping[0].order"]["interval"].is_null(), "{found:#}");
    let said: Vec<&str> =
        found["undetermined"].as_array().unwrap().iter().map(|said| said.as_str().unwrap()).collect();
    assert_eq!(said.len(), 1, "{said:?}");
    for path in ["system.mass[0]", "system.parameters.k", "system.damping[0].coefficient[0]"] {
        assert!(said[0].contains(path), "{said:?}");
    }
    assert!(!said[0].contains("order") && said[0].contains("+1.000 : +1.000 : +1.000"), "{said:?}");
    let ratio = estimate(&found, "system.parameters.k") / estimate(&found, "system.mass[0]");
    assert!((ratio - 4.0).abs() < 1e-7, "{ratio}");
}

#[test]
fn data_without_noise_are_said_to_be_such() {
    let place = Workplace::new();
    place.write("data.csv", &data_of_run(&place, OSCILLATOR, &["t", "q0"], 3));
    let start = "scenario = \"scenario.toml\"\n[[free]]\npath = \"system.parameters.k\"\n";
    for (more, is_said) in [("", true), ("deviation = 0.01\n", false)] {
        let found = fitted(&place, &format!("{start}[[data]]\nfile = \"data.csv\"\n{more}"));
        let notes = found["notes"].to_string();
        assert_eq!(notes.contains("the model says the data to rounding"), is_said, "{notes}");
    }
}

#[test]
fn fewer_data_than_parameters_give_no_errors() {
    let found = fitted_here(
        OSCILLATOR,
        &format!("{FREE}[[data]]\nfile = \"data.csv\"\n"),
        "t,q0\n1.0,-0.3\n2.0,0.1\n",
    );
    assert!(found.parameters.iter().all(|(_, estimate)| estimate.interval.is_none()), "{found:#?}");
    assert!(!found.undetermined.is_empty());
    // G = 2 + 3i by three numbers > 0, of which none is at a bound: a line of them says the same.
    let (free, data) = (format!("{STANDARD_FREE}relative_deviation = 0.01\n"), "omega,storage,loss\n1,2,3\n");
    let found = fitted_here(STANDARD_SOLID, &free, data);
    let all = "system.parameters.e, system.damping[0].coefficient[0], system.damping[0].kernel.times[0]";
    let said =
        format!("there are fewer data than free numbers, 2 for 3: they leave 1 combination of {all} open");
    assert_eq!(found.undetermined, [said]);
}

#[test]
fn a_bound_that_holds_a_parameter_is_said() {
    let place = Workplace::new();
    let data = data_of_run(&place, OSCILLATOR, &["t", "q0"], 3);
    place.write("data.csv", &data);
    let free = FREE.replace("bounds = [0.1, 1.0]", "bounds = [0.7, 1.0]");
    let found = fitted(&place, &format!("{free}[[data]]\nfile = \"data.csv\"\n"));
    let order = &found["parameters"]["system.damping[0].order"];
    assert_eq!((order["estimate"].as_f64(), &order["at_bound"]), (Some(0.7), &Value::from("lower")));
    assert!(order["interval"].is_null() && order["standard_error"].is_null());
    assert!(found["notes"].to_string().contains("lower bound 0.7"), "{found:#}");
    assert!(!found["parameters"]["system.parameters.k"]["interval"].is_null());
}

#[test]
fn records_of_their_own_starts_share_what_is_common() {
    let place = Workplace::new();
    let scenario = OSCILLATOR.replace("position = [1.0]", "position = [1.0]\nvelocity = [0.0]");
    let starts = [("a", "0.5", "-1.0"), ("b", "-0.7", "0.4")];
    for (name, position, velocity) in starts {
        let own = scenario
            .replace("position = [1.0]", &format!("position = [{position}]"))
            .replace("velocity = [0.0]", &format!("velocity = [{velocity}]"));
        place.write(&format!("{name}.csv"), &data_of_run(&place, &own, &["t", "q0"], 5));
    }
    place.write("scenario.toml", &scenario);
    let found = fitted(
        &place,
        &format!(
            r#"{FREE}
            [[free]]
            path = "initial.velocity[0]"
            data = 1
            [[data]]
            file = "a.csv"
            set = {{ "initial.position[0]" = 0.5, "initial.velocity[0]" = -1.0 }}
            [[data]]
            file = "b.csv"
            set = {{ "initial.position[0]" = -0.7 }}
            "#
        ),
    );
    for (path, truth) in [
        ("system.damping[0].order", 0.6),
        ("system.damping[0].coefficient[0]", 0.3),
        ("system.parameters.k", 4.0),
        ("data[1]: initial.velocity[0]", 0.4),
    ] {
        assert!((estimate(&found, path) - truth).abs() < 1e-8, "{path}: {found:#}");
    }
    // Each record has a scenario of its own that runs.
    for (index, position) in [("0", 0.5), ("1", -0.7)] {
        let (file, out) = (format!("out/fitted_{index}.toml"), format!("again_{index}"));
        let again = place.fvi(&["run", &file, "--out", &out, "--quiet"]);
        assert!(again.status.success(), "{}", text(&again.stderr));
        let rows = std::fs::read_to_string(place.path(&out).join("trajectory.csv")).unwrap();
        let first: f64 = rows.lines().nth(1).unwrap().split(',').nth(1).unwrap().parse().unwrap();
        assert_eq!(first, position);
    }
}

/// K(s) = (τs)^β/(1 + (τs)^β).
fn zener(order: f64, time: f64, omega: f64) -> Complex {
    let u = Complex(0.0, time * omega).power(order);
    u.times(Complex(1.0, 0.0).plus(u).inverse())
}

const MATERIAL: &str = r#"
[system]
mass = [1.0]
potential = "0.5*e*q0^2"
parameters = { e = 1.0 }
[[system.damping]]
coefficient = [1.0]
kernel = { form = "maxwell", order = 0.5, time = 1.0 }
[time]
step = 0.1
steps = 10
"#;

#[test]
fn moduli_of_a_fractional_zener_material_are_fitted_over_frequencies() {
    let place = Workplace::new();
    place.write("scenario.toml", MATERIAL);
    let (order, time, coefficient, rest) = (0.35, 0.02, 40.0, 3.0);
    let (mut kernel, mut modulus) = ("omega,re,im\n".to_owned(), "omega,storage,loss\n".to_owned());
    for k in -30..=30 {
        let omega = 10f64.powf(0.2 * f64::from(k));
        let value = zener(order, time, omega);
        writeln!(kernel, "{omega:e},{:e},{:e}", value.0, value.1).unwrap();
        let whole = value.scaled(coefficient).plus(Complex(rest, 0.0));
        writeln!(modulus, "{omega:e},{:e},{:e}", whole.0, whole.1).unwrap();
    }
    place.write("kernel.csv", &kernel);
    place.write("modulus.csv", &modulus);
    let free = r#"scenario = "scenario.toml"
        [[free]]
        path = "system.damping[0].kernel.order"
        bounds = [0.05, 0.95]
        [[free]]
        path = "system.damping[0].kernel.time"
        scale = "log"
        "#;
    let found = fitted(&place, &format!("{free}[[data]]\nfile = \"kernel.csv\"\nterm = 0\n"));
    assert!((estimate(&found, "system.damping[0].kernel.order") - order).abs() < 1e-8, "{found:#}");
    assert!((estimate(&found, "system.damping[0].kernel.time") / time - 1.0).abs() < 1e-8, "{found:#}");
    let more = r#"
        [[free]]
        path = "system.damping[0].coefficient[0]"
        scale = "log"
        [[free]]
        path = "system.parameters.e"
        scale = "log"
        [[data]]
        file = "modulus.csv"
        quantity = "modulus"
        relative_deviation = 0.01
        "#;
    let found = fitted(&place, &format!("{free}{more}"));
    for (path, truth) in [
        ("system.damping[0].kernel.order", order),
        ("system.damping[0].kernel.time", time),
        ("system.damping[0].coefficient[0]", coefficient),
        ("system.parameters.e", rest),
    ] {
        assert!((estimate(&found, path) / truth - 1.0).abs() < 1e-8, "{path}: {found:#}");
    }
}

#[test]
fn answers_at_frequencies_are_refused_where_forces_of_the_velocity_take_part() {
    let place = Workplace::new();
    let force = "mass = [1.0]\nforce = [\"-e*v0\"]";
    place.write("scenario.toml", &MATERIAL.replace("mass = [1.0]", force));
    place.write("data.csv", "omega,re,im\n1,1,1\n2,1,1\n3,1,1\n");
    let free = "scenario = \"scenario.toml\"\n[[free]]\npath = \"system.parameters.e\"\n";
    for what in ["quantity = \"modulus\"", "input = 0\noutput = 0"] {
        place.write("fit.toml", &format!("{free}[[data]]\nfile = \"data.csv\"\n{what}\n"));
        let output = place.fvi(&["fit", "fit.toml"]);
        let error = text(&output.stderr);
        assert!(!output.status.success() && error.contains("forces of the velocity"), "{what}: {error}");
    }
}

#[test]
fn data_before_a_start_other_than_zero_are_refused() {
    let place = Workplace::new();
    let scenario = "[system]\nmass = [1.0]\npotential = \"k*q0^2\"\nparameters = { k = 1.0 }\n[initial]\nposition = [1.0]\n\
        velocity = [0.0]\n[time]\nstart = 1.0\nstep = 0.1\nsteps = 20\n";
    place.write("scenario.toml", scenario);
    let free =
        "scenario = \"scenario.toml\"\n[[free]]\npath = \"system.parameters.k\"\nbounds = [0.1, 3.0]\n";
    let fit = |first: &str, set: &str| {
        place.write("data.csv", &format!("t,q0\n{first},1.0\n1.5,0.7\n2.0,0.2\n"));
        place.write("fit.toml", &format!("{free}[[data]]\nfile = \"data.csv\"\n{set}\n"));
        let output = place.fvi(&["fit", "fit.toml"]);
        (output.status.success(), text(&output.stderr))
    };
    let (_, error) = fit("0.95", "");
    assert!(error.contains("line 2") && error.contains("before the motion begins, at t = 1"), "{error}");
    let (_, error) = fit("1.0", "set = { \"time.start\" = 1.2 }");
    assert!(error.contains("the motion begins at t = 1.2"), "{error}");
    assert!(fit("1.0", "").0);
}

#[test]
fn a_modulus_of_a_system_with_gyroscopic_forces_is_refused() {
    let place = Workplace::new();
    let text_of = "[system]\nmass = [1.0, 1.0]\nstiffness = [{k}, 2.0]\ngyroscopic = [[0.0, -0.5], [0.5, 0.0]]\n[initial]\n\
        position = [1.0, 0.0]\nvelocity = [0.0, 0.0]\n[scheme]\nkind = \"low-order\"\nkappa = 0.5\n[time]\nstep = 0.1\nsteps = 10\n";
    place.write("scenario.toml", &text_of.replace("{k}", "1.5"));
    place.write("data.csv", "omega,re,im\n1,1,1\n2,1,1\n3,1,1\n");
    let free = "scenario = \"scenario.toml\"\n[[free]]\npath = \"system.stiffness[0]\"\n";
    place.write("fit.toml", &format!("{free}[[data]]\nfile = \"data.csv\"\nquantity = \"modulus\"\n"));
    let output = place.fvi(&["fit", "fit.toml"]);
    let error = text(&output.stderr);
    assert!(!output.status.success() && error.contains("gyroscopic forces"), "{error}");
}

/// An arm of one link whose joint is a fractional damper along an angle.
const ARM: &str = "[system]\nkinetic = \"0.5*m*l^2*v0^2\"\npotential = \"-m*9.81*l*cos(q0)\"\n\
    parameters = { m = 1.3, l = 0.8 }\n[[system.damping]]\norder = 0.6\ncoefficient = 0.9\nalong = \"sin(q0)\"\n[initial]\n\
    position = [1.1]\n[time]\nstep = 0.02\nsteps = 150\n";

#[test]
fn a_mechanism_is_fitted_by_its_motion_and_by_its_response_at_rest() {
    let place = Workplace::new();
    let data = data_of_run(&place, ARM, &["t", "q0"], 3);
    place.write("scenario.toml", ARM);
    place.write("data.csv", &data);
    let free = "scenario = \"scenario.toml\"\n[[free]]\npath = \"system.damping[0].order\"\nstart = 0.4\n\
        [[free]]\npath = \"system.damping[0].coefficient\"\nstart = 0.5\n[[free]]\npath = \"system.parameters.l\"\nstart = 0.7\n";
    let truth = [
        ("system.damping[0].order", 0.6),
        ("system.damping[0].coefficient", 0.9),
        ("system.parameters.l", 0.8),
    ];
    let found = fitted(&place, &format!("{free}[[data]]\nfile = \"data.csv\"\n"));
    for (path, truth) in truth {
        assert!((estimate(&found, path) - truth).abs() < 1e-7, "{path}: {found:#}");
        assert_eq!(found["parameters"][path]["derivative"], "exact");
    }
    // The hanging arm: m l² s² + 9.81 m l + 0.9 s^0.6.
    let mut table = "omega,re,im\n".to_owned();
    for k in 0..40 {
        let omega = 0.5 * 1.08_f64.powi(k);
        let (damping, angle) = (0.9 * omega.powf(0.6), 0.3 * std::f64::consts::PI);
        let re = 9.81 * 1.3 * 0.8 - 1.3 * 0.8 * 0.8 * omega * omega + damping * angle.cos();
        let im = damping * angle.sin();
        let squared = re * re + im * im;
        writeln!(table, "{omega},{:e},{:e}", re / squared, -im / squared).unwrap();
    }
    place.write("data.csv", &table);
    let receptance =
        "[[data]]\nfile = \"data.csv\"\ninput = 0\noutput = 0\nset = { \"initial.position\" = [0.0] }\n";
    let found = fitted(&place, &format!("{free}{receptance}"));
    for (path, truth) in truth {
        assert!((estimate(&found, path) - truth).abs() < 1e-7, "{path}: {found:#}");
    }
    // Away from rest, and for a modulus, there is nothing to compare with.
    for (wrong, phrase) in [
        ("[[data]]\nfile = \"data.csv\"\ninput = 0\noutput = 0\n", "equilibrium"),
        ("[[data]]\nfile = \"data.csv\"\nquantity = \"modulus\"\n", "mechanism"),
    ] {
        place.write("fit.toml", &format!("{free}{wrong}"));
        let output = place.fvi(&["fit", "fit.toml"]);
        let error = text(&output.stderr);
        assert!(!output.status.success() && error.contains(phrase), "{wrong}: {error}");
    }
}

/// T = ½ m (1 + q²) v² + 0.4 q v: p = m (1 + q²) v + 0.4 q tells the velocities and accelerations of data.
#[test]
fn a_mechanism_is_fitted_by_its_velocities_accelerations_and_energies() {
    let scenario = "[system]\nkinetic = \"0.5*m*(1 + q0^2)*v0^2 + 0.4*q0*v0\"\npotential = \"2*q0^2\"\n\
        parameters = { m = 1.3 }\n[[system.damping]]\norder = 0.6\ncoefficient = 0.7\nalong = \"sin(q0)\"\n\
        [initial]\nposition = [1.0]\nvelocity = [2.0]\n[scheme]\nkind = \"galerkin\"\ndegree = 3\n\
        [time]\nstep = 0.01\nsteps = 200\n";
    let place = Workplace::new();
    let run = place.run(scenario, &[]);
    let velocity = |row: &[f64]| (row[2] - 0.4 * row[1]) / (1.3 * (1.0 + row[1] * row[1]));
    let rates: Vec<f64> = run.rows.iter().map(|row| velocity(row)).collect();
    // Differences over three steps to each side.
    let slope = |k: usize| {
        let ahead = |far: usize| rates[k + far] - rates[k - far];
        (0.75 * ahead(1) - 0.15 * ahead(2) + ahead(3) / 60.0) / 0.01
    };
    let kept = || (15..195).step_by(4);
    let columns: [(&str, Vec<f64>, f64); 3] = [
        ("v0", kept().map(|k| rates[k]).collect(), 1e-7),
        ("a0", kept().map(slope).collect(), 1e-5),
        ("energy", kept().map(|k| run.rows[k][3]).collect(), 1e-7),
    ];
    place.write("scenario.toml", scenario);
    for (column, data, tolerance) in columns {
        let mut table = format!("t,{column}\n");
        for (k, number) in kept().zip(data) {
            writeln!(table, "{:e},{number:e}", run.rows[k][0]).unwrap();
        }
        place.write("data.csv", &table);
        let found = fitted(
            &place,
            "scenario = \"scenario.toml\"\n[[free]]\npath = \"system.damping[0].coefficient\"\nstart = 0.6\n\
             [[free]]\npath = \"system.parameters.m\"\nstart = 1.28\n[[data]]\nfile = \"data.csv\"\n",
        );
        for (path, truth) in [("system.damping[0].coefficient", 0.7), ("system.parameters.m", 1.3)] {
            let found = estimate(&found, path);
            assert!((found - truth).abs() < tolerance, "{column}, {path}: {found}");
        }
    }
}

#[test]
fn a_receptance_is_fitted() {
    let place = Workplace::new();
    place.write("scenario.toml", OSCILLATOR);
    let mut data = "omega,re,im\n".to_owned();
    for k in 1..=40 {
        let omega = 0.1 * f64::from(k);
        let stiffness = Complex(4.0 - omega * omega, 0.0).plus(Complex(0.0, omega).power(0.6).scaled(0.3));
        let answer = stiffness.inverse();
        writeln!(data, "{omega},{:e},{:e}", answer.0, answer.1).unwrap();
    }
    place.write("data.csv", &data);
    let mass = "[[free]]\npath = \"system.mass[0]\"\nstart = 1.1\n";
    let found =
        fitted(&place, &format!("{FREE}{mass}[[data]]\nfile = \"data.csv\"\ninput = 0\noutput = 0\n"));
    for (path, parameter) in found["parameters"].as_object().unwrap() {
        assert_eq!(parameter["derivative"], "differences", "{path}");
    }
    for (path, truth) in [
        ("system.damping[0].order", 0.6),
        ("system.damping[0].coefficient[0]", 0.3),
        ("system.parameters.k", 4.0),
        ("system.mass[0]", 1.0),
    ] {
        assert!((estimate(&found, path) - truth).abs() < 1e-8, "{path}: {found:#}");
    }
}

/// Storage and loss of K = 1 + K_m with β = 0.5 and τ = 1 at angular frequencies from 0.1 to 10.
fn moduli() -> Vec<(f64, f64, f64)> {
    let row = |k: i32| {
        let omega = 10f64.powf(0.1 * f64::from(k));
        let modulus = Complex(1.0, 0.0).plus(zener(0.5, 1.0, omega));
        (omega, modulus.0, modulus.1)
    };
    (-10..=10).map(row).collect()
}

const MATERIAL_FREE: &str = r#"
scenario = "scenario.toml"
[[free]]
path = "system.damping[0].kernel.order"
start = 0.6
[[free]]
path = "system.damping[0].kernel.time"
start = 2.0
scale = "log"
[[data]]
file = "data.csv"
quantity = "modulus"
"#;

/// The same moduli in the files of several instruments give one result.
#[test]
fn tables_are_read_as_instruments_write_them() {
    let rows = moduli();
    let named = "columns = { omega = \"Angular Frequency\", storage = \"Storage Modulus\", loss = \"Loss Modulus\" }\n";
    let hertz = "columns = { f = \"Frequency\", storage = \"E'\", loss = \"E''\" }\n";
    let with = |head: &str, row: &dyn Fn(f64, f64, f64) -> String| {
        rows.iter()
            .fold(head.to_owned(), |text, &(omega, storage, loss)| text + &row(omega, storage, loss) + "\n")
    };
    let comma = |number: f64| format!("{number:e}").replace('.', ",");
    let backwards = |head: &str| {
        let row = |(omega, storage, loss): &(f64, f64, f64)| format!("{omega:e},{storage:e},{loss:e}\n");
        rows.iter().rev().fold(head.to_owned(), |text, numbers| text + &row(numbers))
    };
    let files = [
        ("", with("omega,storage,loss\n", &|omega, storage, loss| format!("{omega:e},{storage:e},{loss:e}"))),
        ("", backwards("omega,storage,loss\n")),
        // A name and a date before the header, tabs, a row of units, and a column of words.
        (
            named,
            with(
                "Sample 7\t\n\nPoint\tAngular Frequency\tStorage Modulus\tLoss Modulus\tStatus\n\trad/s\tPa\tPa\t\n",
                &|omega, storage, loss| format!("1\t{omega:e}\t{storage:e}\t{loss:e}\tDy_auto"),
            ),
        ),
        (
            &format!("{hertz}decimal = \",\"\n"),
            with("E'';E';Frequency\n", &|omega, storage, loss| {
                format!("{};{};{}", comma(loss), comma(storage), comma(omega / (2.0 * PI)))
            }),
        ),
        (
            named,
            with(
                "Loss Modulus [MPa];Storage Modulus [MPa];Angular Frequency [Hz];\n",
                &|omega, storage, loss| format!("{loss:e};{storage:e};{:e};", omega / (2.0 * PI)),
            ),
        ),
        // By numbers what the headings say holds as by names: beside them, in a row below, in a comment.
        (
            "columns = { omega = 1, storage = 2, loss = 3 }\n",
            with("Frequency [Hz];Storage [MPa];Loss [MPa]\n", &|omega, storage, loss| {
                format!("{:e};{storage:e};{loss:e}", omega / (2.0 * PI))
            }),
        ),
        (
            "columns = { omega = 1, storage = 2, loss = 3 }\n",
            with("Frequency\tStorage\tLoss\nHertz\tMPa\tMPa\n", &|omega, storage, loss| {
                format!("{:e}\t{storage:e}\t{loss:e}", omega / (2.0 * PI))
            }),
        ),
        (
            "columns = { f = 1, storage = 2, loss = 3 }\n",
            with("# w [RAD/S], E', E''\n", &|omega, storage, loss| format!("{omega:e},{storage:e},{loss:e}")),
        ),
        (
            "columns = { f = 1, storage = 3, loss = 4 }\n",
            with("w (rad/s)  T  E' [Pa]  E'' [Pa]\n", &|omega, storage, loss| {
                format!("{omega:e} 20 {storage:e} {loss:e}")
            }),
        ),
        (
            "columns = { f = \"w\", storage = \"S\", loss = \"L\" }\n",
            with("w in rad/s\tS in N/mm²\tL in N/mm²\n", &|omega, storage, loss| {
                format!("{omega:e}\t{storage:e}\t{loss:e}")
            }),
        ),
        (
            "columns = { omega = \"w [cps]\", storage = \"Storage modulus\", loss = \"L\" }\n",
            with("w [cps];Storage\u{a0} modulus in MPA;L in MPA\n", &|omega, storage, loss| {
                format!("{:e};{storage:e};{loss:e}", omega / (2.0 * PI))
            }),
        ),
        (
            "units = { storage = 1e3, loss = 1e3, omega = \"Hz\" }\n",
            with("omega   storage  loss\n", &|omega, storage, loss| {
                format!("  {:e}  {:e}   {:e}", omega / (2.0 * PI), storage / 1e3, loss / 1e3)
            }),
        ),
        // In kilohertz: a number for f leads to Hz.
        (
            "units = { f = 1000.0 }\n",
            with("f,storage,loss\n", &|omega, storage, loss| {
                format!("{:e},{storage:e},{loss:e}", omega / (2000.0 * PI))
            }),
        ),
        (
            "units = { f = \"kHz\" }\n",
            with("f,storage,loss\n", &|omega, storage, loss| {
                format!("{:e},{storage:e},{loss:e}", omega / (2000.0 * PI))
            }),
        ),
    ];
    for (keys, data) in files {
        let found = fitted_here(MATERIAL, &format!("{MATERIAL_FREE}{keys}"), &data);
        let numbers: Vec<f64> = found.parameters.iter().map(|(_, parameter)| parameter.estimate).collect();
        assert!((numbers[0] - 0.5).abs() < 1e-8 && (numbers[1] - 1.0).abs() < 1e-8, "{data}\n{numbers:?}");
        assert_eq!((found.data, found.tables[0].left_out), (42, 0), "{data}");
    }
}

#[test]
fn rows_with_missing_numbers_are_left_out_and_counted() {
    let mut data = "omega,storage,loss\n".to_owned();
    for (index, (omega, storage, loss)) in moduli().into_iter().enumerate() {
        match index {
            3 => data += &format!("{omega},NaN,{loss}\n"),
            7 => data += &format!("{omega},{storage},\n"),
            _ => data += &format!("{omega:e},{storage:e},{loss:e}\n"),
        }
    }
    let found = fitted_here(MATERIAL, MATERIAL_FREE, &data);
    assert_eq!((found.data, found.tables[0].rows, found.tables[0].left_out), (38, 19, 2));
    let said = "data.csv: 2 of 21 rows are left out, in which a number is missing: lines 5, 9";
    assert!(found.notes.iter().any(|note| note == said), "{:?}", found.notes);
}

/// A parameter that no datum depends on stops a fit, over time as over frequencies; one whose derivative
/// vanishes where the search starts does not.
#[test]
fn a_parameter_that_touches_nothing_stops() {
    let unused = "[[free]]\npath = \"system.parameters.unused\"\n";
    for (data, keys) in
        [("t,q0\n0.1,0.9\n0.2,0.8\n0.3,0.7\n0.4,0.5\n", ""), ("omega,re,im\n1.0,0.3,-0.1\n", "")]
    {
        let place = Workplace::new();
        place.write("scenario.toml", OSCILLATOR);
        place.write("data.csv", data);
        place.write("fit.toml", &format!("{FREE}{unused}[[data]]\nfile = \"data.csv\"\n{keys}"));
        let output = place.fvi(&["fit", "fit.toml", "--out", "out"]);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains("no datum changes with system.parameters.unused"), "{said}");
        assert!(!place.path("out").exists());
    }
    let square =
        OSCILLATOR.replace("0.5*k*q0^2", "0.5*(k + unused^2)*q0^2").replace("unused = 1.0", "unused = 0.0");
    let data = "omega,re\n0.5,0.2\n1.0,0.21\n";
    let fit = "scenario = \"scenario.toml\"\n[[free]]\npath = \"system.parameters.unused\"\n[[data]]\nfile = \"data.csv\"\n";
    let found = fitted_here(&square, fit, data);
    assert_eq!(found.parameters.len(), 1);
}

/// A spring e beside a Maxwell element of stiffness E and relaxation time τ.
const STANDARD_SOLID: &str = r#"
[system]
mass = [1.0]
potential = "0.5*e*q0^2"
parameters = { e = 1.0 }
[[system.damping]]
coefficient = [1.0]
kernel = { form = "prony", strengths = [1.0], times = [1.0] }
[time]
step = 0.1
steps = 10
"#;

const STANDARD_FREE: &str = r#"
scenario = "scenario.toml"
[[free]]
path = "system.parameters.e"
scale = "log"
[[free]]
path = "system.damping[0].coefficient[0]"
scale = "log"
[[free]]
path = "system.damping[0].kernel.times[0]"
scale = "log"
[[data]]
file = "data.csv"
"#;

/// e = 2, E = 5, τ = 0.3 from the closed forms of each function of the standard solid.
#[test]
fn every_function_of_a_material_tells_its_numbers() {
    let (e, big, tau) = (2.0, 5.0, 0.3);
    let table = |head: &str, row: &dyn Fn(f64) -> Vec<f64>| {
        (-20..=20).fold(head.to_owned(), |text, k| {
            let place = 10f64.powf(0.1 * f64::from(k));
            let cells: Vec<String> =
                [vec![place], row(place)].concat().iter().map(|cell| format!("{cell:e}")).collect();
            text + &cells.join(",") + "\n"
        })
    };
    let modulus = |omega: f64| {
        let u = Complex(0.0, omega * tau);
        Complex(e, 0.0).plus(u.times(Complex(1.0, 0.0).plus(u).inverse()).scaled(big))
    };
    let relaxation = |t: f64| vec![e + big * (-t / tau).exp()];
    let creep = |t: f64| vec![(1.0 - big / (e + big) * (-t * e / (tau * (e + big))).exp()) / e];
    let storage_loss = |omega: f64| vec![modulus(omega).0, modulus(omega).1];
    let size = |omega: f64| modulus(omega).0.hypot(modulus(omega).1);
    let magnitude = |omega: f64| vec![size(omega), modulus(omega).1 / modulus(omega).0];
    let cases = [
        ("", table("t,relaxation\n", &relaxation)),
        ("", table("t,creep\n", &creep)),
        ("", table("omega,storage,loss\n", &storage_loss)),
        (
            "relative_deviation = { magnitude = 0.01, tan_delta = 0.02 }\n",
            table("omega,magnitude,tan_delta\n", &magnitude),
        ),
        (
            "deviation = { tan_delta = 0.02 }\nrelative_deviation = { magnitude = 0.01 }\n",
            table("omega,magnitude,tan_delta\n", &magnitude),
        ),
    ];
    for (keys, data) in cases {
        let found = fitted_here(STANDARD_SOLID, &format!("{STANDARD_FREE}{keys}"), &data);
        for ((path, parameter), truth) in found.parameters.iter().zip([e, big, tau]) {
            assert!((parameter.estimate / truth - 1.0).abs() < 1e-8, "{data}\n{path}: {parameter:?}");
        }
    }
}

#[test]
fn mobilities_and_accelerances_are_fitted() {
    let mass = "[[free]]\npath = \"system.mass[0]\"\nstart = 1.1\n";
    for (quantity, order) in [("mobility", 1), ("accelerance", 2)] {
        let (mut parts, mut sizes) = ("omega,re,im\n".to_owned(), "omega,magnitude\n".to_owned());
        for k in 1..=40 {
            let (omega, s) = (0.1 * f64::from(k), Complex(0.0, 0.1 * f64::from(k)));
            let stiffness = s.times(s).plus(s.power(0.6).scaled(0.3)).plus(Complex(4.0, 0.0));
            let answer = (0..order).fold(stiffness.inverse(), |answer, _| answer.times(s));
            writeln!(parts, "{omega},{:e},{:e}", answer.0, answer.1).unwrap();
            writeln!(sizes, "{omega},{:e}", answer.0.hypot(answer.1)).unwrap();
        }
        for data in [parts, sizes] {
            let fit = format!("{FREE}{mass}[[data]]\nfile = \"data.csv\"\nquantity = \"{quantity}\"\n");
            let found = fitted_here(OSCILLATOR, &fit, &data);
            for ((path, parameter), truth) in found.parameters.iter().zip([0.6, 0.3, 4.0, 1.0]) {
                assert!((parameter.estimate - truth).abs() < 1e-7, "{quantity}: {path}: {parameter:?}");
            }
        }
    }
}

/// The logarithm of a constant |G| is best at the mean of data in dB, with the error of a mean in dB.
#[test]
fn data_in_decibels_are_fitted_in_decibels() {
    let spring = "[system]\nmass = [1.0]\npotential = \"0.5*e*q0^2\"\nparameters = { e = 1.0 }\n[time]\nstep = 0.1\nsteps = 10\n";
    let free = "scenario = \"scenario.toml\"\n[[free]]\npath = \"system.parameters.e\"\n[[data]]\nfile = \"data.csv\"\n";
    // Their mean is 5, and Σ (d − 5)² = 138.
    let levels = [-3.0, 2.0, 9.0, 12.0];
    let e = 10f64.powf(5.0 / 20.0);
    let per_decibel = e * std::f64::consts::LN_10 / 20.0;
    let cases = [
        ("magnitude [dB]", "", "deviation = 3.0\n", 3.0),
        ("magnitude [DB]", "", "deviation = 3.0\n", 3.0),
        ("magnitude", "", "units = { magnitude = \"dB\" }\ndeviation = { magnitude = 3.0 }\n", 3.0),
        ("magnitude [dB],deviation", ",3", "", 3.0),
        ("magnitude [dB],magnitude_deviation [dB]", ",3", "", 3.0),
        ("magnitude [dB],magnitude_deviation", ",3", "", 3.0),
        // Nothing says how large they are: √(138/3).
        ("magnitude [dB]", "", "", 46f64.sqrt()),
        ("magnitude [dB],weight", ",7", "", 46f64.sqrt()),
    ];
    for (head, tail, keys, deviation) in cases {
        let rows = (1..).zip(levels).map(|(omega, level)| format!("{omega},{level}{tail}\n"));
        let data = rows.fold(format!("omega,{head}\n"), |text, row| text + &row);
        let found = fitted_here(spring, &format!("{free}quantity = \"modulus\"\n{keys}"), &data);
        let parameter = &found.parameters[0].1;
        assert!((parameter.estimate / e - 1.0).abs() < 1e-7, "{data}\n{keys}\n{parameter:?}");
        let error = parameter.standard_error.unwrap();
        assert!(
            (error / (0.5 * deviation * per_decibel) - 1.0).abs() < 1e-6,
            "{data}\n{keys}\n{parameter:?}"
        );
        assert!((found.tables[0].rms[0] / 34.5f64.sqrt() - 1.0).abs() < 1e-7, "{:?}", found.tables);
    }
}

/// Of storage and loss each has its own relative deviation; of the parts of a complex number, that of both.
#[test]
fn relative_deviations_are_those_of_each_datum() {
    let cases = [
        ("omega,storage,loss\n1,3,4\n", "relative_deviation = 0.1\n", [0.3, 0.4]),
        (
            "omega,storage,loss\n1,3,4\n",
            "relative_deviation = 0.1\nrelative_to = \"magnitude\"\n",
            [0.5, 0.5],
        ),
        ("omega,storage,loss\n1,3,4\n", "relative_deviation = { storage = 0.1, loss = 0.2 }\n", [0.3, 0.8]),
        (
            "omega,storage,loss\n1,3,4\n",
            "relative_deviation = { loss = 0.2 }\ndeviation = { storage = 7.0 }\n",
            [7.0, 0.8],
        ),
        ("omega,re,im\n1,3,4\n", "relative_deviation = 0.1\n", [0.5, 0.5]),
        ("omega,re,im\n1,3,4\n", "relative_deviation = 0.1\nrelative_to = \"datum\"\n", [0.3, 0.4]),
        // Data in decibels have deviations in decibels; a fraction is one of the magnitude.
        (
            "omega,magnitude,tan_delta\n1,20,0.5\n",
            "units = { magnitude = \"dB\" }\ndeviation = { magnitude = 0.1, tan_delta = 0.03 }\n",
            [0.1, 0.03],
        ),
        (
            "omega,magnitude,deviation\n1,20,0.1\n",
            "quantity = \"modulus\"\nunits = { magnitude = \"dB\" }\n",
            [0.1, f64::NAN],
        ),
        (
            "omega,magnitude [dB]\n1,20\n",
            "quantity = \"modulus\"\nrelative_deviation = 0.1\n",
            [1.0, f64::NAN],
        ),
    ];
    for (data, keys, deviations) in cases {
        let text = format!("{STANDARD_FREE}{keys}");
        let document = Document::new("fit", Path::new(""), &text).with_attached("data.csv", data.as_bytes());
        let plan =
            Fit::of_scenario(&document, Document::new("scenario", Path::new(""), STANDARD_SOLID)).unwrap();
        for ((_, found), known) in plan.columns(0).into_iter().zip(deviations) {
            assert!((found[0] - known).abs() < 1e-14, "{keys}: {found:?}");
        }
    }
}

#[test]
fn kernels_are_compared() {
    let place = Workplace::new();
    let kernel = "coefficient = [1.5]\nkernel = { form = \"maxwell\", order = 0.6, time = 0.5 }";
    let truth = OSCILLATOR.replace("order = 0.6\ncoefficient = [0.3]", kernel);
    let exact = data_of_run(&place, &truth, &["t", "q0"], 3);
    let mut noise = Noise(77);
    let noisy = exact.lines().map(|line| match line.split_once(',').map(|(t, q)| (t, q.parse::<f64>())) {
        Some((t, Ok(q))) => format!("{t},{:e}\n", q + 0.002 * noise.next()),
        _ => format!("{line}\n"),
    });
    place.write("data.csv", &noisy.collect::<String>());
    place.write("scenario.toml", OSCILLATOR);
    let found = fitted(
        &place,
        r#"
        scenario = "scenario.toml"
        profile = ["system.parameters.k"]
        [[free]]
        path = "system.parameters.k"
        [[free]]
        path = "system.damping[0].coefficient[0]"
        scale = "log"
        [[model]]
        name = "spring-pot"
        free = [{ path = "system.damping[0].order", bounds = [0.05, 1.0] }]
        [[model]]
        name = "dashpot"
        set = { "system.damping[0].order" = 1.0 }
        [[model]]
        name = "fractional Maxwell"
        set = { "system.damping" = [{ coefficient = [1.0], kernel = { form = "maxwell", order = 0.5, time = 1.0 } }] }
        free = [
            { path = "system.damping[0].kernel.order", bounds = [0.05, 0.95] },
            { path = "system.damping[0].kernel.time", scale = "log" },
        ]
        [[data]]
        file = "data.csv"
        deviation = 0.002
        "#,
    );
    assert_eq!(found["name"], "fractional Maxwell");
    let models = found["models"].as_array().unwrap();
    assert_eq!(models.len(), 3);
    for model in models {
        let number = |key: &str| model[key].as_f64().unwrap();
        let free = model["parameters"].as_object().unwrap().len() as f64;
        // With known deviations both criteria are χ² and a term for the parameters, but for a constant.
        assert!((number("bic") - number("aic") - free * (number("data").ln() - 2.0)).abs() < 1e-9);
        assert!(number("aic") >= found["aic"].as_f64().unwrap());
    }
    assert!((found["reduced_chi2"].as_f64().unwrap() - 1.0).abs() < 0.5, "{found:#}");
    let notes = models[1]["notes"].to_string();
    assert!(notes.contains("does not describe the data"), "{notes}");
    // Near the best point the likelihood is nearly that of the linear picture.
    let k = &found["parameters"]["system.parameters.k"];
    for end in 0..2 {
        let (linear, profiled) =
            (k["interval"][end].as_f64().unwrap(), k["profile"]["interval"][end].as_f64().unwrap());
        let width = k["standard_error"].as_f64().unwrap();
        assert!((linear - profiled).abs() < 0.5 * width, "{k:#}");
    }
}

/// The strengths of a series with given times, for G = e + Σ g_i s τ_i/(1 + s τ_i) at s = iω.
fn storage_and_loss(e: f64, strengths: &[f64], times: &[f64], omega: f64) -> Complex {
    strengths.iter().zip(times).fold(Complex(e, 0.0), |sum, (&g, &tau)| {
        let s = Complex(0.0, omega * tau);
        sum.plus(s.times(s.plus(Complex(1.0, 0.0)).inverse()).scaled(g))
    })
}

/// A table of storage and loss at 41 frequencies from 0.01 to 100 rad/s, each with a deviation of 2 %.
fn noisy_moduli(e: f64, strengths: &[f64], times: &[f64], noise: &mut Noise) -> String {
    (-20..=20).fold("omega,storage,loss\n".to_owned(), |text, k| {
        let omega = 10f64.powf(0.1 * f64::from(k));
        let Complex(storage, loss) = storage_and_loss(e, strengths, times, omega);
        let mut blurred = |number: f64| number * (1.0 + 0.02 * noise.next());
        let (storage, loss) = (blurred(storage), blurred(loss));
        text + &format!("{omega:e},{storage:e},{loss:e}\n")
    })
}

const PRONY: &str = r#"
scenario = "scenario.toml"
[[free]]
path = "system.parameters.e"
bounds = [0, 1e9]
[[free]]
path = "system.damping[0].kernel"
terms = TERMS
[[data]]
file = "data.csv"
relative_deviation = 0.02
relative_to = "datum"
"#;

/// The strengths of eleven terms are those of least squares under g ≥ 0, which are known by their conditions:
/// no residual is left along a term with g > 0, and a term with g = 0 could only be less than that.
#[test]
fn strengths_of_a_prony_series_are_the_best_ones_that_are_not_negative() {
    let data = noisy_moduli(2.0, &[5.0, 3.0], &[0.05, 4.0], &mut Noise(3));
    let found = fitted_here(STANDARD_SOLID, &PRONY.replace("TERMS", "11"), &data);
    assert_eq!(found.parameters.len(), 12, "{found:?}");
    let numbers: Vec<f64> = found.parameters.iter().map(|(_, found)| found.estimate).collect();
    // The times of the data from 1/100 to 1/0.01 in equal ratios.
    let times: Vec<f64> = (0..11).map(|k| 10f64.powf(-2.0 + 0.4 * f64::from(k))).collect();
    let (mut slopes, mut sizes) = (vec![0.0; 12], vec![0.0; 12]);
    for line in data.lines().skip(1) {
        let row: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        let unit = |index: usize| match index {
            0 => Complex(1.0, 0.0),
            _ => storage_and_loss(0.0, &[1.0], &times[index - 1..index], row[0]),
        };
        let told = storage_and_loss(numbers[0], &numbers[1..], &times, row[0]);
        for (datum, part) in [(row[1], (|z| z.0) as fn(Complex) -> f64), (row[2], |z| z.1)] {
            let deviation = 0.02 * datum;
            for index in 0..12 {
                let slope = part(unit(index)) / deviation;
                slopes[index] += slope * (part(told) - datum) / deviation;
                sizes[index] += slope.powi(2);
            }
        }
    }
    let mut at_zero = 0;
    for (index, &number) in numbers.iter().enumerate() {
        let off = slopes[index] / sizes[index].sqrt();
        assert!(number >= 0.0);
        at_zero += usize::from(number == 0.0);
        assert!(if number > 0.0 { off.abs() < 1e-7 } else { off > 0.0 }, "{index}: {number}, {off:e}");
    }
    assert!(at_zero > 2, "{numbers:?}");
}

#[test]
fn the_number_of_terms_is_that_of_the_smallest_aic() {
    let place = Workplace::new();
    place.write("scenario.toml", STANDARD_SOLID);
    // Three terms, whose times are those of three between 0.01 and 100.
    place.write("data.csv", &noisy_moduli(2.0, &[5.0, 3.0, 4.0], &[0.01, 1.0, 100.0], &mut Noise(5)));
    let found = fitted(&place, &PRONY.replace("TERMS", "[1, 5]"));
    assert_eq!(found["name"], "3 terms", "{found:#}");
    let models = found["models"].as_array().unwrap();
    assert_eq!(models.len(), 5);
    for (index, strength) in [5.0, 3.0, 4.0].into_iter().enumerate() {
        let path = format!("system.damping[0].kernel.strengths[{index}]");
        let own = &found["parameters"][&path];
        let error = own["standard_error"].as_f64().unwrap();
        assert!((own["estimate"].as_f64().unwrap() - strength).abs() < 3.5 * error, "{own:#}");
    }
    // The table and the picture of the comparison.
    let table = std::fs::read_to_string(place.path("out/models.csv")).unwrap();
    let rows: Vec<Vec<&str>> = table.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows[0], ["model", "parameters", "chi2", "aic", "aic_difference", "aic_weight", "bic"]);
    let number = |row: usize, column: usize| rows[row][column].parse::<f64>().unwrap();
    assert_eq!((rows.len(), rows[3][0]), (6, "\"3 terms\""));
    assert!(number(3, 4) == 0.0 && (1..=5).all(|row| number(row, 4) >= 0.0), "{table}");
    assert!(((1..=5).map(|row| number(row, 5)).sum::<f64>() - 1.0).abs() < 1e-12, "{table}");
    for (row, model) in models.iter().enumerate() {
        assert_eq!(number(row + 1, 3), model["aic"].as_f64().unwrap());
    }
    let picture = std::fs::read_to_string(place.path("out/models.svg")).unwrap();
    assert!(picture.contains("4 terms"), "{picture}");
}

/// The truth of the shifts: log₁₀ a_T by the law of Williams, Landel and Ferry with c₁ = 8, c₂ = 120 about
/// 20 °C.
fn wlf(temperature: f64) -> f64 {
    -8.0 * (temperature - 20.0) / (120.0 + temperature - 20.0)
}

/// A fit of e, the stiffness and the time of [`STANDARD_SOLID`] and the shift, to moduli at four
/// temperatures.
fn at_four_temperatures(shift: &str, log10: fn(f64) -> f64) -> Value {
    let place = Workplace::new();
    let mut fit = format!("{}{shift}", STANDARD_FREE.replace("[[data]]\nfile = \"data.csv\"\n", ""));
    for temperature in [0.0, 20.0, 35.0, 60.0] {
        let mut text = "omega,storage,loss\n".to_owned();
        for k in -10..=10 {
            let omega = 10f64.powf(0.1 * f64::from(k));
            let reduced = omega * 10f64.powf(log10(temperature));
            let Complex(storage, loss) = storage_and_loss(2.0, &[5.0], &[0.3], reduced);
            text += &format!("{omega:e},{storage:e},{loss:e}\n");
        }
        place.write(&format!("{temperature}.csv"), &text);
        write!(fit, "[[data]]\nfile = \"{temperature}.csv\"\ntemperature = {temperature}\n").unwrap();
    }
    place.write("scenario.toml", STANDARD_SOLID);
    let found = fitted(&place, &fit);
    let picture = std::fs::read_to_string(place.path("out/master_curve.svg")).unwrap();
    assert!(picture.contains("reduced angular frequency") && picture.contains("storage at 35"), "{picture}");
    for (table, temperature) in found["tables"].as_array().unwrap().iter().zip([0.0, 20.0, 35.0, 60.0]) {
        assert_eq!(table["temperature"], temperature);
        let shifted = table["log10_shift"].as_f64().unwrap();
        assert!((shifted - log10(temperature)).abs() < 1e-7, "{table:#}");
    }
    for (path, truth) in
        [("parameters.e", 2.0), ("damping[0].coefficient[0]", 5.0), ("damping[0].kernel.times[0]", 0.3)]
    {
        let found = estimate(&found, &format!("system.{path}"));
        assert!((found / truth - 1.0).abs() < 1e-7, "{path}: {found}");
    }
    found
}

#[test]
fn moduli_at_several_temperatures_make_one_master_curve() {
    let found = at_four_temperatures(
        r#"
        [shift]
        law = "wlf"
        reference = 20.0
        c1 = 5.0
        c2 = 80.0
        [[free]]
        path = "shift.c1"
        [[free]]
        path = "shift.c2"
        scale = "log"
        "#,
        wlf,
    );
    assert!((estimate(&found, "shift.c1") - 8.0).abs() < 1e-6);
    assert!((estimate(&found, "shift.c2") - 120.0).abs() < 1e-4);
    // Activation energy 90 kJ/mol.
    let found = at_four_temperatures(
        r#"
        [shift]
        law = "arrhenius"
        reference = 20.0
        energy = 50e3
        [[free]]
        path = "shift.energy"
        "#,
        |t| 90e3 / 8.314_462_618 * (1.0 / (t + 273.15) - 1.0 / 293.15) / std::f64::consts::LN_10,
    );
    assert!((estimate(&found, "shift.energy") / 90e3 - 1.0).abs() < 1e-7);
    // A number for each temperature but the reference.
    let found = at_four_temperatures(
        r#"
        [shift]
        law = "free"
        reference = 20.0
        [[free]]
        path = "shift.log10"
        "#,
        wlf,
    );
    let parameters = found["parameters"].as_object().unwrap();
    let of_shift: Vec<&String> = parameters.keys().filter(|path| path.starts_with("shift")).collect();
    assert_eq!(of_shift.len(), 3, "{of_shift:?}");
    assert!((estimate(&found, "shift.log10[3]") - wlf(60.0)).abs() < 1e-7);
}

#[test]
fn series_and_shifts_that_do_not_fit_are_refused() {
    let data = "omega,storage\n1,2\n2,2.1\n3,2.2\n4,2.3\n5,2.4\n";
    let fit = |more: &str, of_data: &str| {
        format!("scenario = \"scenario.toml\"\n{more}\n[[data]]\nfile = \"data.csv\"\n{of_data}")
    };
    let e = "[[free]]\npath = \"system.mass[0]\"\n";
    let warm = "temperature = 30.0\n";
    let wlf = "shift = { law = \"wlf\", reference = 20.0, c1 = 8.0, c2 = 120.0 }\n";
    let cases: &[(String, &[&str])] = &[
        (
            fit("[[free]]\npath = \"system.damping[0].kernel\"\nterms = 3\n", ""),
            &["no kernel of the form \"prony\"", "system.damping[0].kernel"],
        ),
        (
            fit("[[free]]\npath = \"system.damping[0].kernel\"\nterms = [3, 2]\n", ""),
            &["free[0].terms[1]", "3"],
        ),
        (
            fit("[[free]]\npath = \"system.mass[0]\"\nbetween = [1, 2]\n", ""),
            &["free[0].between", "`terms` beside it"],
        ),
        (
            fit("[[free]]\npath = \"system.damping[0].kernel\"\nterms = 3\nstart = 1.0\n", ""),
            &["free[0].start", "terms"],
        ),
        (fit(e, warm), &["data[0].temperature", "without `[shift]`"]),
        (fit(&format!("{wlf}{e}"), ""), &["data[0]", "temperature"]),
        (fit("[[free]]\npath = \"shift.c1\"\n", ""), &["free[0].path", "`[shift]` beside it"]),
        (
            fit(&format!("{wlf}[[free]]\npath = \"shift.energy\"\n"), warm),
            &["free[0].path", "shift.c1, shift.c2"],
        ),
        (
            fit(&format!("{wlf}{e}").replace("120.0", "-5.0"), "temperature = 22.0\n"),
            &["shift.c2", "data[0]"],
        ),
        (fit(&format!("{wlf}{e}").replace("wlf", "vft"), warm), &["shift.law", "\"wlf\", \"arrhenius\""]),
    ];
    let cases: Vec<_> = cases.iter().map(|(fit, said)| (data, fit.clone(), *said)).collect();
    refuses(&cases);
    let motion = fit(&format!("{wlf}{e}"), warm);
    refuses(&[("t,q0\n0.1,0.5\n", motion, &["data[0].temperature", "a motion over time"])]);
}

#[test]
fn times_between_grid_points_are_told_or_refused() {
    let truth = Oscillator { order: 0.6, coefficient: 0.3, stiffness: 4.0, position: 1.0, velocity: 0.0 };
    let mut data = "t,q0\n".to_owned();
    for k in 1..60 {
        let time = 0.1 * f64::from(k) + 0.037;
        writeln!(data, "{time},{:e}", truth.position_at(time)).unwrap();
    }
    // The exact motion, seen through steps of 1/200: what is left is their error.
    let fine = OSCILLATOR.replace("step = 0.02\nsteps = 300", "step = 0.005\nsteps = 1200");
    let found =
        fitted_here(&fine, &format!("{FREE}[[data]]\nfile = \"data.csv\"\ndeviation = 1e-3\n"), &data);
    for ((path, estimate), truth) in found.parameters.iter().zip([0.6, 0.3, 4.0]) {
        assert!((estimate.estimate - truth).abs() < 1e-3, "{path}: {estimate:?}");
    }
    let place = Workplace::new();
    place.write("data.csv", &data);
    place.write("scenario.toml", &OSCILLATOR.replace("step = 0.02\nsteps = 300", "step = 0.5\nsteps = 12"));
    place.write("fit.toml", &format!("{FREE}[[data]]\nfile = \"data.csv\"\ndeviation = 1e-4\n"));
    let output = place.fvi(&["fit", "fit.toml", "--out", "out"]);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("data.csv: row ") && said.contains("do not resolve the motion"), "{said}");
    assert!(!place.path("out").exists());
}

#[test]
fn several_starts_find_what_one_does_not() {
    // A frequency far from the truth leads one search into another minimum.
    let data = "t,q0\n".to_owned()
        + &(1..=100).map(|k| 0.06 * f64::from(k)).fold(String::new(), |mut rows, t| {
            writeln!(rows, "{t},{}", (2.0 * t).cos()).unwrap();
            rows
        });
    let scenario = OSCILLATOR.replace("coefficient = [0.3]", "coefficient = [0.0]");
    let fit = |more: &str| {
        format!(
            "scenario = \"scenario.toml\"\n{more}[[free]]\npath = \"system.parameters.k\"\nstart = 25.0\nbounds = [0.1, 30.0]\n\
             [[data]]\nfile = \"data.csv\"\n"
        )
    };
    let alone = fitted_here(&scenario, &fit(""), &data);
    let several = fitted_here(&scenario, &fit("starts = 8\nseed = 3\n"), &data);
    assert!((alone.parameters[0].1.estimate - 4.0).abs() > 1.0, "{alone:#?}");
    assert!((several.parameters[0].1.estimate - 4.0).abs() < 1e-2, "{several:#?}");
    assert_eq!(several.starts.len(), 8);
    let again = fitted_here(&scenario, &fit("starts = 8\nseed = 3\n"), &data);
    assert_eq!(again.starts, several.starts);
}

/// Each table and fit is refused with these words, and nothing is written.
fn refuses(cases: &[(&str, String, &[&str])]) {
    for (table, fit, expected) in cases {
        let place = Workplace::new();
        place.write("scenario.toml", OSCILLATOR);
        place.write("data.csv", table);
        place.write("fit.toml", fit);
        let output = place.fvi(&["fit", "fit.toml", "--out", "out"]);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{table}\n{fit}\n{said}");
        for expected in *expected {
            assert!(said.contains(expected), "{expected} is not said of\n{table}\n{fit}\n{said}");
        }
        assert!(said.contains("fit.toml"), "{said}");
        assert!(!place.path("out").exists(), "{said}");
    }
}

/// A fit to `data.csv` with these keys of the table.
fn with(more: &str) -> String {
    format!("{FREE}[[data]]\nfile = \"data.csv\"\n{more}")
}

/// A table that is accepted.
const GOOD: &str = "t,q0\n0.1,0.9\n0.2,0.8\n0.3,0.7\n0.4,0.5\n";

#[test]
fn tables_that_leave_a_number_or_its_unit_open_are_refused() {
    refuses(&[
        (
            "t,q0\n0.1,0.9\n0.2,abc\n",
            with(""),
            &["data.csv, line 3", "column 2 (q0)", "`abc` is not a finite number"],
        ),
        ("t,q0\n0.1,0.9\n0.2,inf\n", with(""), &["line 3", "column 2 (q0)"]),
        ("t,q0\n0.1,NaN\n0.2,\n", with(""), &["line 1", "there are no rows", "in each of 2"]),
        ("t,q0\n0.1\n", with(""), &["data.csv, line 2"]),
        ("t;q0\n0,1;0,9\n", with(""), &["line 2", "column 1 (t)", "`0,1`", "`decimal = \",\"`"]),
        ("t,omega,q0\n0.1,1,0.9\n", with(""), &["line 1", "one column of t, omega and f"]),
        ("t,q0\nmin,m\n0.1,0.9\n", with(""), &["column 1 (t)", "a time in `min`", "units = { t = 60 }"]),
        (
            "t,q0\n0.1,0.9\n",
            with("columns = { t = \"Tine\", q0 = \"q0\" }\n"),
            &["line 1", "no row has all names of `columns`", "`Tine` is missing", "there are `t`, `q0`"],
        ),
        (
            "omega [1/s],storage,loss\n1,2,3\n",
            with("quantity = \"modulus\"\n"),
            &["column 1 (omega)", "may be rad/s or Hz", "units = { omega = \"rad/s\" }"],
        ),
        (
            "omega,storage,loss\nrad/s,MPa,kPa\n1,2,3\n",
            with("quantity = \"modulus\"\n"),
            &["loss is in `kPa`, and storage in `MPa`"],
        ),
        (
            "t,relaxation [kPa],creep [1/Pa]\n0.1,1,1\n",
            with(""),
            &["line 1", "creep is in `1/Pa`, and relaxation in `kPa`", "units = { creep"],
        ),
        ("t,relaxation\n0.0,1\n", with(""), &["line 2", "column 1 (t)", "not a time > 0"]),
        (
            "omega,storage,loss\n1,2,3\n",
            with("quantity = \"mobility\"\n"),
            &["data[0].quantity", "the column storage", "\"modulus\" or \"kernel\""],
        ),
        ("omega,tan_delta,relaxation\n1,2,3\n", with(""), &["column 3", "unknown column `relaxation`"]),
    ]);
}

#[test]
fn deviations_and_decibels_that_leave_a_number_open_are_refused() {
    refuses(&[
        (GOOD, with("relative_to = \"datum\"\n"), &["data[0].relative_to", "`relative_deviation`"]),
        (
            "omega,storage,loss\n1,2,3\n",
            with("deviation = { storage = 1.0 }\n"),
            &["data[0].deviation", "that of loss is missing"],
        ),
        (
            "omega,storage,loss\n1,2,3\n",
            with("deviation = { storage = 1.0, loss = 1.0 }\nrelative_deviation = { loss = 1.0 }\n"),
            &["data[0].deviation", "one deviation of loss"],
        ),
        (
            "omega,magnitude [dB re 1 N/m]\n1,2\n",
            with("quantity = \"modulus\"\n"),
            &["decibels in `dB re 1 N/m`", "units = { magnitude = \"dB\" }"],
        ),
        (
            "omega,magnitude,magnitude_deviation [dB]\n1,2,3\n",
            with("quantity = \"modulus\"\n"),
            &["the deviations of magnitude are in dB, and magnitude is not"],
        ),
        (
            "omega,magnitude\n1,2\n2,-3\n",
            with("quantity = \"modulus\"\n"),
            &["line 3", "magnitude = -3 is below 0", "units = { magnitude = \"dB\" }"],
        ),
        (
            "omega,magnitude [dB],storage [kPa]\n1,2,3\n",
            with("deviation = 1.0\n"),
            &["storage is in `kPa`, and magnitude in `dB`", "in the unit of the scenario"],
        ),
    ]);
}

#[test]
fn headings_and_rows_that_leave_a_number_or_its_unit_open_are_refused() {
    refuses(&[
        (
            "Frequency [Hz];Storage [MPa];Loss [kPa]\n1;2;3\n",
            with("columns = { omega = 1, storage = 2, loss = 3 }\n"),
            &["line 1", "loss is in `kPa`, and storage in `MPa`"],
        ),
        (
            "w [U/min];S;L\n1;2;3\n",
            with("columns = { omega = \"w [U/min]\", storage = \"S\", loss = \"L\" }\n"),
            &["line 1", "a frequency in `U/min`", "units = { omega = 0.104719"],
        ),
        (
            "w [x 10^3 rad/s];S;L\n1;2;3\n",
            with("columns = { f = \"w [x 10^3 rad/s]\", storage = \"S\", loss = \"L\" }\n"),
            &["a frequency in `x 10^3 rad/s`", "neither rad/s nor Hz"],
        ),
        (
            "w [kHz];S;L\n1;2;3\n",
            with("columns = { omega = 1, storage = 2, loss = 3 }\n"),
            &["a frequency in `kHz`", "units = { omega = 6283.18"],
        ),
        (
            "w in 1/s;S;L\n1;2;3\n",
            with("columns = { omega = \"w\", storage = \"S\", loss = \"L\" }\n"),
            &["may be rad/s or Hz", "units = { omega = \"rad/s\" }"],
        ),
        (
            "omega,magnitude [MPa]\n1,2\n",
            with(""),
            &["line 1", "a magnitude of a receptance", "quantity = \"modulus\""],
        ),
        ("omega\n1\n", with(""), &["there is no column of data", "storage, loss, tan_delta of a modulus"]),
        (
            "w;M;P\n1;2;3\n",
            with("columns = { omega = \"w\", magnitude = \"M\", phase = \"P\" }\nquantity = \"modulus\"\n"),
            &["line 1", "unknown column `phase`", "storage and loss"],
        ),
        (
            "omega,tan_delta [deg]\n1,2\n",
            with(""),
            &["an angle in `deg`, where its tangent is wanted", "no number"],
        ),
        (
            "t,relaxation in N/mm²,creep in 1/Pa\n1,2,3\n",
            with(""),
            &["creep is in `1/Pa`, and relaxation in `N/mm²`"],
        ),
        ("omega,re,im\n1,2,3\nInfinity,2,3\n", with(""), &["line 3", "`Infinity` is not a finite number\n"]),
        ("0.1,2,3\n1,2,3\n", with(""), &["line 1", "columns = { omega = 1, … }", "or t or f"]),
        (
            "omega,re,im\n1,2,3\n2,3,4\nmeasured by,N.,2020-01-01\n",
            with(""),
            &["line 4", "`measured by`, `N.`, `2020-01-01` where numbers are wanted", "begins with #"],
        ),
        (
            "omega,re,im\n1,2,3\n2,3,4\n[step],2\n",
            with(""),
            &["line 4", "2 cells where the header has 3", "another table wants a file"],
        ),
        (GOOD, with("units = { q1 = 2.0 }\n"), &["data[0].units.q1", "unknown key"]),
        (GOOD, with("units = { t = \"min\" }\n"), &["data[0].units.t", "a number"]),
    ]);
}

#[test]
fn tables_in_different_units_are_not_fitted_together() {
    let place = Workplace::new();
    place.write("scenario.toml", OSCILLATOR);
    place.write("one.csv", "omega,storage [kPa]\n1,0.1\n2,0.1\n");
    place.write("two.csv", "t,relaxation [Pa]\n1,100\n2,90\n");
    let with = |units: &str| {
        let first = "[[data]]\nfile = \"one.csv\"\nquantity = \"modulus\"\n";
        let second = "[[data]]\nfile = \"two.csv\"\nquantity = \"modulus\"\n";
        place.write("fit.toml", &format!("{FREE}{first}{units}{second}"));
        place.fvi(&["fit", "fit.toml", "--out", "out"])
    };
    let output = with("");
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    let wanted = ["two.csv, line 1", "relaxation is in `Pa`, and storage of one.csv in `kPa`"];
    assert!(wanted.iter().all(|wanted| said.contains(wanted)), "{said}");
    let output = with("units = { storage = 1000 }\n");
    assert!(!text(&output.stderr).contains("kPa"), "{}", text(&output.stderr));
}

#[test]
fn bad_files_are_refused_with_their_places() {
    let good = "t,q0\n0.1,0.9\n0.2,0.8\n0.3,0.7\n0.4,0.5\n";
    let data = "[[data]]\nfile = \"data.csv\"\n";
    let with = |more: &str| format!("{FREE}{data}{more}");
    refuses(&[
        ("t,q0\n-0.2,0.9\n", with(""), &["line 2", "t = -0.2", "before the motion begins"]),
        ("t,q0\n7.0,0.9\n", with(""), &["line 2", "t = 7", "after the motion ends, at t = 6"]),
        ("t,q1\n0.1,0.9\n", with(""), &["line 1", "column 2", "unknown column `q1`"]),
        ("t,q0,q0\n0.1,0.9,1\n", with(""), &["column 3", "twice"]),
        ("time,q0\n0.1,0.9\n", with(""), &["there is no column t, omega (rad/s) or f (Hz)"]),
        ("t,q0\n", with(""), &["there are no rows"]),
        ("t\n0.1\n", with(""), &["there is no column of data"]),
        ("t,q0,q0_deviation\n0.1,0.9,0.0\n", with(""), &["line 2", "column 3 (q0_deviation)", "not > 0"]),
        ("t,q0,weight\n0.1,0.9,1\n", with("deviation = 0.1\n"), &["deviation", "the column weight"]),
        ("t,q0,p0\n0.1,0.9,1\n", with(""), &["`deviation` in every table", "positions"]),
        ("omega,re,im\n0.0,0.9,1\n", with(""), &["line 2", "column 1 (omega)", "not a frequency > 0"]),
        ("omega,re,im\n1.0,0.9,1\n", with("term = 3\n"), &["data[0].term = 3", "0 to 0"]),
        ("omega,re,im\n1.0,0.9,1\n", with("input = 1\n"), &["data[0].input = 1"]),
        (good, with("term = 0\n"), &["data[0].term", "data of a motion over time"]),
        (good, with("deviation = 0.0\n"), &["data[0].deviation = 0.0", "a number > 0"]),
        (
            good,
            with("deviation = 1e-300\n"),
            &["data.csv, line 2", "q0", "deviation of 1e-300", "1e-70 to 1e70"],
        ),
        (good, with("deviation = 1e300\n"), &["data.csv, line 2", "deviation of 1e300"]),
        ("t,q0\n0.1,0.9\n0.2,8e180\n", with(""), &["line 3", "q0 = 8e180", "a larger unit"]),
        (
            "t,q0\n0.1,3e-180\n0.2,2e-180\n",
            with(""),
            &["line 1", "the largest q0 is 3e-180", "a smaller unit"],
        ),
        (good, with("sigma = 1.0\n"), &["data[0].sigma", "unknown key"]),
        (good, with("set = { \"initial.positon[0]\" = 1.0 }\n"), &["data[0].set", "initial"]),
        (
            good,
            with("set = { \"system.parameters.k\" = 1.0 }\n"),
            &["data[0].set", "system.parameters.k is sought"],
        ),
        (good, format!("starts = 3\n{FREE}{data}"), &["starts = 3", "every free number has `bounds`"]),
        (good, format!("deviations = \"known\"\n{FREE}{data}"), &["deviations = \"known\""]),
        (good, format!("profile = [\"system.mass[0]\"]\n{FREE}{data}"), &["profile[0]"]),
        (good, format!("scenaro = 1\n{FREE}{data}"), &["scenaro", "did you mean `scenario`"]),
        (good, format!("scenario = \"scenario.toml\"\n{data}"), &["the key `free` is missing"]),
        (good, FREE.to_owned(), &["the key `data` is missing"]),
        (
            good,
            with("[[free]]\npath = \"system.parameters.q\"\n"),
            &["free[3].path = \"system.parameters.q\"", "scenario.toml cannot take it", "there is no number"],
        ),
        (
            good,
            with("[[free]]\npath = \"time.step\"\n"),
            &["free[3].path = \"time.step\"", "there is no number of the system"],
        ),
        (good, with("[[free]]\npath = \"system.parameters.k\"\n"), &["free[3].path", "each number once"]),
        (
            good,
            with("[[free]]\npath = \"system.mass[0]\"\nstart = -1.0\n"),
            &["free[3]", "system.mass[0] = -1", "not positive definite"],
        ),
        (
            good,
            with("[[free]]\npath = \"system.mass[0]\"\nbounds = [2, 3]\n"),
            &["free[3]", "within the bounds 2 and 3"],
        ),
        (
            good,
            with("[[free]]\npath = \"system.mass[0]\"\nbounds = [3, 2]\n"),
            &["free[3].bounds", "the lower one first"],
        ),
        (
            good,
            with("[[free]]\npath = \"system.mass[0]\"\nscale = \"log\"\nbounds = [0, 2]\n"),
            &["free[3].bounds", "bounds > 0"],
        ),
        (
            good,
            with("[[free]]\npath = \"system.mass[0]\"\nscale = \"cubic\"\n"),
            &["free[3].scale", "\"linear\", \"log\""],
        ),
        (
            good,
            with("[[model]]\nname = \"a\"\n[[model]]\nname = \"a\"\n"),
            &["model[1].name", "a name of its own"],
        ),
    ]);
}

#[test]
fn scenarios_whose_numbers_jump_are_refused() {
    let adaptive = format!("{OSCILLATOR}[scheme]\nkind = \"galerkin\"\ndegree = 1\n")
        .replace("family = \"bdf\"\norder = 2", "family = \"radau-iia\"\nstages = 2")
        .replace("step = 0.02\nsteps = 300", "grid = \"adaptive\"\nend = 6.0\ntolerance = 1e-6");
    let event = format!("{OSCILLATOR}[[event]]\nwhen = \"q0\"\n");
    for (scenario, said) in [(adaptive, "time.grid"), (event, "event")] {
        let place = Workplace::new();
        place.write("scenario.toml", &scenario);
        place.write("data.csv", "t,q0\n0.1,0.9\n");
        place.write("fit.toml", &format!("{FREE}[[data]]\nfile = \"data.csv\"\n"));
        let output = place.fvi(&["fit", "fit.toml", "--out", "out"]);
        assert_eq!(output.status.code(), Some(2));
        assert!(text(&output.stderr).contains(said), "{}", text(&output.stderr));
    }
}

/// Runs a fit of the repository.
fn of_repository(name: &str) -> Value {
    let place = Workplace::new();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/fits");
    let output = place.fvi(&["fit", folder.join(name).to_str().unwrap(), "--out", "out"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    record(&place)
}

fn is_covered(record: &Value, path: &str, truth: f64) -> bool {
    let interval = &record["parameters"][path]["interval"];
    interval[0].as_f64().unwrap() <= truth && truth <= interval[1].as_f64().unwrap()
}

#[test]
fn the_decay_of_the_repository_tells_what_it_was_made_of() {
    let found = of_repository("decay.toml");
    for (path, truth) in [
        ("system.damping[0].order", 0.6),
        ("system.damping[0].coefficient[0]", 0.3),
        ("system.parameters.k", 4.0),
    ] {
        assert!(is_covered(&found, path, truth), "{path}: {found:#}");
    }
}

#[test]
fn the_spring_of_the_repository_is_known_by_its_moduli_and_its_decay() {
    let found = of_repository("spring-models.toml");
    assert_eq!(found["name"], "fractional Zener");
    for (path, truth) in [
        ("system.damping[0].kernel.order", 0.45),
        ("system.damping[0].kernel.time", 0.02),
        ("system.damping[0].coefficient[0]", 60.0),
        ("system.parameters.e", 40.0),
    ] {
        assert!(is_covered(&found, path, truth), "{path}: {found:#}");
    }
    assert!((found["reduced_chi2"].as_f64().unwrap() - 1.0).abs() < 0.2, "{found:#}");
    let models = found["models"].as_array().unwrap();
    for other in &models[..2] {
        assert!(other["aic"].as_f64().unwrap() > found["aic"].as_f64().unwrap() + 100.0, "{other:#}");
    }
}
