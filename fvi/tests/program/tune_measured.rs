//! `fvi tune` of plants by their measured frequency response: made from plants that are known, with which the
//! tunings are compared.

use crate::tune::{Complex, number, tune};
use crate::workplace::{Workplace, text};
use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;
use std::fs;

/// 2 (s + 3) e^{−0.35 s}/((s + 1)(s² + 0.4 s + 4))
fn plant(omega: f64) -> Complex {
    let s = Complex(0.0, omega);
    let below = s.plus(Complex(1.0, 0.0)).times(s.times(s).plus(s.scaled(0.4)).plus(Complex(4.0, 0.0)));
    let late = Complex((0.35 * omega).cos(), -(0.35 * omega).sin());
    s.plus(Complex(3.0, 0.0)).scaled(2.0).times(late).times(below.inverse())
}

const FORMULA: &str = "transfer = \"2*(s + 3)*exp(-0.35*s)/((s + 1)*(s^2 + 0.4*s + 4))\"";

/// `count` frequencies in geometric sequence.
fn frequencies(from: f64, to: f64, count: u32) -> impl Iterator<Item = f64> {
    (0..count).map(move |k| from * (to / from).powf(f64::from(k) / f64::from(count - 1)))
}

/// Numbers of mean 0 and standard deviation 1, the same in every run.
fn noise(index: u32) -> f64 {
    let mut state = u64::from(index).wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(0x1234_5678);
    let mut uniform = || {
        state = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        state ^= state >> 27;
        ((state >> 11) as f64 + 1.0) / (1u64 << 53) as f64
    };
    (-2.0 * uniform().ln()).sqrt() * (TAU * uniform()).cos()
}

/// Rows omega, re, im, with relative noise.
fn table(from: f64, to: f64, count: u32, deviation: f64) -> String {
    let mut rows = "omega,re,im\n".to_owned();
    for (k, omega) in (0..).zip(frequencies(from, to, count)) {
        let error = Complex(1.0 + deviation * noise(2 * k), deviation * noise(2 * k + 1));
        let value = plant(omega).times(error);
        let _ = writeln!(rows, "{omega},{},{}", value.0, value.1);
    }
    rows
}

fn problem(plant: &str, specification: &str) -> String {
    format!(
        "[plant]\n{plant}\n[controller]\nstructure = \"pi\"\nlambda = 1.0\nsample = 0.1\n\
         [specification]\n{specification}\n"
    )
}

const CROSSOVER: &str = "crossover = 0.3\nphase_margin = 75";

#[test]
fn a_response_without_noise_leads_to_the_tuning_of_its_plant() {
    let place = Workplace::new();
    place.write("response.csv", &table(0.02, 60.0, 120, 0.0));
    for specification in [CROSSOVER, "ms = 1.6"] {
        let known = tune(&place, &problem(FORMULA, specification));
        let found = tune(&place, &problem("response = \"response.csv\"", specification));
        for key in ["kp", "ki", "sampled_margins.ms", "sampled_margins.gain_margin", "ultimate.gain"] {
            let [found, known] = [&found, &known].map(|record| number(record, key));
            assert!((found / known - 1.0).abs() < 1e-5, "{specification}, {key}: {found} for {known}");
        }
        assert_eq!(number(&found, "plant.response.order"), 3.0);
        assert!(number(&found, "plant.response.deviation") < 1e-6);
        assert!((number(&found, "plant.dead_time") - 0.35).abs() < 1e-5);
    }
}

/// As analysers write it: Hz, decibels, degrees without jumps, frequencies downwards, a row without a number.
#[test]
fn hertz_decibels_and_degrees_are_taken() {
    let place = Workplace::new();
    let mut phase = 0.0;
    let mut rows: Vec<String> = Vec::new();
    for omega in frequencies(0.02, 60.0, 120) {
        let value = plant(omega);
        phase += (value.phase() - phase + PI).rem_euclid(TAU) - PI;
        rows.push(format!("{};{};{}", omega / TAU, 20.0 * value.size().log10(), phase.to_degrees()));
    }
    rows.reverse();
    rows.insert(7, "0.5;NaN;3".to_owned());
    place.write("sweep.csv", &format!("Frequency (Hz);Gain (dB);Phase (deg)\n{}\n", rows.join("\n")));
    let plant = "response = \"sweep.csv\"\n\
                 columns = { f = \"Frequency\", magnitude = \"Gain\", phase = \"Phase\" }";
    let known = tune(&place, &problem(FORMULA, CROSSOVER));
    let found = tune(&place, &problem(plant, CROSSOVER));
    for key in ["kp", "ki"] {
        let [found, known] = [&found, &known].map(|record| number(record, key));
        assert!((found / known - 1.0).abs() < 1e-5, "{key}: {found} for {known}");
    }
    assert!(found["warnings"].to_string().contains("1 of 121 rows is left out"), "{}", found["warnings"]);
    // The same in words of the problem, where the file has no units.
    let bare = rows.iter().map(|row| row.replace(';', ",")).collect::<Vec<_>>().join("\n");
    place.write("sweep.csv", &format!("f,magnitude,phase\n{bare}\n"));
    let plant = "response = \"sweep.csv\"\nunits = { magnitude = \"dB\", phase = \"deg\" }";
    assert_eq!(number(&tune(&place, &problem(plant, CROSSOVER)), "kp"), number(&found, "kp"));
}

