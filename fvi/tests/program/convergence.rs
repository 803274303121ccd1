//! `fvi converge`: errors and orders; starting weights.

use crate::workplace::{Workplace, text};
use fvi_fft::sums::max_or_nan;
use std::fs;
use std::process::Output;

/// t^{5/2} solves it exactly; BDF 1 alone has order 1.
fn root_scenario(convolution: &str) -> String {
    format!(
        r#"
        [system]
        mass = [1.0]
        potential = "0.5*q0^2"
        force = ["15/4*sqrt(t) + 15/8*sqrt(pi)*t + t^2.5"]
        force_quadrature = "nodes"
        [[system.damping]]
        order = 1.5
        coefficient = [1.0]
        derivative = "riemann-liouville"
        [initial]
        position = [0.0]
        momentum = [0.0]
        [scheme]
        kind = "low-order"
        kappa = 0.5
        [convolution]
        family = "bdf"
        order = 1
        at = "main-nodes"
        {convolution}
        [time]
        step = 0.125
        end = 1.0
        [reference]
        position = ["t^2.5"]
        "#
    )
}

fn converge(place: &Workplace, scenario: &str, levels: &str) -> Output {
    place.write("scenario.toml", scenario);
    place.fvi(&["converge", "scenario.toml", "--levels", levels, "--out", "out"])
}

/// Cells of a column of `convergence.csv`.
fn column(place: &Workplace, name: &str) -> Vec<String> {
    let table = fs::read_to_string(place.path("out").join("convergence.csv")).unwrap();
    let mut lines = table.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let header = lines.next().unwrap();
    let at = header.iter().position(|cell| cell == name).unwrap_or_else(|| panic!("{name} in {header:?}"));
    lines.map(|cells| cells[at].clone()).collect()
}

fn numbers(place: &Workplace, name: &str) -> Vec<f64> {
    column(place, name).iter().filter_map(|cell| cell.parse().ok()).collect()
}

#[test]
fn a_run_without_steps_is_refused_by_its_end() {
    let place = Workplace::new();
    let output = converge(&place, &root_scenario("").replace("end = 1.0", "end = 0.0"), "3..4");
    assert_eq!(output.status.code(), Some(2));
    let said = text(&output.stderr);
    assert!(said.contains("time.end = 0.0") && said.contains("an end after the start is needed"), "{said}");
    assert!(!place.path("out").exists());
}

#[test]
fn errors_orders_and_a_picture_against_the_reference_and_a_finer_run() {
    let place = Workplace::new();
    let output = converge(&place, &root_scenario(""), "4..8");
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_eq!(numbers(&place, "steps"), [16.0, 32.0, 64.0, 128.0, 256.0]);
    let orders = numbers(&place, "position_order");
    assert_eq!(orders.len(), 4);
    assert!(orders.iter().all(|order| (order - 1.0).abs() < 0.1), "{orders:?}");
    // The reference says nothing about the energy.
    let energy = numbers(&place, "energy_order");
    assert!(energy.iter().all(|order| (order - 1.0).abs() < 0.3), "{energy:?}");
    assert!(text(&output.stdout).contains("energy against a run of 1024 steps"));
    let picture = fs::read_to_string(place.path("out").join("convergence.svg")).unwrap();
    assert!(picture.contains("position (slope 1.0") && picture.contains("step size h"), "{picture}");
}

#[test]
fn starting_weights_take_away_the_error_of_the_quadrature() {
    // t² with damping of order ½: BDF 1 has order 1, exact derivatives leave the order 2 of the midpoint
    // rule.
    let square = |convolution: &str| {
        root_scenario(convolution)
            .replace("15/4*sqrt(t) + 15/8*sqrt(pi)*t + t^2.5", "2 + t^2 + 2/gamma(2.5)*t^1.5")
            .replace("order = 1.5", "order = 0.5")
            .replace("\"t^2.5\"", "\"t^2\"")
    };
    let place = Workplace::new();
    converge(&place, &square(""), "4..8");
    let plain = numbers(&place, "position_error");
    let orders = numbers(&place, "position_order");
    assert!(orders.iter().all(|order| (order - 1.0).abs() < 0.2), "{orders:?}");
    let corrected = square("starting = [2.0]");
    // The weights of t² grow, which does no harm to a solution that is t².
    let output = converge(&place, &corrected, "4..8");
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("exponents up to 1.5"), "{}", text(&output.stderr));
    let output = converge(&place, &corrected.replace("[time]", "[time]\nallow_unstable = true"), "4..8");
    assert!(text(&output.stderr).contains("warning: convolution.starting"), "{}", text(&output.stderr));
    let corrected = numbers(&place, "position_error");
    assert!(corrected[4] < 0.05 * plain[4], "{corrected:?} and {plain:?}");
    let orders = numbers(&place, "position_order");
    assert!(orders.iter().all(|order| (order - 2.0).abs() < 0.2), "{orders:?}");
}

