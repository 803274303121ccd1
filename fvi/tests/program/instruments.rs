//! Tables as instruments and programs of laboratories write them: one truth comes from every file, or the
//! file is refused with its line and what would be read.

use crate::workplace::{Workplace, text};
use nalgebra::Complex;
use serde_json::Value;
use std::f64::consts::TAU;
use std::fs;

/// A spring of stiffness 1 beside (iω)^½/(1 + (iω)^½), a fractional Maxwell element of time 1.
const MATERIAL: &str = r#"
[system]
mass = [1.0]
potential = "0.5*e*q0^2"
parameters = { e = 1.0 }
[[system.damping]]
coefficient = [1.0]
kernel = { form = "maxwell", order = 0.5, time = 1.0 }
[time]
step = 0.1
steps = 10
"#;

const FREE: &str = r#"
scenario = "scenario.toml"
[[free]]
path = "system.damping[0].kernel.order"
start = 0.6
[[free]]
path = "system.damping[0].kernel.time"
start = 2.0
scale = "log"
[[data]]
file = "data.txt"
quantity = "modulus"
"#;

/// ω, storage and loss modulus, from ω = 0.1 to 10.
fn moduli() -> Vec<[f64; 3]> {
    let row = |k: i32| {
        let omega = 10f64.powf(0.1 * f64::from(k));
        let root = Complex::new(0.0, omega).sqrt();
        let modulus = root / (root + 1.0) + 1.0;
        [omega, modulus.re, modulus.im]
    };
    (-10..=10).map(row).collect()
}

/// Lines before the rows, and the rows.
fn with(head: &str, row: impl Fn(usize, [f64; 3]) -> String) -> String {
    moduli()
        .into_iter()
        .enumerate()
        .fold(head.to_owned(), |all, (index, numbers)| all + &row(index, numbers) + "\n")
}

fn comma(number: f64) -> String {
    format!("{number:.10E}").replace('.', ",")
}

fn latin(text: &str) -> Vec<u8> {
    text.chars().map(|letter| u8::try_from(u32::from(letter)).unwrap()).collect()
}

fn utf16(text: &str) -> Vec<u8> {
    "\u{feff}".encode_utf16().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect()
}

fn fit(keys: &str, data: &[u8]) -> (Workplace, std::process::Output) {
    let place = Workplace::new();
    place.write("scenario.toml", MATERIAL);
    place.write("fit.toml", &format!("{FREE}{keys}\n"));
    fs::write(place.path("data.txt"), data).unwrap();
    let output = place.fvi(&["fit", "fit.toml", "--out", "out"]);
    (place, output)
}

/// The numbers of a row with a sign between them.
fn plain(row: [f64; 3], sign: &str) -> String {
    format!("{:.12e}{sign}{:.12e}{sign}{:.12e}", row[0], row[1], row[2])
}

