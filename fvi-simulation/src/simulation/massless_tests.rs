//! Coordinates without mass: orders against exact solutions, condensed systems, starts, refusals.

use crate::simulation::motion::Motion;
use crate::simulation::response::Linearised;
use crate::simulation::{GridState, Precision, Simulation, Solver, SolverChoice};
use fvi_core::max_or_nan;
use fvi_scenario::scenario::Scenario;
use std::fmt::Write as _;

fn scenario(text: &str) -> Scenario {
    text.parse().unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn refused(text: &str) -> String {
    let error = match text.parse::<Scenario>() {
        Err(error) => error,
        Ok(scenario) => match Simulation::new(&scenario, Precision::F64) {
            Err(error) => error,
            Ok(_) => panic!("not refused:\n{text}"),
        },
    };
    format!("{error}; {}", error.problem().allowed().unwrap_or_default())
}

/// The states at all grid points.
fn states(scenario: &Scenario, precision: Precision) -> Vec<GridState> {
    let mut motion = Motion::start(scenario, precision).unwrap_or_else(|error| panic!("{error}"));
    let mut states = vec![motion.state().clone()];
    while !motion.is_done() {
        motion.advance().unwrap_or_else(|failure| panic!("{}", failure.reason));
        states.push(motion.state().clone());
    }
    states
}

fn end(scenario: &Scenario) -> GridState {
    states(scenario, Precision::F64).pop().unwrap()
}

const MIDPOINT: &str =
    "[scheme]\nkind = \"low-order\"\nkappa = 0.5\n[convolution]\norder = 2\nat = \"nodes\"";
const TRAPEZOIDAL: &str =
    "[scheme]\nkind = \"low-order\"\nkappa = 0.5\n[convolution]\nsymbol = \"trapezoidal\"\nat = \"nodes\"";
const GAUSS_3: &str = "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\norder = 3\nat = \"nodes\"";
const GAUSS_4: &str = "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\norder = 4\nat = \"nodes\"";
const RADAU_2: &str = "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 2";
const RADAU_3: &str = "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 3";

/// e^{At} y by its series, in pieces that converge fast.
fn exponential<const N: usize>(a: [[f64; N]; N], t: f64, mut y: [f64; N]) -> [f64; N] {
    let pieces = 64;
    for _ in 0..pieces {
        let mut term = y;
        for power in 1..30 {
            let factor = t / f64::from(pieces) / f64::from(power);
            term = std::array::from_fn(|i| factor * (0..N).map(|j| a[i][j] * term[j]).sum::<f64>());
            y = std::array::from_fn(|i| y[i] + term[i]);
        }
    }
    y
}

/// A mass on a spring, with a parallel Maxwell element whose node between spring and dashpot has no mass:
/// 2 ẍ + 3 x + 5 (x − z) = 0 , R(z) = 5 (x − z).
fn maxwell(dashpot: &str, z: f64, scheme: &str, steps: usize) -> Scenario {
    scenario(&format!(
        "[system]\nmass = [2.0, 0.0]\nstiffness = [[8.0, -5.0], [-5.0, 5.0]]\n{dashpot}\n\
         [initial]\nposition = [1.0, {z:?}]\nvelocity = [0.5, 0.0]\n{scheme}\n[time]\nend = 2.0\nstep = {:?}\n",
        2.0 / steps as f64
    ))
}

#[test]
fn a_maxwell_element_with_a_massless_node_follows_its_exact_solution() {
    // y = (x, p, z).
    let exact =
        |z: f64| exponential([[0.0, 0.5, 0.0], [-8.0, 0.0, 5.0], [2.0, 0.0, -2.0]], 2.0, [1.0, 1.0, z]);
    let memory = "[[system.damping]]\norder = 1.0\ncoefficient = [0.0, 2.5]";
    let force = "force = [\"0\", \"-2.5*v1\"]";
    // Dashpot, scheme, steps, and the order of all numbers with a node that starts at rest. One that does not
    // has ż(0) ≠ 0 and no past: positions of masses keep the order, p and z have order 2 by multistep
    // memories.
    let cases = [
        (memory, MIDPOINT, 64, 2.0, [2.0; 3]),
        (memory, TRAPEZOIDAL, 64, 2.0, [2.0; 3]),
        (memory, GAUSS_3, 32, 3.0, [3.0, 2.0, 2.0]),
        (memory, GAUSS_4, 32, 4.0, [4.0, 2.0, 2.0]),
        (memory, RADAU_2, 32, 3.0, [3.0; 3]),
        (memory, RADAU_3, 16, 5.0, [5.0; 3]),
        (force, MIDPOINT, 64, 2.0, [2.0; 3]),
        (force, GAUSS_4, 32, 4.0, [4.0; 3]),
        (force, RADAU_3, 16, 5.0, [5.0; 3]),
    ];
    for (dashpot, scheme, steps, at_rest, in_motion) in cases {
        for (z, orders) in [(1.0, [at_rest; 3]), (-0.4, in_motion)] {
            let errors = |steps: usize| {
                let state = end(&maxwell(dashpot, z, scheme, steps));
                assert_eq!(state.momentum[1], 0.0);
                let found = [state.position[0], state.momentum[0], state.position[1]];
                let exact = exact(z);
                [0, 1, 2].map(|index| (found[index] - exact[index]).abs())
            };
            let (coarse, fine) = (errors(steps), errors(2 * steps));
            for (index, expected) in orders.into_iter().enumerate() {
                let found = (coarse[index] / fine[index]).log2();
                assert!(
                    found > expected - 0.35,
                    "{dashpot}\n{scheme}\nz = {z}: order {found:.2} of number {index}, not {expected}; {coarse:?} {fine:?}"
                );
            }
        }
    }
}

#[test]
fn a_massless_node_stands_for_the_kernel_of_its_element() {
    // With z eliminated: K(s) = 5 s/(s + 2), and with a springpot 5 · 2 s^½/(5 + 2 s^½).
    let kernels = [
        (
            "order = 1.0\ncoefficient = [0.0, 2.5]",
            "kernel = { form = \"prony\", strengths = [5.0], times = [0.5] }\ncoefficient = [1.0]",
        ),
        (
            "order = 0.5\ncoefficient = [0.0, 2.0]",
            "kernel = { symbol = \"10*s^0.5/(5 + 2*s^0.5)\" }\ncoefficient = [1.0]",
        ),
    ];
    for (element, kernel) in kernels {
        let reduced = |steps: usize| {
            end(&scenario(&format!(
                "[system]\nmass = [2.0]\nstiffness = [3.0]\n[[system.damping]]\n{kernel}\n\
                 [initial]\nposition = [1.0]\nvelocity = [0.5]\n{RADAU_3}\n[time]\nend = 2.0\nstep = {:?}\n",
                2.0 / steps as f64
            )))
        };
        // The element is at rest at the start: z(0) = x(0).
        let exact = reduced(400);
        for (scheme, steps, bound) in [(MIDPOINT, 200, 2e-4), (GAUSS_3, 100, 2e-5), (RADAU_3, 50, 2e-6)] {
            let found = end(&maxwell(&format!("[[system.damping]]\n{element}"), 1.0, scheme, steps));
            let error = (found.position[0] - exact.position[0])
                .abs()
                .max((found.momentum[0] - exact.momentum[0]).abs());
            assert!(error < bound, "{element}\n{scheme}: {error:e}");
        }
    }
}

/// A mass on two springs in series, 4 and 6, with a force on their joint, which has no mass.
fn joint(scheme: &str, push: &str, z: f64, more: &str) -> Scenario {
    scenario(&format!(
        "[system]\nmass = [2.0, 0.0]\npotential = \"2*(q0 - q1)^2 + 3*q1^2\"\nforce = [\"0\", \"{push}\"]\n{more}\n\
         [initial]\nposition = [1.0, {z:?}]\n{scheme}\n[time]\nstep = 0.05\nsteps = 100\n"
    ))
}

#[test]
fn a_joint_moves_as_the_condensed_system_says() {
    // z = (4 x + F)/10: 2 ẍ + 2.4 x = 0.4 F. F jumps at a grid point.
    let push = "cos(3*t) + 5*step(t - 1)";
    let pushed = |t: f64, inside: bool| {
        (3.0 * t).cos() + if t > 1.0 + 1e-9 || (inside && t >= 1.0) { 5.0 } else { 0.0 }
    };
    for scheme in [MIDPOINT, GAUSS_4, RADAU_3] {
        let condensed = scenario(&format!(
            "[system]\nmass = [2.0]\npotential = \"1.2*q0^2\"\nforce = [\"0.4*({push})\"]\n\
             [initial]\nposition = [1.0]\n{scheme}\n[time]\nstep = 0.05\nsteps = 100\n"
        ));
        for (precision, bound) in [(Precision::F64, 1e-12), (Precision::F32, 2e-4)] {
            let whole = states(&joint(scheme, push, 0.0, ""), precision);
            let reduced = states(&condensed, precision);
            for (one, other) in whole.iter().zip(&reduced) {
                let error = (one.position[0] - other.position[0])
                    .abs()
                    .max((one.momentum[0] - other.momentum[0]).abs());
                assert!(error < bound, "{scheme}\nt = {}: {error:e}", one.time);
                // At the jump the state is the limit from before.
                let z = (4.0 * one.position[0] + pushed(one.time, false)) / 10.0;
                assert!(
                    (one.position[1] - z).abs() < bound,
                    "{scheme}\nt = {}: {} {z}",
                    one.time,
                    one.position[1]
                );
                assert_eq!(one.momentum[1], 0.0);
            }
        }
    }
}

#[test]
fn without_damping_the_energy_is_that_of_the_condensed_system_and_stays() {
    for scheme in [MIDPOINT, GAUSS_4] {
        let states = states(&joint(scheme, "0", 0.0, ""), Precision::F64);
        for state in &states {
            let condensed = 0.25 * state.momentum[0].powi(2) + 1.2 * state.position[0].powi(2);
            assert!((state.energy - condensed).abs() < 1e-13);
            assert!((state.energy - 1.2).abs() < 1e-12, "{scheme}: {}", state.energy);
        }
    }
}

#[test]
fn a_nonlinear_joint_balances_at_every_grid_point() {
    // 4 (z − x) + 6 z + 8 z³ = cos 3t.
    for scheme in [MIDPOINT, GAUSS_4, RADAU_3] {
        let scenario = scenario(&format!(
            "[system]\nmass = [2.0, 0.0]\npotential = \"2*(q0 - q1)^2 + 3*q1^2 + 2*q1^4\"\nforce = [\"0\", \"cos(3*t)\"]\n\
             [initial]\nposition = [1.0, 0.0]\n{scheme}\n[time]\nstep = 0.05\nsteps = 100\n"
        ));
        for state in states(&scenario, Precision::F64) {
            let (x, z) = (state.position[0], state.position[1]);
            let force = 4.0 * (z - x) + 6.0 * z + 8.0 * z.powi(3) - (3.0 * state.time).cos();
            assert!(force.abs() < 1e-12, "{scheme}\nt = {}: {force:e}", state.time);
        }
    }
}

#[test]
fn a_mass_matrix_with_rows_of_zeros_is_that_of_fewer_coordinates() {
    // Masses that are coupled, with a massless coordinate between them.
    let full = "[[2.0, 0.0, 0.5], [0.0, 0.0, 0.0], [0.5, 0.0, 1.0]]";
    let of = |mass: &str, potential: &str, position: &str, damping: &str, scheme: &str| {
        scenario(&format!(
            "[system]\nmass = {mass}\npotential = \"{potential}\"\n[[system.damping]]\norder = 0.5\ncoefficient = {damping}\n\
             [initial]\nposition = {position}\n{scheme}\n[time]\nstep = 0.05\nsteps = 60\n"
        ))
    };
    const KICKED: &str = "[convolution]\norder = 2\nat = \"main-nodes\"";
    for scheme in [MIDPOINT, GAUSS_4, RADAU_3, KICKED] {
        let whole =
            end(&of(full, "(q0 - q1)^2 + (q1 - q2)^2 + q0^2", "[1.0, 0.0, -0.5]", "[0.3, 0.0, 0.2]", scheme));
        let condensed = end(&of(
            "[[2.0, 0.5], [0.5, 1.0]]",
            "0.5*(q0 - q1)^2 + q0^2",
            "[1.0, -0.5]",
            "[0.3, 0.2]",
            scheme,
        ));
        let pairs = [(0, 0), (2, 1)];
        for (of_whole, of_condensed) in pairs {
            assert!((whole.position[of_whole] - condensed.position[of_condensed]).abs() < 1e-12);
            assert!((whole.momentum[of_whole] - condensed.momentum[of_condensed]).abs() < 1e-12);
        }
        assert!((whole.position[1] - 0.5 * (whole.position[0] + whole.position[2])).abs() < 1e-13);
        assert!((whole.energy - condensed.energy).abs() < 1e-12, "{} {}", whole.energy, condensed.energy);
    }
}

#[test]
fn a_start_that_is_not_given_is_computed_and_one_that_does_not_balance_is_refused() {
    // z(0) = (4 + 1)/10.
    let start = |z: f64| states(&joint(MIDPOINT, "1", z, ""), Precision::F64)[0].position[1];
    assert!((start(0.0) - 0.5).abs() < 1e-15 && (start(0.500_000_1) - 0.5).abs() < 1e-15);
    let error = refused_joint(0.7);
    for part in ["initial.position", "coordinate 1", "balance at 0.", "0.7", "0 to have it computed"] {
        assert!(error.contains(part), "{error}");
    }
    // A dashpot holds it at the given position.
    let held = end(&maxwell("[[system.damping]]\norder = 1.0\ncoefficient = [0.0, 1e9]", -0.4, MIDPOINT, 10));
    assert!((held.position[1] + 0.4).abs() < 1e-6);
}

fn refused_joint(z: f64) -> String {
    match Simulation::new(&joint(MIDPOINT, "1", z, ""), Precision::F64) {
        Err(error) => error.to_string(),
        Ok(_) => panic!("not refused"),
    }
}

#[test]
fn springs_in_kernels_are_at_rest_where_the_motion_begins() {
    // K(s) = 2 + s/(1 + s) of z − z(0): at the start 4 (z − x) + 6 z = 1, and with x held by its mass for
    // ever.
    let states = states(
        &scenario(&format!(
            "[system]\nmass = [1e12, 0.0]\npotential = \"2*(q0 - q1)^2 + 3*q1^2\"\nforce = [\"0\", \"1\"]\n\
                 [[system.damping]]\nkernel = {{ symbol = \"2 + s/(1 + s)\" }}\ncoefficient = [0.0, 1.0]\n\
                 [initial]\nposition = [1.0, 0.5]\n{MIDPOINT}\n[time]\nstep = 0.1\nsteps = 50\n"
        )),
        Precision::F64,
    );
    assert!(states.iter().all(|state| (state.position[1] - 0.5).abs() < 1e-9));
}

#[test]
fn what_needs_a_mass_is_refused_with_the_coordinate() {
    let system = |mass: &str, potential: &str, more: &str| {
        format!(
            "[system]\nmass = {mass}\npotential = \"{potential}\"\n{more}\n[time]\nstep = 0.1\nsteps = 10\n"
        )
    };
    let springs = "q0^2 + (q0 - q1)^2 + q1^2";
    let with = |more: &str| system("[1.0, 0.0]", springs, more);
    let start = "[initial]\nposition = [1.0, 0.0]\n";
    let damped = |keys: &str| format!("[[system.damping]]\n{keys}\ncoefficient = [0.0, 1.0]\n{start}");
    let cases: Vec<(String, &[&str])> = vec![
        (system("[1.0, 0.0]", "q0^2", start), &["system.mass", "mass 0 at coordinate 1", "holds"]),
        (system("[1.0, 0.0]", "q0^2 - q1^2", start), &["system.mass", "mass 0 at coordinate 1"]),
        (
            system("[1.0, 0.0, 0.0]", "q0^2 + (q1 - q2)^2", "[initial]\nposition = [1.0, 0.0, 0.0]"),
            &["system.mass", "mass 0 at coordinate", "holds"],
        ),
        (system("[[1.0, 1.0], [1.0, 0.0]]", springs, start), &["system.mass", "positive definite"]),
        (
            with(&format!("{start}[scheme]\nkind = \"low-order\"\nkappa = 0.3")),
            &["scheme", "coordinate 1", "collocation"],
        ),
        (with(&format!("{start}[scheme]\nkind = \"implicit-euler\"")), &["scheme", "coordinate 1"]),
        (
            with(&format!(
                "{start}[scheme]\nkind = \"galerkin\"\ndegree = 2\nquadrature = \"lobatto\"\npoints = 3"
            )),
            &["scheme", "coordinate 1"],
        ),
        (
            with(&format!(
                "{start}[scheme]\nkind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 2"
            )),
            &["scheme", "coordinate 1"],
        ),
        (
            with(&format!("{}[convolution]\nat = \"main-nodes\"\norder = 2", damped("order = 0.5"))),
            &["convolution.at", "coordinate 1", "nodes"],
        ),
        (with(&damped("order = 1.5")), &["system.damping[0]", "coordinate 1", "inertia"]),
        (
            with(
                "[[system.damping]]\norder = 0.5\ncoefficient = [0.0, 1.0]\nderivative = \"riemann-liouville\"\n\
                  [initial]\nposition = [1.0, 0.3]",
            ),
            &["system.damping[0]", "coordinate 1", "caputo"],
        ),
        (
            system(
                "[1.0, 0.0, 0.0]",
                "q0^2 + (q0 - q1)^2 + q2^2",
                "force = [\"0\", \"-v1 + v2\", \"v1 - v2\"]\n[initial]\nposition = [1.0, 0.0, 0.0]",
            ),
            &["system.damping", "has no mass", "elongations"],
        ),
        (
            with("gyroscopic = [[0.0, 1.0], [-1.0, 0.0]]\n[initial]\nposition = [1.0, 0.0]"),
            &["system.gyroscopic", "coordinate 1"],
        ),
        (
            with("force = [\"0\", \"-v0\"]\n[initial]\nposition = [1.0, 0.0]"),
            &["system.force", "coordinate 1", "resist"],
        ),
        (
            with("force = [\"0\", \"-v1*abs(v1)\"]\n[initial]\nposition = [1.0, 0.0]"),
            &["system.force", "coordinate 1", "resist"],
        ),
        (
            with("[initial]\nposition = [1.0, 0.0]\nvelocity = [0.0, 2.0]"),
            &["initial.velocity", "coordinate 1", "no mass"],
        ),
        (
            with("[initial]\nposition = [1.0, 0.0]\nmomentum = [0.0, 2.0]"),
            &["initial.momentum", "coordinate 1", "no mass"],
        ),
        (
            with(&format!("{start}[sensitivity]\nparameters = [\"initial.position[0]\"]")),
            &["sensitivity", "coordinate 1"],
        ),
        (
            with(&format!("{start}[input]\nperiod = 0.5\nsamples = [[0.0, 1.0], [0.0, 2.0]]")),
            &["input", "coordinate 1", "loads"],
        ),
        (
            with(&format!("{}[output]\nmemory_energy = true", damped("order = 0.5"))),
            &["output.memory_energy", "coordinate 1"],
        ),
    ];
    for (text, parts) in cases {
        let error = refused(&text);
        for part in parts {
            assert!(error.contains(part), "{part:?} is not in: {error}\n{text}");
        }
    }
}

#[test]
fn a_step_that_is_too_long_for_the_condensed_system_is_refused() {
    // ω = √(k/2) with k = 2.4 · 10⁶, and BDF 4 on two Gauss points, damped at the mass or at the joint.
    let of = |coefficient: &str| {
        refused(&format!(
            "[system]\nmass = [2.0, 0.0]\npotential = \"2e6*(q0 - q1)^2 + 3e6*q1^2\"\n\
             [[system.damping]]\norder = 1.0\ncoefficient = {coefficient}\n\
             [initial]\nposition = [1.0, 0.0]\n{GAUSS_4}\n[time]\nstep = 0.01\nsteps = 100000\n"
        ))
    };
    for coefficient in ["[3e3, 0.0]", "[0.0, 3e4]"] {
        let error = of(coefficient);
        assert!(error.contains("time.step") && error.contains("unstable"), "{coefficient}: {error}");
    }
}

/// A clamped beam of Hermite elements whose rotations may have no mass, in the order (w, φ) of each node,
/// with a damping proportional to its stiffness if `damped`.
fn frame(elements: usize, damped: bool, massless: bool, scheme: &str) -> (Scenario, nalgebra::DMatrix<f64>) {
    let l = 1.0 / elements as f64;
    let (a, b, c, d) = (12.0 / l.powi(3), 6.0 / l.powi(2), 4.0 / l, 2.0 / l);
    let element = [[a, b, -a, b], [b, c, -b, d], [-a, -b, a, -b], [b, d, -b, c]];
    let size = 2 * elements;
    let mut stiffness = nalgebra::DMatrix::zeros(size, size);
    for number in 0..elements {
        for (i, row) in element.iter().enumerate() {
            for (j, entry) in row.iter().enumerate() {
                let (row, column) = (2 * number + i, 2 * number + j);
                // The first node is clamped.
                if row >= 2 && column >= 2 {
                    stiffness[(row - 2, column - 2)] += entry;
                }
            }
        }
    }
    let kept = stiffness.clone();
    let (w, phi): (Vec<usize>, Vec<usize>) = (0..size).partition(|index| index % 2 == 0);
    let block = |rows: &[usize], columns: &[usize]| {
        nalgebra::DMatrix::from_fn(rows.len(), columns.len(), |i, j| kept[(rows[i], columns[j])])
    };
    let condensed = block(&w, &w)
        - block(&w, &phi) * fvi_fft::dense::inverse(block(&phi, &phi)).unwrap() * block(&phi, &w);
    let (stiffness, masses) = if massless {
        (stiffness, (0..size).map(|index| if index % 2 == 0 { l } else { 0.0 }).collect::<Vec<_>>())
    } else {
        let symmetric = (&condensed + condensed.transpose()) * 0.5;
        (symmetric, vec![l; elements])
    };
    let mut rows = String::new();
    for row in stiffness.row_iter() {
        let numbers: Vec<String> = row.iter().map(|entry| format!("{entry:e}")).collect();
        write!(rows, "[{}],", numbers.join(", ")).unwrap();
    }
    let load = if massless { size - 2 } else { elements - 1 };
    let damping = if damped {
        format!("[[system.damping]]\norder = 0.5\nscale = 0.01\ncoefficient = [{rows}]\n")
    } else {
        String::new()
    };
    let text = format!(
        "[system]\nmass = {masses:?}\nstiffness = [{rows}]\n\
         [[system.load]]\npattern = {{ coordinate = {load} }}\namplitude = \"sin(2*t)\"\n{damping}\
         [initial]\nposition = {:?}\n{scheme}\n[time]\nstep = 0.004\nsteps = 100\n",
        vec![0.0; masses.len()]
    );
    (scenario(&text), condensed)
}

#[test]
fn a_sparse_frame_with_massless_rotations_is_its_static_condensation() {
    for scheme in [MIDPOINT, GAUSS_3] {
        let end = |scenario: &Scenario, choice: SolverChoice| {
            let mut simulation = Simulation::with_solver(scenario, Precision::F64, choice)
                .unwrap_or_else(|error| panic!("{error}"));
            for _ in 0..scenario.time.steps {
                simulation.step(&[]).unwrap();
            }
            let size = scenario.coordinates();
            let mut state =
                GridState { position: vec![0.0; size], momentum: vec![0.0; size], ..GridState::default() };
            simulation.read(&mut state);
            (state, simulation.solver())
        };
        let (whole, _) = frame(8, false, true, scheme);
        let (condensed, _) = frame(8, false, false, scheme);
        let (reference, _) = end(&condensed, SolverChoice::Dense);
        let (sparse, solver) = end(&whole, SolverChoice::Sparse);
        let (dense, _) = end(&whole, SolverChoice::Dense);
        assert!(matches!(solver, Solver::Sparse { .. }));
        let largest = reference.position.iter().map(|q| q.abs()).fold(0.0, max_or_nan);
        for node in 0..8 {
            for found in [&sparse, &dense] {
                assert!(
                    (found.position[2 * node] - reference.position[node]).abs() < 1e-10 * largest,
                    "{scheme}"
                );
            }
            let rotation = sparse.position[2 * node + 1] - dense.position[2 * node + 1];
            assert!(
                rotation.abs() < 1e-9 * largest && sparse.position[2 * node + 1] != 0.0,
                "{scheme}: {rotation:e}"
            );
        }
        assert!((sparse.energy - reference.energy).abs() < 1e-9 * reference.energy.abs());
        // With a damping proportional to the stiffness rotations are held by memories, with sparse and dense
        // solvers.
        let (whole, _) = frame(8, true, true, scheme);
        let ((sparse, _), (dense, _)) = (end(&whole, SolverChoice::Sparse), end(&whole, SolverChoice::Dense));
        for (one, other) in sparse.position.iter().zip(&dense.position) {
            assert!((one - other).abs() < 1e-9 * largest, "{scheme}: {one} {other}");
        }
    }
}

#[test]
fn collocation_takes_any_grid_and_kernels_that_yield_at_once() {
    // A spring 5 from x to z, and on z a spring 1 beside a Maxwell element, 2.5 s/(1 + s/2).
    let of = |grid: &str| {
        scenario(&format!(
            "[system]\nmass = [2.0, 0.0]\nstiffness = [[8.0, -5.0], [-5.0, 6.0]]\n\
             [[system.damping]]\nkernel = {{ form = \"prony\", strengths = [5.0], times = [0.5] }}\ncoefficient = [0.0, 1.0]\n\
             [initial]\nposition = [1.0, 0.8333333333333333]\n{RADAU_3}\n{grid}\n"
        ))
    };
    // y = (x, p, u), u the elongation of the dashpot:
    // 5 (x − z) = z + 5 (z − 5/6 − u), 2.5 u̇ = 5 (z − 5/6 − u).
    let z = |x: f64, u: f64| (5.0 * x + 5.0 * (5.0 / 6.0) + 5.0 * u) / 11.0;
    let rate = |[x, p, u]: [f64; 3]| {
        let z = z(x, u);
        [0.5 * p, -3.0 * x - 5.0 * (x - z), 2.0 * (z - 5.0 / 6.0 - u)]
    };
    let mut y = [1.0, 0.0, 0.0];
    let h = 2.0 / 2000.0;
    for _ in 0..2000 {
        let moved = |by: f64, k: [f64; 3]| std::array::from_fn(|i| y[i] + by * h * k[i]);
        let a = rate(y);
        let b = rate(moved(0.5, a));
        let c = rate(moved(0.5, b));
        let d = rate(moved(1.0, c));
        y = std::array::from_fn(|i| y[i] + h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]));
    }
    for grid in [
        "[time]\nend = 2.0\nstep = 0.02",
        "[time]\ngrid = \"graded\"\nend = 2.0\nsteps = 100\nexponent = 2.0",
        "[time]\ngrid = \"adaptive\"\nend = 2.0\ntolerance = 1e-8",
    ] {
        let state = end(&of(grid));
        let errors = [state.position[0] - y[0], state.momentum[0] - y[1], state.position[1] - z(y[0], y[2])];
        assert!(errors.iter().all(|error| error.abs() < 1e-6), "{grid}: {errors:?}");
    }
}

