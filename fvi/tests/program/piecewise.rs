//! Jumps and kinks in the position: walls, backlash, dead zones and forces like those of dry friction,
//! against solutions that go from one to the next in closed form.

use fvi_fft::sums::max_or_nan;
use fvi_host::run::{Run, RunEnd, RunSummary};
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::Precision;
use serde_json::{Value, json};
use std::sync::atomic::AtomicBool;

/// Runs a scenario; the summary and the rows (t, q, p, energy).
fn rows(scenario: &Value, precision: Precision) -> (RunSummary, Vec<[f64; 4]>) {
    let scenario = Scenario::from_value(scenario).unwrap_or_else(|error| panic!("{scenario}: {error}"));
    let mut rows = Vec::new();
    let mut run = Run::of(&scenario).precision(precision).start().unwrap();
    let Ok(end) = run.drive(&AtomicBool::new(false), |portion| {
        portion.states(|_, state| {
            rows.push([state.time, state.position[0], state.momentum[0], state.energy]);
            Ok::<_, std::convert::Infallible>(())
        })
    });
    (run.summary(end), rows)
}

fn radau(stages: usize) -> Value {
    json!({ "family": "radau-iia", "stages": stages })
}

/// Schemes on adaptive grids.
fn schemes() -> [(Value, Value); 4] {
    [
        (json!({ "kind": "collocation" }), radau(3)),
        (json!({ "kind": "galerkin", "degree": 3 }), radau(3)),
        (json!({ "kind": "collocation" }), radau(2)),
        (json!({ "kind": "galerkin", "degree": 2 }), json!({ "family": "lobatto-iiic", "stages": 3 })),
    ]
}

fn scenario(system: Value, position: f64, end: f64, tolerance: f64) -> Value {
    let mut system = system;
    system["mass"] = json!([1.0]);
    json!({
        "system": system,
        "initial": { "position": [position], "velocity": [0.0] },
        "scheme": { "kind": "collocation" },
        "time": { "grid": "adaptive", "end": end, "tolerance": tolerance },
    })
}

/// q̈ = −sign q from rest at 1: parabolas.
fn bouncing(time: f64) -> (f64, f64) {
    let quarter = 2.0_f64.sqrt();
    let time = time % (4.0 * quarter);
    let from_top = |time: f64| (1.0 - 0.5 * time * time, -time);
    match time {
        time if time <= quarter => from_top(time),
        time if time <= 3.0 * quarter => {
            let (q, p) = from_top(time - 2.0 * quarter);
            (-q, -p)
        }
        time => from_top(time - 4.0 * quarter),
    }
}

#[test]
fn a_force_that_jumps_leaves_no_error_beyond_the_tolerance() {
    let systems = [
        json!({ "potential": "abs(q0)" }),
        json!({ "potential": "max(q0, -q0)" }),
        json!({ "force": ["-sign(q0)"] }),
        json!({ "force": ["1 - 2*step(q0)"] }),
        json!({ "element": [{ "potential": "abs(x0)", "coordinates": [[0]] }] }),
    ];
    for (scheme, convolution) in schemes() {
        for system in &systems {
            for tolerance in [1e-4, 1e-6, 1e-8, 1e-10] {
                let mut jumping = scenario(system.clone(), 1.0, 20.0, tolerance);
                jumping["scheme"] = scheme.clone();
                jumping["convolution"] = convolution.clone();
                let (summary, rows) = rows(&jumping, Precision::F64);
                assert_eq!(summary.end, RunEnd::Completed, "{system}");
                for [time, q, p, _] in rows {
                    let (exact_q, exact_p) = bouncing(time);
                    let error = max_or_nan((q - exact_q).abs(), (p - exact_p).abs());
                    assert!(error < tolerance, "{system} {scheme} {tolerance:e}: {error:e} at {time}");
                }
            }
        }
    }
}