/// The files of instruments, each with the keys of its `[[data]]`.
fn files_of_instruments() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    let angular =
        "columns = { omega = \"Angular frequency\", storage = \"Storage modulus\", loss = \"Loss modulus\" }";
    let capital = "columns = { omega = \"Angular Frequency\", storage = \"Storage Modulus\", loss = \"Loss Modulus\" }\ndecimal = \",\"";
    vec![
        (
            "TRIOS, text",
            angular,
            latin(&with(
                "Filename\tsweep.tri\nInstrument name\tDHR-3\nTemperature\t25 °C\n\n[step]\nFrequency sweep - 1\n\
                 Angular frequency\tStorage modulus\tLoss modulus\tTan(delta)\tTorque\nrad/s\tMPa\tMPa\t\tµN.m\n",
                |_, row| format!("{}\t{:.4}\t12.1", plain(row, "\t"), row[2] / row[1]),
            )),
        ),
        (
            "TRIOS, loss factor by its name with brackets",
            "columns = { omega = \"Angular frequency\", storage = \"Storage modulus\", tan_delta = \"Tan(delta)\" }\nrelative_deviation = 0.01",
            with("Angular frequency,Storage modulus,Tan(delta)\nrad/s,Pa,\n", |_, row| {
                format!("{:.12e},{:.12e},{:.12e}", row[0], row[1], row[2] / row[1])
            })
            .into_bytes(),
        ),
        (
            "RheoCompass, UTF-16, its list of variables above the header",
            capital,
            utf16(&with(
                "Project:\tRubber\r\nVariables:\tAngular Frequency\tStorage Modulus\tLoss Modulus\r\n\r\nResult:\tSweep 1\r\n\
                 Interval and data points:\t1\t21\r\n\
                 Interval data:\tPoint No.\tAngular Frequency\tStorage Modulus\tLoss Modulus\tMeas. Status\r\n\t\t\t\t\t\r\n\
                 \t\t[rad/s]\t[Pa]\t[Pa]\t\r\n",
                |index, row| {
                    format!("\t{}\t{}\t{}\t{}\tDSO\r", index + 1, comma(row[0]), comma(row[1]), comma(row[2]))
                },
            )),
        ),
        (
            "Rheoplus, [1/s]",
            "columns = { omega = \"Angular Frequency\", storage = \"Storage Modulus\", loss = \"Loss Modulus\" }\nunits = { omega = \"rad/s\" }",
            with("Meas. Pts.;Angular Frequency;Storage Modulus;Loss Modulus\n;[1/s];[Pa];[Pa]\n", |index, row| {
                format!("{};{}", index + 1, plain(row, ";"))
            })
            .into_bytes(),
        ),
        (
            "rSpace, quoted names that contain brackets",
            "columns = { omega = \"Angular frequency\", storage = \"Shear modulus (elastic component)\", loss = \"Shear modulus (viscous component)\" }",
            with(
                "\"Sample\",\"7\"\n\"Angular frequency (rad/s)\",\"Shear modulus (elastic component) (Pa)\",\"Shear modulus (viscous component) (Pa)\"\n",
                |_, row| plain(row, ","),
            )
            .into_bytes(),
        ),
        (
            "Netzsch, its header a comment in Latin-1",
            "columns = { f = \"f\", storage = \"E'\", loss = \"E''\" }",
            latin(&with("#IDENTITY:;PA6\n#RANGE:;25°C\n##f/Hz;E'/MPa;E''/MPa\n", |_, row| {
                plain([row[0] / TAU, row[1], row[2]], ";")
            })),
        ),
        (
            "RheoWin, 'in' before units, decimal commas",
            "columns = { f = \"f\", storage = \"G'\", loss = \"G''\" }\ndecimal = \",\"",
            with("f in Hz;G' in Pa;G'' in Pa\n", |_, row| {
                format!("{};{};{}", comma(row[0] / TAU), comma(row[1]), comma(row[2]))
            })
            .into_bytes(),
        ),
        (
            "STARe, spaces, units in brackets in line with the names, one of a column without any missing",
            "columns = { f = \"Freq\", storage = \"E'\", loss = \"E''\" }",
            latin(&with(
                "Curve Name:\r\n  Rubber\r\nCurve Values:\r\n    Index      t       Ts    Freq      E'     E''   tan\r\n\
                 \x20            [s]    [° C]    [Hz]   [MPa]   [MPa]\r\n",
                |index, row| {
                    let row = plain([row[0] / TAU, row[1], row[2]], "  ");
                    format!("    {index}  {}.5  25.0  {row}  0.5\r", 60 + index)
                },
            )),
        ),
    ]
}

/// Those of programs and spreadsheets.
fn files_of_programs() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    vec![
        ("NumPy's savetxt", "", with("# omega storage loss\n", |_, row| plain(row, " ")).into_bytes()),
        (
            "a spreadsheet with its separator in the first line",
            "",
            with("sep=;\nomega;storage;loss\n", |_, row| plain(row, ";")).into_bytes(),
        ),
        (
            "columns by number, numbers of Fortran",
            "columns = { omega = 2, storage = 3, loss = 4 }",
            with("point of the sweep\n1 2 3 4\n", |index, row| {
                format!("{}  {}", index, plain(row, "  ").replace('e', "D"))
            })
            .replace("1 2 3 4\n", "")
            .into_bytes(),
        ),
        (
            "names with units after a slash, as DIN has them",
            "",
            with("omega / rad/s,storage / kPa,loss / kPa\r\n", |_, row| plain(row, ",") + "\r").into_bytes(),
        ),
        (
            "a frequency in Hz by its whole name",
            "columns = { omega = \"Freq (Hz)\", storage = \"E' (MPa)\", loss = \"E'' (MPa)\" }",
            with("Freq (Hz)\tE' (MPa)\tE'' (MPa)\n", |_, row| plain([row[0] / TAU, row[1], row[2]], "\t"))
                .into_bytes(),
        ),
    ]
}

#[test]
fn every_file_has_the_numbers_of_its_material() {
    for (name, keys, data) in files_of_instruments().into_iter().chain(files_of_programs()) {
        let (place, output) = fit(keys, &data);
        assert!(output.status.success(), "{name}: {}", text(&output.stderr));
        let record: Value =
            serde_json::from_str(&fs::read_to_string(place.path("out/fit.json")).unwrap()).unwrap();
        for (path, truth) in [("system.damping[0].kernel.order", 0.5), ("system.damping[0].kernel.time", 1.0)]
        {
            let found = record["parameters"][path]["estimate"].as_f64().unwrap();
            assert!((found - truth).abs() < 1e-7, "{name}: {path} = {found}");
        }
        assert_eq!(record["tables"][0]["rows"], 21, "{name}");
    }
}

