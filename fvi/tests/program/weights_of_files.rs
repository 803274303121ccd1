//! `kernel = { weights = "w.csv" }`: memories that somebody else discretised.

use crate::workplace::{Workplace, text};
use std::fs;

const KERNEL: &str = "[kernel]\nform = \"havriliak-negami\"\norder = 1.0\npower = 0.8\ntime = 0.3\n";

fn scenario(kernel: &str, rest: &str) -> String {
    format!(
        "[system]\nmass = [1.0]\npotential = \"2*q0^2\"\n[[system.damping]]\ncoefficient = [1.5]\nkernel = {kernel}\n[initial]\n\
         position = [1.0]\n[time]\nstep = 0.02\nsteps = 300\n{rest}"
    )
}

/// A place with weights of BDF 2 at h = 0.02 beside the kernel that they are of.
fn place() -> Workplace {
    let place = Workplace::new();
    place.write("kernel.toml", KERNEL);
    place.write("weights.toml", "[kernel]\nweights = \"w.csv\"\n");
    let of = "weights --kernel kernel.toml --order 2 --step 0.02 --count 301 --out w.csv";
    done(&place, of);
    place
}

fn done(place: &Workplace, arguments: &str) -> String {
    let output = place.fvi(&arguments.split(' ').collect::<Vec<_>>());
    assert!(output.status.success(), "{arguments}: {}", text(&output.stderr));
    text(&output.stdout)
}

fn refused(place: &Workplace, arguments: &str) -> String {
    let output = place.fvi(&arguments.split(' ').collect::<Vec<_>>());
    assert_eq!(output.status.code(), Some(2), "{arguments}: {}", text(&output.stderr));
    // Without the breaks of lines.
    text(&output.stderr).split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

fn numbers(place: &Workplace, name: &str) -> Vec<Vec<f64>> {
    let table = fs::read_to_string(place.path(name)).unwrap();
    table.lines().skip(1).map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect()
}

#[test]
fn weights_that_were_listed_run_and_answer_as_their_kernel() {
    let place = place();
    assert_eq!(
        done(&place, "weights --kernel weights.toml --order 1 --step 0.02 --count 301"),
        fs::read_to_string(place.path("w.csv")).unwrap()
    );
    let form = KERNEL.trim_start_matches("[kernel]\n").trim().replace('\n', ", ");
    place.write("known.toml", &scenario(&format!("{{ {form} }}"), "[convolution]\norder = 2\n"));
    place.write("given.toml", &scenario("{ weights = \"w.csv\" }", ""));
    for command in ["run", "response"] {
        done(&place, &format!("{command} known.toml --out known"));
        done(&place, &format!("{command} given.toml --out given"));
    }
    let near = |name: &str, tolerance: f64| {
        let [known, given] = ["known", "given"].map(|run| numbers(&place, &format!("{run}/{name}")));
        assert_eq!(known.len(), given.len());
        for (known, given) in known.iter().flatten().zip(given.iter().flatten()) {
            assert!((known - given).abs() <= tolerance * (1.0 + known.abs()), "{name}: {known} {given}");
        }
    };
    near("trajectory.csv", 1e-12);
    // The weights behind the last row, which the run does not meet, are not there.
    near("response_discrete.csv", 1e-7);
    assert!(!place.path("given/poles.csv").exists() && !place.path("given/creep_0.csv").exists());
    let record = fs::read_to_string(place.path("given/response.json")).unwrap();
    assert!(record.contains("for frequencies up to π/h") && record.contains("given by weights"), "{record}");
    let message = refused_or_failed(&place, "response given.toml --to 1000 --out beyond");
    assert!(message.contains("which tell it up to π/h"), "{message}");
}

fn refused_or_failed(place: &Workplace, arguments: &str) -> String {
    let output = place.fvi(&arguments.split(' ').collect::<Vec<_>>());
    assert!(!output.status.success(), "{arguments}");
    text(&output.stderr).split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

#[test]
fn other_contents_of_the_file_are_another_run() {
    let place = place();
    place.write("given.toml", &scenario("{ weights = \"w.csv\" }", ""));
    done(&place, "run given.toml --out out --checkpoint-every 100");
    let weights = fs::read_to_string(place.path("w.csv")).unwrap();
    let (others, _) = weights.rsplit_once("300,").unwrap();
    place.write("w.csv", &format!("{others}300,0\n"));
    let message = refused_or_failed(&place, "run given.toml --out out --resume");
    assert!(
        message.contains("system.damping[0].kernel, its file") && message.contains("checksum"),
        "{message}"
    );
    place.write("w.csv", &weights);
    done(&place, "run given.toml --out out --resume");
}

#[test]
fn studies_that_change_the_step_are_refused() {
    let place = place();
    place.write("given.toml", &scenario("{ weights = \"w.csv\" }", "[reference]\nposition = [\"1\"]\n"));
    let message = refused(&place, "converge given.toml --levels 4..6 --out out");
    assert!(message.contains("to which these weights belong"), "{message}");
    let sweep = "scenario = \"given.toml\"\n[axes]\n\"time.step\" = [0.02, 0.01]\n";
    place.write("sweep.toml", sweep);
    let message = refused(&place, "sweep sweep.toml --out out");
    assert!(message.contains("which belong to one step"), "{message}");
    // With the step of each file stated the runs at another one fail by themselves.
    let stated = format!("{sweep}\"system.damping[0].kernel.step\" = [0.02]\n");
    place.write("given.toml", &scenario("{ weights = \"w.csv\", step = 0.02 }", ""));
    place.write("sweep.toml", &stated);
    done(&place, "sweep sweep.toml --out out");
    let rows = fs::read_to_string(place.path("out/results.csv")).unwrap();
    let row = |index: usize| rows.lines().nth(1 + index).unwrap();
    assert!(row(0).contains(",completed,"), "{rows}");
    assert!(row(1).contains(",refused,") && row(1).contains("those of another one"), "{rows}");
}

#[test]
fn listings_that_need_the_kernel_itself_are_refused() {
    let place = place();
    for arguments in [
        "exponentials --kernel weights.toml --step 0.02 --horizon 100 --tolerance 1e-6",
        "weights --kernel weights.toml --family radau-iia --stages 2 --step 0.02 --count 3",
        "weights --kernel weights.toml --step 0.02 --count 302",
        "rates --stages 2 --kernel weights.toml --shortest 0.1 --horizon 10",
    ] {
        assert!(refused(&place, arguments).contains("weights"), "{arguments}");
    }
}
