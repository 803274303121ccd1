//! What is done with each kind of input, and what must hold.

use super::corpus::{files, lines};
use super::{Domain, Outcome};
use fvi_exhibits::two_point::ProblemFile;
use fvi_host::sweep::Sweep;
use fvi_scenario::language::expression::{Expression, Moment, Symbols};
use fvi_scenario::language::{Document, InputError};
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::{GridState, Precision, Simulation};
use nalgebra::SVector;
use std::path::Path;

/// Longest message, in bytes.
const LONGEST_MESSAGE: usize = 4000;

/// Steps of a run.
const STEPS: usize = 6;

/// A table that scenarios and problems of the corpus name, whatever its name.
const TABLE: &str = "t,u0\n0,1\n0.5,-1\n";

fn message(error: &dyn std::fmt::Display) -> Result<(), String> {
    let text = error.to_string();
    if text.trim().is_empty() || text.len() > LONGEST_MESSAGE || text.contains(['\u{0}', '\u{1b}']) {
        return Err(format!("the message {text:?}"));
    }
    Ok(())
}

fn refused(error: &InputError) -> Result<Outcome, String> {
    message(error)?;
    if let Some(help) = miette::Diagnostic::help(error) {
        message(&help)?;
    }
    Ok(Outcome::Refused)
}

fn failed(error: &dyn std::fmt::Display) -> Result<Outcome, String> {
    message(error).map(|()| Outcome::Failed)
}

/// Whole numbers of more than three digits on lines that speak of steps or counts are cut: what is tried is
/// the reader, not the patience.
fn few_steps(input: &str) -> String {
    let mut text = String::new();
    for line in input.split_inclusive('\n') {
        let mut digits = 0;
        let counted = line.contains("steps") || line.contains("count");
        text.extend(line.chars().filter(|letter| {
            digits = if letter.is_ascii_digit() || *letter == '_' { digits + 1 } else { 0 };
            !counted || digits <= 3
        }));
    }
    text
}

pub(crate) fn expressions() -> Domain {
    Domain { name: "expressions", corpus: lines("expressions.txt"), attempt: expression }
}

fn expression(input: &str) -> Result<Outcome, String> {
    let symbols = Symbols::new().with_time().with_coordinates(2).with_parameter("k", 2.0).unwrap();
    match Expression::parse(input, &symbols) {
        Ok(expression) => {
            for (t, q) in [(0.0, [0.0, 0.0]), (0.5, [1.5, -2.0]), (1e300, [1e-300, f64::MAX])] {
                let point = SVector::<f64, 2>::from(q);
                let value: f64 = expression.value(Moment::from_left(t), &q);
                let (with_gradient, gradient) = expression.gradient(Moment::from_left(t), &point);
                let (with_hessian, same_gradient, _) = expression.hessian(Moment::from_left(t), &point);
                let same = |a: f64, b: f64| a == b || (a.is_nan() && b.is_nan());
                let equal = same(value, with_gradient)
                    && same(value, with_hessian)
                    && gradient.iter().zip(&same_gradient).all(|(a, b)| same(*a, *b));
                if !equal {
                    return Err(format!(
                        "{value} {with_gradient} {with_hessian}, {gradient} {same_gradient}"
                    ));
                }
            }
            Ok(Outcome::Done)
        }
        Err(error) => {
            message(&error)?;
            if error.span.end > input.len() + 1 || error.column() == 0 {
                return Err(format!("the place {:?} of {error}", error.span));
            }
            Ok(Outcome::Refused)
        }
    }
}

pub(crate) fn scenarios() -> Domain {
    let corpus =
        [files("../examples/scenarios", "toml"), files("tests/hostile/corpus/scenarios", "toml")].concat();
    Domain { name: "scenarios", corpus, attempt: scenario }
}

