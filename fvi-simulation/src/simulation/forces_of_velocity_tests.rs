//! Forces that depend on the velocity: orders, energies, checks.

use crate::simulation::motion::Motion;
use crate::simulation::{GridState, Precision, Simulation};
use fvi_fft::memory::Tables;
use fvi_scenario::scenario::Scenario;

fn scenario(text: &str) -> Scenario {
    text.parse().unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// The state at the end.
fn end(scenario: &Scenario, precision: Precision) -> GridState {
    let mut motion = Motion::start(scenario, precision).unwrap();
    if scenario.sensitivity.is_some() {
        motion = motion.with_sensitivities(&Tables::default()).unwrap();
    }
    while !motion.is_done() {
        motion.advance().unwrap_or_else(|failure| panic!("{}", failure.reason));
    }
    motion.state().clone()
}

/// A pendulum with air drag and van der Pol's force, and a load of time for which it moves as q = 1 + t⁵.
/// With a Caputo derivative of order ½ if `rho` is not zero.
fn manufactured(rho: f64, scheme: &str, convolution: &str, steps: usize) -> Scenario {
    // Γ(6)/Γ(5.5)
    let derivative = format!("{rho}*2.2925478883*t^4.5");
    let derivative = derivative.replace("2.2925478883", "gamma(6)/gamma(5.5)");
    let (q, v, a) = ("(1 + t^5)", "(5*t^4)", "(20*t^3)");
    let load = format!("{a} + sin{q} + {derivative} + 0.3*{v}^2 - 0.5*(1 - {q}^2)*{v}");
    let damping = match rho {
        0.0 => String::new(),
        _ => format!("[[system.damping]]\norder = 0.5\ncoefficient = [{rho}]\n"),
    };
    scenario(&format!(
        "[system]\nmass = [1.0]\npotential = \"-cos(q0)\"\n\
         force = [\"{load} - 0.3*v0*abs(v0) + 0.5*(1 - q0^2)*v0\"]\n{damping}\
         [initial]\nposition = [1.0]\nmomentum = [0.0]\n[scheme]\n{scheme}\n[convolution]\n{convolution}\n\
         [time]\nend = 1.0\nstep = {}\nallow_unstable = true\n",
        1.0 / steps as f64
    ))
}

#[test]
fn schemes_keep_their_orders() {
    let nodes = |order: usize| format!("order = {order}\nat = \"nodes\"");
    let gauss = |degree: usize, points: usize| {
        format!("kind = \"galerkin\"\ndegree = {degree}\nquadrature = \"gauss\"\npoints = {points}")
    };
    let lobatto = |degree: usize, points: usize| {
        format!("kind = \"galerkin\"\ndegree = {degree}\nquadrature = \"lobatto\"\npoints = {points}")
    };
    let low = |kappa: f64| format!("kind = \"low-order\"\nkappa = {kappa:?}");
    let of = |kind: &str| format!("kind = \"{kind}\"");
    let staged = |family: &str, stages: usize| format!("family = \"{family}\"\nstages = {stages}");
    let bdf = |order: usize| format!("order = {order}\nat = \"main-nodes\"");
    // Scheme, quadrature, order of position and momentum; for ρ = 0 and ρ = 0.7.
    let cases: [(String, String, i32, [f64; 2], f64); 16] = [
        (low(0.5), nodes(2), 32, [2.0; 2], 0.7),
        (low(0.5), bdf(2), 32, [2.0, 1.0], 0.7),
        (low(0.5), nodes(2), 32, [2.0; 2], 0.0),
        (low(0.0), nodes(1), 64, [1.0; 2], 0.7),
        (low(1.0), nodes(1), 64, [1.0; 2], 0.7),
        (gauss(1, 2), nodes(2), 32, [2.0; 2], 0.7),
        (lobatto(1, 2), nodes(2), 32, [2.0; 2], 0.7),
        (gauss(2, 2), nodes(4), 32, [4.0; 2], 0.7),
        (gauss(2, 2), nodes(4), 16, [4.0; 2], 0.0),
        (gauss(2, 3), nodes(4), 32, [4.0; 2], 0.7),
        (lobatto(2, 3), nodes(4), 96, [4.0; 2], 0.7),
        (gauss(3, 3), nodes(6), 8, [6.0; 2], 0.0),
        (of("collocation"), staged("radau-iia", 2), 16, [3.0; 2], 0.7),
        (of("collocation"), staged("radau-iia", 3), 24, [5.0; 2], 0.0),
        (of("explicit-euler"), bdf(1), 64, [1.0; 2], 0.7),
        (of("implicit-euler"), bdf(1), 64, [1.0; 2], 0.7),
    ];
    for (scheme, convolution, steps, orders, rho) in cases {
        let errors = |steps: i32| {
            let state = end(&manufactured(rho, &scheme, &convolution, steps as usize), Precision::F64);
            [(state.position[0] - 2.0).abs(), (state.momentum[0] - 5.0).abs()]
        };
        let (coarse, fine) = (errors(steps), errors(2 * steps));
        for (what, expected) in orders.into_iter().enumerate() {
            let found = (coarse[what] / fine[what]).log2();
            assert!(
                found > expected - 0.3,
                "{scheme}\n{convolution}\nρ = {rho}: order {found:.2} of number {what}, not {expected}; {coarse:?} {fine:?}"
            );
        }
    }
}

/// Two coupled oscillators with these forces, from a state in motion.
fn coupled(forces: [&str; 2], system: &str, more: &str) -> Scenario {
    scenario(&format!(
        "[system]\nmass = [[1.5, 0.2], [0.2, 1.0]]\npotential = \"q0^2 + 0.5*q1^2 + 0.3*q0*q1\"\n\
         force = [\"{}\", \"{}\"]\n{system}\n\
         [initial]\nposition = [1.0, -0.5]\nvelocity = [0.3, 0.8]\n{more}\n[time]\nstep = 0.05\nsteps = 200\n",
        forces[0], forces[1]
    ))
}

#[test]
fn skew_forces_of_the_velocity_are_gyroscopic() {
    let damping = "[[system.damping]]\norder = 0.5\ncoefficient = [0.1, 0.3]";
    for scheme in [
        "[scheme]\nkind = \"low-order\"\nkappa = 0.5\n[convolution]\norder = 2",
        "[scheme]\nkind = \"galerkin\"\ndegree = 2\nquadrature = \"gauss\"\npoints = 2\n[convolution]\norder = 2",
    ] {
        let skew = format!("gyroscopic = [[0.0, -0.7], [0.7, 0.0]]\n{damping}");
        let allowed = |scenario: Scenario| {
            let mut scenario = scenario;
            scenario.time.allow_unstable = true;
            scenario
        };
        let one = end(&allowed(coupled(["0", "0"], &skew, scheme)), Precision::F64);
        let other = end(&coupled(["0.7*v1", "-0.7*v0"], damping, scheme), Precision::F64);
        for (a, b) in
            one.position.iter().chain(&one.momentum).zip(other.position.iter().chain(&other.momentum))
        {
            assert!((a - b).abs() < 1e-12, "{one:?} {other:?}");
        }
    }
}

#[test]
fn the_midpoint_rule_loses_what_the_drag_takes() {
    // E_{k+1} − E_k = h v̄ᵀ F with v̄ = (q_{k+1} − q_k)/h, of a quadratic potential to rounding.
    for (forces, linear) in [(["-0.4*v0 + 0.1*v1", "-0.2*v1"], true), (["-0.4*v0^3", "-0.1*v1*q0^2"], false)]
    {
        let scenario = coupled(forces, "", "[scheme]\nkind = \"low-order\"\nkappa = 0.5");
        let mut simulation = Simulation::new(&scenario, Precision::F64).unwrap();
        let new = || GridState { position: vec![0.0; 2], momentum: vec![0.0; 2], ..GridState::default() };
        let (mut before, mut after) = (new(), new());
        simulation.read(&mut before);
        let first = before.energy;
        for _ in 0..200 {
            let iterations = simulation.step(&[]).unwrap();
            assert!(iterations <= if linear { 1 } else { 5 }, "{iterations}");
            simulation.read(&mut after);
            let middle: Vec<f64> = (0..2).map(|i| 0.5 * (before.position[i] + after.position[i])).collect();
            let v: Vec<f64> = (0..2).map(|i| (after.position[i] - before.position[i]) / 0.05).collect();
            let force = match linear {
                true => [-0.4 * v[0] + 0.1 * v[1], -0.2 * v[1]],
                false => [-0.4 * v[0].powi(3), -0.1 * v[1] * middle[0].powi(2)],
            };
            let work = 0.05 * (force[0] * v[0] + force[1] * v[1]);
            assert!((after.energy - before.energy - work).abs() < 1e-14, "{after:?}");
            std::mem::swap(&mut before, &mut after);
        }
        assert!(before.energy < 0.8 * first);
    }
}

#[test]
fn linear_drag_is_seen_by_the_check_of_the_step() {
    // p_{k+1} = (1 − h c) p_k: stable up to h c = 2. With c < 0 the motion itself grows.
    let with = |c: f64| {
        scenario(&format!(
            "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\nforce = [\"{}*v0\"]\n\
             [initial]\nposition = [1.0]\nmomentum = [0.0]\n[scheme]\nkind = \"low-order\"\nkappa = 0.0\n\
             [time]\nstep = 0.1\nsteps = 100\n",
            -c
        ))
    };
    for (c, is_stable) in [(0.5, true), (18.0, true), (21.0, false), (-0.5, true)] {
        assert_eq!(Simulation::is_predicted_stable(&with(c)).unwrap(), is_stable, "{c}");
    }
    let error = Simulation::new(&with(21.0), Precision::F64).err().unwrap().to_string();
    assert!(error.contains("time.step") && error.contains("9.50e-2"), "{error}");
    // The limit in the message is sharp.
    for (step, grows) in [(0.097, true), (0.0945, false)] {
        let mut scenario = with(21.0);
        scenario.time.allow_unstable = true;
        (scenario.time.step, scenario.time.steps) = (step, 4000);
        scenario.time.energy_guard = Some(fvi_scenario::scenario::OnEnergyGrowth::Ignore);
        let energy = end(&scenario, Precision::F64).energy;
        assert_eq!(energy > 1e3, grows, "{step}: {energy:e}");
    }
    // A nonsymmetric coupling, with a scheme of several nodes.
    let gauss = "[scheme]\nkind = \"galerkin\"\ndegree = 2\nquadrature = \"gauss\"\npoints = 2";
    let turning = coupled(["-0.2*v0 + 3*v1", "-2*v0 - 0.1*v1"], "", gauss);
    assert!(Simulation::is_predicted_stable(&turning).unwrap());
}

#[test]
fn driven_motions_do_not_trip_the_guard_and_steps_too_long_do() {
    let run = |force: &str, start: &str, scheme: &str, time: &str| {
        let scenario = scenario(&format!(
            "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\nforce = [\"{force}\"]\n\
             [initial]\n{start}\n[scheme]\n{scheme}\n[time]\n{time}\n"
        ));
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
        while !motion.is_done() {
            if let Err(failure) = motion.advance() {
                return Some(failure.reason);
            }
        }
        None
    };
    // From 10⁻⁶ to a limit cycle of amplitude 2: the energy rises by the factor 10¹².
    let small = "position = [1e-6]\nmomentum = [0.0]";
    let midpoint = "kind = \"low-order\"\nkappa = 0.5";
    assert_eq!(run("(1 - q0^2)*v0", small, midpoint, "step = 0.05\nsteps = 2000"), None);
    assert_eq!(run("0.5*v0", small, midpoint, "step = 0.05\nsteps = 2000"), None);
    assert_eq!(
        run(
            "v0/max(abs(v0), 1e-300) - v0",
            "position = [0.0]\nmomentum = [1e-9]",
            midpoint,
            "step = 0.05\nsteps = 200"
        ),
        None
    );
    // Explicit with h c = 2.5 after t = 1; the check at the start does not see it.
    let late = run(
        "-50*step(t - 1)*v0",
        "position = [1.0]\nmomentum = [0.0]",
        "kind = \"low-order\"\nkappa = 0.0",
        "step = 0.05\nsteps = 2000",
    );
    assert!(late.as_ref().is_some_and(|reason| reason.contains("energy has risen")), "{late:?}");
}

#[test]
fn single_precision_and_adaptive_steps_follow() {
    let exact = {
        let scenario = manufactured(0.7, "kind = \"low-order\"\nkappa = 0.5", "order = 2", 256);
        end(&scenario, Precision::F32)
    };
    assert!((exact.position[0] - 2.0).abs() < 1e-3 && (exact.momentum[0] - 5.0).abs() < 1e-2, "{exact:?}");
    for tolerance in [1e-5, 1e-8] {
        let text = manufactured(0.7, "kind = \"collocation\"", "family = \"radau-iia\"\nstages = 3", 8);
        let text = text
            .document()
            .text()
            .replace("step = 0.125", &format!("grid = \"adaptive\"\ntolerance = {tolerance:e}"));
        let state = end(&scenario(&text.replace("allow_unstable = true", "")), Precision::F64);
        let error = (state.position[0] - 2.0).abs().max((state.momentum[0] - 5.0).abs());
        assert!(error < 20.0 * tolerance, "{tolerance:e}: {error:e}");
    }
}

#[test]
fn steps_end_at_kinks_in_the_position_beside_a_drag() {
    let state = |system: &str| {
        end(
            &scenario(&format!(
                "[system]\nmass = [1.0]\n{system}\n[initial]\nposition = [-1.0]\nmomentum = [0.0]\n\
                 [scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 3\n\
                 [time]\ngrid = \"adaptive\"\ntolerance = 1e-9\nend = 5.0\n"
            )),
            Precision::F64,
        )
    };
    let drag = "0.3*v0^3 - 0.1*v0*abs(v0)";
    let one = state(&format!("potential = \"0.5*q0^2 + 10*max(q0, 0)^2\"\nforce = [\"-{drag}\"]"));
    let other = state(&format!("force = [\"-q0 - 20*max(q0, 0) - {drag}\"]"));
    for (a, b) in [(one.position[0], other.position[0]), (one.momentum[0], other.momentum[0])] {
        assert!((a - b).abs() < 1e-7, "{one:?} {other:?}");
    }
}

/// v̇ = −2 − |v| and v̇ = −1 − max(v, 0): a kink where the velocity turns, which no node of a step shows if
/// it lies before the first one.
#[test]
fn adaptive_steps_keep_their_tolerance_across_kinks_in_the_velocity() {
    let end_time = 2.0_f64;
    // Position and velocity of both.
    let (turn, rest) = (2.5_f64.ln(), end_time - 2.5_f64.ln());
    let magnitude = [3.0 - 2.0 * turn + 2.0 * rest - 2.0 * (rest.exp() - 1.0), 2.0 - 2.0 * rest.exp()];
    let (turn, rest) = (4.0_f64.ln(), end_time - 4.0_f64.ln());
    let maximum = [3.0 - turn - 0.5 * rest * rest, -rest];
    for (force, exact) in
        [("-2 - abs(v0)", magnitude), ("-1 - max(v0, 0)", maximum), ("-1 + min(0, -v0)", maximum)]
    {
        for scheme in [
            "kind = \"collocation\"",
            "kind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 2",
            "kind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 5",
            "kind = \"galerkin\"\ndegree = 2\n[convolution]\nfamily = \"radau-iia\"\nstages = 2",
        ] {
            for exponent in [4, 5, 6, 7, 8, 9] {
                let scenario = scenario(&format!(
                    "[system]\nmass = [1.0]\nforce = [\"{force}\"]\n[initial]\nposition = [0.0]\nvelocity = [3.0]\n\
                     [scheme]\n{scheme}\n[time]\ngrid = \"adaptive\"\nend = {end_time:?}\ntolerance = 1e-{exponent}\n"
                ));
                let state = end(&scenario, Precision::F64);
                let tolerance = 10f64.powi(-exponent);
                for (found, exact) in [state.position[0], state.momentum[0]].into_iter().zip(exact) {
                    let error = (found - exact).abs() / exact.abs().max(3.0);
                    assert!(error < 10.0 * tolerance, "{force}, {scheme}, {tolerance:e}: {error:e}");
                }
            }
        }
    }
}

#[test]
fn sensitivities_are_differences_of_runs() {
    let paths = [
        "system.parameters.mu",
        "system.parameters.c",
        "system.parameters.v1",
        "system.mass[0]",
        "system.damping[0].order",
        "initial.velocity[1]",
    ];
    let schemes = [
        "[scheme]\nkind = \"low-order\"\nkappa = 0.5\n[convolution]\norder = 2",
        "[scheme]\nkind = \"galerkin\"\ndegree = 2\nquadrature = \"gauss\"\npoints = 2\n[convolution]\norder = 3",
        "[scheme]\nkind = \"galerkin\"\ndegree = 1\nquadrature = \"lobatto\"\npoints = 2\n[convolution]\nat = \"main-nodes\"",
    ];
    // A linear force is compiled to matrices. The parameter v1 is not a velocity.
    let forces =
        [["mu*(1 - q0^2)*v0 - c*v0*q1", "-c*v0^3 + v1*q1"], ["mu*v0 - c*v0 + 0.2*q1", "-c*v0 + v1*q1"]];
    for (scheme, force) in schemes.iter().flat_map(|scheme| forces.map(|force| (scheme, force))) {
        let text = |[mu, c, v1, mass, order, velocity]: [f64; 6], sensitive: &str| {
            format!(
                "[system]\nmass = [{mass:?}, 2.0]\npotential = \"q0^2 + 0.5*q1^2 + 0.3*q0*q1\"\n\
                 force = [\"{}\", \"{}\"]\nparameters = {{ mu = {mu:?}, c = {c:?}, v1 = {v1:?} }}\n\
                 [[system.damping]]\norder = {order:?}\ncoefficient = [0.3, 0.1]\n\
                 [initial]\nposition = [0.5, -0.4]\nvelocity = [0.0, {velocity:?}]\n{scheme}\n\
                 [time]\nstep = 0.05\nsteps = 40\nallow_unstable = true\n{sensitive}",
                force[0], force[1]
            )
        };
        let numbers = [0.8, 0.3, -0.2, 1.2, 0.6, 0.7];
        let state = |numbers: [f64; 6]| {
            let state = end(&scenario(&text(numbers, "")), Precision::F64);
            [state.position, state.momentum].concat()
        };
        let sensitive = format!("[sensitivity]\nparameters = {paths:?}\n");
        let found = end(&scenario(&text(numbers, &sensitive)), Precision::F64).sensitivities;
        for (index, path) in paths.iter().enumerate() {
            let near = |by: f64| {
                let mut numbers = numbers;
                numbers[index] += by;
                state(numbers)
            };
            let (above, below) = (near(1e-5), near(-1e-5));
            for (place, (above, below)) in above.iter().zip(&below).enumerate() {
                let (found, difference) = (found[4 * index + place], (above - below) / 2e-5);
                assert!(
                    (found - difference).abs() < 1e-7,
                    "{scheme}\n{force:?}\n{path}, number {place}: {found}, not {difference}"
                );
            }
        }
    }
}
