//! The results of the scenarios agree with exact values.

use std::error::Error;

use fvi_core::{
    BdfOrder, ConvolutionWeights, ExponentialSum, ExponentialTable, Memory, StateReader, StateWriter,
};
use scenarios::control_loop::ControlLoop;
use scenarios::mechanism;
use scenarios::pulse;
use scenarios::tables::{DAMPING, DERIVATIVE, INTEGRAL};

/// Positions of the plate in double precision.
fn positions() -> Result<Vec<f64>, Box<dyn Error>> {
    let mut text = String::new();
    pulse::run::<f64>(&mut text)?;
    let position = |line: &str| -> Result<f64, Box<dyn Error>> {
        let bits = line.split(' ').nth(1).ok_or("no position")?;
        Ok(f64::from_bits(u64::from_str_radix(bits, 16)?))
    };
    text.lines().map(position).collect()
}

#[test]
fn the_plate_follows_the_exact_solution_as_far_as_the_step_allows() -> Result<(), Box<dyn Error>> {
    let positions = positions()?;
    assert_eq!(positions.len(), pulse::STEPS + 1);
    let exact = include_str!("../../../tests/reference/bagley_torvik_pulse.csv");
    let mut compared = 0;
    for row in exact.lines().skip(1) {
        let numbers: Vec<f64> = row.split(',').map(str::parse).collect::<Result<_, _>>()?;
        let (time, position) = (numbers[5], numbers[6]);
        let place = time / pulse::STEP_SIZE;
        let step = place.round();
        if (step - place).abs() < 1e-9 && step <= pulse::STEPS as f64 {
            let error = (positions[step as usize] - position).abs();
            // Error of a first-order scheme with h = 0.125, on a motion of magnitude 4.
            assert!(error < 0.2, "t = {time}: {error}");
            compared += 1;
        }
    }
    assert!(compared >= 5, "{compared}");
    Ok(())
}

#[test]
fn tables_give_the_weights_of_their_operators() -> Result<(), Box<dyn Error>> {
    let check = |exponent: f64, table: ExponentialTable<&'static [f32]>| -> Result<(), Box<dyn Error>> {
        let mut memory = ExponentialSum::new(table, 1.0, 1, vec![0.0f32; table.state_len(1)])?;
        // The response to a single sample is the weights, one after another.
        let mut sample = 1.0;
        for (n, weight) in ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, exponent, 1e-3)?
            .take(100_000)
            .enumerate()
            .skip(1)
        {
            memory.push(&[sample])?;
            sample = 0.0;
            let mut term = [0.0];
            memory.next_term(&mut term)?;
            let error = (f64::from(term[0]) / weight - 1.0).abs();
            assert!(error < 1e-5, "exponent {exponent}, weight {n}: {error:e}");
        }
        Ok(())
    };
    check(0.5, DAMPING)?;
    check(-0.8, INTEGRAL)?;
    check(0.6, DERIVATIVE)
}

#[test]
fn a_control_loop_that_is_restored_goes_on_with_the_same_bits() -> Result<(), Box<dyn Error>> {
    let mut undisturbed = ControlLoop::new()?;
    for _ in 0..5_000 {
        undisturbed.tick()?;
    }
    let mut bytes = [0; 4096];
    let mut to = StateWriter::new(&mut bytes);
    undisturbed.save(&mut to)?;
    let written = to.written();
    let mut restored = ControlLoop::restored(&mut StateReader::new(&bytes[..written]))?;
    assert_eq!(restored.ticks(), 5_000);
    for _ in 0..5_000 {
        assert_eq!(restored.tick()?, undisturbed.tick()?);
    }
    assert_eq!(restored.hash(), undisturbed.hash());
    assert!(ControlLoop::restored(&mut StateReader::new(&bytes[..written - 1])).is_err());
    Ok(())
}

/// Slopes of angle, rate and strut of the mass on its rod, in coordinates without a constraint.
fn slopes([angle, rate, y0, y1]: [f64; 4]) -> [f64; 4] {
    let [a, b] = mechanism::HELD;
    let (x, y) = (angle.sin(), -angle.cos());
    let length = (x - a).hypot(y - b);
    // ∂l/∂φ, with ∂(x, y)/∂φ = (−y, x).
    let lever = ((x - a) * -y + (y - b) * x) / length;
    let [c0, c1] = mechanism::STRENGTHS;
    let [r0, r1] = mechanism::RATES;
    let force = c0 * y0 + c1 * y1;
    [rate, -mechanism::GRAVITY * x - force * lever, lever * rate - r0 * y0, lever * rate - r1 * y1]
}

#[test]
fn the_mass_on_a_rod_moves_as_by_its_angle_and_its_strut_takes_energy() -> Result<(), Box<dyn Error>> {
    let mut text = String::new();
    mechanism::run::<f64>(&mut text)?;
    let [[x, y], [u, v]] = mechanism::START;
    let mut state = [x.atan2(-y), u * -y + v * x, 0.0, 0.0];
    let (parts, mut taken) = (50, 0.0);
    let h = mechanism::STEP_SIZE / f64::from(parts);
    let on = |state: [f64; 4], by: f64, slope: [f64; 4]| [0, 1, 2, 3].map(|i| state[i] + by * slope[i]);
    for line in text.lines() {
        let bits = line.split(' ').skip(1).map(|word| u64::from_str_radix(word, 16));
        let numbers: Vec<f64> = bits.map(|bits| bits.map(f64::from_bits)).collect::<Result<_, _>>()?;
        let (x, y) = (numbers[0], numbers[1]);
        assert!(
            (x.hypot(y) - 1.0).abs() < 1e-14 && (x * numbers[2] + y * numbers[3]).abs() < 1e-13,
            "{line}"
        );
        let error = (x - state[0].sin()).hypot(y + state[0].cos());
        assert!(error < 2e-5, "step {line}: {error:e}");
        assert!(numbers[4] >= -1e-14, "the strut has given {}", -numbers[4]);
        taken = numbers[4];
        // The classical Runge–Kutta method, of order 4.
        for _ in 0..parts {
            let first = slopes(state);
            let second = slopes(on(state, 0.5 * h, first));
            let third = slopes(on(state, 0.5 * h, second));
            let fourth = slopes(on(state, h, third));
            let mean = [0, 1, 2, 3].map(|i| (first[i] + 2.0 * (second[i] + third[i]) + fourth[i]) / 6.0);
            state = on(state, h, mean);
        }
    }
    assert_eq!(text.lines().count(), mechanism::STEPS + 1);
    assert!(taken > 1.0, "{taken} J");
    Ok(())
}
