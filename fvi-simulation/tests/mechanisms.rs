//! What holds for every mechanism: the order of the degree for every kernel, and no work from dampers.

use fvi_core::max_or_nan;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::Precision;
use fvi_simulation::simulation::motion::Motion;
use serde_json::{Value, json};

/// A bead on the ellipse x = 2 cos φ, y = sin φ under gravity, its damper along the distance to a point
/// outside: by φ, whose mass depends on it, or by x and y with a constraint.
fn bead(damper: &Value, by_angle: bool) -> [Value; 2] {
    let mut damper = damper.clone();
    let (angle, rate) = (0.7_f64, 1.5_f64);
    let (cos, sin) = (angle.cos(), angle.sin());
    if by_angle {
        damper["along"] = json!("hypot(2*cos(q0) - 2.5, sin(q0) - 0.8)");
        let kinetic = "0.5*1.3*(4*sin(q0)^2 + cos(q0)^2)*v0^2";
        let system = json!({ "kinetic": kinetic, "potential": "1.3*9.81*sin(q0)", "damping": [damper] });
        return [system, json!({ "position": [angle], "velocity": [rate] })];
    }
    damper["along"] = json!("hypot(q0 - 2.5, q1 - 0.8)");
    let system = json!({
        "mass": [1.3, 1.3],
        "potential": "1.3*9.81*q1",
        "constraints": ["q0^2/4 + q1^2 - 1"],
        "damping": [damper],
    });
    [system, json!({ "position": [2.0 * cos, sin], "velocity": [-2.0 * sin * rate, cos * rate] })]
}

/// Positions as x and y, and momenta as those of φ, p_φ = p·∂(x, y)/∂φ, at 13 times in the second half.
fn motion_of(damper: &Value, by_angle: bool, degree: usize, steps: usize) -> Vec<([f64; 2], f64)> {
    let [system, initial] = bead(damper, by_angle);
    let scenario = Scenario::from_value(&json!({
        "system": system,
        "initial": initial,
        "scheme": { "kind": "galerkin", "degree": degree },
        "time": { "step": 1.5 / steps as f64, "steps": steps },
    }))
    .unwrap();
    let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
    let mut found = Vec::new();
    for step in 1..=steps {
        motion.advance().unwrap();
        if 2 * step >= steps && (24 * step).is_multiple_of(steps) {
            let (q, p) = (&motion.state().position, &motion.state().momentum);
            found.push(match by_angle {
                true => ([2.0 * q[0].cos(), q[0].sin()], p[0]),
                false => ([q[0], q[1]], -2.0 * q[1] * p[0] + 0.5 * q[0] * p[1]),
            });
        }
    }
    found
}

/// Orders 2, 4 and 6 in q by either coordinates for all kernels and orders, in p for orders below 1; against
/// the motion by the other coordinates on shorter steps of degree 4. Degree 3 is given with what it falls
/// short of 6 on these steps: in q under a tempered kernel, in p for orders near 1.
#[test]
fn a_bead_on_an_ellipse_has_the_order_of_its_degree_for_every_kernel() {
    let order = |order: f64| json!({ "order": order, "coefficient": if order < 1.0 { 2.0 } else { 0.3 } });
    let kernel = |kernel: Value| json!({ "kernel": kernel, "coefficient": 2.0 });
    let cases = [
        (order(0.2), [5.7, 6.0]),
        (order(0.5), [6.0, 6.0]),
        (order(0.8), [5.7, 5.15]),
        (order(1.2), [5.8, 0.0]),
        (order(1.7), [5.5, 0.0]),
        (kernel(json!({ "form": "maxwell", "order": 0.6, "time": 0.3 })), [6.0, 6.0]),
        (kernel(json!({ "form": "tempered", "order": 0.4, "rate": 0.8 })), [5.0, 5.9]),
        (kernel(json!({ "form": "prony", "strengths": [1.0, 0.5], "times": [0.1, 1.0] })), [6.0, 5.9]),
        (
            kernel(json!({ "form": "havriliak-negami", "order": 0.7, "power": 0.6, "time": 0.4 })),
            [5.95, 5.95],
        ),
    ];
    for (damper, of_degree_3) in &cases {
        let exact = [false, true].map(|by_angle| motion_of(damper, by_angle, 4, 240));
        for (by_angle, degree, steps) in
            [true, false].into_iter().flat_map(|by| [(by, 1, 240), (by, 2, 24), (by, 3, 24)])
        {
            let errors = |steps: usize| {
                let found = motion_of(damper, by_angle, degree, steps);
                let pairs = found.iter().zip(&exact[usize::from(!by_angle)]);
                pairs.fold([0.0, 0.0], |most, ((x, p), (y, r))| {
                    let off = [(x[0] - y[0]).hypot(x[1] - y[1]), (p - r).abs()];
                    [0, 1].map(|of| max_or_nan(most[of], off[of]))
                })
            };
            let (coarse, fine) = (errors(steps), errors(4 * steps));
            let orders = [0, 1].map(|of| 0.5 * (coarse[of] / fine[of]).log2());
            for (name, of) in [("q", 0), ("p", 1)].into_iter().take(1 + usize::from(of_degree_3[1] > 0.0)) {
                let least = [1.98, 3.7, of_degree_3[of] - 0.02][degree - 1];
                let most = 2.0 * degree as f64 + [0.02, 0.3, 0.9][degree - 1];
                let found = orders[of];
                assert!(
                    (least..most).contains(&found) && fine[of] < [2e-4, 3e-6, 1e-8][degree - 1],
                    "{damper}, by the angle: {by_angle}, degree {degree}: {name} {found}, {:e}",
                    fine[of]
                );
            }
        }
    }
}