#[test]
fn energy_stays_in_single_precision_too() {
    let (summary, rows) = rows(&scenario(json!({ "potential": "abs(q0)" }), 1.0, 20.0, 1e-4), Precision::F32);
    assert_eq!(summary.end, RunEnd::Completed);
    assert!(rows.iter().all(|row| (row[3] - 1.0).abs() < 1e-3), "{:?}", rows.last());
}

#[test]
fn what_is_at_rest_on_a_jump_stays_there_until_it_is_pushed_off() {
    for tolerance in [1e-5, 1e-8] {
        // Held by a force of up to 1, then q̈ = t − 1.
        let pushed = scenario(json!({ "force": ["-sign(q0) + t"] }), 0.0, 2.0, tolerance);
        let (summary, pushed) = rows(&pushed, Precision::F64);
        assert_eq!(summary.end, RunEnd::Completed);
        for [time, q, p, _] in pushed {
            let late = (time - 1.0).max(0.0);
            let error = max_or_nan((q - late.powi(3) / 6.0).abs(), (p - late.powi(2) / 2.0).abs());
            assert!(error < tolerance, "{error:e} at {time}");
        }
    }
    // A potential with an edge, and a load that jumps to what it holds and back, and then to more.
    let load = "0.5*step(t - 1) - 1.2*step(t - 2) + 2*step(t - 3)";
    let system = json!({ "potential": "abs(q0 - 0.25)", "force": [load] });
    let (summary, rows) = rows(&scenario(system, 0.25, 4.0, 1e-6), Precision::F64);
    assert_eq!(summary.end, RunEnd::Completed);
    for [time, q, p, _] in rows {
        let late = (time - 3.0).max(0.0);
        let error = max_or_nan((q - 0.25 - 0.15 * late.powi(2)).abs(), (p - 0.3 * late).abs());
        assert!(error < 2e-6, "{error:e} at {time}");
    }
}

#[test]
fn what_has_no_motion_or_several_is_refused() {
    let ends = [
        (json!({ "potential": "-abs(q0)" }), 0.0, "not unique: at rest on abs(q0) of `system.potential`"),
        (json!({ "potential": "0.5*q0^2 + step(q0 - 0.5)" }), 1.0, "jumps by"),
        (
            json!({ "element": [{ "potential": "0.5*x0^2 + 2*sign(x0 - 0.5)", "coordinates": [[0]] }] }),
            1.0,
            "sign(x0 - 0.5) of `system.element[0].potential` at coordinates[0]",
        ),
    ];
    for (system, start, told) in ends {
        let (summary, _) = rows(&scenario(system.clone(), start, 5.0, 1e-6), Precision::F64);
        let RunEnd::Failed { reason, .. } = summary.end else { panic!("{system} is not refused") };
        assert!(reason.contains(told), "{system}: {reason}");
    }
}

#[test]
fn powers_that_end_at_a_contact_are_passed() {
    // A sphere that bounces between half spaces: no number on the far side of the contact's own formula.
    let (summary, rows) = rows(
        &scenario(json!({ "potential": "0.5*q0^2 + 100*max(-q0 - 0.2, 0)^2.5" }), 1.0, 20.0, 1e-8),
        Precision::F64,
    );
    assert_eq!(summary.end, RunEnd::Completed);
    assert!(rows.iter().all(|row| (row[3] - 0.5).abs() < 1e-7), "{:?}", rows.last());
}