/// With 1 % noise the loop with the plant itself has what was specified within 1 % and a degree.
#[test]
fn noise_in_the_data_is_noise_in_the_margins() {
    let place = Workplace::new();
    for count in [60, 600] {
        place.write("response.csv", &table(0.02, 60.0, count, 0.01 / 2f64.sqrt()));
        let found = tune(&place, &problem("response = \"response.csv\"", CROSSOVER));
        let [kp, ki] = ["kp", "ki"].map(|key| number(&found, key));
        let open = |omega: f64| {
            // The sampled law and the delay of its hold; the rest of the hold is some 10⁻⁴ here.
            let z = Complex(1.0 - (0.1 * omega).cos(), (0.1 * omega).sin()).scaled(10.0);
            let held = Complex((0.05 * omega).cos(), -(0.05 * omega).sin());
            Complex(kp, 0.0).plus(z.inverse().scaled(ki)).times(plant(omega)).times(held)
        };
        let crossed = open(0.3);
        assert!((crossed.size() - 1.0).abs() < 0.01, "{count}: {crossed:?}");
        assert!((crossed.phase().to_degrees() + 105.0).abs() < 1.0, "{count}: {crossed:?}");
    }
}

/// An integrator is said; the model has it, and so does the loop that runs, with a dead time between two
/// samples.
#[test]
fn the_model_of_a_response_runs() {
    let place = Workplace::new();
    let mut rows = "omega,re,im\n".to_owned();
    for omega in frequencies(0.01, 60.0, 100) {
        // e^{−0.3137 s}/(s (s + 1))
        let late = Complex((0.3137 * omega).cos(), -(0.3137 * omega).sin());
        let value = late.times(Complex(-omega * omega, omega).inverse());
        let _ = writeln!(rows, "{omega},{},{}", value.0, value.1);
    }
    place.write("response.csv", &rows);
    let found = tune(&place, &problem("response = \"response.csv\"\nintegrators = 1", "ms = 1.6"));
    assert_eq!(number(&found, "plant.response.order"), 2.0);
    let scenario = fs::read_to_string(place.path("out/loop.toml")).unwrap();
    assert!(scenario.contains("# By measurement: the model of the plant has order 2"), "{scenario}");
    let output = place.fvi(&["run", "out/loop.toml", "--out", "run"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let read = |file: &str| -> Vec<Vec<f64>> {
        let content = fs::read_to_string(place.path(file)).unwrap();
        content.lines().skip(1).map(|l| l.split(',').map(|cell| cell.parse().unwrap()).collect()).collect()
    };
    let (ran, known) = (read("run/trajectory.csv"), read("out/steps.csv"));
    for step in &known {
        let row = ran.iter().find(|row| row[0] >= step[0]).unwrap();
        assert!((row[row.len() - 1] - step[1]).abs() < 0.04, "at {}", step[0]);
    }
    // Without a word about it the model has a pole next to zero.
    let again = tune(&place, &problem("response = \"response.csv\"", "ms = 1.6"));
    assert_eq!(number(&again, "plant.response.order"), 2.0);
    assert!((number(&again, "kp") / number(&found, "kp") - 1.0).abs() < 1e-3);
}

#[test]
fn what_data_do_not_cover_is_refused_with_its_frequency() {
    let place = Workplace::new();
    for (from, to, specification, code, part) in [
        (0.02, 0.5, "crossover = 0.3\nphase_margin = 75", 1, "the data end at ω = 0.500000, and |L| is"),
        (0.25, 60.0, "crossover = 0.3\nphase_margin = 75", 1, "the data begin at ω = 0.250000"),
        (0.02, 0.2, CROSSOVER, 2, "among the frequencies of `plant.response`, 0.020000 to 0.200000"),
        (
            0.02,
            60.0,
            "crossover = 0.3\nphase_margin = 75\nsensitivity = [{ at = 0.001, below = -20 }]",
            2,
            "sensitivity[0].at",
        ),
        (
            0.02,
            60.0,
            "crossover = 0.3\nphase_margin = 75\ncomplementary = [{ from = 10, to = 100, below = -20 }]",
            2,
            "complementary[0].to",
        ),
    ] {
        place.write("response.csv", &table(from, to, 100, 0.0));
        place.write("plant.toml", &problem("response = \"response.csv\"", specification));
        let output = place.fvi(&["tune", "plant.toml", "--out", "out"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{from} {to}: {message}");
        assert!(message.contains(part), "{from} {to}: {message}");
    }
}

#[test]
fn responses_that_say_too_little_are_refused() {
    let place = Workplace::new();
    let good = table(0.02, 60.0, 60, 0.0);
    let noisy = table(0.02, 60.0, 60, 0.1);
    let rows = |header: &str, row: &dyn Fn(f64) -> String| {
        let rows: Vec<String> = frequencies(0.1, 10.0, 20).map(row).collect();
        format!("{header}\n{}\n", rows.join("\n"))
    };
    let magnitudes = |header: &str| rows(header, &|omega| format!("{omega},{},-10", 1.0 / omega));
    for (content, keys, part) in [
        (noisy, "", "`tolerance` is 0.05"),
        (magnitudes("omega,magnitude,phase"), "", "a phase without a unit"),
        (magnitudes("omega,magnitude,phase (turns)"), "", "neither deg nor rad"),
        (magnitudes("omega,magnitude,im"), "", "two columns of one kind"),
        (magnitudes("omega,magnitude,angle"), "", "column 3 (angle): unknown"),
        (magnitudes("t,re,im"), "", "a table over t"),
        (rows("omega,magnitude,phase (deg)", &|w| format!("{w},{},0", -w)), "", "magnitude = \"dB\""),
        (rows("omega,re,im", &|w| format!("{},1,0", w - 1.0)), "", "is not a frequency > 0"),
        (rows("omega,re,im", &|w| format!("{w},0,0")), "", "a response of zero"),
        (good.lines().take(6).collect::<Vec<_>>().join("\n"), "", "8 frequencies at least, not 5"),
        (good.clone(), "gain = 2.0", "gain"),
        (good.clone(), "tolerance = 1.5", "greater than 0 and less than 1"),
        (good.clone(), "dead_time = 9.0", "with a dead time of 9"),
        (good, "time_constant = 2.0", "plant.time_constant"),
    ] {
        place.write("response.csv", &content);
        place.write("plant.toml", &problem(&format!("response = \"response.csv\"\n{keys}"), CROSSOVER));
        let output = place.fvi(&["tune", "plant.toml", "--out", "out"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{part}: {message}");
        assert!(message.contains(part), "{part}: {message}");
    }
}

/// The example of the repository, and its data by the formula that its script says.
#[test]
fn the_example_is_tuned_run_and_made_into_constants() {
    let place = Workplace::new();
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/tunings/oven.toml");
    let output = place.fvi(&["tune", example, "--out", "oven"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    assert!(said.contains("the model of the plant has order 2 and a dead time of"), "{said}");
    let output = place.fvi(&["run", "oven/loop.toml", "--out", "run"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let trajectory = fs::read_to_string(place.path("run/trajectory.csv")).unwrap();
    let last = trajectory.lines().last().unwrap().rsplit(',').next().unwrap();
    assert!((last.parse::<f64>().unwrap() - 10.0).abs() < 0.05, "{last}");
    let output = place.fvi(&["controller", "oven/loop.toml", "--format", "c", "--name", "oven"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let data =
        fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/tunings/oven-response.csv"));
    let data = data.unwrap();
    let rows = data
        .lines()
        .skip(2)
        .map(|row| row.split(',').map(|cell| cell.parse().unwrap()).collect::<Vec<f64>>());
    for row in rows {
        let omega = TAU * row[0];
        let known = 1.8 / ((90.0 * omega).hypot(1.0) * (12.0 * omega).hypot(1.0));
        let phase = -6.0 * omega - (90.0 * omega).atan() - (12.0 * omega).atan();
        assert!((10f64.powf(row[1] / 20.0) / known - 1.0).abs() < 0.04, "{row:?}");
        assert!((row[2].to_radians() - phase).abs() < 0.04, "{row:?}");
    }
}
