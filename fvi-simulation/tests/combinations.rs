//! What goes with what: every pair of features is refused by the table of combinations, or gives the motion
//! of the plain way.

use fvi_core::{BdfOrder, ConvolutionWeights};
use fvi_fft::memory::Tables;
use fvi_fft::sums::max_or_nan;
use fvi_scenario::language::expression::Moment;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Feature, OwnTerms, ROWS, Row, Scenario, SharedTerms};
use fvi_simulation::simulation::Precision;
use fvi_simulation::simulation::motion::Motion;
use fvi_simulation::simulation::response::Linearised;
use nalgebra::Complex;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Mutex;

/// Something that a scenario may have.
struct Fragment {
    name: &'static str,
    /// The keys that turn it on.
    on: Value,
    /// The keys that say the same in a scenario that is otherwise plain: empty for what is no part of the
    /// problem, such as a scheme.
    plain: Value,
    /// Largest change of the motion by it, relative to its size; `None` for what changes the motion, or the
    /// error of its discretisation.
    change: Option<f64>,
}

/// A part of the problem, which changes the motion.
fn problem(name: &'static str, on: Value) -> Fragment {
    Fragment { name, plain: on.clone(), on, change: None }
}

/// A discretisation, which changes the error of the motion.
fn method(name: &'static str, on: Value) -> Fragment {
    Fragment { name, on, plain: json!({}), change: None }
}

/// What must not change the motion by more than rounding.
fn neutral(name: &'static str, on: Value) -> Fragment {
    Fragment { name, on, plain: json!({}), change: Some(1e-10) }
}

const STEP: f64 = 0.005;

/// Error of a discretisation on steps of [`STEP`], relative to the largest position.
const ACCURACY: f64 = 0.03;

fn system(keys: Value) -> Value {
    json!({ "system": keys })
}

fn damped(term: Value) -> Value {
    system(json!({ "damping": [term] }))
}

/// Rows of a uniform motion before the start, on steps with nodes at these fractions.
fn past(step: f64, fractions: &[f64]) -> Value {
    let steps = (0.05 / step).round() as usize;
    let rows = (0..steps).rev().flat_map(|k| {
        let beginning = -((k + 1) as f64) * step;
        let nodes = fractions.iter().map(move |fraction| beginning + fraction * step);
        std::iter::once(beginning).chain(nodes)
    });
    rows.map(|t| json!([1.0 + 4.0 * t, -0.3])).collect()
}