#[test]
fn masses_at_a_gap_cross_together() {
    // Two pairs alike, so that every crossing is one of both.
    let wall = "0.5*200*max(abs(q1 - q0) - 0.1, 0)^2 + 0.5*200*max(abs(q3 - q2) - 0.1, 0)^2";
    let gap = json!({
        "system": {
            "mass": [1.0, 1.0, 1.0, 1.0],
            "potential": format!("0.5*(q0^2 + q2^2) + 0.1*(q1^2 + q3^2) + {wall}"),
        },
        "initial": { "position": [1.0, 1.0, 1.0, 1.0], "velocity": [0.0, -1.0, 0.0, -1.0] },
        "scheme": { "kind": "collocation" },
        "time": { "grid": "adaptive", "end": 10.0, "tolerance": 1e-8 },
    });
    let scenario = Scenario::from_value(&gap).unwrap();
    let mut run = Run::of(&scenario).start().unwrap();
    let mut energies = Vec::new();
    let Ok(end) = run.drive(&AtomicBool::new(false), |portion| {
        portion.states(|_, state| {
            assert_eq!(state.position[0], state.position[2]);
            assert_eq!(state.position[1], state.position[3]);
            energies.push(state.energy);
            Ok::<_, std::convert::Infallible>(())
        })
    });
    assert_eq!(end, RunEnd::Completed);
    let first = energies[0];
    assert!(energies.iter().all(|energy| (energy / first - 1.0).abs() < 1e-6), "{:?}", energies.last());
}

/// Random numbers: xorshift.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }

    fn one_of(&mut self, count: usize) -> usize {
        ((self.next() * count as f64) as usize).min(count - 1)
    }
}

/// q̈ + c q̇ = F(q) + load(t), F linear between some places, the load constant between some times.
#[derive(Clone, Debug, Default)]
struct Piecewise {
    damping: f64,
    /// Places where F jumps or has a kink.
    places: Vec<f64>,
    /// (x, jump of F at x, jump of F′): F is the sum of these and of −stiffness q.
    terms: Vec<(f64, f64, f64)>,
    stiffness: f64,
    constant: f64,
    loads: Vec<(f64, f64)>,
    potential: Vec<String>,
    force: Vec<String>,
    elements: Vec<String>,
}

impl Piecewise {
    fn random(dice: &mut Dice) -> Self {
        let stiffness = dice.between(0.2, 3.0);
        let mut system = Self { stiffness, ..Self::default() };
        system.potential.push(format!("0.5*{stiffness}*q0^2"));
        if dice.next() < 0.4 {
            system.damping = dice.between(0.01, 0.5);
        }
        for _ in 0..=dice.one_of(3) {
            let place = dice.between(-0.8, 0.8);
            let strength = 10.0_f64.powf(dice.between(-1.0, 1.0));
            match dice.one_of(4) {
                // A wall on the right or the left, of a stiffness up to 10⁵.
                0 => {
                    let stiff = 10.0_f64.powf(dice.between(0.0, 5.0));
                    let right = dice.next() < 0.5;
                    let gap = if right { format!("q0 - {place}") } else { format!("{place} - q0") };
                    system.write(dice, &format!("0.5*{stiff}*max({gap}, 0)^2"), None);
                    system.stiffness += if right { 0.0 } else { stiff };
                    system.constant += if right { 0.0 } else { stiff * place };
                    let turn = if right { -stiff } else { stiff };
                    system.turn(place, 0.0, turn);
                }
                // Backlash, or a dead zone.
                1 => {
                    let gap = place.abs() + 0.05;
                    let text = format!("0.5*{strength}*max(abs(q0) - {gap}, 0)^2");
                    system.write(dice, &text, None);
                    system.stiffness += strength;
                    system.constant -= strength * gap;
                    system.turn(-gap, 0.0, strength);
                    system.turn(gap, 0.0, -strength);
                }
                // Pulled towards a place.
                2 => {
                    let force = format!("-{strength}*sign(q0 - {place})");
                    system.write(dice, &format!("{strength}*abs(q0 - {place})"), Some(force));
                    system.constant += strength;
                    system.turn(place, -2.0 * strength, 0.0);
                }
                // Pushed beyond it.
                _ => {
                    let force = format!("-{strength}*step(q0 - {place})");
                    system.write(dice, &format!("{strength}*max(q0 - {place}, 0)"), Some(force));
                    system.turn(place, -strength, 0.0);
                }
            }
        }
        if dice.next() < 0.5 {
            let mut time = 0.0;
            for _ in 0..3 {
                time += dice.between(0.3, 3.0);
                let change = dice.between(-1.0, 1.0);
                system.loads.push((time, change));
                system.force.push(format!("{change}*step(t - {time})"));
            }
        }
        system
    }

