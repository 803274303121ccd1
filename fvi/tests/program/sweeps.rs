//! What a user of `fvi sweep` relies on.

use crate::workplace::{Workplace, text};
use fvi_fft::memory::Tables;
use fvi_host::sweep::{Column, Ledger, Sweep, SweepOptions, rows, sweep};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

const SCENARIO: &str = r#"
[system]
mass = [1.0]
potential = "0.5*k*q0^2"
parameters = { k = 1.0 }
[[system.damping]]
order = 0.5
coefficient = [0.1]
[initial]
position = [1.0]
momentum = [0.0]
[scheme]
kind = "low-order"
kappa = 0.0
[time]
step = 0.05
steps = 60
"#;

const GRID: &str = r#"
scenario = "scenario.toml"
[axes]
"system.damping[0].order" = { from = 0.1, to = 1.9, count = 7 }
"system.parameters.k" = [1.0, 4.0, 1e5]
[keep]
quantities = ["last", "energy", "amplitude"]
"#;

fn place(sweep: &str) -> Workplace {
    let place = Workplace::new();
    place.write("scenario.toml", SCENARIO);
    place.write("sweep.toml", sweep);
    place
}

/// The files of results, without the records.
fn results(directory: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap());
    let files = entries.filter(|entry| !entry.file_name().to_str().unwrap().ends_with(".fvi"));
    files.map(|entry| (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap())).collect()
}

fn done(output: &std::process::Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    text(&output.stdout)
}

#[test]
fn a_sweep_is_a_row_for_each_run_and_failed_ones_are_rows_too() {
    let place = place(GRID);
    let line = done(&place.fvi(&["sweep", "sweep.toml", "--jobs", "2"]));
    assert!(line.starts_with("scenario: 21 of 21 runs, 7 of them failed; "), "{line}");
    let table = fs::read_to_string(place.path("out/sweep/results.csv")).unwrap();
    let rows: Vec<Vec<&str>> = table.lines().map(|line| line.splitn(14, ',').collect()).collect();
    assert_eq!(
        table.lines().next().unwrap(),
        "run,system.damping[0].order,system.parameters.k,status,steps,t,q0,p0,\
         energy_start,energy,energy_left,largest_energy,amplitude_q0,message"
    );
    assert_eq!(rows.len(), 22);
    for (run, row) in rows[1..].iter().enumerate() {
        assert_eq!(row[0], run.to_string());
        let stiff = run % 3 == 2;
        assert_eq!(row[3], if stiff { "refused" } else { "completed" });
        assert_eq!(row[4], if stiff { "0" } else { "60" });
        assert_eq!(stiff, row[13].contains("the largest stable step is"), "{row:?}");
    }
    // A row is what `fvi run` says of its scenario.
    let single = SCENARIO.replace("order = 0.5", "order = 1.3").replace("k = 1.0", "k = 4.0");
    let run = place.run(&single, &[]);
    assert_eq!(rows[1 + 3 * 4 + 1][1..3], ["1.3", "4.0"]);
    assert_eq!(rows[1 + 3 * 4 + 1][6].parse::<f64>().unwrap(), run.rows[60][1]);
}

