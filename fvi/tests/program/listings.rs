//! `fvi weights` and `fvi exponentials`: what the tables and constants say.

use std::process::{Command, Output};

fn fvi(arguments: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_fvi")).args(arguments.split_whitespace()).output().unwrap()
}

fn text(arguments: &str) -> String {
    let output = fvi(arguments);
    assert!(output.status.success(), "{arguments}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Rows of numbers under the given header.
fn rows(table: &str, header: &str) -> Vec<[f64; 2]> {
    let mut lines = table.lines().filter(|line| !line.starts_with('#'));
    assert_eq!(lines.next(), Some(header));
    lines
        .map(|line| {
            let (first, second) = line.split_once(',').unwrap();
            [first.parse().unwrap(), second.parse().unwrap()]
        })
        .collect()
}

#[test]
fn listed_exponentials_sum_up_to_the_listed_weights_behind_the_head() {
    let weights = rows(&text("weights --order 2 --exponent 0.5 --step 0.01 --count 3000"), "n,weight");
    let table = text("exponentials --order 2 --exponent 0.5 --step 0.01 --horizon 1e8 --tolerance 1e-12");
    let note = |name: &str| {
        let line = table.lines().find_map(|line| line.strip_prefix(&format!("# {name} = "))).unwrap();
        line.parse::<f64>().unwrap()
    };
    assert_eq!((note("horizon"), note("tolerance")), (1e8, 1e-12));
    let exponentials = rows(&table, "rate,coefficient");
    assert_eq!(weights.len(), 3000);
    for &[n, weight] in weights.iter().skip(note("head") as usize) {
        let sum: f64 = exponentials.iter().map(|[rate, coefficient]| coefficient * (-rate * n).exp()).sum();
        assert!((sum / weight - 1.0).abs() <= 1.1e-12, "n = {n}: {sum:e} and {weight:e}");
    }
}

#[test]
fn constants_hold_the_numbers_of_the_tables() {
    for format in ["rust", "c"] {
        // Constants of C are those of fvi.h, in single precision, and carry its suffix.
        let head = if format == "rust" {
            "1e0, -5e-1, -1.25e-1, -6.25e-2,"
        } else {
            "1e0f, -5e-1f, -1.25e-1f, -6.25e-2f,"
        };
        let constants = text(&format!("weights --order 1 --exponent 0.5 --count 6 --format {format}"));
        assert!(constants.contains(head), "{constants}");
        let constants =
            text(&format!("exponentials --exponent 0.5 --horizon 1e4 --tolerance 1e-3 --format {format}"));
        assert!(constants.contains(head), "{constants}");
        let scalar = if format == "rust" { "&[f64]" } else { "static const float fvi_head" };
        assert!(constants.contains(scalar), "{constants}");
        // In the other precision on request.
        let asked = |arguments: &str| {
            let precision = if format == "rust" { "f32" } else { "f64" };
            text(&format!("{arguments} --precision {precision} --format {format}"))
        };
        let other = [
            asked("weights --exponent 0.5 --count 6"),
            asked("exponentials --exponent 0.5 --tolerance 1e-3"),
        ];
        for constants in other {
            assert!(constants.contains(if format == "rust" { "f32" } else { "const double" }), "{constants}");
            assert!(constants.contains("1e0, -5e-1, -1.25e-1, -6.25e-2,"), "{constants}");
        }
        assert!(constants.contains(if format == "rust" {
            "horizon: 10000,"
        } else {
            "#define FVI_HORIZON UINT64_C(10000)\n"
        }));
    }
}

#[test]
fn a_table_has_no_end_unless_asked_for_and_one_that_ends_says_when() {
    let table = |arguments: &str| text(&format!("exponentials --exponent -0.8 --tolerance 1e-7 {arguments}"));
    let endless = table("--format rust --precision f32");
    assert_eq!(endless, table("--endless --format rust --precision f32"));
    assert!(!endless.contains("ends after"), "{endless}");
    assert!(endless.contains("horizon: fvi_core::ExponentialTable::<()>::ENDLESS,"), "{endless}");
    assert!(endless.contains("step_size: 1.0,") && !endless.contains("far_blocks: 0,"), "{endless}");
    let endless = table("--step 0.001 --format c");
    assert!(endless.contains("#define FVI_HORIZON FVI_ENDLESS\n"), "{endless}");
    assert!(endless.contains("#define FVI_STEP 1e-3\n"), "{endless}");
    assert!(table("").contains("# horizon = endless\n"));
    // In the file and on standard error.
    for format in ["rust", "c"] {
        let arguments = format!(
            "exponentials --exponent -0.8 --tolerance 1e-7 --step 0.01 --horizon 1e6 --format {format}"
        );
        let output = fvi(&arguments);
        let [file, said] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        assert!(file.contains("ends after 1000000 samples, 10000 units of time"), "{file}");
        assert_eq!(said, "note: a memory on this table ends after 1000000 samples, 10000 units of time\n");
    }
    // More than a word of 32 bits holds.
    let long = table("--horizon 1e10 --format c --precision f32");
    assert!(long.contains("#define FVI_HORIZON UINT64_C(10000000000)\n"), "{long}");
    let long = table("--horizon 1e10 --format rust --precision f32");
    assert!(long.contains("horizon: 10000000000,"), "{long}");
    // Kernels that end with their head have no horizon.
    let whole = text("exponentials --exponent 1 --horizon 1e4 --format c");
    assert!(!whole.contains("ends after"), "{whole}");
    assert!(whole.contains("#define FVI_HORIZON FVI_ENDLESS\n") && whole.contains(".exponentials = NULL"));
    let both = fvi("exponentials --exponent 0.5 --endless --horizon 5");
    assert_eq!(both.status.code(), Some(2));
}

/// With a band the table, and what is said of it, are for the frequencies of the band.
#[test]
fn tables_for_a_band_say_what_they_are_worth_there() {
    let band = "exponentials --exponent 0.5 --increments --step 0.001 --band 0.0025 250 --tolerance";
    let output = fvi(&format!("{band} 1e-2 --format c"));
    let [file, said] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert!(file.contains("#define FVI_EXPONENTIALS 16\n"), "two blocks of eight numbers: {file}");
    for text in [&file, &said] {
        assert!(text.contains("from 0.0025 to 250 Hz within 9."), "{text}");
        assert!(text.contains(" dB, ") && text.contains("degrees of the operator"), "{text}");
    }
    for (arguments, named) in [
        (format!("{band} 1e-9"), "tolerance = 0.000000001 is not allowed: it must be at least 1e-7"),
        (
            "exponentials --exponent 0.5 --band 0.1 0.7 --tolerance 1e-2".to_owned(),
            "upper end of the band = 0.7",
        ),
        (format!("{band} 1e-2 --horizon 1e4"), "cannot be used with"),
    ] {
        let output = fvi(&arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments}");
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(message.contains(named), "{arguments}: {message}");
    }
}

#[test]
fn filters_of_the_literature_are_listed_in_three_forms() {
    let filter =
        |rest: &str| text(&format!("filter --exponent -0.5 --step 0.001 --band 1 100 --order 4 {rest}"));
    for design in ["oustaloup", "matsuda"] {
        for (form, header, rows) in
            [("poles", "gain,zero,pole", 4), ("sections", "b0,b1,a1", 4), ("transfer", "n,b,a", 5)]
        {
            let table = filter(&format!("--design {design} --form {form}"));
            assert!(table.contains(" dB, ") && table.contains(" degrees of the operator"), "{table}");
            let mut lines = table.lines().skip(1);
            assert_eq!((lines.next(), lines.count()), (Some(header), rows), "{table}");
        }
    }
    let refused = fvi("filter --design oustaloup --exponent 1.5 --step 0.001 --band 1 100 --order 4");
    assert_eq!(refused.status.code(), Some(2));
}

/// A controller for a band: every operator's table, in the file and in the message.
#[test]
fn a_controller_for_a_band_has_short_tables() {
    let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/scenarios/controlled-stage.toml");
    for format in ["rust", "c"] {
        let output = fvi(&format!("controller {scenario} --band 0.01 10 --tolerance 1e-2 --format {format}"));
        let [file, said] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        for part in ["integral", "derivative"] {
            assert!(said.contains(&format!("note: controller {part}: from 0.01 to 10 Hz within ")), "{said}");
        }
        assert_eq!(file.matches("; from 0.01 to 10 Hz within ").count(), 2, "{file}");
        assert!(!file.contains("ends after"), "{file}");
    }
    let alone = fvi(&format!("controller {scenario} --format c --tolerance 1e-2"));
    assert_eq!(alone.status.code(), Some(2));
}

/// A limit beyond single precision is none there, and a filter without a time none at all.
#[test]
fn constants_in_c_are_declared() {
    let place = crate::workplace::Workplace::new();
    let controller = "[controller]\nmeasures = \"q0\"\nsetpoint = \"0\"\ndrives = [1.0]\nkp = 2.0\nki = 0.2\nkd = 0.5\n\
                      lambda = 0.7\nmu = 0.6\nsample = 0.01\n";
    let listed = |more: &str| {
        place.write("c.toml", &format!("{controller}{more}"));
        let output = place.fvi(&["controller", "c.toml", "--format", "c", "--name", "x"]);
        assert!(output.status.success(), "{}", crate::workplace::text(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let header = listed("limits = [0.0, 1e39]\n");
    assert!(
        header.starts_with("#include <math.h>\n") && header.contains(".limits = {0e0f, INFINITY}"),
        "{header}"
    );
    let none = listed("derivative_filter = { time = 0.0, order = 0.5 }\n");
    assert!(none == listed("") && !none.contains("FILTER") && !none.contains("math.h"), "{none}");
}

/// A controller in whole numbers says what its counts are worth and how far rounding goes, and is refused
/// where it would not be the law.
#[test]
fn a_controller_in_whole_numbers_says_its_units_and_its_rounding() {
    let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/scenarios/controlled-stage.toml");
    let band = format!("controller {scenario} --band 0.01 10 --tolerance 1e-2 --arithmetic fixed");
    let units = "--input-unit 1e-5 --output-unit 0.001";
    for (format, constants) in [
        ("rust", ["pub const STAGE_LAW: fvi_core::FixedLaw<'static>", "pub fn new_stage()"]),
        ("c", ["static const FviFixedLaw stage_law = {", "#define STAGE_NUMBERS "]),
    ] {
        let output = fvi(&format!("{band} {units} --format {format} --name stage"));
        let [file, said] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        let worth = "a count of setpoint and measured value is 0.00001, of the output 0.001; inputs saturate at ±8388607 counts; \
                     the output is within 0.5";
        for text in [&file.replace("\n///", ""), &said] {
            assert!(text.contains(worth), "{text}");
        }
        assert!(constants.iter().all(|constant| file.contains(constant)), "{file}");
        assert!(!file.contains("f32") && !file.contains("float"), "{file}");
    }
    for (arguments, said) in [
        (format!("{band} --format c"), "--input-unit"),
        (format!("controller {scenario} --arithmetic fixed {units} --format c"), "--band"),
        (format!("{band} {units} --format rust --precision f64"), "--precision"),
        (format!("controller {scenario} {units} --format c"), "--arithmetic fixed"),
        (format!("{band} --input-unit 0 --output-unit 1 --format c"), "unit of the inputs = 0"),
        (format!("{band} --input-unit 1 --output-unit 1e-12 --format c"), "limits"),
    ] {
        let output = fvi(&arguments);
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && message.contains(said), "{arguments}: {message}");
    }
}

/// A notch is written as a filter, and what cannot be is refused.
#[test]
fn symbols_with_complex_poles_are_filters() {
    let of = |symbol: &str, more: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_fvi"));
        command.args(["exponentials", "--symbol", symbol, "--step", "0.01"]).args(more.split_whitespace());
        let output = command.output().unwrap();
        let [said, message] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        (output.status.code(), said, message)
    };
    let notch = "(s^2 + 4)/(s^2 + 0.4*s + 4)";
    let (code, rust, message) = of(notch, "--format rust --precision f32 --name notch");
    assert_eq!(code, Some(0), "{message}");
    assert!(rust.contains("pub struct Notch {") && rust.contains("sample: f32) -> f32"), "{rust}");
    let (_, c, _) = of(notch, "--format c --name notch");
    assert!(c.contains("} Notch;") && c.contains("static inline float notch_tick(Notch *filter"), "{c}");
    let (_, csv, _) = of(notch, "");
    assert!(csv.lines().nth(2) == Some("re,im,coefficient_re,coefficient_im"), "{csv}");
    // Backward Euler: ρ = 1/(1 − h p) with p = −0.2 + 1.98997… i.
    let row: Vec<f64> = csv.lines().nth(3).unwrap().split(',').map(|cell| cell.parse().unwrap()).collect();
    let [re, im] = [1.0 + 0.01 * 0.2, -0.01 * (4.0f64 - 0.04).sqrt()];
    let size = re * re + im * im;
    assert!((row[0] - re / size).abs() < 1e-12 && (row[1].abs() + im / size).abs() < 1e-12, "{row:?}");
    for (symbol, more, code, part) in [
        ("1/(s^2 + 0.4*s + 4)^2", "", 2, "horizon"),
        ("1/(s^2 + 0.4*s + 4)^2", "--horizon 3000 --tolerance 1e-6", 0, ""),
        (notch, "--band 0.1 1 --tolerance 1e-2", 2, "--band shortens tables of real exponentials"),
        ("1/(s + 1)^2", "--band 0.1 1 --tolerance 1e-2", 2, "come in pairs"),
        ("exp(-0.1*s)/(s + 1)", "--band 0.1 1 --tolerance 1e-2", 2, "come in pairs"),
        // No more exponentials than poles.
        ("(s + 1)/(0.1*s + 1)", "--band 0.01 10 --tolerance 1e-7", 0, "note: 1 exponentials"),
        (
            "(s + 1)*(s + 20)/((0.1*s + 1)*(s + 50))",
            "--band 0.01 10 --tolerance 1e-7",
            0,
            "note: 2 exponentials",
        ),
        ("(s^2 + 4)/(s^2 - 0.4*s + 4)", "", 2, "analytic for Re s > 0"),
        // What fades: a double pole, a fractional lead–lag, a filter behind a delay.
        ("1/(s + 1)^2", "--tolerance 1e-9", 0, ""),
        ("((1 + s)/(1 + 0.1*s))^0.5", "--tolerance 1e-7", 0, ""),
        ("exp(-0.1*s)/(s + 1)", "--tolerance 1e-7", 0, ""),
        ("1/(s^2 + 0.4*s + 4)", "--tolerance 1e-9", 0, ""),
        ("1/(s^2 + 0.4*s + 4)", "", 1, "the best has"),
    ] {
        let (found, _, message) = of(symbol, more);
        assert!(found == Some(code) && message.contains(part), "{symbol} {more}: {found:?} {message}");
    }
}

#[test]
fn tables_of_several_operators_have_names() {
    let arguments =
        "exponentials --exponent 0.5 --horizon 1e4 --tolerance 1e-3 --precision f32 --name Half_rate2";
    let c = text(&format!("{arguments} --format c"));
    for name in [
        "#define HALF_RATE2_HEAD 5",
        "half_rate2_head[HALF_RATE2_HEAD]",
        "HALF_RATE2_TABLE",
        "HALF_RATE2_NUMBERS(channels)",
    ] {
        assert!(c.contains(name), "{name}: {c}");
    }
    assert!(!c.to_lowercase().contains("define fvi_") && !c.contains("fvi_head"), "{c}");
    let rust = text(&format!("{arguments} --format rust"));
    assert!(rust.contains("pub const HALF_RATE2: fvi_core::ExponentialTable<&[f32]>"), "{rust}");
    let weights = text("weights --exponent 0.5 --count 2 --format c --name half");
    assert!(weights.contains("static const float half_weights[HALF_WEIGHTS]"), "{weights}");
    let weights = text("weights --exponent 0.5 --count 2 --format rust --name half");
    assert!(weights.contains("pub const HALF: [f64; 2]"), "{weights}");
    let rates = text("rates --stages 1 --exponent 0.5 --shortest 0.1 --horizon 9 --format rust --name half");
    assert!(rates.contains("pub const HALF: fvi_core::RateTable<&[f64]>"), "{rates}");
    for name in ["9a", "_a", "a-b", "a.b", "é", ""] {
        let output = Command::new(env!("CARGO_BIN_EXE_fvi"))
            .args(["weights", "--exponent", "0.5", "--name", name])
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(2), "{name:?}");
    }
}

#[test]
fn arguments_outside_their_range_end_with_code_two_and_the_parameter() {
    for (arguments, named) in [
        ("weights --exponent 2", "exponent = 2 is not allowed"),
        (
            "weights --exponent 0.5 --order 7",
            "order of the backward differentiation formula = 7 is not allowed",
        ),
        ("weights --exponent 0.5 --family radau-iia --stages 4", "1, 2, 3, 5 or 7 with the family radau-iia"),
        ("weights --exponent 0.5 --family lobatto-iiic", "2, 3 or 4 with the family lobatto-iiic"),
        ("weights --exponent 0.5 --stages 2", "none with the family bdf"),
        ("exponentials --exponent 0.5 --horizon 0", "horizon = 0 is not allowed"),
        ("exponentials --exponent 0.5 --tolerance 1e-17", "tolerance"),
    ] {
        let output = fvi(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments}");
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(message.contains(named), "{arguments}: {message}");
    }
}

#[test]
fn a_listing_goes_to_a_file_as_a_whole() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("weights.csv");
    let arguments = "weights --exponent 0.5 --count 5";
    assert_eq!(text(&format!("{arguments} --out {}", path.display())), "");
    assert_eq!(std::fs::read_to_string(path).unwrap(), text(arguments));
    let missing = directory.path().join("missing").join("weights.csv");
    assert_eq!(fvi(&format!("{arguments} --out {}", missing.display())).status.code(), Some(1));
}

#[test]
fn matrix_weights_are_listed_entry_by_entry() {
    // D¹ by Radau IIA of 2 stages, h = ½: W₀ = A⁻¹/h, and W₁ = −A⁻¹1bᵀA⁻¹/h has a zero first column.
    let table = text("weights --family radau-iia --stages 2 --exponent 1 --step 0.5 --count 3");
    let mut lines = table.lines();
    assert_eq!(lines.next(), Some("n,row,column,weight"));
    let entries: Vec<(String, f64)> = lines
        .map(|line| line.rsplit_once(',').unwrap())
        .map(|(place, weight)| (place.to_owned(), weight.parse().unwrap()))
        .collect();
    let expected = [3.0, 1.0, -9.0, 5.0, 0.0, -4.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(entries.len(), 12);
    for (index, ((place, weight), expected)) in entries.iter().zip(expected).enumerate() {
        assert_eq!(place, &format!("{},{},{}", index / 4, index / 2 % 2, index % 2));
        assert!((weight - expected).abs() < 1e-14, "{place}: {weight} {expected}");
    }
    let constants =
        text("weights --family radau-iia --stages 2 --exponent 1 --step 0.5 --count 3 --format c");
    assert!(constants.contains("entry (i, j) of weight n at (i*2 + j)*3 + n"), "{constants}");
    assert!(constants.contains("#define FVI_WEIGHTS 12\n"), "{constants}");
}

#[test]
fn rates_of_other_kernels_are_listed_and_refused_where_there_are_none() {
    // s/(1 + s^½) = s Σ c/(s + λ).
    let range = "--stages 3 --shortest 0.001 --horizon 100 --tolerance 1e-12";
    let listed = |symbol: &str, more: &str| {
        let arguments = format!("rates {range} {more}");
        let mut command = Command::new(env!("CARGO_BIN_EXE_fvi"));
        let output = command.args(arguments.split_whitespace()).args(["--symbol", symbol]).output().unwrap();
        (
            output.status.code(),
            String::from_utf8(output.stdout).unwrap(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    let (code, table, _) = listed("s/(1 + s^0.5)", "");
    assert!(code == Some(0) && table.contains("# K(s)/s^1 = sum of coefficient/(s + rate)"), "{table}");
    let rates = rows(&table, "rate,coefficient");
    // Relaxations that are slower than the horizon are merged, which shows below the inverse of it.
    for s in [0.1, 1.0, 300.0] {
        let sum: f64 = rates.iter().map(|[rate, coefficient]| coefficient * s / (s + rate)).sum();
        assert!((sum * (1.0 + s.sqrt()) / s - 1.0).abs() < 2e-12, "{s}: {sum}");
    }
    let (code, constant, _) = listed("s/(1 + s^0.5)", "--format rust --precision f32");
    assert!(code == Some(0) && constant.contains("leading: &[\n    ],"), "{constant}");
    let (code, _, message) = listed("0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)", "");
    assert!(
        code == Some(2) && message.contains("singularities must all lie on the negative real axis"),
        "{message}"
    );
}

#[test]
fn listed_rates_sum_up_to_the_kernel_of_their_integral() {
    // s^(−1/2) is the integral of order 1/2, with the kernel 1/√(πt).
    let arguments = "rates --stages 3 --exponent 0.5 --shortest 0.001 --horizon 1e4 --tolerance 1e-10";
    let rates = rows(&text(arguments), "rate,coefficient");
    for t in [1.0_f64, 7.0, 300.0, 5000.0] {
        let sum: f64 = rates.iter().map(|[rate, coefficient]| coefficient * (-rate * t).exp()).sum();
        let kernel = 1.0 / (std::f64::consts::PI * t).sqrt();
        assert!((sum / kernel - 1.0).abs() < 1e-9, "t = {t}: {sum:e} and {kernel:e}");
    }
    let constant = text(&format!("{arguments} --format rust --precision f32"));
    assert!(constant.contains("pub const TABLE: fvi_core::RateTable<&[f32]>"), "{constant}");
    assert!(constant.contains("exponent: 0.5,") && constant.contains("horizon: 10000.0,"), "{constant}");
    for (arguments, named) in [
        (
            "rates --stages 4 --exponent 0.5 --shortest 1 --horizon 2",
            "1, 2, 3, 5 or 7 with the family radau-iia",
        ),
        ("rates --stages 1 --exponent 0.5 --shortest 2 --horizon 1", "horizon = 1 is not allowed"),
        ("rates --stages 1 --exponent 2 --shortest 1 --horizon 2", "exponent"),
        ("rates --stages 1 --exponent 0.5 --shortest 1e-300 --horizon 1", "shortest step"),
        ("rates --stages 1 --exponent 1.99 --shortest 1 --horizon 1e308", "horizon"),
        (
            "rates --stages 1 --exponent 0.5 --shortest 1e-40 --horizon 1e-30 --format rust --precision f32",
            "shortest",
        ),
    ] {
        let output = fvi(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments}");
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(message.contains(named), "{arguments}: {message}");
    }
}