    fn turn(&mut self, place: f64, jump: f64, slope: f64) {
        self.terms.push((place, jump, slope));
        self.places.push(place);
        self.places.sort_by(f64::total_cmp);
    }

    fn write(&mut self, dice: &mut Dice, potential: &str, force: Option<String>) {
        match (dice.one_of(3), force) {
            (0, Some(force)) => self.force.push(force),
            (1, _) => self.elements.push(potential.replace("q0", "x0")),
            _ => self.potential.push(potential.to_owned()),
        }
    }

    fn scenario(&self, position: f64, velocity: f64, time: Value) -> Value {
        let mut system = json!({ "mass": [1.0], "potential": self.potential.join(" + ") });
        if !self.force.is_empty() {
            system["force"] = json!([self.force.join(" + ")]);
        }
        if self.damping > 0.0 {
            system["damping"] = json!([{ "order": 1.0, "coefficient": [self.damping] }]);
        }
        let element = |potential: &String| json!({ "potential": potential, "coordinates": [[0]] });
        system["element"] = self.elements.iter().map(element).collect();
        json!({
            "system": system,
            "initial": { "position": [position], "velocity": [velocity] },
            "scheme": { "kind": "collocation" },
            "time": time,
        })
    }

    /// (f, k) of F + load = f − k q in a region, between the places number `region` − 1 and `region`.
    fn force(&self, region: usize, time: f64) -> (f64, f64) {
        let (mut force, mut stiffness) = (self.constant, self.stiffness);
        let left = region.checked_sub(1).map_or(f64::NEG_INFINITY, |place| self.places[place]);
        for &(place, jump, slope) in self.terms.iter().filter(|(place, ..)| *place <= left) {
            force += jump - slope * place;
            stiffness -= slope;
        }
        force += self.loads.iter().filter(|(from, _)| *from <= time).map(|(_, load)| load).sum::<f64>();
        (force, stiffness)
    }

    /// (q, v) at some times, from one crossing or load to the next.
    fn solve(&self, (mut q, mut v): (f64, f64), times: &[f64]) -> Vec<(f64, f64)> {
        let mut found = Vec::new();
        let mut now = 0.0;
        let mut region = self.places.partition_point(|&place| place <= q);
        while found.len() < times.len() {
            let next_load =
                self.loads.iter().map(|&(time, _)| time).find(|&time| time > now).unwrap_or(f64::INFINITY);
            let (force, stiffness) = self.force(region, now);
            let flow = |after: f64| flow((self.damping, force, stiffness), (q, v), after);
            let low = region.checked_sub(1).map_or(f64::NEG_INFINITY, |place| self.places[place]);
            let high = self.places.get(region).copied().unwrap_or(f64::INFINITY);
            let outside = |after: f64| {
                let q = flow(after).0;
                q < low || q > high
            };
            // Parts of a period, and of what there is of the time.
            let rate = (stiffness.abs().sqrt() + self.damping).max(1.0);
            let part = 0.04 / rate;
            let (mut after, mut crossed) = (0.0, false);
            while !crossed && found.len() < times.len() && after < next_load - now {
                let mut end = (after + part).min(next_load - now);
                if outside(end) {
                    let (mut inner, mut outer) = (after, end);
                    while outer - inner > 1e-16 * (now + outer) {
                        let middle = 0.5 * (inner + outer);
                        if middle <= inner || middle >= outer {
                            break;
                        }
                        if outside(middle) { outer = middle } else { inner = middle }
                    }
                    (end, crossed) = (outer, true);
                }
                while let Some(&time) = times.get(found.len()).filter(|&&time| time <= now + end) {
                    found.push(flow(time - now));
                }
                after = end;
            }
            let (place, velocity) = flow(after);
            now = if crossed { now + after } else { next_load };
            (q, v) = (place, velocity);
            if crossed {
                let up = v > 0.0;
                q = if up { high } else { low };
                region = if up { region + 1 } else { region - 1 };
            }
        }
        found
    }
}