/// Numbers in [0, 1), of Knuth's linear congruential generator.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn within(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.next()
    }

    fn choice<T: Clone>(&mut self, of: &[T]) -> T {
        of[(self.next() * of.len() as f64) as usize].clone()
    }
}

/// A damper of any kernel of relaxations along a length, an angle with a cut, or a crooked function.
fn any_damper(draws: &mut Draws) -> Value {
    let [a, b, c] = [0; 3].map(|_| draws.within(-1.0, 1.0));
    let along = draws.choice(&[
        format!("hypot(q0 - {a}, q1 - {b})"),
        format!("atan2(q1 - {a}, q0 - {b})"),
        format!("atan2(q1 - q0, {a} + q1*q0)"),
        format!("{c}*q0*q1 + sin(3*q0) - {b}*q1^2"),
    ]);
    let order = draws.within(0.1, 0.95);
    let time = 10_f64.powf(draws.within(-2.0, 1.0));
    let power = draws.within(0.2, 1.0);
    let kernel = draws.choice(&[
        json!({ "form": "power", "order": order }),
        json!({ "form": "maxwell", "order": order, "time": time }),
        json!({ "form": "tempered", "order": order, "rate": 1.0 / time }),
        json!({ "form": "prony", "strengths": [1.0, power], "times": [time, 10.0 * time] }),
        json!({ "form": "havriliak-negami", "order": order, "power": power, "time": time }),
    ]);
    json!({ "kernel": kernel, "coefficient": 10_f64.powf(draws.within(-1.0, 1.5)), "along": along })
}

/// The work of the dampers, h Σ b_i W_iᵀ f_i, and what they store are never negative, and what they have
/// dissipated never falls, whatever kernel, elongation, step and potential.
#[test]
fn dampers_never_give_more_than_they_took_from_200_random_systems() {
    let mut draws = Draws(5);
    let (mut ended, mut most_taken) = (0, 0.0);
    for system in 0..200 {
        let [mass, k, m, c] = [0; 4].map(|_| 10_f64.powf(draws.within(-1.0, 1.0)));
        let (step, degree) = (10_f64.powf(draws.within(-2.0, 0.0)), draws.choice(&[1, 2, 3, 4]));
        let scenario = Scenario::from_value(&json!({
            "system": {
                "mass": [mass, 1.0],
                "potential": format!("0.5*{k}*q0^2 + {m}*q1^4 + {c}*cos(q0 - 2*q1)"),
                "damping": [any_damper(&mut draws), any_damper(&mut draws)],
            },
            "initial": {
                "position": [draws.within(-2.0, 2.0), draws.within(-2.0, 2.0)],
                "velocity": [draws.within(-3.0, 3.0), draws.within(-3.0, 3.0)],
            },
            "scheme": { "kind": "galerkin", "degree": degree },
            "time": { "step": step, "steps": 30, "energy_guard": "off" },
            "output": { "memory_energy": true },
        }))
        .unwrap();
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
        let (mut last, mut size) = (0.0, motion.state().energy.abs());
        // Where the equation of a step that is too long has no solution nearby, the run ends with the time.
        while !motion.is_done() && motion.advance().is_ok() {
            let [stored, dissipated] = motion.state().columns[..] else { panic!("two columns") };
            size = max_or_nan(size, max_or_nan(motion.state().energy.abs(), dissipated.abs()));
            let rounding = 1e-12 * size;
            assert!(stored >= -rounding, "system {system}: {stored:e} stored");
            assert!(stored + dissipated >= -rounding, "system {system}: {stored:e} and {dissipated:e}");
            assert!(dissipated - last >= -rounding, "system {system}: from {last:e} to {dissipated:e}");
            last = dissipated;
            most_taken = max_or_nan(most_taken, dissipated / size);
        }
        ended += usize::from(!motion.is_done());
    }
    assert!(ended < 25, "{ended} of 200 runs ended early");
    // The dampers do take, of some systems nearly all.
    assert!(most_taken > 0.5, "{most_taken}");
}

