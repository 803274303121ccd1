//! `fvi tune` on plants without a time of their own, that fall more slowly than 1/s, or with a direct path,
//! by closed forms of their sampled responses.

use crate::tune::{Complex, number, tune};
use crate::workplace::{Workplace, text};
use std::f64::consts::PI;

fn problem(plant: &str, controller: &str, specification: &str) -> String {
    format!("[plant]\ntransfer = \"{plant}\"\n[controller]\n{controller}\n[specification]\n{specification}\n")
}

/// K_i h²·K of a PI for an integrator K/s is the same for all samples h, and so is K_p h·K.
#[test]
fn an_integrator_is_tuned_alike_in_every_unit_of_time() {
    for sample in [2.0, 1e4, 1e7] {
        let place = Workplace::new();
        let record = tune(
            &place,
            &problem("0.001/s", &format!("structure = \"pi\"\nsample = {sample:?}"), "ms = 1.4"),
        );
        let [kp, ki] = ["kp", "ki"].map(|key| number(&record, key));
        let scaled = [kp * 1e-3 * sample, ki * 1e-3 * sample * sample];
        assert!((scaled[0] - 0.463).abs() < 2e-3 && (scaled[1] - 0.177).abs() < 2e-3, "{sample}: {scaled:?}");
    }
}

/// |1 + k s^{−3/2}| comes down to sin 45°, so that Ms ≥ 1.414 for any gain; an integral term adds to it.
#[test]
fn a_bound_that_no_gain_keeps_is_refused_whatever_the_unit_of_time() {
    for sample in [0.1, 1e3] {
        let place = Workplace::new();
        let controller = format!("structure = \"pi\"\nsample = {sample:?}");
        place.write("plant.toml", &problem("1/s^1.5", &controller, "ms = 1.4"));
        let output = place.fvi(&["tune", "plant.toml", "--out", "out"]);
        assert_eq!(output.status.code(), Some(1), "{sample}: {}", text(&output.stdout));
    }
}

/// At ω = π/h the terms of the alias sum of s^{−a} are those of Hurwitz' zeta function:
///
/// ```text
/// G(−1) = 2/h (2π/h)^{−1−a} 2 cos((1 + a) π/2) (2^{1+a} − 1) ζ(1 + a)
/// ```
#[test]
fn a_plant_that_falls_slowly_keeps_its_bound_at_the_end_of_the_band() {
    const ZETA: [(f64, f64); 2] = [(0.2, 5.591_582_441_177_751), (0.5, 2.612_375_348_685_488)];
    let h = 0.1;
    for (a, zeta) in ZETA {
        let place = Workplace::new();
        let record =
            tune(&place, &problem(&format!("1/s^{a}"), "structure = \"pi\"\nsample = 0.1", "ms = 1.4"));
        let [kp, ki] = ["kp", "ki"].map(|key| number(&record, key));
        let held = 2.0 / h
            * (2.0 * PI / h).powf(-1.0 - a)
            * 2.0
            * (0.5 * (1.0 + a) * PI).cos()
            * (2f64.powf(1.0 + a) - 1.0)
            * zeta;
        let at_the_end = held * (kp + 0.5 * ki * h);
        let reached = 1.0 / (1.0 + at_the_end).abs();
        assert!(reached < 1.4 * (1.0 + 1e-3), "s^-{a}: Ms at π/h is {reached}");
    }
}