#[test]
fn numbers_that_are_missing_are_counted_whatever_stands_there() {
    let signs = ["", "-", "--", "–", "—", "n/a", "N/A", "#N/A", "NaN", "null"];
    let data = with("omega;storage;loss\n", |index, row| match signs.get(index) {
        Some(sign) => format!("{:e};{sign};{:e}", row[0], row[2]),
        None => format!("{:e};{:e};{:e}", row[0], row[1], row[2]),
    });
    let (place, output) = fit("", data.as_bytes());
    assert!(output.status.success(), "{}", text(&output.stderr));
    let record: Value =
        serde_json::from_str(&fs::read_to_string(place.path("out/fit.json")).unwrap()).unwrap();
    assert_eq!((&record["tables"][0]["rows"], &record["tables"][0]["left_out"]), (&11.into(), &10.into()));
    // One is told as one.
    let data = with("omega;storage;loss\n", |index, row| match index {
        4 => format!("{:e};{:e};—", row[0], row[1]),
        _ => format!("{:e};{:e};{:e}", row[0], row[1], row[2]),
    });
    let (place, output) = fit("", data.as_bytes());
    assert!(output.status.success(), "{}", text(&output.stderr));
    let record = fs::read_to_string(place.path("out/fit.json")).unwrap();
    let said = "1 of 21 rows is left out, in which a number is missing: line 6";
    assert!(record.contains(said), "{record}");
}

#[test]
fn what_is_not_a_table_says_what_it_is() {
    let trios = "Filename\tsweep.tri\n[step]\nAngular frequency\tStorage modulus\tLoss modulus\n1\t2\t3\n";
    let names =
        "columns = { omega = \"Angular frequency\", storage = \"Storage modulus\", loss = \"Loss modulus\" }";
    let rows = "1,2,3\n2,3,4\n";
    let cases: Vec<(&str, Vec<u8>, &[&str])> = vec![
        ("", trios.into(), &["line 1", "among `Filename`, `sweep.tri`", "columns = { omega = \"Filename\""]),
        ("", rows.into(), &["line 1", "numbers where the names", "columns = { omega = 1"]),
        (
            "",
            format!("omega [1/s],storage,loss\n{rows}").into(),
            &["line 1", "column 1 (omega)", "may be rad/s or Hz", "units = { omega = \"rad/s\" }"],
        ),
        (
            "",
            format!("omega,storage,loss\n1/s,Pa,Pa\n{rows}").into(),
            &["column 1 (omega)", "may be rad/s or Hz"],
        ),
        (
            "",
            format!("omega,storage,loss\nkHz,Pa,Pa\n{rows}").into(),
            &["column 1 (omega)", "omega = 6283.18"],
        ),
        (
            "columns = { omega = \"Freq (min)\", storage = \"a\", loss = \"b\" }",
            format!("Freq (min),a,b\n{rows}").into(),
            &["a frequency in `min`"],
        ),
        (
            "columns = { omega = \"w\", storage = \"E' (MPa)\", loss = \"E'' (kPa)\" }",
            format!("w,E' (MPa),E'' (kPa)\n{rows}").into(),
            &["loss is in `kPa`, and storage in `MPa`"],
        ),
        (
            names,
            format!("{trios}[step]\nAngular frequency\tStorage modulus\tLoss modulus\n1\t2\t3\n").into(),
            &["line 5", "1 cell where the header has 3"],
        ),
        ("", format!("sep=x\nomega,storage,loss\n{rows}").into(), &["line 1", "a tab, a semicolon, a comma"]),
        ("", b"PK\x03\x04\x14\x00\x06\x00".to_vec(), &["spreadsheet", "CSV"]),
        ("", b"omega,storage,loss\n1,\x00\x01\xff,3\n".to_vec(), &["line 2"]),
        ("columns = { omega = 1, storage = 7, loss = 3 }", rows.into(), &["7 (storage)"]),
        (
            "columns = { omega = 1, storage = 2, loss = 2 }",
            rows.into(),
            &["column 2 stands in `columns` twice"],
        ),
        ("columns = { omega = 1, storage = \"b\", loss = 3 }", rows.into(), &["columns.omega"]),
        (
            "columns = { f = \"f\", storage = \"a\", loss = \"b\" }",
            "n f a b\n  [Hz] [Pa] [Pa]\n1 1 2 3\n".into(),
            &["line 2", "`[Hz]`, `[Pa]`, `[Pa]`", "the 4 names of line 1", "columns = { f = 2"],
        ),
        ("", "omega,storage,loss\nlog(rad/s),Pa,Pa\n1,2,3\n".into(), &["column 1 (omega)", "`log(rad/s)`"]),
        (
            "",
            format!("omega,storage,loss\n{rows}\n1.5,4,6\n2.5,6,8\n").into(),
            &["line 5", "a second table", "omega from 1.5 to 2.5 after 1 to 2"],
        ),
        ("", "Time,G\n1,2\n".into(), &["line 1", "columns = { t = \"Time\""]),
        ("", "omega,storage,loss\n1,2,12 %\n".into(), &["line 2", "column 3 (loss)", "empty cells, dashes"]),
    ];
    for (keys, data, expected) in cases {
        let (place, output) = fit(keys, &data);
        let (said, data) = (text(&output.stderr), text(&data));
        assert_eq!(output.status.code(), Some(2), "{keys}\n{data}\n{said}");
        for expected in expected {
            assert!(said.contains(expected), "{expected} is not said of {keys}\n{data}\n{said}");
        }
        assert!(!place.path("out").exists());
    }
}