#[test]
fn threads_shards_and_interruptions_leave_the_same_bytes() {
    let place = place(GRID);
    done(&place.fvi(&["sweep", "sweep.toml", "--jobs", "1", "--out", "one"]));
    let expected = results(&place.path("one"));
    assert_eq!(
        expected.keys().collect::<Vec<_>>(),
        ["amplitude_q0.svg", "energy_left.svg", "q0.svg", "results.csv", "results.npz"]
    );
    done(&place.fvi(&["sweep", "sweep.toml", "--jobs", "3", "--out", "three"]));
    assert!(results(&place.path("three")) == expected);

    // Stopped again and again.
    let plan = Sweep::read(&place.path("sweep.toml")).unwrap();
    let options = SweepOptions::new(place.path("stopped"));
    let mut last = 0;
    for _ in 0..21 {
        let stop = AtomicBool::new(false);
        let summary = sweep(&plan, &options, &stop, &mut |done| {
            if done > last {
                stop.store(true, Ordering::Relaxed);
            }
        });
        last = summary.unwrap().done;
    }
    assert_eq!(last, 21);
    assert!(results(&place.path("stopped")) == expected);

    // As tasks of an array, one of them not yet made.
    for task in ["3", "1"] {
        let mut command = place.command(&["sweep", "sweep.toml", "--out", "array"]);
        command.env("SLURM_ARRAY_TASK_ID", task).env("SLURM_ARRAY_TASK_COUNT", "3");
        let line = done(&command.output().unwrap());
        assert!(line.contains(&format!("shard {task}/3: 7 of its 7 runs")), "{line}");
    }
    let missing = place.fvi(&["sweep", "sweep.toml", "--out", "array", "--gather"]);
    assert_eq!(missing.status.code(), Some(2));
    assert!(text(&missing.stderr).contains("shard 2/3 is missing"), "{}", text(&missing.stderr));
    done(&place.fvi(&["sweep", "sweep.toml", "--out", "array", "--shard", "2/3"]));
    assert!(results(&place.path("array")).is_empty());
    done(&place.fvi(&["sweep", "sweep.toml", "--out", "array", "--gather"]));
    assert!(results(&place.path("array")) == expected);

    // Another sweep in the same directory.
    place.write("sweep.toml", &GRID.replace("4.0", "5.0"));
    let other = place.fvi(&["sweep", "sweep.toml", "--out", "one"]);
    assert_eq!(other.status.code(), Some(2));
    assert!(text(&other.stderr).contains("records of another sweep"), "{}", text(&other.stderr));
    assert!(results(&place.path("one")) == expected);
}

#[test]
fn all_runs_see_the_files_that_the_sweep_was_read_with_and_have_the_bits_of_single_runs() {
    let place = place(
        "scenario = \"scenario.toml\"\n[axes]\n\"initial.position[0]\" = { from = 0.5, to = 1.5, count = 6 }\n\
         [keep]\nquantities = [\"last\"]\n",
    );
    let scenario =
        format!("{SCENARIO}[history]\nengine = \"exponential-sum\"\n[input]\nfile = \"drive.csv\"\n");
    place.write("scenario.toml", &scenario);
    place.write("drive.csv", "t,u0\n0,0\n1,0.5\n2,-0.25\n3,0\n");
    let single = place.run(&scenario.replace("position = [1.0]", "position = [0.7]"), &[]);
    let plan = Sweep::read(&place.path("sweep.toml")).unwrap();
    fs::remove_file(place.path("drive.csv")).unwrap();
    let options = SweepOptions::new(place.path("swept"));
    let summary = sweep(&plan, &options, &AtomicBool::new(false), &mut |_| ()).unwrap();
    assert_eq!((summary.done, summary.failed), (6, 0));
    let table = fs::read_to_string(place.path("swept/results.csv")).unwrap();
    let row: Vec<&str> = table.lines().nth(2).unwrap().split(',').collect();
    assert_eq!(row[1], "0.7");
    let last = single.rows.last().unwrap();
    let found: Vec<f64> = row[4..7].iter().map(|cell| cell.parse().unwrap()).collect();
    assert_eq!(found, last[..3]);
}

#[test]
fn sampled_sweeps_cover_their_axes_and_keep_trajectories() {
    for kind in ["latin-hypercube", "sobol"] {
        let place = place(&format!(
            "scenario = \"scenario.toml\"\n[axes]\n\"system.damping[0].order\" = {{ from = 0.1, to = 1.9 }}\n\
             \"system.damping[0].coefficient[0]\" = {{ from = 1e-3, to = 0.01, spacing = \"logarithmic\" }}\n\
             [sampling]\nkind = \"{kind}\"\ncount = 16\nseed = 1\n[keep]\ntrajectories = true\n"
        ));
        done(&place.fvi(&["sweep", "sweep.toml", "--out", "out"]));
        let table = fs::read_to_string(place.path("out/results.csv")).unwrap();
        let row = |line: &str| -> Vec<f64> {
            line.split(',').skip(1).take(2).map(|cell| cell.parse().unwrap()).collect()
        };
        let rows: Vec<Vec<f64>> = table.lines().skip(1).map(row).collect();
        let mut parts: Vec<usize> = rows.iter().map(|row| ((row[0] - 0.1) / 1.8 * 16.0) as usize).collect();
        parts.sort_unstable();
        assert_eq!(parts, (0..16).collect::<Vec<_>>(), "{kind}");
        assert!(rows.iter().all(|row| (1e-3..=0.01).contains(&row[1])));
        assert_eq!(fs::read_dir(place.path("out/runs")).unwrap().count(), 16);
    }
}