fn problems() -> Vec<Fragment> {
    let singular = || json!({ "order": 0.3, "coefficient": [0.5, 0.0], "derivative": "riemann-liouville" });
    let push = json!({ "pattern": [1.0, 0.0], "amplitude": "3*cos(2*t)" });
    let controller = |delay: f64| json!({ "controller": [{ "measures": "q0", "setpoint": "0.2", "drives": [1.0, 0.0], "kp": 3.0, "sample": 0.01, "delay": delay }] });
    vec![
        problem("potential", system(json!({ "potential": "q0^4" }))),
        problem("force", system(json!({ "force": ["3*sin(3*t)", "0"] }))),
        problem("force of velocity", system(json!({ "force": ["-0.8*v0", "0"] }))),
        problem("kinked force", system(json!({ "force": ["-2*abs(q0 - 0.8)", "0"] }))),
        problem("kinked potential", system(json!({ "potential": "(q0 - 0.8)*abs(q0 - 0.8)" }))),
        problem("element", system(json!({ "element": [{ "potential": "x0^4", "coordinates": [[0]] }] }))),
        problem(
            "kinked element",
            system(json!({ "element": [{ "potential": "x0*abs(x0)", "coordinates": [[1]] }] })),
        ),
        problem("load", system(json!({ "load": [push] }))),
        // Schemes whose step is limited are not checked with it and damping.
        problem(
            "gyroscopic",
            json!({ "system": { "gyroscopic": [[0.0, -1.5], [1.5, 0.0]] }, "time": { "allow_unstable": true } }),
        ),
        problem("massless", system(json!({ "mass": [1.0, 0.0] }))),
        problem("order 1.5", damped(json!({ "order": 1.5, "coefficient": [0.5, 0.0] }))),
        problem("riemann-liouville", damped(singular())),
        Fragment {
            plain: damped(singular()),
            ..problem(
                "momentum offset",
                json!({
                    "system": { "damping": [singular()] },
                    "scheme": { "kind": "galerkin", "degree": 2 },
                    "convolution": { "order": 3 },
                }),
            )
        },
        problem(
            "prony",
            damped(
                json!({ "kernel": { "form": "prony", "strengths": [2.0], "times": [0.5] }, "coefficient": [1.0, 0.0] }),
            ),
        ),
        problem(
            "tempered",
            damped(
                json!({ "kernel": { "form": "tempered", "order": 0.5, "rate": 1.0 }, "coefficient": [1.0, 0.0] }),
            ),
        ),
        problem(
            "oscillating",
            damped(json!({ "kernel": { "symbol": "4*s^2/(s^2 + s + 9)" }, "coefficient": [1.0, 0.0] })),
        ),
        problem(
            "oscillating, riemann-liouville",
            damped(json!({
                "kernel": { "symbol": "4*s^2/(s^2 + s + 9)" }, "coefficient": [0.3, 0.0], "derivative": "riemann-liouville",
            })),
        ),
        problem(
            "elongation",
            damped(json!({ "order": 0.6, "coefficient": 0.9, "along": "hypot(q0 + 2, 1.5*q1)" })),
        ),
        problem(
            "kinked elongation",
            damped(json!({ "order": 0.6, "coefficient": 0.9, "along": "abs(q0 + 5)" })),
        ),
        problem(
            "lagrangian",
            system(json!({ "kinetic": "0.5*v0^2 + 0.35*v1^2 + 0.3*q0^2*v0*v1 + 0.5*(q0*v1 - q1*v0)" })),
        ),
        problem(
            "constraint",
            json!({ "system": { "constraints": ["q0 + 2*q1 - 0.3 - 0.1*q0^2"] }, "initial": { "project": true } }),
        ),
        problem("past", json!({ "initial": { "past": [] } })),
        problem("start", json!({ "time": { "start": 0.25 } })),
        problem("input", json!({ "input": { "samples": [[3.0, 0.0], [-1.0, 0.5]], "period": 0.25 } })),
        problem("controller", controller(0.0)),
        problem("delay", controller(0.013)),
        problem("own terms", json!({ "own": "approximately" })),
        problem("own terms with derivatives", json!({ "own": "exactly" })),
        Fragment {
            plain: system(json!({ "load": [push] })),
            ..problem("case", json!({ "case": [{ "name": "one", "load": [push] }] }))
        },
        Fragment {
            plain: damped(json!({ "order": 0.5, "coefficient": [1.0, 0.0] })),
            ..problem(
                "weights",
                damped(json!({ "kernel": { "weights": weights() }, "coefficient": [1.0, 0.0] })),
            )
        },
    ]
}

/// Weights of D^½ by BDF 2, of the default scheme.
fn weights() -> Vec<f64> {
    let order = BdfOrder::new(2).unwrap();
    ConvolutionWeights::bdf(order, 0.5, STEP).unwrap().take(300).collect()
}

fn staged(scheme: Value, family: &str, stages: usize) -> Value {
    json!({ "scheme": scheme, "convolution": { "family": family, "stages": stages } })
}