#[test]
fn a_system_without_any_mass_relaxes_like_a_mittag_leffler_function() {
    // z + D^½ z = 0 from 1: E_½(−√t) = e^t erfc(√t), at t = 1 by mpmath: exp(1)*erfc(1).
    let exact = 0.427_583_576_155_807;
    for (scheme, bound) in [(MIDPOINT, 1e-5), (GAUSS_3, 1e-5), (RADAU_3, 1e-8)] {
        let state = end(&scenario(&format!(
            "[system]\nmass = [0.0]\npotential = \"0.5*q0^2\"\n[[system.damping]]\norder = 0.5\ncoefficient = [1.0]\n\
             [initial]\nposition = [1.0]\n{scheme}\n[time]\nstep = 0.01\nsteps = 100\n"
        )));
        let error = (state.position[0] - exact).abs();
        assert!(error < bound, "{scheme}: {error:e}");
        assert!((state.energy - 0.5 * state.position[0].powi(2)).abs() < 1e-15);
    }
}

#[test]
fn the_frequency_response_is_that_of_the_condensed_system() {
    let whole = Linearised::new(&joint(MIDPOINT, "0", 0.0, ""), &[0.0, 0.0]).unwrap();
    // 1/(2.4 − 2 ω²), and 0.4 times that at the joint.
    for omega in [0.3, 1.0, 5.0] {
        let exact = 1.0 / (2.4 - 2.0 * omega * omega);
        let found = whole.response(omega, 0).unwrap();
        assert!((found[0].re - exact).abs() < 1e-13 && (found[1].re - 0.4 * exact).abs() < 1e-13);
    }
    // Positions at grid points do not follow from the polynomial of the midpoint rule without mass.
    assert!(whole.discrete_response(1.0, 0).unwrap_err().contains("coordinate 1 has no mass"));
    assert!(whole.poles().unwrap_err().contains("coordinate 1 has no mass"));
    let collocated = Linearised::new(&joint(RADAU_3, "0", 0.0, ""), &[0.0, 0.0]).unwrap();
    let found = collocated.discrete_response(1.0, 0).unwrap();
    assert!((found[0].re - 2.5).abs() < 1e-6 && (found[1].re - 1.0).abs() < 1e-6, "{found:?}");
}