/// (s + 2)/(s + 1) = 1 + 1/(s + 1): a sample sees the direct part of the output before it is renewed, z⁻¹.
#[test]
fn a_direct_path_is_seen_a_sample_later() {
    let place = Workplace::new();
    let record = tune(
        &place,
        &problem("(s + 2)/(s + 1)", "structure = \"pi\"\nlambda = 1.0\nsample = 0.1", "ms = 1.4"),
    );
    let [kp, ki] = ["kp", "ki"].map(|key| number(&record, key));
    let h = 0.1f64;
    let fallen = (-h).exp();
    let mut largest = 0.0f64;
    for index in 1..=100_000 {
        let angle = PI * f64::from(index) / 1e5;
        let earlier = Complex(angle.cos(), -angle.sin());
        let one = Complex(1.0, 0.0);
        let lag = earlier.scaled(1.0 - fallen).times(one.plus(earlier.scaled(-fallen)).inverse());
        let integral = one.plus(earlier.scaled(-1.0)).inverse().scaled(ki * h);
        let open = earlier.plus(lag).times(Complex(kp, 0.0).plus(integral));
        largest = fvi_fft::sums::max_or_nan(largest, 1.0 / one.plus(open).size());
    }
    assert!(largest > 1.38 && largest < 1.4 * (1.0 + 1e-3), "{largest}");
    // The loop itself, about the setpoint 0 from a lag of 1.
    let (mut x, mut u, mut sum, mut last) = (1.0f64, 0.0f64, 0.0f64, f64::INFINITY);
    for _ in 0..400 {
        let y = x + u;
        sum += ki * h * y;
        u = -(kp * y + sum);
        x = fallen * x + (1.0 - fallen) * u;
        last = y.abs();
    }
    assert!(last < 1e-6, "{last}");
}

/// L = (1 + K_i s^{−1.2})/s crosses the negative axis at low frequencies with a large |L|, and at π/h.
#[test]
fn the_gain_margin_is_that_of_all_crossings() {
    let place = Workplace::new();
    let record = tune(
        &place,
        &problem(
            "1/s",
            "structure = \"pi\"\nlambda = 1.2\nsample = 0.1",
            "crossover = 1.0\nphase_margin = 60",
        ),
    );
    let [kp, ki] = ["kp", "ki"].map(|key| number(&record, key));
    // G(−1) = −h/2 of the held integrator, and (2/h)^{−1.2}.
    let at_the_end = 0.05 * (kp + ki * 20f64.powf(-1.2));
    let margin = number(&record, "sampled_margins.gain_margin");
    assert!((margin * at_the_end - 1.0).abs() < 1e-3, "{margin} {at_the_end}");
}

/// Of fixed orders the slopes of the phase with positive gains are a short interval.
#[test]
fn a_law_of_fixed_orders_is_found_where_its_slopes_are_few() {
    for crossover in [0.5, 0.55, 1.2, 1.4] {
        let place = Workplace::new();
        let controller = "structure = \"pid\"\nlambda = 0.5\nmu = 0.5\nsample = 0.01";
        let record = tune(
            &place,
            &problem("1/(s + 1)^3", controller, &format!("crossover = {crossover:?}\nphase_margin = 60")),
        );
        let margin = number(&record, "sampled_margins.phase_margin");
        assert!((margin - 60.0).abs() < 0.1, "{crossover}: {margin}");
    }
}

/// A resonance that lifts |L| to 1 far above the crossover is kept below it, in seconds as in milliseconds.
#[test]
fn an_oscillating_plant_is_tuned_in_every_unit_of_time() {
    for unit in [1.0, 1e3] {
        let place = Workplace::new();
        let record = tune(
            &place,
            &format!(
                "plant = {{ gain = 1.0, frequency = {:?}, damping = 0.1, dead_time = {unit:?} }}\n\
                 controller = {{ structure = \"pid\", sample = {:?} }}\n\
                 specification = {{ crossover = {:?}, phase_margin = 65, flat_phase = true }}\n",
                0.3 / unit,
                0.5 * unit,
                0.03 / unit
            ),
        );
        let crossovers = record["sampled_margins"]["gain_crossovers"].as_array().unwrap();
        assert_eq!(crossovers.len(), 1, "{crossovers:?}");
        assert!((number(&record, "sampled_margins.phase_margin") - 65.0).abs() < 0.1);
    }
}