fn methods() -> Vec<Fragment> {
    let galerkin = |degree: usize| json!({ "kind": "galerkin", "degree": degree });
    let collocation = || json!({ "kind": "collocation" });
    let graded = || json!({ "grid": "graded", "end": 1.0, "steps": 200, "exponent": 1.5 });
    let with = |mut value: Value, key: &str, more: Value| {
        value[key] = more;
        value
    };
    let scheme = |scheme: Value| json!({ "scheme": scheme });
    let gauss = |time: Value| {
        let gauss = json!({ "scheme": galerkin(2), "convolution": { "family": "gauss" } });
        if time == json!({}) { gauss } else { with(gauss, "time", time) }
    };
    let convolution = |convolution: Value| json!({ "convolution": convolution });
    vec![
        method("explicit Euler", scheme(json!({ "kind": "explicit-euler" }))),
        method("implicit Euler", scheme(json!({ "kind": "implicit-euler" }))),
        method("projected", json!({ "initial": { "project": true } })),
        method("symplectic Euler", scheme(json!({ "kind": "low-order", "kappa": 0.0 }))),
        method("symplectic Euler of the beginning", scheme(json!({ "kind": "low-order", "kappa": 1.0 }))),
        method("auto", scheme(json!({ "kind": "auto", "tolerance": 1e-4 }))),
        method("galerkin", scheme(galerkin(2))),
        method("galerkin, more points", scheme(json!({ "kind": "galerkin", "degree": 2, "points": 3 }))),
        method(
            "galerkin, Lobatto",
            scheme(json!({ "kind": "galerkin", "degree": 2, "quadrature": "lobatto", "points": 2 })),
        ),
        method("galerkin, Radau", staged(galerkin(2), "radau-iia", 2)),
        method("galerkin, Lobatto IIIC", staged(galerkin(2), "lobatto-iiic", 2)),
        method("gauss", gauss(json!({}))),
        method("gauss at one point", convolution(json!({ "family": "gauss" }))),
        method("graded gauss", gauss(graded())),
        method("energy", scheme(json!({ "kind": "energy" }))),
        method(
            "energy by weights of a multistep rule",
            with(convolution(json!({ "order": 2 })), "scheme", json!({ "kind": "energy" })),
        ),
        method("adaptive gauss", gauss(json!({ "grid": "adaptive", "end": 1.0, "tolerance": 1e-5 }))),
        method("collocation", staged(collocation(), "radau-iia", 3)),
        method("collocation of five stages", staged(collocation(), "radau-iia", 5)),
        method("collocation, Lobatto IIIC", staged(collocation(), "lobatto-iiic", 2)),
        method("order 1", convolution(json!({ "order": 1 }))),
        method("order 4", convolution(json!({ "order": 4 }))),
        method("trapezoidal", convolution(json!({ "symbol": "trapezoidal" }))),
        method("nodes", convolution(json!({ "at": "nodes" }))),
        method("main nodes", convolution(json!({ "at": "main-nodes" }))),
        method("starting", convolution(json!({ "starting": [0.5] }))),
        method("stages", convolution(json!({ "family": "radau-iia", "stages": 2 }))),
        method("moments at nodes", system(json!({ "force_quadrature": "nodes" }))),
        method("steps", json!({ "time": graded() })),
        method("graded collocation", with(staged(collocation(), "radau-iia", 3), "time", graded())),
        method("graded galerkin", with(staged(galerkin(2), "radau-iia", 2), "time", graded())),
        method(
            "adaptive",
            with(
                staged(collocation(), "radau-iia", 3),
                "time",
                json!({ "grid": "adaptive", "end": 1.0, "tolerance": 1e-5 }),
            ),
        ),
    ]
}

fn neutrals() -> Vec<Fragment> {
    let history = |history: Value| json!({ "history": history });
    let output = |output: Value| json!({ "output": output });
    let event = |when: &str, action: &str| json!({ "event": [{ "when": when, "action": action }] });
    vec![
        neutral("direct", history(json!({ "engine": "direct" }))),
        neutral("forgetful", history(json!({ "capacity": 400, "overflow": "forget" }))),
        neutral("block-fft", history(json!({ "engine": "block-fft" }))),
        neutral("real-time", history(json!({ "engine": "real-time" }))),
        neutral("exponential-sum", history(json!({ "engine": "exponential-sum" }))),
        neutral("exponential-sum-core", history(json!({ "engine": "exponential-sum-core" }))),
        Fragment { change: Some(1e-6), ..neutral("tolerance", history(json!({ "tolerance": 1e-7 }))) },
        Fragment {
            change: Some(1e-4),
            ..neutral("single states", history(json!({ "tolerance": 1e-6, "states": "f32" })))
        },
        Fragment { change: Some(1e-8), ..neutral("any-step", history(json!({ "engine": "any-step" }))) },
        neutral("threads", history(json!({ "threads": 2 }))),
        neutral("every", output(json!({ "every": 7, "snapshots": 20 }))),
        neutral("mean momentum", output(json!({ "momentum": "mean" }))),
        neutral("one-sided momentum", output(json!({ "momentum": "one-sided" }))),
        neutral("times", output(json!({ "times": [0.333, 0.7777] }))),
        neutral("memory energy", output(json!({ "memory_energy": true }))),
        neutral("energy guard", json!({ "time": { "energy_guard": "warn" } })),
        neutral("reference", json!({ "reference": { "position": ["0.1", "0"] } })),
        neutral("event", event("q0 - 0.7", "record")),
        neutral("momentum event", event("p0", "record")),
        neutral("stop", event("q0 - 100", "stop")),
        neutral("sensitivity", json!({ "sensitivity": { "parameters": ["initial.position[0]"] } })),
    ]
}

