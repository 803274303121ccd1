//! Every scenario in the repository does what its comment says.

use crate::workplace::{Run, Workplace, text};
use fvi_core::min_or_nan;
use fvi_fft::sums::max_or_nan;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::Precision;
use fvi_simulation::simulation::motion::Motion;
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/scenarios")
}

fn run(name: &str) -> Run {
    let place = Workplace::new();
    let scenario = folder().join(name).with_extension("toml");
    let output = place.fvi(&["run", scenario.to_str().unwrap(), "--out", "out"]);
    assert!(output.status.success(), "{name}: {}", text(&output.stderr));
    Run::read(&place.path("out"))
}

/// A scenario that runs too long for a test, with something in its file replaced.
fn shortened(name: &str, long: &str, short: &str) -> Run {
    let place = Workplace::new();
    let scenario = std::fs::read_to_string(folder().join(name).with_extension("toml")).unwrap();
    assert!(scenario.contains(long), "{name}");
    place.write("short.toml", &scenario.replace(long, short));
    let output = place.fvi(&["run", "short.toml", "--out", "out"]);
    assert!(output.status.success(), "{name}: {}", text(&output.stderr));
    Run::read(&place.path("out"))
}

fn largest_error(run: &Run, of: &str) -> f64 {
    run.summary["errors"][of]["largest"].as_f64().unwrap()
}

#[test]
fn what_the_package_carries_is_what_the_repository_has() {
    let carried = Path::new(env!("CARGO_MANIFEST_DIR")).join("../research/exhibits/scenarios");
    let mut seen = 0;
    let mut folders = vec![PathBuf::new()];
    while let Some(inside) = folders.pop() {
        for entry in std::fs::read_dir(carried.join(&inside)).unwrap() {
            let name = inside.join(entry.unwrap().file_name());
            if carried.join(&name).is_dir() {
                folders.push(name);
                continue;
            }
            let text = |folder: &Path| std::fs::read(folder.join(&name)).unwrap();
            assert!(
                text(&carried) == text(&folder()),
                "research/exhibits/scenarios/{0} is not examples/scenarios/{0}: copy it",
                name.display()
            );
            seen += 1;
        }
    }
    assert!(seen >= 17, "{seen}");
}

#[test]
fn every_scenario_is_accepted_and_makes_its_first_steps() {
    let mut seen = 0;
    for entry in std::fs::read_dir(folder()).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "toml") {
            continue;
        }
        let scenario = Scenario::read(&path).unwrap_or_else(|error| panic!("{error}"));
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap_or_else(|error| panic!("{error}"));
        for step in 0..5 {
            let made = motion.advance();
            assert!(made.is_ok(), "{}, step {step}: {made:?}", path.display());
        }
        let state = motion.state();
        assert!((state.time / scenario.time.time(5) - 1.0).abs() < 1e-12 && state.energy.is_finite());
        seen += 1;
    }
    assert!(seen >= 12, "{seen} scenarios");
}

