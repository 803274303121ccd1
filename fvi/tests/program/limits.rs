//! Input that asks for more than there is: refused, never an abort, an endless read or a file outside of the
//! output directory.

use crate::workplace::{Workplace, text};
use std::fs;

const FREE: &str = "[system]\nmass = [1.0]\n[initial]\nposition = [0.0]\n[time]\nstep = 0.1\nsteps = 3\n";

/// Runs a line under a limit on memory, in kilobytes.
fn under(place: &Workplace, kilobytes: usize, line: &str) -> (Option<i32>, String) {
    let output = place.shell(&format!("ulimit -v {kilobytes}; {line}"));
    (output.status.code(), text(&output.stderr))
}

#[cfg(target_os = "linux")]
#[test]
fn counts_that_no_memory_holds_are_refused_before_anything_is_allocated() {
    let place = Workplace::new();
    place.write("free.toml", FREE);
    for kilobytes in [1_000_000, 4_000_000] {
        for points in ["200000000", "1000000000000", "18446744073709551615"] {
            let line = format!("fvi response free.toml --points {points} --out out");
            let (code, message) = under(&place, kilobytes, &line);
            assert_eq!(code, Some(2), "{line}: {message}");
            assert!(message.contains("--points: "), "{message}");
            assert!(!place.path("out").exists());
        }
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_system_of_many_coordinates_in_lists_takes_sparse_matrices_by_itself() {
    let place = Workplace::new();
    let ones = vec!["1.0"; 20_000].join(", ");
    let zeros = vec!["0.0"; 19_999].join(", ");
    let text = format!(
        "[system]\nmass = [{ones}]\npotential = \"0.5*q0^2 + 0.5*(q1 - q0)^2\"\n\
         [initial]\nposition = [1.0, {zeros}]\n[time]\nstep = 0.1\nsteps = 3\n[output]\ncoordinates = [0, 1]\n"
    );
    place.write("many.toml", &text);
    let (code, message) = under(&place, 2_000_000, "fvi run many.toml --out many --quiet");
    assert_eq!(code, Some(0), "{message}");
    let two = text.replace(&ones, "1.0, 1.0").replace(&format!("1.0, {zeros}"), "1.0, 0.0");
    place.write("two.toml", &two);
    let (code, message) = under(&place, 2_000_000, "fvi run two.toml --out two --quiet");
    assert_eq!(code, Some(0), "{message}");
    let rows = |name: &str| -> Vec<f64> {
        let text = fs::read_to_string(place.path(name).join("trajectory.csv")).unwrap();
        text.lines().skip(1).flat_map(|line| line.split(',').map(|number| number.parse().unwrap())).collect()
    };
    let (many, two) = (rows("many"), rows("two"));
    assert_eq!(many.len(), two.len());
    assert!(many.iter().zip(&two).all(|(many, two)| (many - two).abs() <= 1e-14), "{many:?}\n{two:?}");
}

#[cfg(unix)]
#[test]
fn devices_and_pipes_without_an_end_are_not_read_as_input() {
    let place = Workplace::new();
    std::os::unix::fs::symlink("/dev/zero", place.path("zero.toml")).unwrap();
    let refused = |line: &str, named: &str| {
        let (code, message) = under(&place, 1_000_000, line);
        assert_eq!(code, Some(2), "{line}: {message}");
        assert!(message.contains(named), "{line}: {message}");
    };
    refused("fvi run /dev/zero", "a device or socket; a regular file or a pipe is read");
    refused("fvi run zero.toml", "a device or socket; a regular file or a pipe is read");
    refused("fvi run .", "a directory; a regular file or a pipe is read");
    refused("cat /dev/zero | fvi run /dev/stdin", "of which 16777216 may be read");
    place.write("matrix.toml", &FREE.replace("[1.0]", "\"/dev/urandom\""));
    refused("fvi run matrix.toml", "a device or socket; a regular file or a pipe is read");
    // A pipe that is written to is read to its end.
    place.write("free.toml", FREE);
    let (code, message) = under(&place, 1_000_000, "cat free.toml | fvi run /dev/stdin --out out --quiet");
    assert_eq!(code, Some(0), "{message}");
}

#[cfg(unix)]
#[test]
fn a_document_larger_than_its_limit_is_refused_with_what_to_do() {
    let place = Workplace::new();
    fs::write(place.path("long.toml"), format!("{FREE}# {}\n", "x".repeat(17 << 20))).unwrap();
    let (code, message) = under(&place, 1_000_000, "fvi run long.toml");
    assert_eq!(code, Some(2), "{message}");
    assert!(message.contains("stand in files of their own"), "{message}");
}

#[cfg(unix)]
#[test]
fn an_output_directory_that_is_a_dangling_link_is_refused() {
    let place = Workplace::new();
    place.write("free.toml", FREE);
    std::os::unix::fs::symlink("nowhere/at/all", place.path("out")).unwrap();
    for out in ["out", "out/deeper"] {
        let (code, message) = under(&place, 1_000_000, &format!("fvi run free.toml --out {out}"));
        assert_eq!(code, Some(2), "{message}");
        assert!(message.contains("out: a link to what is not there"), "{message}");
    }
}

#[cfg(unix)]
#[test]
fn no_link_in_an_output_directory_leads_a_run_out_of_it() {
    let place = Workplace::new();
    place.write("free.toml", FREE);
    place.write("referenced.toml", &format!("{FREE}[reference]\nposition = [\"0\"]\n"));
    let axes = "[axes]\n\"system.mass[0]\" = [1.0, 2.0]\n";
    place.write("swept.toml", &format!("scenario = \"free.toml\"\n{axes}"));
    for (line, names) in [
        ("run free.toml", &["trajectory.csv", "trajectory.csv.part", "energy.svg", "summary.json"][..]),
        ("response free.toml", &["response.csv", "response.json"]),
        ("converge referenced.toml --levels 2..3", &["convergence.csv"]),
        ("sweep swept.toml", &["sweep.fvi", "sweep.csv", "sweep.json"]),
    ] {
        let _ = fs::remove_dir_all(place.path("out"));
        fs::create_dir(place.path("out")).unwrap();
        for name in names {
            place.write(&format!("mine-{name}"), "mine");
            std::os::unix::fs::symlink(place.path(&format!("mine-{name}")), place.path("out").join(name))
                .unwrap();
        }
        let output = place.shell(&format!("fvi {line} --out out --quiet"));
        assert_eq!(output.status.code(), Some(0), "{line}: {}", text(&output.stderr));
        for name in names {
            let kept = fs::read_to_string(place.path(&format!("mine-{name}"))).unwrap();
            assert_eq!(kept, "mine", "{line} wrote through out/{name}");
        }
    }
}

#[test]
fn numbers_of_hundreds_of_digits_are_shortened_in_messages() {
    let place = Workplace::new();
    let long = "7".repeat(300);
    place.write("mass.toml", &FREE.replace("[1.0]", &format!("[{long}.0, -{long}.0]")));
    place.write("small.toml", &FREE.replace("[1.0]", "[1e-300]\npotential = \"1e300*q0^2\""));
    for (line, shown) in [
        ("weights --exponent 1e300", "exponent = 1e300"),
        ("run mass.toml", "-7.777777777777778e299"),
        ("run small.toml", "1e-300"),
    ] {
        let output = place.fvi(&line.split(' ').collect::<Vec<_>>());
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(shown), "{message}");
        let has_long = message.as_bytes().windows(70).any(|digits| digits.iter().all(u8::is_ascii_digit));
        assert!(!has_long, "{message}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_run_whose_force_jumps_too_often_is_stopped_within_a_few_steps() {
    let place = Workplace::new();
    place.write(
        "jumps.toml",
        &FREE
            .replace("[initial]", "force = [\"sign(sin(1e9*pi*t))\"]\n[initial]")
            .replace("steps = 3", "steps = 100000"),
    );
    let mut child = place.command(&["run", "jumps.toml", "--out", "out", "--quiet"]).spawn().unwrap();
    while !place.path("out/trajectory.csv.part").exists() {
        assert!(child.try_wait().unwrap().is_none());
        std::thread::yield_now();
    }
    let kill = std::process::Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
    assert!(kill.success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    if let Ok(summary) = fs::read_to_string(place.path("out/summary.json")) {
        let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
        let steps = summary["steps"].as_u64().unwrap();
        assert!(steps < 64, "{summary}");
        // The signal may come before the first step.
        let warned = summary["warnings"].to_string().contains("than are looked for");
        assert_eq!(warned, steps > 0, "{summary}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_document_whose_values_do_not_fit_into_memory_is_refused() {
    let place = Workplace::new();
    place.write("list.toml", &format!("x = [{}]\n{FREE}", "0,".repeat(5_000_000)));
    let (code, message) = under(&place, 1_000_000, "fvi run list.toml");
    assert_eq!(code, Some(2), "{message}");
    assert!(
        message.contains("a document of 10000084 bytes: about 1526 MB of memory are needed"),
        "{message}"
    );
    assert!(message.contains("stand in files of their own"), "{message}");
}