/// The motion of q̈ + c q̇ + k q = f in closed form.
fn flow((damping, force, stiffness): (f64, f64, f64), (q, v): (f64, f64), after: f64) -> (f64, f64) {
    // k > 0 in all of these systems.
    let (half, rest) = (0.5 * damping, force / stiffness);
    let (x, fading) = (q - rest, (-half * after).exp());
    let square = stiffness - half * half;
    let root = square.abs().sqrt();
    let (cosine, sine) = match square {
        square if square > 0.0 => ((root * after).cos(), (root * after).sin() / root),
        _ => ((root * after).cosh(), (root * after).sinh() / root),
    };
    let w = v + half * x;
    let moved = fading * (x * cosine + w * sine);
    (rest + moved, -half * moved + fading * (w * cosine - square * x * sine))
}

#[test]
fn the_closed_form_goes_from_place_to_place() {
    // 4 (1 − cos t) up to a wall at 4, where it is at speed 4: and back.
    let mut wall = Piecewise { stiffness: 1.0, constant: 4.0, ..Piecewise::default() };
    wall.turn(4.0, 0.0, -99.0);
    let half = std::f64::consts::PI;
    let states =
        wall.solve((0.0, 0.0), &[1.0, 0.5 * half, 0.5 * half + 0.05 * half, 0.5 * half + 0.1 * half]);
    assert!((states[0].0 - 4.0 * (1.0 - 1.0_f64.cos())).abs() < 1e-13);
    assert!((states[1].1 - 4.0).abs() < 1e-13);
    assert!((states[2].0 - 4.4).abs() < 1e-13 && states[2].1.abs() < 1e-12, "{states:?}");
    assert!((states[3].0 - 4.0).abs() < 1e-12 && (states[3].1 + 4.0).abs() < 1e-12, "{states:?}");
}

/// 500 random systems, or those of the seed in FVI_SEED.
#[test]
fn random_piecewise_systems_keep_the_tolerance_or_say_why_not() {
    let seed: Option<u64> = std::env::var("FVI_SEED").ok().and_then(|seed| seed.parse().ok());
    let mut dice = Dice(seed.unwrap_or(0x5eed).max(1));
    let (mut refused, mut worst) = (0, 0.0_f64);
    for case in 0..500 {
        let system = Piecewise::random(&mut dice);
        let (q, v) = (dice.between(-1.5, 1.5), dice.between(-1.0, 1.0));
        let tolerance = 10.0_f64.powf(dice.between(-9.0, -4.0));
        let end = dice.between(2.0, 12.0);
        let (scheme, convolution) = schemes()[case % 4].clone();
        let mut scenario =
            system.scenario(q, v, json!({ "grid": "adaptive", "end": end, "tolerance": tolerance }));
        (scenario["scheme"], scenario["convolution"]) = (scheme, convolution);
        let (summary, rows) = rows(&scenario, Precision::F64);
        if let RunEnd::Failed { reason, .. } = &summary.end {
            refused += 1;
            eprintln!("case {case}: {reason}: {scenario}");
            continue;
        }
        assert_eq!(summary.end, RunEnd::Completed);
        let times: Vec<f64> = rows.iter().map(|row| row[0]).collect();
        let exact = system.solve((q, v), &times);
        // How far motions come apart that begin beside it: what the errors of many steps may become.
        let size = rows.iter().flat_map(|row| [row[1].abs(), row[2].abs()]).fold(1.0, max_or_nan);
        let near = tolerance.max(1e-8) * size;
        let beside: Vec<_> = [(near, 0.0), (0.0, near)]
            .into_iter()
            .map(|(dq, dv)| system.solve((q + dq, v + dv), &times))
            .collect();
        let apart = |one: (f64, f64), other: (f64, f64)| [(one.0 - other.0).abs(), (one.1 - other.1).abs()];
        let mut growth = [1.0_f64; 2];
        for (index, row) in rows.iter().enumerate() {
            for other in &beside {
                let distance = apart(exact[index], other[index]);
                growth = [0, 1].map(|part| growth[part].max(distance[part] / near));
            }
            let error = apart(exact[index], (row[1], row[2]));
            for part in 0..2 {
                let share = error[part] / (tolerance * size * growth[part] * rows.len().max(100) as f64);
                worst = max_or_nan(worst, share);
                assert!(
                    share < 0.1,
                    "case {case}: error {:e} of {} at t = {}, tolerance {tolerance:e}, growth {growth:?}, {} rows: {scenario}",
                    error[part],
                    ["q", "p"][part],
                    row[0],
                    rows.len()
                );
            }
        }
    }
    eprintln!("worst share {worst:.3}, {refused} refused");
    assert!(refused <= 5, "{refused} of 500 are refused");
}