/// The keys of both; `None` if they differ in a value.
fn merged(one: &Value, other: &Value) -> Option<Value> {
    match (one, other) {
        (Value::Object(one), Value::Object(other)) => {
            let mut all = one.clone();
            for (key, value) in other {
                let both = match all.get(key) {
                    Some(known) => merged(known, value)?,
                    None => value.clone(),
                };
                all.insert(key.clone(), both);
            }
            Some(Value::Object(all))
        }
        (Value::Array(one), Value::Array(other)) if one.iter().chain(other).all(Value::is_object) => {
            Some(one.iter().chain(other).cloned().collect())
        }
        _ => (one == other).then(|| one.clone()),
    }
}

/// A whole scenario from keys, with what they do not say.
fn whole(keys: &Value, step: f64) -> Value {
    let mut usual = json!({
        "system": {
            "mass": [1.0, 0.7],
            "stiffness": [[3.0, -1.0], [-1.0, 2.0]],
        },
        "initial": { "position": [1.0, -0.3], "velocity": [0.4, 0.0] },
    });
    if keys["time"].get("grid").is_none() {
        usual["time"] = json!({ "step": step, "end": 1.0 });
    }
    let over = |usual: &mut Value, keys: &Value| {
        for (table, values) in keys.as_object().unwrap() {
            match (usual.get_mut(table).and_then(Value::as_object_mut), values) {
                (Some(usual), Value::Object(values)) => usual.extend(values.clone()),
                _ => usual[table] = values.clone(),
            }
        }
    };
    over(&mut usual, keys);
    if !keys["system"]["kinetic"].is_null() {
        usual["system"].as_object_mut().unwrap().remove("mass");
    }
    let base = json!({ "order": 0.5, "coefficient": [[0.4, -0.1], [-0.1, 0.3]] });
    let damping = usual["system"].as_object_mut().unwrap().entry("damping").or_insert(json!([]));
    damping.as_array_mut().unwrap().insert(0, base);
    if !usual["initial"]["past"].is_null() {
        usual["initial"]["past"] = past(step, &fractions(&usual));
    }
    usual
}

/// The nodes of a step, as fractions, of schemes that store several of them.
fn fractions(scenario: &Value) -> Vec<f64> {
    let root = |x: f64| x.sqrt();
    let convolution = &scenario["convolution"];
    match (scenario["scheme"]["kind"].as_str(), convolution["family"].as_str()) {
        _ if convolution["at"] == "main-nodes" || !convolution["starting"].is_null() => vec![],
        _ if is_mechanism(scenario) => vec![0.5 - root(1.0 / 12.0), 0.5 + root(1.0 / 12.0)],
        (Some("galerkin"), Some("radau-iia")) => vec![1.0 / 3.0, 1.0],
        (_, Some("lobatto-iiic")) => vec![0.0, 1.0],
        (Some("galerkin"), _) if scenario["scheme"]["points"] == 3 => {
            vec![0.5 - root(0.15), 0.5, 0.5 + root(0.15)]
        }
        (Some("galerkin"), _) if scenario["scheme"]["quadrature"] == "lobatto" => vec![0.0, 1.0],
        (Some("galerkin"), _) => vec![0.5 - root(1.0 / 12.0), 0.5 + root(1.0 / 12.0)],
        (Some("collocation"), _) if convolution["stages"] == 5 => vec![
            0.057_104_196_114_517_68,
            0.276_843_013_638_123_8,
            0.583_590_432_368_916_8,
            0.860_240_135_656_219_5,
            1.0,
        ],
        (Some("collocation"), _) => vec![0.4 - root(0.06), 0.4 + root(0.06), 1.0],
        _ => vec![],
    }
}

/// True if it has a Lagrangian, or damping along elongations.
fn is_mechanism(scenario: &Value) -> bool {
    let system = &scenario["system"];
    let terms = system["damping"].as_array().into_iter().flatten();
    !system["kinetic"].is_null() || terms.into_iter().any(|term| !term["along"].is_null())
}

/// U(q) = q0⁴/4 in code.
struct Quartic {
    exact: bool,
}