/// x and z at `end` of ẍ = −x − (x − z), 0 = x − z − ż − c ż³ from x = −0.81, z = 0.99 at rest: by Runge and
/// Kutta's method, with ż by bisection.
fn behind_a_cubic_drag(c: f64, end: f64) -> [f64; 2] {
    let velocity = |pull: f64| {
        let (mut low, mut high) = (-10.0, 10.0);
        for _ in 0..80 {
            let v = 0.5 * (low + high);
            if v + c * v * v * v < pull { low = v } else { high = v }
        }
        0.5 * (low + high)
    };
    let slope = |[x, p, z]: [f64; 3]| [p, z - 2.0 * x, velocity(x - z)];
    let steps = 500;
    let h = end / f64::from(steps);
    let mut y = [-0.81, 0.0, 0.99];
    let along = |y: [f64; 3], k: [f64; 3], h: f64| std::array::from_fn(|i| y[i] + h * k[i]);
    for _ in 0..steps {
        let a = slope(y);
        let b = slope(along(y, a, 0.5 * h));
        let c = slope(along(y, b, 0.5 * h));
        let d = slope(along(y, c, h));
        y = std::array::from_fn(|i| y[i] + h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]));
    }
    [y[0], y[2]]
}

#[test]
fn forces_that_change_much_within_a_step_are_solved_at_any_step() {
    // The increments of z are as small as the rounding that an iteration may end with elsewhere.
    for (c, scheme, precision, step, steps, allowed) in [
        (0.5, MIDPOINT, Precision::F64, 1e-3, 500, 1e-6),
        (50.0, MIDPOINT, Precision::F64, 1e-8, 5000, 1e-11),
        (5.0, RADAU_3, Precision::F64, 1e-7, 2000, 1e-11),
        (50.0, MIDPOINT, Precision::F32, 1e-3, 500, 2e-6),
        (5.0, RADAU_3, Precision::F32, 1e-4, 5000, 2e-5),
    ] {
        let text = format!(
            "[system]\nmass = [1.0, 0.0]\npotential = \"0.5*q0^2 + 0.5*(q0 - q1)^2\"\nforce = [\"0\", \"-v1 - {c}*v1^3\"]\n\
             [initial]\nposition = [-0.81, 0.99]\n{scheme}\n[time]\nstep = {step:e}\nsteps = {steps}\n"
        );
        let found = states(&scenario(&text), precision).pop().unwrap();
        let exact = behind_a_cubic_drag(c, step * f64::from(steps));
        for (found, exact) in found.position.iter().zip(exact) {
            assert!((found - exact).abs() < allowed, "c = {c}, step {step:e}: {found} instead of {exact}");
        }
    }
    let text = "[system]\nmass = [1.0, 0.0]\npotential = \"0.5*q0^2 + 0.5*(q0 - q1)^2\"\nforce = [\"0\", \"-v1 - 5*v1^3\"]\n\
                [initial]\nposition = [-0.81, 0.99]\n[scheme]\nkind = \"collocation\"\n\
                [time]\ngrid = \"adaptive\"\nend = 0.5\ntolerance = 1e-8\n";
    let states = states(&scenario(text), Precision::F64);
    let exact = behind_a_cubic_drag(5.0, 0.5);
    let error = (states.last().unwrap().position[1] - exact[1]).abs();
    assert!(error < 1e-7 && states.len() < 1000, "{error:e} after {} steps", states.len());
}