#[test]
fn starting_weights_are_no_better_than_the_first_step() {
    // The midpoint rule takes the first step under a force like √t with an error of a third, at every step
    // size: the coefficient of t^{5/2} is wrong by as much, and the order stays that of BDF 1.
    let place = Workplace::new();
    converge(&place, &root_scenario(""), "4..8");
    let plain = numbers(&place, "position_error");
    converge(&place, &root_scenario("starting = [2.5]"), "4..8");
    let corrected = numbers(&place, "position_error");
    assert!(corrected[4] < 0.4 * plain[4], "{corrected:?} and {plain:?}");
    let orders = numbers(&place, "position_order");
    assert!(orders.iter().all(|order| (order - 1.0).abs() < 0.1), "{orders:?}");
}

#[test]
fn a_warning_says_that_starting_weights_are_ill_determined() {
    let place = Workplace::new();
    let exponents = "starting = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]";
    let output = converge(&place, &root_scenario(exponents), "4..4");
    let warning = text(&output.stderr);
    assert!(warning.contains("warning: convolution.starting") && warning.contains("condition"), "{warning}");
    let output = converge(&place, &root_scenario("starting = [1.5, 2.5]"), "4..4");
    assert_eq!(text(&output.stderr), "");
    let run = place.run(&root_scenario("starting = [1.5, 2.5]"), &[]);
    assert!(run.summary["starting_condition"].as_f64().unwrap() < 100.0);
}

#[test]
fn levels_that_are_too_coarse_are_listed_and_the_others_measured() {
    let place = Workplace::new();
    let scenario = root_scenario("").replace("order = 1\n", "order = 4\n");
    let output = converge(&place, &scenario, "1..9");
    assert!(output.status.success(), "{}", text(&output.stderr));
    let failures = column(&place, "failure");
    assert!(failures[0].contains("unstable") && failures[8].is_empty(), "{failures:?}");
    assert_eq!(column(&place, "position_error")[0], "");
    assert!(numbers(&place, "position_order").len() >= 2);
}

#[test]
fn levels_that_make_no_sense_are_bad_input() {
    let place = Workplace::new();
    for levels in ["8..4", "4", "4..99", "a..b"] {
        assert_eq!(converge(&place, &root_scenario(""), levels).status.code(), Some(2), "{levels}");
    }
    assert!(!place.path("out").exists());
}