/// How a run of a mechanism ends: its reason to stop, if it stops, and its warning.
fn end_of(system: Value, initial: Value, time: Value) -> (Option<String>, Option<String>) {
    let scenario =
        Scenario::from_value(&json!({ "system": system, "initial": initial, "time": time })).unwrap();
    let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
    while !motion.is_done() {
        if let Err(failure) = motion.advance() {
            return (Some(failure.reason), None);
        }
    }
    (None, motion.warning().map(str::to_owned))
}

#[test]
fn mechanisms_whose_energy_rises_without_work_are_stopped() {
    let stopped = |system: Value, initial: Value, time: Value| {
        let (reason, _) = end_of(system.clone(), initial, time);
        let reason = reason.unwrap_or_else(|| panic!("{system} ran to the end"));
        assert!(reason.contains("energy has risen"), "{reason}");
    };
    // A double pendulum that turns too far in a step, a mass that vanishes on the way, a sharp bend.
    let double = json!({
        "kinetic": "0.5*2*v0^2 + 0.5*v1^2 + cos(q0 - q1)*v0*v1",
        "potential": "-19.62*cos(q0) - 9.81*cos(q1)",
    });
    stopped(double.clone(), json!({ "position": [2.5, 2.5] }), json!({ "step": 0.1, "end": 24.0 }));
    let vanishing = json!({ "kinetic": "0.5*q0^2*v0^2", "potential": "0.5*q0^2" });
    stopped(vanishing, json!({ "position": [1.0] }), json!({ "step": 0.01, "end": 5.0 }));
    let sharp = json!({ "mass": [1.0, 1.0], "constraints": ["q0^2 + 1e-9*q1"] });
    let start = json!({ "position": [0.0, 0.0], "velocity": [1.0, 0.0] });
    stopped(sharp, start, json!({ "step": 0.01, "end": 5.0 }));
    // With steps that are short enough the double pendulum is let pass, and so is one that falls from rest
    // at a height of 0 with a constant of any size in its potential.
    let time = json!({ "step": 0.01, "end": 24.0 });
    assert_eq!(end_of(double, json!({ "position": [2.5, 2.5] }), time.clone()), (None, None));
    let lifted = json!({ "kinetic": "0.5*v0^2", "potential": "1e6 + 9.81*(cos(1) - cos(q0))" });
    assert_eq!(end_of(lifted, json!({ "position": [1.0] }), time), (None, None));
}

#[test]
fn energy_of_a_mechanism_that_changes_though_nothing_drives_it_is_told() {
    // A spherical pendulum that passes close to the pole of its angles, and a bead in a steep parabola.
    let spherical = json!({ "kinetic": "0.5*(v0^2 + sin(q0)^2*v1^2)", "potential": "-9.81*cos(q0)" });
    let start = json!({ "position": [1.0, 0.0], "momentum": [0.0, 0.001] });
    let (reason, warning) = end_of(spherical, start, json!({ "step": 0.01, "end": 20.0 }));
    assert_eq!(reason, None);
    assert!(warning.as_ref().is_some_and(|warning| warning.contains("though nothing damps")), "{warning:?}");
    let parabola = json!({ "mass": [1.0, 1.0], "potential": "9.81*q1", "constraints": ["q1 - 10*q0^2"] });
    let start = json!({ "position": [1.0, 10.0] });
    let (reason, warning) = end_of(parabola, start, json!({ "step": 0.01, "end": 5.0 }));
    assert_eq!(reason, None);
    assert!(warning.as_ref().is_some_and(|warning| warning.contains("risen")), "{warning:?}");
    // What a damper has taken up counts with the energy, which may fall, and what a force has done counts
    // against it.
    let end = |push: Option<&str>, speed: f64| {
        let mut system = json!({
            "kinetic": "0.5*v0^2 + 0.5*sin(q0)^2*v1^2",
            "potential": "9.81*cos(q0)",
            "damping": [{ "order": 0.6, "coefficient": 0.3, "along": "q0" }],
        });
        if let Some(push) = push {
            system["force"] = json!([push, "0"]);
        }
        let start = json!({ "position": [1.5, 0.0], "velocity": [0.0, speed] });
        end_of(system, start, json!({ "step": 0.01, "end": 3.0 }))
    };
    for (push, words) in [(None, "taken up, has"), (Some("0.1*sin(t)"), "forces explain no more")] {
        let (reason, warning) = end(push, 0.01);
        assert_eq!(reason, None);
        assert!(warning.as_ref().is_some_and(|warning| warning.contains(words)), "{warning:?}");
        assert_eq!(end(push, 3.0), (None, None));
    }
}

