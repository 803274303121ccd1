//! Runs agree with an independent implementation of the scheme, in 40-digit arithmetic, to 10⁻¹¹ of each
//! column's largest value: see `dense_bdf.py` and `dense_galerkin.py` in `tests/reference`.

use crate::workplace::Workplace;
use fvi_fft::sums::max_or_nan;

fn agrees(name: &str, scenario: &str) {
    let path = format!("{}/../tests/reference/trajectory_{name}.csv", env!("CARGO_MANIFEST_DIR"));
    let table = std::fs::read_to_string(path).unwrap();
    let scenario = format!("{scenario}\n[output]\nmomentum = \"one-sided\"\n");
    let run = Workplace::new().run(&scenario, &[]);
    let mut lines = table.lines();
    let columns: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect();
    assert_eq!(run.rows.len(), rows.len());
    for (index, column) in columns.iter().enumerate() {
        let largest = rows.iter().fold(0.0_f64, |largest, row| max_or_nan(largest, row[index].abs()));
        let found = run.column(column);
        let error =
            found.iter().zip(&rows).map(|(found, row)| (found - row[index]).abs()).fold(0.0, max_or_nan);
        assert!(
            error <= 1e-11 * largest,
            "{name}: {column} differs by {error}, its largest value is {largest}"
        );
    }
}

#[test]
fn a_pendulum_with_caputo_memory() {
    agrees(
        "pendulum",
        r#"
        [system]
        mass = [1.5]
        potential = "-9.81*cos(q0)"
        [[system.damping]]
        order = 0.5
        coefficient = [0.4]
        [initial]
        position = [2.0]
        momentum = [0.3]
        [convolution]
        family = "bdf"
        order = 2
        at = "main-nodes"
        [time]
        step = 0.05
        steps = 200
        "#,
    );
}

#[test]
fn two_coupled_coordinates_with_dense_matrices_two_terms_and_a_force_in_time_and_position() {
    agrees(
        "coupled",
        r#"
        [system]
        mass = [[2.0, 0.5], [0.5, 1.0]]
        potential = "1.5*q0^2 + 0.25*q0^4 + q1^2 - cos(q0 - q1)"
        force = ["cos(2*t) - q1/4", "t*q0/8"]
        [[system.damping]]
        order = 0.75
        coefficient = [[0.5, 0.25], [0.25, 0.5]]
        derivative = "riemann-liouville"
        [[system.damping]]
        order = 1.5
        coefficient = [[0.25, 0], [0, 0.125]]
        derivative = "caputo"
        [initial]
        position = [0.5, -0.25]
        momentum = [0.125, 1.0]
        [scheme]
        kind = "low-order"
        kappa = 0.3125
        [convolution]
        family = "bdf"
        order = 3
        at = "main-nodes"
        [time]
        step = 0.03125
        steps = 160
        "#,
    );
}

#[test]
fn a_high_order_of_quadrature_and_a_potential_at_the_beginning_of_the_step() {
    agrees(
        "steep_first",
        r#"
        [system]
        mass = [1]
        potential = "0.5*q0^2 + 0.25*q0^4"
        force = ["sin(3*t) - q0^2/8"]
        [[system.damping]]
        order = 1.875
        coefficient = [0.0078125]
        [initial]
        position = [1]
        momentum = [-0.5]
        [scheme]
        kind = "low-order"
        kappa = 1
        [convolution]
        family = "bdf"
        order = 6
        at = "main-nodes"
        [time]
        step = 0.015625
        end = 2
        "#,
    );
}

#[test]
fn three_terms_of_order_zero_one_and_between_and_a_potential_at_the_end_of_the_step() {
    agrees(
        "steep_last",
        r#"
        [system]
        mass = [1]
        potential = "0.5*q0^2 + 0.25*q0^4"
        force = ["sin(3*t) - q0^2/8"]
        [[system.damping]]
        order = 1.25
        coefficient = [0.0625]
        derivative = "riemann-liouville"
        [[system.damping]]
        order = 0
        coefficient = [0.5]
        [[system.damping]]
        order = 1
        coefficient = [0.25]
        [initial]
        position = [1]
        momentum = [-0.5]
        [scheme]
        kind = "low-order"
        kappa = 0
        [convolution]
        family = "bdf"
        order = 5
        at = "main-nodes"
        [time]
        step = 0.015625
        end = 2
        "#,
    );
}

const PENDULUM: &str = r#"
    [system]
    mass = [1.5]
    potential = "-9.75*cos(q0)"
    [[system.damping]]
    order = 0.5
    coefficient = [0.375]
    [initial]
    position = [2.0]
    momentum = [0.3]
"#;

const COUPLED: &str = r#"
    [system]
    mass = [[2.0, 0.5], [0.5, 1.0]]
    potential = "1.5*q0^2 + 0.25*q0^4 + q1^2 - cos(q0 - q1)"
    force = ["cos(2*t) - q1/4", "t*q0/8"]
    [[system.damping]]
    order = 0.75
    coefficient = [[0.5, 0.25], [0.25, 0.5]]
    derivative = "riemann-liouville"
    [[system.damping]]
    order = 1.5
    coefficient = [0.25, 0.125]
    [initial]
    position = [0.5, -0.25]
    momentum = [0.125, 1.0]
"#;

fn galerkin(system: &str, scheme: &str, convolution: &str, step: f64, steps: usize) -> String {
    format!(
        "{system}\n[scheme]\nkind = \"galerkin\"\n{scheme}\n[convolution]\n{convolution}\n\
         [time]\nstep = {step}\nsteps = {steps}\n"
    )
}

#[test]
fn galerkin_schemes_with_gauss_and_lobatto_quadrature() {
    let bdf = |order: usize| format!("family = \"bdf\"\norder = {order}\nat = \"main-nodes\"");
    agrees("galerkin_pendulum", &galerkin(PENDULUM, "degree = 2", &bdf(2), 0.0625, 120));
    let lobatto = "degree = 3\nquadrature = \"lobatto\"\npoints = 4";
    agrees("galerkin_coupled", &galerkin(COUPLED, lobatto, &bdf(3), 0.0625, 60));
    let weak = PENDULUM.replace("[0.375]", "[0.0078125]\nderivative = \"riemann-liouville\"");
    let weak = weak.replace("order = 0.5", "order = 1.25");
    agrees("galerkin_high", &galerkin(&weak, "degree = 6", &bdf(6), 0.125, 40));
}

#[test]
fn runge_kutta_quadrature_at_the_stages() {
    let radau = |stages: usize| format!("family = \"radau-iia\"\nstages = {stages}");
    let lobatto = |stages: usize| format!("family = \"lobatto-iiic\"\nstages = {stages}");
    agrees("radau_pendulum", &galerkin(PENDULUM, "degree = 3", &radau(3), 0.125, 60));
    agrees("radau_coupled", &galerkin(COUPLED, "degree = 2", &radau(2), 0.125, 40));
    agrees("lobatto_coupled", &galerkin(COUPLED, "degree = 2", &lobatto(3), 0.125, 40));
    let steep = r#"
        [system]
        mass = [1]
        potential = "0.5*q0^2 + 0.25*q0^4"
        force = ["sin(3*t) - q0^2/8"]
        [[system.damping]]
        order = 1.875
        coefficient = [0.5]
        [[system.damping]]
        order = 1
        coefficient = [0.25]
        [[system.damping]]
        order = 0
        coefficient = [0.5]
        [initial]
        position = [1]
        momentum = [-0.5]
    "#;
    agrees("lobatto_steep", &galerkin(steep, "degree = 3", &lobatto(4), 0.125, 40));
}
