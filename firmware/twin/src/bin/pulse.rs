//! Prints the trajectory of the plate under a pulse, in single and in double precision.

use scenarios::pulse;

fn main() -> Result<(), scenarios::refusal::Refusal> {
    let mut text = String::new();
    let result = pulse::run_both(&mut text);
    print!("{text}");
    result
}