#[test]
fn errors_next_to_a_singular_start_need_not_count() {
    let place = Workplace::new();
    place.write(
        "released.toml",
        r#"
        [system]
        mass = [1.0]
        potential = "0.5*q0^2"
        [[system.damping]]
        order = 0.7
        coefficient = [0.5]
        [initial]
        position = [1.0]
        momentum = [0.0]
        [scheme]
        kind = "galerkin"
        degree = 2
        [convolution]
        family = "bdf"
        order = 4
        [time]
        step = 0.125
        end = 4.0
        "#,
    );
    let orders = |from: &str| {
        let output =
            place.fvi(&["converge", "released.toml", "--levels", "6..8", "--from", from, "--out", "out"]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        ["position_order", "momentum_order", "energy_order"]
            .map(|name| *numbers(&place, name).last().unwrap())
    };
    // The force is not smooth there, so that the momentum suffers first.
    assert!(orders("0")[1] < 2.5);
    let orders = orders("1");
    assert!(orders.iter().all(|order| (order - 4.0).abs() < 0.2), "{orders:?}");
    for from in ["-1", "4.5", "nan"] {
        let from = format!("--from={from}");
        let output = place.fvi(&["converge", "released.toml", &from, "--out", "none"]);
        assert_eq!(output.status.code(), Some(2), "{from}");
        assert!(text(&output.stderr).contains("from"), "{}", text(&output.stderr));
    }
}

#[test]
fn momenta_have_the_order_of_positions_under_the_singular_force_of_a_start() {
    let place = Workplace::new();
    // A damper between two masses, and a second one that resists the first in Caputo's sense.
    let scenario = |damping: &str, momentum: &str| {
        format!(
            r#"
            [system]
            mass = [1.0, 2.0]
            potential = "0.5*q0^2 + 0.25*(q1 - q0)^2"
            [[system.damping]]
            order = 0.6
            {damping}
            derivative = "riemann-liouville"
            [[system.damping]]
            order = 0.3
            coefficient = [0.2, 0.0]
            [initial]
            position = [1.0, -0.5]
            momentum = [0.0, 0.0]
            [scheme]
            kind = "galerkin"
            degree = 2
            [convolution]
            family = "bdf"
            order = 4
            [time]
            step = 0.125
            end = 4.0
            [output]
            momentum = "{momentum}"
            "#
        )
    };
    let rows = "coefficient = [[0.5, -0.5], [-0.5, 0.5]]";
    let attached = "attached = [[1.0], [-1.0]]\nstrength = [0.5]";
    for (damping, momentum, expected) in
        [(rows, "mean", 4.0), (attached, "mean", 4.0), (rows, "one-sided", 2.0)]
    {
        place.write("dampers.toml", &scenario(damping, momentum));
        let output =
            place.fvi(&["converge", "dampers.toml", "--levels", "7..9", "--from", "1", "--out", "out"]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        for name in ["momentum_order", "energy_order"] {
            let order = *numbers(&place, name).last().unwrap();
            assert!((order - expected).abs() < 0.2, "{damping}, {momentum}: {name} {order}");
        }
        assert!((numbers(&place, "position_order").last().unwrap() - 4.0).abs() < 0.2);
    }
}

#[test]
fn known_values_that_no_level_meets_are_bad_input() {
    let place = Workplace::new();
    place.write("known.csv", "t,q0\n0.3,1\n");
    let scenario = root_scenario("").replace("position = [\"t^2.5\"]", "file = \"known.csv\"");
    let scenario = scenario.replace("step = 0.125", "step = 0.1");
    let output = converge(&place, &scenario, "4..6");
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    assert!(
        text(&output.stderr).contains("does not go together with `--levels`"),
        "{}",
        text(&output.stderr)
    );
}

#[test]
fn exact_moments_keep_the_order_that_a_root_costs_the_nodes() {
    // The largest error over all times of q'' + D^{3/2} q + q = f with the solution t^(5/2) and others, Radau
    // IIA of order five.
    let error = |place: &Workplace, nu: f64, quadrature: &str| {
        let text = format!(
            r#"
            [system]
            mass = [1.0]
            potential = "0.5*q0^2"
            force = ["nu*(nu - 1)*t^(nu - 2) + 0.7*gamma(nu + 1)/gamma(nu - 1/2)*t^(nu - 3/2) + t^nu"]
            force_quadrature = "{quadrature}"
            parameters = {{ nu = {nu:?} }}
            [[system.damping]]
            order = 1.5
            coefficient = [0.7]
            derivative = "riemann-liouville"
            [initial]
            position = [0.0]
            momentum = [0.0]
            [scheme]
            kind = "galerkin"
            degree = 3
            [convolution]
            family = "radau-iia"
            stages = 3
            [time]
            step = 0.00390625
            end = 1.0
            "#
        );
        place.write("root.toml", &text);
        let output = place.fvi(&["run", "root.toml", "--out", "out", "--quiet"]);
        assert!(output.status.success(), "{}", self::text(&output.stderr));
        let rows = fs::read_to_string(place.path("out").join("trajectory.csv")).unwrap();
        let mut worst = 0.0_f64;
        for row in rows.lines().skip(1) {
            let numbers: Vec<f64> = row.split(',').map(|cell| cell.parse().unwrap()).collect();
            worst = max_or_nan(worst, (numbers[1] - numbers[0].powf(nu)).abs());
        }
        worst
    };
    let place = Workplace::new();
    let (exact, nodal) = (error(&place, 2.5, "moments"), error(&place, 2.5, "nodes"));
    assert!(exact < 3e-11 && nodal > 1e-7, "{exact:e} and {nodal:e}");
}