/// q̈ = −q − k max(q − ½, 0) from rest at −1.5, over 30 units of time. What is late by 12 tolerances at a
/// wall
/// that turns it round within π/√k has momenta √k times as far off meanwhile.
#[test]
fn walls_of_any_stiffness_shift_positions_and_energies_by_some_tolerances() {
    for stiffness in [1e2, 1e4, 1e6] {
        for as_element in [false, true] {
            let mut wall = Piecewise { stiffness: 1.0, ..Piecewise::default() };
            wall.turn(0.5, 0.0, -stiffness);
            wall.potential.push("0.5*q0^2".to_owned());
            let potential = format!("0.5*{stiffness}*max(q0 - 0.5, 0)^2");
            let places = if as_element { &mut wall.elements } else { &mut wall.potential };
            places.push(if as_element { potential.replace("q0", "x0") } else { potential });
            let tolerance = 1e-8;
            let time = json!({ "grid": "adaptive", "end": 30.0, "tolerance": tolerance });
            let mut scenario = wall.scenario(-1.5, 0.0, time);
            scenario["convolution"] = radau(3);
            let (summary, rows) = rows(&scenario, Precision::F64);
            assert_eq!(summary.end, RunEnd::Completed);
            let times: Vec<f64> = rows.iter().map(|row| row[0]).collect();
            let exact = wall.solve((-1.5, 0.0), &times);
            let most = |errors: &mut dyn Iterator<Item = f64>| errors.fold(0.0, max_or_nan) / tolerance;
            let pairs = || rows.iter().zip(&exact);
            let position = most(&mut pairs().map(|(row, (q, _))| (row[1] - q).abs()));
            let momentum = most(&mut pairs().map(|(row, (_, p))| (row[2] - p).abs()));
            let energy = most(&mut rows.iter().map(|row| (row[3] - 1.125).abs()));
            let told =
                format!("stiffness {stiffness:e}: q {position:.0}, p {momentum:.0}, energy {energy:.0}");
            assert!(position < 25.0 && energy < 12.0, "{told}");
            assert!(momentum < 25.0 * stiffness.sqrt(), "{told}");
        }
    }
}

