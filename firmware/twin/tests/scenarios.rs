//! The results of the scenarios agree with exact values.

use std::error::Error;

use fvi_core::{
    BdfOrder, ConvolutionWeights, ExponentialSum, ExponentialTable, Memory, StateReader, StateWriter,
};
use scenarios::control_loop::ControlLoop;
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