fn scenario(input: &str) -> Result<Outcome, String> {
    run(Document::new("hostile.toml", Path::new("/nowhere"), &few_steps(input))
        .with_attached("viscoelastic-stage-drive.csv", TABLE)
        .with_attached("bagley-torvik-pulse-reference.csv", "t,q0\n0,0\n"))
}

/// Reads a scenario and makes a few steps, in both precisions.
fn run(document: Document) -> Result<Outcome, String> {
    let mut scenario = match Scenario::from_document(document) {
        Ok(scenario) => scenario,
        Err(error) => return refused(&error),
    };
    scenario.warnings().iter().try_for_each(|warning| message(warning))?;
    scenario.time.steps = scenario.time.steps.min(STEPS);
    let mut outcome = Outcome::Done;
    for precision in [Precision::F64, Precision::F32] {
        let mut simulation = match Simulation::new(&scenario, precision) {
            Ok(simulation) => simulation,
            Err(error) => {
                refused(&error)?;
                outcome = Outcome::Refused;
                continue;
            }
        };
        let numbers = vec![0.0; scenario.coordinates()];
        let mut state = GridState { position: numbers.clone(), momentum: numbers, ..GridState::default() };
        for step in 0..scenario.time.steps {
            let input = scenario.input_over(step);
            if let Err(error) = simulation.step(input) {
                outcome = failed(&error)?;
                break;
            }
            simulation.read(&mut state);
            let known = scenario.reference.as_ref().and_then(|reference| {
                reference.at_step(step + 1, scenario.time.step, scenario.coordinates())
            });
            let known =
                known.iter().flat_map(|row| row.position.iter().chain(&row.momentum).chain([&row.energy]));
            let mut numbers = state.position.iter().chain(&state.momentum).chain(known.flatten());
            if !numbers.all(|number| number.is_finite()) {
                return Err(format!("step {step} gives {state:?}"));
            }
        }
    }
    Ok(outcome)
}

pub(crate) fn problems() -> Domain {
    let corpus =
        [files("../examples/problems", "toml"), files("tests/hostile/corpus/problems", "toml")].concat();
    Domain { name: "problems", corpus, attempt: problem }
}

fn problem(input: &str) -> Result<Outcome, String> {
    let document = Document::new("hostile.toml", Path::new("/nowhere"), &few_steps(input))
        .with_attached("least-fractional-speed-reference.csv", "t,x0\n0,0\n0.5,0.25\n1,1\n");
    let file = match ProblemFile::from_document(document) {
        Ok(file) => file,
        Err(error) => return refused(&error),
    };
    let grid = file.grid.with_steps(file.grid.steps().min(16)).map_err(|error| error.to_string())?;
    let solution = match file.solve(grid, &mut |_, _| ()) {
        Ok(Ok(solution)) => solution,
        Ok(Err(error)) => return failed(&error),
        Err(error) => return failed(&error),
    };
    let numbers = solution.positions.iter().chain(&solution.velocities).chain(&solution.history);
    let measures = [solution.residual, solution.relative_residual, solution.rounding_level];
    if numbers.chain(&measures).chain(&solution.value).all(|number| number.is_finite()) {
        Ok(Outcome::Done)
    } else {
        Err(format!("the solution {solution:?}"))
    }
}

pub(crate) fn sweeps() -> Domain {
    Domain { name: "sweeps", corpus: files("../examples/sweeps", "toml"), attempt: sweep }
}

/// A sweep file beside the scenarios that the repository's sweeps name.
fn sweep(input: &str) -> Result<Outcome, String> {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/sweeps");
    let plan = match Sweep::from_document(&Document::new("hostile.toml", &directory, &few_steps(input))) {
        Ok(plan) => plan,
        Err(error) => return refused(&error),
    };
    let mut outcome = Outcome::Refused;
    for run in [0, plan.runs() / 2, plan.runs() - 1] {
        match plan.scenario_of(run) {
            Ok(_) => outcome = Outcome::Done,
            Err(error) => _ = refused(&error)?,
        }
    }
    Ok(outcome)
}