#[test]
fn van_der_pols_oscillator_reaches_its_cycle_on_adaptive_steps_too() {
    let cycle = run("van-der-pol");
    let largest =
        |run: &Run| run.rows.iter().filter(|row| row[0] > 40.0).map(|row| row[1].abs()).fold(0.0, max_or_nan);
    assert!((1.8..2.1).contains(&largest(&cycle)) && cycle.rows[0][1] == 0.01, "{}", largest(&cycle));
    // The same cycle by other means.
    let step = "step = 0.02\nend = 60.0";
    let adaptive = "grid = \"adaptive\"\ntolerance = 1e-6\nend = 60.0";
    let place = Workplace::new();
    let scenario = std::fs::read_to_string(folder().join("van-der-pol.toml")).unwrap();
    let scheme = "kind = \"low-order\"\nkappa = 0.5\n\n[convolution]\norder = 2";
    assert!(scenario.contains(step) && scenario.contains(scheme));
    let stages = "kind = \"collocation\"\n\n[convolution]\nfamily = \"radau-iia\"\nstages = 3";
    place.write("adaptive.toml", &scenario.replace(step, adaptive).replace(scheme, stages));
    let output = place.fvi(&["run", "adaptive.toml", "--out", "out"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let other = Run::read(&place.path("out"));
    assert!((largest(&other) - largest(&cycle)).abs() < 2e-2, "{} {}", largest(&other), largest(&cycle));
}

#[test]
fn the_pulse_driven_plate_agrees_with_the_exact_solution() {
    let run = run("bagley-torvik-pulse");
    assert_eq!(run.rows.len(), 3001);
    assert_eq!(run.summary["errors"]["position"]["compared"], 28);
    // Second order: 1.5e-4 at h = 0.01 on a solution of 4.5. The momentum is of first order.
    assert!(largest_error(&run, "position") < 2e-4);
    assert!(largest_error(&run, "momentum") < 2e-2);
}

#[test]
fn graded_and_growing_steps_keep_their_digits() {
    let root = run("bagley-torvik-root-graded");
    assert_eq!(root.rows.len(), 161);
    assert!(largest_error(&root, "position") < 1.5e-11 && largest_error(&root, "momentum") < 2.5e-11);
    let creep = run("creep-seventeen-decades");
    assert!(creep.rows.len() <= 401 && creep.rows.last().unwrap()[0] == 1e8);
    assert_eq!(creep.summary["errors"]["position"]["compared"], 15);
    assert!(largest_error(&creep, "position") < 2e-8);
}

#[test]
fn the_plate_damped_at_the_nodes_gives_nine_digits_of_the_position() {
    let run = run("bagley-torvik-pulse-nodes");
    assert_eq!(run.rows.len(), 6001);
    assert!(largest_error(&run, "position") < 4e-9);
    assert!(largest_error(&run, "momentum") < 2e-8);
}

#[test]
fn six_hundred_steps_with_radau_quadrature_give_eight_digits_of_the_position() {
    let run = run("bagley-torvik-pulse-radau");
    assert_eq!(run.rows.len(), 601);
    assert!(largest_error(&run, "position") < 1e-8);
    assert!(largest_error(&run, "momentum") < 2e-6);
}

#[test]
fn the_exact_solutions_of_the_bagley_torvik_equation_are_met() {
    let cubic = run("bagley-torvik-cubic");
    assert!(largest_error(&cubic, "position") < 1e-5);
    let root = run("bagley-torvik-root");
    assert!(largest_error(&root, "position") < 5e-5);
}

#[test]
fn the_variational_integrator_is_closer_than_both_euler_methods() {
    let variational = run("damped-oscillator-jo");
    let implicit = run("damped-oscillator-jo-implicit-euler");
    let explicit = run("damped-oscillator-jo-explicit-euler");
    assert!(largest_error(&variational, "position") < 0.03);
    // The explicit method even has half the step.
    for baseline in [&implicit, &explicit] {
        assert!(largest_error(baseline, "position") > 10.0 * largest_error(&variational, "position"));
    }
    let (gains, loses) = (explicit.column("energy"), implicit.column("energy"));
    let exact = |t: f64| 0.625 * (-0.2 * t).exp();
    assert!(gains[300] > 5.0 * exact(30.0) && loses[150] < 0.2 * exact(30.0));
}

#[test]
fn the_oscillator_with_a_quadrature_of_second_order_is_accurate() {
    assert!(largest_error(&run("damped-oscillator-hjo"), "position") < 6e-3);
}

#[test]
fn damping_at_the_nodes_gives_nine_digits_of_the_position_with_32_steps_a_unit() {
    let run = run("damped-oscillator-nodes");
    assert_eq!(run.summary["errors"]["position"]["compared"], 7);
    assert!(largest_error(&run, "position") < 1e-9);
    assert!(largest_error(&run, "momentum") < 5e-8);
}

#[test]
fn the_pendulum_comes_to_rest_slowly_below_its_first_height() {
    let run = run("pendulum");
    let angle = run.column("q0");
    assert_eq!(angle[0], 2.0);
    assert!(angle.iter().all(|angle| angle.abs() <= 2.0));
    let late = angle[3000..].iter().fold(0.0_f64, |largest, angle| max_or_nan(largest, angle.abs()));
    assert!(late > 0.02 && late < 0.5, "{late}");
}

#[test]
fn the_pendulum_of_ten_million_steps_swings_on_in_twenty_kilobytes() {
    let run = shortened("pendulum-ten-million", "steps = 10_000_000", "steps = 100_000");
    assert_eq!(run.summary["engine"][0], "exponential-sum");
    assert!(run.summary["memory_bytes"].as_u64().unwrap() < 20_000);
    assert_eq!(run.rows.len(), 51);
    // The energy falls slowly: each time it is looked at there is less.
    let energy = run.column("energy");
    assert!(energy.windows(2).all(|pair| pair[1] < pair[0]), "{energy:?}");
    assert!(energy[50] > 0.9 * energy[0]);
}

#[test]
fn the_coupled_masses_follow_their_drive_in_the_end() {
    let run = run("coupled-masses");
    assert_eq!(run.columns, ["t", "q0", "q1", "p0", "p1", "energy"]);
    // The start dies out; the drive, of period 2π/1.3, keeps both masses going.
    let swing = |name: &str| {
        let late = &run.column(name)[1700..];
        late.iter().fold(f64::MIN, |a, &b| max_or_nan(a, b)) - late.iter().copied().fold(f64::MAX, min_or_nan)
    };
    assert!((0.2..1.0).contains(&swing("q0")) && (0.2..1.0).contains(&swing("q1")));
}

#[test]
fn the_stage_moves_with_its_drive_and_returns() {
    let run = run("viscoelastic-stage");
    let position = run.column("q0");
    let farthest = position.iter().fold(0.0_f64, |largest, q| max_or_nan(largest, q.abs()));
    // 2 N against 40 N/m and the mounts.
    assert!(farthest > 0.05 && farthest < 0.15, "{farthest}");
    assert!(position[3000].abs() < 0.1 * farthest);
}

#[test]
fn the_stage_in_a_loop_goes_where_it_is_told() {
    let run = run("controlled-stage");
    let (position, output) = (run.column("q0"), run.column("u"));
    // 3.5 s after each setpoint, to a tenth of the way.
    assert!((position[2000] - 0.1).abs() < 0.01 && (position[3750] - 0.04).abs() < 0.006);
    assert!(output.iter().all(|u| u.abs() <= 8.0));
}

/// Energy and the energies of the dampers make up the start, to the error of the scheme, and the dampers take.
#[test]
fn mechanisms_lose_what_their_dampers_take() {
    let names = [
        ("double-pendulum", 1e-6),
        ("slider-crank", 1e-4),
        ("four-bar", 1e-4),
        ("heavy-top", 1e-8),
        // Of 10 J that turn from height to speed.
        ("cable", 1e-2),
    ];
    for (name, accuracy) in names {
        let run = run(name);
        let [energy, stored, dissipated] =
            ["energy", "memory_stored", "memory_dissipated"].map(|column| run.column(column));
        let largest = energy.iter().fold(1.0, |most, energy| max_or_nan(most, energy.abs()));
        let rows = energy.iter().zip(&stored).zip(&dissipated);
        let off =
            rows.map(|((energy, stored), dissipated)| (energy + stored + dissipated - energy_of(&run)).abs());
        let off = off.fold(0.0, max_or_nan);
        assert!(off < accuracy * largest, "{name}: {off:e} of {largest}");
        let rises = dissipated.windows(2).map(|pair| pair[0] - pair[1]).fold(f64::MIN, max_or_nan);
        assert!(rises < 1e-12 * largest, "{name}: the dampers give back {rises:e}");
        assert!(dissipated.last().unwrap() > &0.0, "{name}");
    }
}

/// The energy of the first row.
fn energy_of(run: &Run) -> f64 {
    run.column("energy")[0]
}

#[test]
fn linkages_and_bodies_keep_their_constraints() {
    let four_bar = run("four-bar");
    let [a, b, c, d] = ["q0", "q1", "q2", "q3"].map(|name| four_bar.column(name));
    for row in 0..a.len() {
        let crank = a[row].hypot(b[row]) - 0.5;
        let rod = (c[row] - a[row]).hypot(d[row] - b[row]) - 1.2;
        let rocker = (c[row] - 1.3).hypot(d[row]) - 1.0;
        for length in [crank, rod, rocker] {
            assert!(length.abs() < 1e-13, "row {row}: {length:e}");
        }
    }
    let top = run("heavy-top");
    let [w, x, y, z] = ["q0", "q1", "q2", "q3"].map(|name| top.column(name));
    for row in 0..w.len() {
        let length = w[row].powi(2) + x[row].powi(2) + y[row].powi(2) + z[row].powi(2);
        assert!((length - 1.0).abs() < 1e-13, "row {row}: {length}");
    }
    // It spins fast enough to stay up.
    let lean = |row: usize| 1.0 - 2.0 * (x[row].powi(2) + y[row].powi(2));
    assert!((0..w.len()).all(|row| lean(row) > 0.7), "{:?}", (0..w.len()).map(lean).fold(1.0, min_or_nan));
}

#[test]
fn the_links_of_the_cable_keep_their_lengths_while_it_falls() {
    let cable = run("cable");
    let places: Vec<_> = (0..100).map(|index| cable.column(&format!("q{index}"))).collect();
    for link in 0..50 {
        let along = |axis: usize, row: usize| match link {
            0 => places[axis][row],
            _ => places[2 * link + axis][row] - places[2 * link + axis - 2][row],
        };
        for row in 0..places[2 * link].len() {
            let length = along(0, row).hypot(along(1, row));
            assert!((length - 0.04).abs() < 1e-13, "row {row}, link {link}: {length}");
        }
    }
    // Its end was 2 m beside the bearing, and is below it after a quarter of a swing.
    let lowest = places[99].iter().fold(0.0, |least, &y| min_or_nan(least, y));
    assert!(lowest < -1.8, "{lowest}");
}

#[test]
fn the_arm_goes_where_its_controllers_are_told() {
    let run = run("robot-arm");
    let (shoulder, upper) = (run.column("q0"), run.column("q1"));
    let end = shoulder.len() - 1;
    let told = -std::f64::consts::FRAC_PI_2 + 1.2;
    assert!((shoulder[end] - told).abs() < 3e-3, "{}", shoulder[end]);
    assert!((upper[end] - shoulder[end] - 0.9).abs() < 3e-3, "{}", upper[end] - shoulder[end]);
    assert!(run.column("u0").iter().all(|torque| torque.abs() <= 40.0));
}