#[test]
fn sweeps_that_cannot_be_made_are_refused_before_anything_runs() {
    for (wrong, right, said) in [
        ("system.damping[0].ordre", "system.damping[0].order", "did you mean `system.damping[0].order`?"),
        ("system.damping[1].order", "system.damping[0].order", "`system.damping` has 1 entries"),
        ("time.stepp", "system.damping[0].order", "did you mean `time.step`?"),
        ("system.parameters.K", "system.parameters.k", "did you mean `system.parameters.k`?"),
        ("to = 2.1", "to = 1.9", "system.damping[0].order = 2.1"),
        ("count = 0", "count = 7", "sweep.toml:4"),
        ("[]", "[1.0, 4.0, 1e5]", "at least one value"),
        ("[1.0, -3.0, \"x\"]", "[1.0, 4.0, 1e5]", "system.parameters.k = x"),
        ("\"amplitud\"", "\"amplitude\"", "\"amplitude\""),
        ("missing.toml", "scenario.toml", "missing.toml"),
    ] {
        let place = place(&GRID.replace(right, wrong));
        let output = place.fvi(&["sweep", "sweep.toml"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{wrong}: {message}");
        assert!(message.contains(said), "{wrong}: {message}");
        assert!(!place.path("out").exists());
    }
    let place = place("scenario = \"scenario.toml\"\n[axes]\n\"system.stiffness[0]\" = [1.0, 2.0]\n");
    let structure = "[system]\nmass = [1.0]\nstiffness = [1.0]\n[time]\nstep = 0.1\nsteps = 5\n";
    let load = "pattern = { coordinate = 0 }\namplitude = \"1\"\n";
    place.write("scenario.toml", &format!("{structure}[[case]]\nname = \"a\"\n[[case.load]]\n{load}"));
    let output = place.fvi(&["sweep", "sweep.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("does not go together with a sweep"), "{}", text(&output.stderr));
    assert!(!place.path("out").exists());
}

#[test]
fn the_sweeps_of_the_repository_are_accepted() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/sweeps");
    for name in ["energy-left", "resonance", "stability"] {
        let plan = Sweep::read(&folder.join(format!("{name}.toml"))).unwrap();
        assert!(plan.scenario_of(plan.runs() - 1).is_ok(), "{name}");
    }
}

#[test]
fn runs_made_where_no_file_is_seen_come_back_to_the_same_bytes() {
    let place = place(GRID);
    let forces = "[input]\nfile = \"drive.csv\"\n[[system.load]]\npattern = { coordinate = 0 }\namplitude = { file = \"record.csv\" }\n";
    place.write("scenario.toml", &format!("{SCENARIO}{forces}"));
    place.write("record.csv", "t,a\n0,0\n3,0.1\n");
    place.write("drive.csv", "t,u0\n0,0.5\n1,0\n");
    place.write("other.csv", "t,u0\n0,-0.5\n1,0\n");
    let axes = "\"input.file\" = [\"drive.csv\", \"other.csv\"]\n[keep]\ntrajectories = true\n";
    place.write("sweep.toml", &GRID.replace("count = 7", "count = 3").replace("[keep]\n", axes));
    done(&place.fvi(&["sweep", "sweep.toml", "--out", "here"]));
    let plan = Sweep::read(&place.path("sweep.toml")).unwrap();
    let parts = plan.parts().unwrap();
    let names: Vec<&str> = parts.files.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["drive.csv", "other.csv", "record.csv"]);

    fs::remove_file(place.path("drive.csv")).unwrap();
    let sent = Sweep::of_parts(&parts).unwrap();
    let precision = fvi_simulation::simulation::Precision::F64;
    assert_eq!(sent.fingerprint(precision), plan.fingerprint(precision));
    let ledger = Ledger::open(&plan, SweepOptions::new(place.path("there"))).unwrap();
    assert_eq!(ledger.missing().unwrap(), (0..18).collect::<Vec<_>>());
    let tables = Tables::default();
    for run in (0..18).rev() {
        let (scratch, stop) = (place.path("scratch"), AtomicBool::new(false));
        let mut made = sent.make_elsewhere(run, precision, &scratch, &tables, &stop).unwrap().unwrap();
        made.record[9] ^= 1;
        assert!(!ledger.take(&plan, &made).unwrap());
        made.record[9] ^= 1;
        assert!(ledger.take(&plan, &made).unwrap());
    }
    let summary = ledger.finish(&plan).unwrap();
    assert_eq!((summary.done, summary.failed), (18, 6));
    let table = |directory: &str| fs::read(place.path(directory).join("results.csv")).unwrap();
    assert!(table("there") == table("here"));
    let runs = |directory: &str| results(&place.path(directory).join("runs"));
    assert_eq!(runs("here").len(), 12);
    assert!(runs("there") == runs("here"));

    // The rows at hand are those of the file.
    let columns = rows(&plan, &SweepOptions::new(place.path("there")), false).unwrap();
    let table = fs::read_to_string(place.path("here/results.csv")).unwrap();
    let names: Vec<&str> = columns.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names.join(","), table.lines().next().unwrap());
    for (row, line) in table.lines().skip(1).enumerate() {
        for ((name, column), cell) in columns.iter().zip(line.split(',')) {
            match column {
                Column::Whole(numbers) => assert_eq!(numbers[row].to_string(), cell, "{name}"),
                Column::Number(numbers) if numbers[row].is_nan() => assert_eq!(cell, "", "{name}"),
                Column::Number(numbers) => assert_eq!(numbers[row], cell.parse::<f64>().unwrap(), "{name}"),
                Column::Text(texts) if name != "message" => assert_eq!(texts[row], cell, "{name}"),
                Column::Text(texts) => {
                    assert!(texts[row].trim_start_matches('"').starts_with(cell.trim_start_matches('"')))
                }
            }
        }
    }
}

/// The last half of a run is one of its time, whatever the lengths of its steps.
#[test]
fn amplitudes_are_taken_over_a_share_of_the_time() {
    // q = (1 − e^{−2t})/2: from t = 5 to 10 half its range.
    let half_range = 0.25 * ((-10f64).exp() - (-20f64).exp());
    for (grid, tolerance) in [
        ("step = 0.01\nend = 10.0", 1e-6),
        ("grid = \"graded\"\nend = 10.0\nsteps = 1000\nexponent = 3.0", 0.05),
        ("grid = \"geometric\"\nend = 10.0\nfirst = 0.001\nratio = 1.02", 0.2),
        ("grid = \"adaptive\"\nend = 10.0\ntolerance = 1e-8\nmust_hit = [5.0]", 1e-4),
    ] {
        let place = Workplace::new();
        place.write(
            "scenario.toml",
            &format!(
                "system.mass = [1.0]\nsystem.force = [\"-2*v0\"]\ninitial = {{ position = [0.0], velocity = [1.0] }}\n\
                 scheme = {{ kind = \"collocation\" }}\n[time]\n{grid}\n"
            ),
        );
        let sweep = "scenario = \"scenario.toml\"\n[axes]\n\"initial.velocity[0]\" = [1.0]\n[keep]\nquantities = [\"amplitude\"]\nsettled = 0.5\n";
        place.write("sweep.toml", sweep);
        done(&place.fvi(&["sweep", "sweep.toml"]));
        let table = fs::read_to_string(place.path("out/sweep/results.csv")).unwrap();
        let found: f64 = table.lines().nth(1).unwrap().split(',').nth(4).unwrap().parse().unwrap();
        assert!((found / half_range - 1.0).abs() < tolerance, "{grid}: {found} {half_range}");
    }
}