#[test]
fn work_that_is_done_on_a_mechanism_is_explained() {
    // Resonance, a force against the motion's
    // own direction that drives it, and dampers of orders up to 1.7.
    let time = json!({ "step": 0.02, "end": 40.0 });
    let pendulum =
        |force: &str| json!({ "kinetic": "0.5*v0^2", "potential": "-9.81*cos(q0)", "force": [force] });
    assert_eq!(end_of(pendulum("0.1*sin(3.13*t)"), json!({ "position": [0.0] }), time.clone()), (None, None));
    assert_eq!(end_of(pendulum("0.2*v0"), json!({ "position": [0.01] }), time.clone()), (None, None));
    for order in [0.2, 0.5, 1.0, 1.7] {
        let damper = json!({ "order": order, "coefficient": 3.0, "along": "hypot(q0 - 2, q1)" });
        let bead = json!({ "mass": [1.0, 1.0], "constraints": ["q0^2 + q1^2 - 1"], "damping": [damper] });
        for velocity in [[0.0, 0.0], [0.0, 2.0]] {
            let start = json!({ "position": [1.0, 0.0], "velocity": velocity });
            assert_eq!(
                end_of(bead.clone(), start, time.clone()),
                (None, None),
                "order {order}, {velocity:?}"
            );
        }
        let start = json!({ "position": [0.0, 1.0] });
        assert_eq!(end_of(bead, start, time.clone()), (None, None), "order {order}, at rest");
    }
}

/// Steps of a long run: `MECHANISM_STEPS`, or as many as take little time.
fn long_run() -> usize {
    std::env::var("MECHANISM_STEPS").map_or(4000, |steps| steps.parse().expect("a number of steps"))
}

/// A double pendulum by the places of its masses, hardly damped: |c| and |Cv| at every grid point, and E +
/// stored + dissipated, which neither rises nor falls.
#[test]
fn constraints_and_energies_hold_over_a_long_run_of_a_mechanism() {
    let angles = ["atan2(q0, -q1)", "atan2(q2 - q0, q1 - q3)"];
    let damper = |order: f64, along: &str| json!({ "order": order, "coefficient": 1e-5, "along": along });
    let steps = long_run();
    let scenario = Scenario::from_value(&json!({
        "system": {
            "mass": [1.0, 1.0, 0.8, 0.8],
            "potential": "9.81*q1 + 0.8*9.81*q3",
            "constraints": ["q0^2 + q1^2 - 1", "(q2 - q0)^2 + (q3 - q1)^2 - 0.49"],
            "damping": [damper(0.5, angles[0]), damper(0.7, angles[1])],
        },
        "initial": { "position": [0.6, -0.8, 1.16, -0.38], "velocity": [0.4, 0.3, -0.2, 1.1] , "project": true },
        "scheme": { "kind": "galerkin", "degree": 2 },
        "time": { "step": 0.01, "steps": steps },
        "output": { "memory_energy": true },
    }))
    .unwrap();
    let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
    let first = motion.state().energy;
    let mut off = [0.0; 4];
    while !motion.is_done() {
        motion.advance().unwrap();
        let (q, p) = (&motion.state().position, &motion.state().momentum);
        let v = [p[0], p[1], p[2] / 0.8, p[3] / 0.8];
        let [x, y] = [q[2] - q[0], q[3] - q[1]];
        let c = [q[0] * q[0] + q[1] * q[1] - 1.0, x * x + y * y - 0.49];
        let rates = [2.0 * (q[0] * v[0] + q[1] * v[1]), 2.0 * (x * (v[2] - v[0]) + y * (v[3] - v[1]))];
        let [.., stored, dissipated] = motion.state().columns[..] else { panic!("columns of energies") };
        let balance = (motion.state().energy + stored + dissipated - first).abs();
        let half = if 2 * motion.steps() < steps { 2 } else { 3 };
        for (place, size) in [(0, c[0]), (0, c[1]), (1, rates[0]), (1, rates[1]), (half, balance)] {
            off[place] = max_or_nan(off[place], size.abs());
        }
    }
    let [c, rate, early, late] = off;
    println!("{steps} steps: |c| {c:.1e}, |Cv| {rate:.1e}, energies off by {early:.1e} and then {late:.1e}");
    assert!(c < 1e-13 && rate < 1e-13, "{c:e} {rate:e}");
    // The larger of either half is that of the fastest swing in it, whose steps are the same.
    assert!(early < 1e-3 && late < 3.0 * early, "{early:e} {late:e}");
}