impl OwnTerms for Quartic {
    fn potential(&mut self, position: &[f64]) -> f64 {
        0.25 * position[0].powi(4)
    }

    fn add_restoring_force(&mut self, _: Moment<f64>, position: &[f64], restoring: &mut [f64]) {
        restoring[0] += position[0].powi(3);
    }

    fn add_linearisation(
        &mut self,
        moment: Moment<f64>,
        position: &[f64],
        restoring: &mut [f64],
        stiffness: &mut [f64],
    ) {
        self.add_restoring_force(moment, position, restoring);
        stiffness[0] += 3.0 * position[0].powi(2);
    }

    fn has_exact_derivatives(&self) -> bool {
        self.exact
    }

    fn take_largest_force(&mut self, largest: &mut [f64]) {
        largest[0] = 1.0;
    }
}

/// The last position, or why there is none.
#[derive(Clone, Debug)]
enum End {
    At(Vec<f64>),
    Refused(&'static Row),
    /// The key of an error of a reader, and the error.
    Unread(String, String),
    Failed(String),
}

fn read(scenario: &Value) -> Result<Scenario, InputError> {
    let mut scenario = scenario.clone();
    let own = scenario.as_object_mut().and_then(|keys| keys.remove("own"));
    let scenario = Scenario::from_value(&scenario)?;
    let terms = own.map(|own| SharedTerms::new(Quartic { exact: own == "exactly" }));
    Ok(match terms {
        Some(terms) => scenario.with_own_terms(terms),
        None => scenario,
    })
}

fn run(scenario: &Value, precision: Precision) -> End {
    let end = || -> Result<Result<Vec<f64>, String>, InputError> {
        let scenario = read(scenario)?;
        let mut motion = Motion::start(&scenario, precision)?.with_sensitivities(&Tables::default())?;
        while !motion.is_done() {
            if let Err(failure) = motion.advance() {
                return Ok(Err(format!("{failure:?}")));
            }
        }
        Ok(Ok(motion.state().position.clone()))
    };
    let told = |error: &InputError| format!("{error}; {:?}", error.problem().allowed());
    if let Err(error) = read(scenario)
        && row_of(&error).is_none()
    {
        return End::Unread(error.key().to_owned(), told(&error));
    }
    match end() {
        Ok(Ok(position)) => End::At(position),
        Ok(Err(failure)) => End::Failed(failure),
        Err(error) => match row_of(&error) {
            Some(row) => End::Refused(row),
            None => End::Failed(told(&error)),
        },
    }
}

/// The row of the table that an error is from.
fn row_of(error: &InputError) -> Option<&'static Row> {
    let Problem::Incompatible { with, allowed } = error.problem() else { return None };
    ROWS.iter().find(|row| {
        let plain = |key: &str| key.replace(['[', ']', 'i', '0', '1', '2'], "");
        let name = row.beside.name().replace(" i ", " 1 ");
        let is_key = |key: String| plain(error.key()) == plain(&key);
        row.instead == allowed && with.starts_with(&name) && row.refused.keys().any(is_key)
    })
}

/// Distance of two ends relative to the larger one.
fn distance(one: &[f64], other: &[f64]) -> f64 {
    if one.len() != other.len() {
        return f64::INFINITY;
    }
    let size = other.iter().fold(0.0, |most: f64, x| max_or_nan(most, x.abs()));
    let apart = one.iter().zip(other).map(|(a, b)| (a - b).abs());
    apart.fold(0.0, |most: f64, x| if x > most || x.is_nan() { x } else { most }) / size
}

/// Runs of scenarios, each made once.
#[derive(Default)]
struct Runs(Mutex<BTreeMap<String, End>>);

impl Runs {
    fn end(&self, keys: &Value, step: f64) -> End {
        let scenario = whole(keys, step);
        let key = scenario.to_string();
        if let Some(known) = self.0.lock().unwrap().get(&key) {
            return known.clone();
        }
        let end = run(&scenario, Precision::F64);
        self.0.lock().unwrap().insert(key, end.clone());
        end
    }
}

