//! Compares a trajectory of `fvi run` with what the image `pulse` or `closed_loop` printed: `same_as_run
//! SCALAR IMAGE TRAJECTORY`, bit by bit.

use std::error::Error;
use std::fs;

use scenarios::bits::Bits;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, scalar, image, trajectory] = &arguments[..] else {
        return Err("usage: same_as_run f32|f64 IMAGE TRAJECTORY".into());
    };
    let bits = |number: &str| -> Result<String, Box<dyn Error>> {
        let number: f64 = number.parse()?;
        Ok(if scalar == f32::NAME { (number as f32).hexadecimal() } else { number.hexadecimal() }.to_string())
    };
    let image = fs::read_to_string(image)?;
    let printed =
        image.lines().skip_while(|line| line != scalar).skip(1).take_while(|line| line.contains(' '));
    let trajectory = fs::read_to_string(trajectory)?;
    let mut rows = trajectory.lines().skip(1);
    let mut count = 0;
    for (step, printed) in printed.enumerate() {
        let row: Vec<&str> = rows.next().ok_or("the trajectory is shorter")?.split(',').collect();
        let [_, position, momentum, ..] = row[..] else {
            return Err("a row without position and momentum".into());
        };
        let mut run = format!("{step} {} {}", bits(position)?, bits(momentum)?);
        // The column after the energy is the output of a controller.
        if let Some(output) = row.get(4) {
            run += &format!(" {}", bits(output)?);
        }
        if run != printed {
            return Err(format!("{scalar}, step {step}: the image has {printed}, the run {run}").into());
        }
        count += 1;
    }
    if count == 0 || rows.next().is_some() {
        return Err(format!("{count} states, and the trajectory is longer").into());
    }
    println!("{scalar}: {count} states identical to those of fvi run");
    Ok(())
}