/// With a quadratic potential and no constraints energies make up the start to rounding, which adds up like
/// a random walk.
#[test]
fn energies_of_a_quadratic_potential_hold_over_a_long_run() {
    let steps = long_run();
    let scenario = Scenario::from_value(&json!({
        "system": {
            "mass": [1.0, 2.0],
            "potential": "3*q0^2 + q0*q1 + 2*q1^2",
            "damping": [
                { "order": 0.5, "coefficient": 1e-4, "along": "hypot(q0 + 2, q1)" },
                { "order": 0.8, "coefficient": 1e-4, "along": "atan2(q1 + 3, q0)" },
            ],
        },
        "initial": { "position": [0.6, -0.4], "velocity": [0.3, 1.0] },
        "scheme": { "kind": "galerkin", "degree": 2 },
        "time": { "step": 0.05, "steps": steps },
        "output": { "memory_energy": true },
    }))
    .unwrap();
    let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
    let (first, mut most) = (motion.state().energy, 0.0);
    while !motion.is_done() {
        motion.advance().unwrap();
        let [stored, dissipated] = motion.state().columns[..] else { panic!("two columns") };
        most = max_or_nan(most, ((motion.state().energy + stored + dissipated - first) / first).abs());
    }
    println!("{steps} steps: energies off by {most:.1e} of the first");
    assert!(most < 1e-14 * (steps as f64).sqrt(), "{most:e}");
}

/// A spring that hardens and a damper c sign(v)|v|^0.3, with lengths around 1 and around a picometre: the
/// motion is the same to rounding, by Gauss weights and by the energy scheme.
#[test]
fn a_motion_is_the_same_in_any_unit_of_length() {
    let end = |scheme: &Value, length: f64| {
        let mut scenario = scheme.clone();
        scenario["system"] = json!({
            "mass": [1.0],
            "potential": "0.5*4*q0^2 + 0.25*1.5*(q0/L)^2*q0^2",
            "force": ["-0.5*L*sign(v0)*abs(v0/L)^0.3"],
            "parameters": { "L": length },
        });
        scenario["initial"] = json!({ "position": [length] });
        scenario["time"] = json!({ "step": 0.02, "steps": 200 });
        let scenario = Scenario::from_value(&scenario).unwrap();
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
        (0..200).for_each(|_| assert!(motion.advance().is_ok()));
        [motion.state().position[0] / length, motion.state().momentum[0] / length]
    };
    let gauss =
        json!({ "scheme": { "kind": "galerkin", "degree": 2 }, "convolution": { "family": "gauss" } });
    for scheme in [gauss, json!({ "scheme": { "kind": "energy" } })] {
        let of_metres = end(&scheme, 1.0);
        for length in [1e-12, 1e-6, 1e6] {
            for (one, other) in of_metres.iter().zip(end(&scheme, length)) {
                assert!((one - other).abs() < 1e-11, "{scheme}, lengths of {length}: {one} {other}");
            }
        }
    }
}

/// A pendulum whose bar is a hundredth too long at the start is refused in any unit, one that fits is not.
#[test]
fn a_start_off_its_constraint_is_refused_in_any_unit_of_length() {
    let starts = |length: f64, stretch: f64| {
        let scenario = Scenario::from_value(&json!({
            "system": {
                "mass": [1.0, 1.0],
                "potential": "9.81*L*q1/L",
                "parameters": { "L": length },
                "constraints": ["q0^2/L + q1^2/L - L"],
            },
            "initial": { "position": [0.6 * length * stretch, -0.8 * length * stretch] },
            "time": { "step": 0.001, "steps": 2 },
        }))
        .unwrap();
        Motion::start(&scenario, Precision::F64).is_ok()
    };
    for length in [1.0, 1e-8, 1e-6, 1e5] {
        assert!(starts(length, 1.0), "lengths of {length}");
        assert!(!starts(length, 1.01), "lengths of {length}");
    }
}