/// The largest error of (q, p) over [0, 8] with equal steps.
fn error_on_equal_steps(system: &Piecewise, scheme: &Value, convolution: Option<Value>, steps: usize) -> f64 {
    let step = 8.0 / steps as f64;
    let mut scenario = system.scenario(1.0, 0.3, json!({ "step": step, "steps": steps }));
    scenario["scheme"] = scheme.clone();
    if let Some(convolution) = convolution {
        scenario["convolution"] = convolution;
    }
    let (summary, rows) = rows(&scenario, Precision::F64);
    assert_eq!(summary.end, RunEnd::Completed);
    let times: Vec<f64> = rows.iter().map(|row| row[0]).collect();
    let exact = system.solve((1.0, 0.3), &times);
    let errors =
        rows.iter().zip(exact).map(|(row, (q, v))| max_or_nan((row[1] - q).abs(), (row[2] - v).abs()));
    errors.fold(0.0, max_or_nan)
}

#[test]
fn equal_steps_have_order_one_with_jumps_and_two_with_kinks() {
    let mut jump = Piecewise { stiffness: 1.0, constant: 1.0, ..Piecewise::default() };
    jump.turn(0.1, -2.0, 0.0);
    jump.potential.push("0.5*q0^2".to_owned());
    jump.force.push("-sign(q0 - 0.1)".to_owned());
    let mut kink = Piecewise { stiffness: 1.0, ..Piecewise::default() };
    kink.turn(0.1, 0.0, -20.0);
    kink.potential.push("0.5*q0^2 + 0.5*20*max(q0 - 0.1, 0)^2".to_owned());
    let schemes = [
        (json!({ "kind": "low-order", "kappa": 0.5 }), None),
        (json!({ "kind": "galerkin", "degree": 2 }), None),
        (json!({ "kind": "galerkin", "degree": 3 }), Some(radau(3))),
        (json!({ "kind": "collocation" }), Some(radau(3))),
    ];
    for (scheme, convolution) in schemes {
        for (system, order) in [(&jump, 1), (&kink, 2)] {
            // The constant swings with the places of crossings in their steps: bounds, not ratios.
            for (steps, share) in [(400, 1.0), (1600, 4.0), (6400, 16.0)] {
                let error = error_on_equal_steps(system, &scheme, convolution.clone(), steps);
                let bound = 0.5 / f64::powi(share, order);
                assert!(error < bound, "{scheme}, order {order}, {steps} steps: {error:e}");
            }
        }
    }
    // Jumps are warned of, kinks are not; adaptive steps need no warning.
    let warnings = |system: &Piecewise, time: Value| {
        Scenario::from_value(&system.scenario(1.0, 0.3, time)).unwrap().warnings()
    };
    let equal = json!({ "step": 0.01, "steps": 10 });
    assert!(warnings(&jump, equal.clone())[0].starts_with("system.force: `step` or `sign` of the position"));
    assert!(warnings(&kink, equal).is_empty());
    assert!(warnings(&jump, json!({ "grid": "adaptive", "end": 1.0, "tolerance": 1e-6 })).is_empty());
}

#[test]
fn energy_that_is_gone_without_damping_is_told() {
    // A spring that steps are too long for: collocation lets it fade.
    let fading = |steps: usize, damped: bool| {
        let mut scenario = json!({
            "system": { "mass": [1.0], "potential": "0.5*q0^2 + 0.25*q0^4" },
            "initial": { "position": [1.0], "velocity": [0.0] },
            "scheme": { "kind": "collocation" },
            "time": { "step": 20.0 / steps as f64, "steps": steps },
        });
        if damped {
            scenario["system"]["damping"] = json!([{ "order": 0.5, "coefficient": [0.3] }]);
        }
        rows(&scenario, Precision::F64).0.warnings
    };
    assert!(fading(12, false)[0].contains("though nothing damps"), "{:?}", fading(12, false));
    assert!(fading(2000, false).is_empty() && fading(12, true).is_empty());
    // What falls into a well and swings there has lost nothing.
    let well = scenario(json!({ "potential": "10*q0^4 - 10*q0^2" }), 0.01, 20.0, 1e-8);
    assert!(rows(&well, Precision::F64).0.warnings.is_empty());
}