/// Pairs that are refused where matrices or tables of numbers are computed: gyroscopic forces and dampers act
/// on the coordinate without mass, kernels have no exponentials to rounding or for steps of any length, or no
/// Maxwell elements, the matrix of a step is not symmetric.
const BY_NUMBERS: [(&str, &str); 22] = [
    ("gyroscopic", "massless"),
    ("massless", "main nodes"),
    ("massless", "starting"),
    ("order 1.5", "memory energy"),
    ("oscillating", "exponential-sum"),
    ("oscillating", "exponential-sum-core"),
    ("oscillating", "single states"),
    ("oscillating", "graded collocation"),
    ("oscillating", "graded galerkin"),
    ("oscillating", "adaptive"),
    ("oscillating, riemann-liouville", "exponential-sum"),
    ("oscillating, riemann-liouville", "exponential-sum-core"),
    ("oscillating, riemann-liouville", "single states"),
    ("oscillating, riemann-liouville", "graded collocation"),
    ("oscillating, riemann-liouville", "graded galerkin"),
    ("oscillating, riemann-liouville", "adaptive"),
    ("case", "galerkin, more points"),
    ("case", "galerkin, Lobatto"),
    ("case", "galerkin, Radau"),
    ("case", "galerkin, Lobatto IIIC"),
    ("case", "collocation"),
    ("case", "collocation of five stages"),
];

/// What is wrong with two fragments together; the row of the table if it refuses them.
fn judged(one: &Fragment, other: &Fragment, runs: &Runs) -> Result<Option<&'static Row>, String> {
    let (Some(on), Some(plain)) = (merged(&one.on, &other.on), merged(&one.plain, &other.plain)) else {
        return Ok(None);
    };
    let both_write = |key: &str| {
        let table = key.split(['.', '[']).next().unwrap_or_default();
        table != "system" && [one, other].iter().all(|fragment| !fragment.on[table].is_null())
    };
    let position = match runs.end(&on, STEP) {
        End::At(position) => position,
        End::Refused(row) => return Ok(Some(row)),
        // What a tolerance chooses is not given beside it.
        End::Unread(key, _) if [one, other].iter().any(|fragment| fragment.name == "auto") => {
            let chosen = key == "convolution" || key.starts_with("time.");
            return if chosen { Ok(None) } else { Err(format!("{key} is not read")) };
        }
        // A table that both write may contradict itself.
        End::Unread(key, _) if both_write(&key) => return Ok(None),
        End::Failed(_) if BY_NUMBERS.contains(&(one.name, other.name)) => return Ok(None),
        End::Failed(reason) | End::Unread(_, reason) => return Err(reason),
    };
    if BY_NUMBERS.contains(&(one.name, other.name)) {
        return Err("it runs".to_owned());
    }
    let End::At(exact) = runs.end(&plain, STEP / 4.0) else {
        return Err("the plain way does not run".to_owned());
    };
    let off = distance(&position, &exact);
    if off.is_nan() || off > ACCURACY {
        return Err(format!("{off:.1e} off the plain way: {position:?}, not {exact:?}"));
    }
    for (this, without) in [(one, other), (other, one)] {
        let (Some(change), End::At(same)) = (this.change, runs.end(&without.on, STEP)) else { continue };
        let off = distance(&position, &same);
        if off.is_nan() || off > change {
            return Err(format!("`{}` changes the motion by {off:.1e}", this.name));
        }
    }
    Ok(None)
}

fn fragments() -> Vec<Fragment> {
    problems().into_iter().chain(methods()).chain(neutrals()).collect()
}

#[test]
fn every_pair_is_refused_or_right() {
    let fragments = fragments();
    let runs = Runs::default();
    let pairs: Vec<_> =
        (0..fragments.len()).flat_map(|i| (i..fragments.len()).map(move |j| (i, j))).collect();
    let judged: Vec<_> = std::thread::scope(|scope| {
        let (fragments, runs) = (&fragments, &runs);
        let halves = pairs.chunks(pairs.len().div_ceil(2)).map(|part| {
            scope.spawn(move || {
                let judge = |&(i, j): &(usize, usize)| {
                    let nothing = Fragment { on: json!({}), plain: json!({}), ..method("itself", json!({})) };
                    let other = if i == j { &nothing } else { &fragments[j] };
                    (&fragments[i], &fragments[j], judged(&fragments[i], other, runs))
                };
                part.iter().map(judge).collect::<Vec<_>>()
            })
        });
        let halves: Vec<_> = halves.collect();
        halves.into_iter().flat_map(|half| half.join().unwrap()).collect()
    });
    let wrong: Vec<String> = judged
        .iter()
        .filter_map(|(one, other, found)| {
            let reason = found.as_ref().err()?;
            Some(format!("{} beside {}: {reason}", one.name, other.name))
        })
        .collect();
    assert!(wrong.is_empty(), "{} of {} pairs:\n{}", wrong.len(), judged.len(), wrong.join("\n"));
    let seen =
        |row: &&Row| !judged.iter().any(|(.., found)| found.as_ref().is_ok_and(|found| *found == Some(row)));
    // The fragments are parts of a system.
    let of_systems = |row: &&Row| !row.beside.is_use() && row.beside != Feature::Equation;
    let missed: Vec<_> = ROWS.iter().filter(of_systems).filter(seen).collect();
    assert!(missed.is_empty(), "no pair meets {missed:#?}");
}

