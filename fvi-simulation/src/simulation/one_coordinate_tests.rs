//! One coordinate is stepped in place to the bits of any number of coordinates.

use crate::language::Document;
use crate::model::OnePoint;
use crate::scenario::Scenario;
use crate::simulation::{GridState, Precision, Simulation, SolverChoice};
use std::path::Path;

fn scenario(system: &str, scheme: &str, convolution: &str) -> Scenario {
    let text = format!(
        "[system]\n{system}\n[initial]\nposition = [0.7]\nmomentum = [-0.4]\n[scheme]\n{scheme}\n\
         [convolution]\n{convolution}\n[time]\nstep = 0.05\nsteps = 120\n"
    );
    Scenario::from_document(Document::new("test.toml", Path::new(""), &text)).unwrap()
}

/// All states of a run with the given solver.
fn states(scenario: &Scenario, choice: SolverChoice) -> Vec<GridState> {
    let mut simulation = Simulation::with_solver(scenario, Precision::F64, choice).unwrap();
    let mut state = GridState { position: vec![0.0], momentum: vec![0.0], ..GridState::default() };
    let step = |index: usize| {
        // An input that comes and goes.
        let input: &[f64] = if index % 7 == 3 { &[0.25] } else { &[] };
        simulation.step(input).unwrap();
        simulation.read(&mut state);
        state.clone()
    };
    (0..scenario.time.steps).map(step).collect()
}

#[test]
fn a_step_in_place_has_the_bits_of_a_step_of_any_size() {
    let damping = "[[system.damping]]\norder = 0.5\ncoefficient = [0.3]\n";
    let springs =
        "[[system.damping]]\norder = 1.3\ncoefficient = [[0.1]]\nderivative = \"riemann-liouville\"\n";
    let systems = [
        ("potential = \"3*q0^2 - q0 + 2\"", damping),
        ("potential = \"9.81*(1 - cos(q0))\"", damping),
        ("potential = \"0.5*q0^2 + q0^4\"\nforce = [\"sin(3*t) - 0.1*q0\"]", springs),
        // Rough in time: its moments are exact.
        ("potential = \"2*q0^2\"\nforce = [\"5*step(1.23 - t)\"]", damping),
        ("force = [\"-q0^3 + sqrt(t)\"]", springs),
        ("potential = \"2*q0^2\"", ""),
    ];
    let convolutions = ["at = \"nodes\"\norder = 2", "at = \"main-nodes\"\norder = 1"];
    for (system, damping) in systems {
        for convolution in convolutions {
            for scheme in ["kind = \"low-order\"\nkappa = 0.5", "kind = \"low-order\"\nkappa = 0.25"] {
                let system = format!("mass = [1.7]\n{system}\n{damping}");
                let scenario = scenario(&system, scheme, convolution);
                assert!(OnePoint::<f64>::serves(&scenario), "{system}");
                let (found, expected) =
                    (states(&scenario, SolverChoice::Automatic), states(&scenario, SolverChoice::Dense));
                assert_eq!(found, expected, "{system}\n{scheme}\n{convolution}");
            }
        }
    }
}

#[test]
fn other_schemes_and_systems_are_not_stepped_in_place() {
    let system = "mass = [1.7]\npotential = \"q0^2\"";
    let low_order = "kind = \"low-order\"\nkappa = 0.5";
    let served = |system: &str, scheme| OnePoint::<f64>::serves(&scenario(system, scheme, "order = 1"));
    assert!(served(system, low_order));
    assert!(!served(system, "kind = \"galerkin\"\ndegree = 2"));
    assert!(!served(system, "kind = \"implicit-euler\""));
    assert!(!served("mass = [1.7]\nstiffness = [2.0]", low_order));
}