pub(crate) fn tables() -> Domain {
    let corpus = [
        files("../examples/scenarios", "csv"),
        files("../examples/problems", "csv"),
        files("tests/hostile/corpus/tables", "csv"),
    ];
    // The beginning of a long table is as good as the whole.
    let short = |text: String| text.lines().take(20).map(|line| format!("{line}\n")).collect();
    Domain { name: "tables", corpus: corpus.concat().into_iter().map(short).collect(), attempt: table }
}

/// A table as samples of a force, as known values of a run, and as known values of a problem.
fn table(input: &str) -> Result<Outcome, String> {
    const SCENARIO: &str = "[system]\nmass = [1.0]\npotential = \"q0^2\"\n[initial]\nposition = [0.5]\nmomentum = [0.0]\n\
                            [time]\nstep = 0.05\nsteps = 6\n";
    const PROBLEM: &str = "[problem]\nlagrangian = \"0.5*v0^2\"\nalpha = 0.75\n[boundary]\nstart = [0.0]\nend = [1.0]\n\
                           [interval]\nend = 1.0\nsteps = 8\n[reference]\nfile = \"table.csv\"\n";
    let document = |text: &str| {
        Document::new("hostile.toml", Path::new("/nowhere"), text).with_attached("table.csv", input)
    };
    let mut outcomes = Vec::new();
    for part in ["input", "reference"] {
        outcomes.push(run(document(&format!("{SCENARIO}[{part}]\nfile = \"table.csv\"\n")))?);
    }
    outcomes.push(match ProblemFile::from_document(document(PROBLEM)) {
        Ok(_) => Outcome::Done,
        Err(error) => refused(&error)?,
    });
    Ok(outcomes.into_iter().max().unwrap_or(Outcome::Refused))
}

pub(crate) fn matrices() -> Domain {
    Domain { name: "matrices", corpus: files("../examples/scenarios", "mtx"), attempt: matrix }
}

fn matrix(input: &str) -> Result<Outcome, String> {
    matrix_file("a.mtx", input.as_bytes())
}

/// A matrix in a file as stiffness, damping and the columns of dampers of ten masses.
pub(crate) fn matrix_file(name: &str, content: &[u8]) -> Result<Outcome, String> {
    let mut outcome = Outcome::Refused;
    for damping in
        ["coefficient = \"{name}\"", "attached = \"{name}\"\nstrength = [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    {
        let damping = damping.replace("{name}", name);
        let scenario = format!(
            "[system]\nmass = [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\nstiffness = \"{name}\"\n[[system.damping]]\norder = 0.5\n{damping}\n\
             [convolution]\nat = \"nodes\"\norder = 2\n[scheme]\nkind = \"low-order\"\n\
             [time]\nstep = 0.01\nsteps = 3\n[[system.load]]\npattern = {{ coordinate = 0 }}\namplitude = \"1\"\n"
        );
        let document = Document::new("matrix", Path::new(""), &scenario).with_attached(name, content);
        let scenario = match Scenario::from_document(document) {
            Ok(scenario) => scenario,
            Err(error) => {
                refused(&error)?;
                continue;
            }
        };
        let mut simulation = match Simulation::new(&scenario, Precision::F64) {
            Ok(simulation) => simulation,
            Err(error) => {
                refused(&error)?;
                continue;
            }
        };
        outcome = Outcome::Done;
        for _ in 0..scenario.time.steps {
            if let Err(error) = simulation.step(&[]) {
                outcome = failed(&error)?;
                break;
            }
        }
        let mut state =
            GridState { position: vec![0.0; 10], momentum: vec![0.0; 10], ..GridState::default() };
        simulation.read(&mut state);
        if !state.position.iter().chain(&state.momentum).all(|number| number.is_finite()) {
            return Err(format!("three steps give {state:?}"));
        }
    }
    Ok(outcome)
}
