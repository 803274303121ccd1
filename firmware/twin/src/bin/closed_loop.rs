//! Prints the trajectory of a stage under a fractional PID controller.

use scenarios::closed_loop;

fn main() -> Result<(), scenarios::refusal::Refusal> {
    let mut text = String::new();
    let result = closed_loop::run(&mut text);
    print!("{text}");
    result
}