#[test]
fn what_an_equation_does_not_have_is_refused() {
    let equation = |table: &str, keys: Value| {
        let mut scenario = json!({
            "equation": { "order": 0.5, "right": "-x0", "initial": [1.0] },
            "time": { "end": 1.0 },
        });
        scenario[table].as_object_mut().unwrap().extend(keys.as_object().unwrap().clone());
        Scenario::from_value(&scenario)
    };
    let refused = [("time", json!({ "energy_guard": "warn" }), "time.energy_guard")];
    assert_eq!(ROWS.iter().filter(|row| row.beside == Feature::Equation).count(), refused.len());
    for (table, keys, path) in refused {
        assert!(equation(table, json!({})).is_ok());
        assert_eq!(equation(table, keys).unwrap_err().key(), path);
    }
}

#[test]
fn every_part_of_the_problem_is_felt() {
    let runs = Runs::default();
    let End::At(base) = runs.end(&json!({}), STEP) else { panic!("the base runs") };
    for part in problems() {
        let End::At(moved) = runs.end(&part.plain, STEP) else { panic!("{} runs", part.name) };
        let off = distance(&moved, &base);
        assert!(off > 2.0 * ACCURACY, "{} moves the end by {off:.1e}", part.name);
    }
}

#[test]
fn every_feature_goes_with_single_precision() {
    for Fragment { name, on, .. } in fragments() {
        let scenario = whole(&on, STEP);
        let End::At(double) = run(&scenario, Precision::F64) else { continue };
        match run(&scenario, Precision::F32) {
            End::At(single) => {
                let off = distance(&single, &double);
                assert!(off < 1e-4, "{name}: {off:.1e}");
            }
            End::Refused(row) => assert_eq!(row.beside, Feature::SinglePrecision, "{name}"),
            other => panic!("{name}: {other:?}"),
        }
    }
}

#[test]
fn every_feature_is_continued_to_the_bit() {
    for Fragment { name, on, .. } in fragments() {
        let Ok(scenario) = read(&whole(&on, STEP)) else { continue };
        if scenario.check_use(Feature::Motion).is_err() {
            continue;
        }
        let start = || {
            let motion = Motion::start(&scenario, Precision::F64).unwrap();
            motion.with_sensitivities(&Tables::default()).unwrap()
        };
        let mut whole = start();
        let mut rest = start();
        while !whole.is_done() {
            whole.advance().unwrap();
            if whole.steps() == 20 {
                let state = whole.save().unwrap();
                rest.resume(20, &state, whole.gathered(), whole.chosen()).unwrap();
            }
        }
        while !rest.is_done() {
            rest.advance().unwrap();
        }
        assert_eq!(whole.state(), rest.state(), "{name}");
    }
}

#[test]
fn every_feature_has_the_response_of_the_plain_way() {
    let answer = |scenario: &Value| -> Result<Vec<Complex<f64>>, InputError> {
        let scenario = read(scenario)?;
        let linearised = Linearised::new(&scenario, &scenario.initial.position)?;
        Ok(linearised.response(2.0, 0).unwrap())
    };
    for Fragment { name, on, plain, .. } in fragments() {
        let Ok(plain) = answer(&whole(&plain, STEP)) else { continue };
        match answer(&whole(&on, STEP)) {
            Ok(found) => {
                let off = found.iter().zip(&plain).map(|(a, b)| (a - b).norm() / b.norm());
                assert!(off.clone().all(|off| off < ACCURACY), "{name}: {:?}", off.collect::<Vec<_>>());
            }
            Err(error) => assert!(row_of(&error).is_some(), "{name}: {error}"),
        }
    }
}
