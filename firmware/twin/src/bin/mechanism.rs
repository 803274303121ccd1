//! Prints the trajectory of a mass on a rod with a viscoelastic strut, in single and in double precision.

use scenarios::mechanism;

fn main() -> Result<(), scenarios::refusal::Refusal> {
    let mut text = String::new();
    let result = mechanism::run_both(&mut text);
    print!("{text}");
    result
}
