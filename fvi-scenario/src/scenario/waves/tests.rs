use super::*;
use crate::language::document::Document;
use crate::scenario::{Scenario, SymmetricMatrix};
use std::fmt::Write as _;
use std::path::Path;

/// K̂ = s(s + 1.2)/((s² + 1.1 s + 1.3)(s + 0.7)), which is positive real.
fn rational(omega: f64) -> Complex<f64> {
    let s = Complex::new(0.0, omega);
    s * (s + 1.2) / ((s * s + s * 1.1 + 1.3) * (s + 0.7))
}

/// A and B with A(∞) = 2.
fn row(omega: f64) -> [f64; 2] {
    let value = rational(omega);
    [2.0 + value.im / omega, value.re]
}

fn csv(change: impl Fn(f64, f64) -> f64) -> String {
    (1..=400).fold("omega,A,B\n".to_owned(), |mut text, k| {
        let omega = 0.05 * f64::from(k);
        let [added, damping] = row(omega);
        writeln!(text, "{omega},{added},{}", change(omega, damping)).unwrap();
        text
    })
}

fn scenario(kernel: &str, mass: &str, files: &[(&str, String)]) -> Result<Scenario, String> {
    let count = mass.matches(',').count() + 1;
    let position = vec!["1.0"; count].join(", ");
    let text = format!(
        "[system]\nmass = [{mass}]\n[[system.damping]]\nkernel = {{ {kernel} }}\n[initial]\nposition = [{position}]\n[time]\nstep = 0.01\nsteps = 10\n"
    );
    let mut document = Document::new("s.toml", Path::new("/data"), &text);
    for (name, content) in files {
        document = document.with_attached(name, content);
    }
    Scenario::from_document(document).map_err(|error| {
        let help = miette::Diagnostic::help(&error).map(|help| help.to_string()).unwrap_or_default();
        format!("{error} {help}")
    })
}

#[test]
fn a_table_is_its_rational_function_and_a_mass() {
    let files = [("sphere.csv", csv(|_, b| b))];
    let read = scenario("radiation = \"sphere.csv\"", "3.0", &files).unwrap();
    let mass = read.system.mass.diagonal()[0];
    assert!((mass - 5.0).abs() < 2e-3, "{mass}");
    assert_eq!(read.system.damping.len(), 1);
    let transfer = &read.system.damping[0].transfer;
    for omega in [0.2, 0.8, 1.7, 5.0, 15.0] {
        let s = Complex::new(0.0, omega);
        let (own, exact) = (transfer.value(s) / s, rational(omega));
        assert!((own - exact).norm() < 2e-3, "{omega}: {own} {exact}");
    }
    let said = read.warnings().join("\n");
    assert!(said.contains("Ogilvie") && said.contains("A(∞) follows from A and B"), "{said}");
    // What is written down again has the whole mass, and adds nothing to it.
    let again = toml::to_string(&read).unwrap();
    assert!(again.contains("added_to_mass = false") && again.contains("/data/sphere.csv"), "{again}");
}

#[test]
fn tables_are_taken_in_every_form_and_order() {
    let of = |kernel: &str, files: &[(&str, String)]| {
        let read = scenario(kernel, "3.0", files).unwrap();
        (read.system.mass.diagonal()[0], read.system.damping[0].transfer.value(Complex::new(0.0, 0.8)))
    };
    let plain = of("radiation = \"a.csv\"", &[("a.csv", csv(|_, b| b))]);
    // Frequencies in Hz, a row of units, semicolons, from high to low, a number missing, other names.
    let mut other = "Project: buoy\nFreq;Added mass;Radiation damping\n[Hz];[kg];[N s/m]\n".to_owned();
    for k in (1..=400).rev() {
        let omega = 0.05 * f64::from(k);
        let [added, damping] = row(omega);
        let f = omega / std::f64::consts::TAU;
        writeln!(other, "{f:.17};{added:.17};{damping:.17}").unwrap();
    }
    other += "7.7;;0.1\n";
    let columns = "columns = { f = \"Freq\", A = \"Added mass\", B = \"Radiation damping\" }";
    let found = of(&format!("radiation = \"b.txt\", {columns}"), &[("b.txt", other)]);
    assert!((found.0 - plain.0).abs() < 1e-9 && (found.1 - plain.1).norm() < 1e-9, "{found:?} {plain:?}");
    let list = |pick: &dyn Fn(f64) -> f64| {
        let numbers: Vec<String> = (1..=400).map(|k| pick(0.05 * f64::from(k)).to_string()).collect();
        numbers.join(", ")
    };
    let inline = format!(
        "radiation = {{ omega = [{}], A = [{}], B = [{}] }}",
        list(&|omega| omega),
        list(&|omega| row(omega)[0]),
        list(&|omega| row(omega)[1])
    );
    let found = of(&inline, &[]);
    assert!((found.0 - plain.0).abs() < 1e-9 && (found.1 - plain.1).norm() < 1e-9, "{found:?} {plain:?}");
}

#[test]
fn bodies_take_their_coordinates() {
    // Two equal bodies, coupled by a third of what each has.
    let mut text = "omega,A00,A01,A11,B00,B01,B11\n".to_owned();
    for k in 1..=400 {
        let omega = 0.05 * f64::from(k);
        let [added, b] = row(omega);
        let third = (added - 2.0) / 3.0;
        writeln!(text, "{omega},{added},{third},{added},{b},{},{b}", b / 3.0).unwrap();
    }
    let read =
        scenario("radiation = \"a.csv\", coordinates = [2, 0]", "3.0, 7.0, 4.0", &[("a.csv", text)]).unwrap();
    let mass: Vec<f64> = read.system.mass.diagonal().to_vec();
    assert!((mass[0] - 5.0).abs() < 2e-3 && (mass[1] - 7.0).abs() < 1e-12 && (mass[2] - 6.0).abs() < 2e-3);
    // K₀₀, K₂₂, and K₀₂ in two parts.
    assert_eq!(read.system.damping.len(), 4);
    let sum = read.system.damping.iter().fold(DMatrix::zeros(3, 3), |sum, term| {
        let s = Complex::new(0.0, 0.8);
        let value = term.transfer.value(s) / s;
        let SymmetricMatrix::Dense(coefficient) = &term.coefficient else { unreachable!() };
        sum + coefficient.map(|entry| value * entry)
    });
    let exact = rational(0.8);
    assert!((sum[(0, 0)] - exact).norm() < 2e-3 && (sum[(0, 2)] - exact / 3.0).norm() < 1e-3);
    assert_eq!(sum[(1, 1)], Complex::ZERO);
}

#[test]
fn equations_of_states_are_their_prony_series() {
    // K̂ = 2/(s + 0.5) + 3/(s + 4) is two Maxwell elements of the strengths 2 and 3.
    let kernel =
        "states = { A = [[-0.5, 0.0], [0.0, -4.0]], B = [[1.0], [1.0]], C = [[2.0, 3.0]] }, infinite = 1.5";
    let read = scenario(kernel, "3.0", &[]).unwrap();
    assert_eq!(read.system.mass.diagonal()[0], 4.5);
    let transfer = &read.system.damping[0].transfer;
    let prony = TransferFunction::prony(&[2.0, 3.0], &[2.0, 0.25]).unwrap();
    assert!(transfer.is_relaxation() && transfer.active().is_none());
    for omega in [0.01, 0.7, 20.0] {
        let s = Complex::new(0.1, omega);
        let (own, exact) = (transfer.value(s) + transfer.spring(), prony.value(s));
        assert!((own - exact).norm() < 1e-14 * exact.norm(), "{omega}: {own} {exact}");
    }
    // Of a pair of poles, in another basis.
    let kernel = "states = { A = [[0.0, 1.0], [-1.3, -1.1]], B = [[1.0], [-1.1]], C = [[1.0, 0.0]] }";
    let read = scenario(kernel, "3.0", &[]).unwrap();
    let s = Complex::new(0.0, 0.9);
    let exact = s * s / (s * s + s * 1.1 + 1.3);
    assert!((read.system.damping[0].transfer.value(s) - exact).norm() < 1e-13);
}

#[test]
fn what_cannot_be_taken_is_told_in_numbers() {
    let good = || ("a.csv", csv(|_, b| b));
    let states = |a: &str| format!("states = {{ A = {a}, B = [[1.0], [1.0]], C = [[1.0, -3.0]] }}");
    let cut = |from: usize, to: usize| {
        let text = csv(|_, b| b);
        let lines: Vec<&str> = text.lines().collect();
        format!("{}\n{}\n", lines[0], lines[from..to].join("\n"))
    };
    let other_sign_of_a = csv(|_, b| b).lines().enumerate().fold(String::new(), |text, (index, line)| {
        let line = if index == 0 { line.to_owned() } else { line.replacen(',', ",-", 1) };
        text + &line + "\n"
    });
    for (kernel, file, reason) in [
        (
            "radiation = \"a.csv\"",
            ("a.csv", csv(|omega, b| if omega < 0.12 { -1e-3 } else { b })),
            "`activity` ≥",
        ),
        ("radiation = \"a.csv\"", ("a.csv", cut(10, 400)), "`begin` ≥"),
        ("radiation = \"a.csv\"", ("a.csv", cut(30, 400)), "no `begin` < 1 takes that"),
        ("radiation = \"a.csv\"", ("a.csv", cut(1, 40)), "`end` ≥"),
        ("radiation = \"a.csv\"", ("a.csv", csv(|_, b| 2.0 * b)), "Ogilvie"),
        // No tolerance is 1 or more, and none is advised.
        ("radiation = \"a.csv\"", ("a.csv", csv(|_, b| -b)), "no `activity` < 1 takes that"),
        ("radiation = \"a.csv\"", ("a.csv", other_sign_of_a), "no `inconsistency` < 1 takes that"),
        ("radiation = \"a.csv\", memory = 1.0", good(), "`memory` = 1 is too short"),
        // A fifth too much, with the number and its place.
        ("radiation = \"a.csv\"", ("a.csv", csv(|_, b| 1.2 * b)), "`inconsistency` ≥ "),
        ("radiation = \"a.csv\", infinite = 4.0", good(), "would follow from both"),
        ("radiation = \"a.csv\", infinite = [[1.0, 0.0], [0.0, 1.0]]", good(), "1 rows of 1"),
        ("radiation = \"a.csv\", coordinates = [1]", good(), "0 to 0"),
        ("radiation = \"a.csv\", order = 1", good(), "unknown key"),
        ("radiation = \"a.csv\"", ("a.csv", "omega,A,C\n1,1,1\n".to_owned()), "column 3 (C): unknown"),
        ("radiation = \"a.csv\"", ("a.csv", "omega,A,B\n1,1,1\n2,1,x\n".to_owned()), "line 3"),
        ("radiation = \"a.csv\"", ("a.csv", "t,A,B\n1,1,1\n2,1,3\n".to_owned()), "omega (rad/s) or f (Hz)"),
        ("radiation = \"a.csv\"", ("a.csv", "omega,A [t],B\n1,1,1\n2,1,3\n".to_owned()), "no product of kg"),
        ("radiation = \"a.csv\"", ("a.csv", "omega,B\n1,1\n2,1\n3,0\n".to_owned()), "`begin`"),
        (
            "radiation = \"a.csv\"",
            ("a.csv", "omega,A,B\n1,1,1\n1,1,1\n2,1,0\n".to_owned()),
            "stands there twice",
        ),
        (
            "radiation = \"a.csv\"",
            (
                "a.csv",
                "omega,A00,A01,A10,A11,B00,B11\n0,1,0.1,0.101,1,0,0\n1,1,0,0,1,1,1\n2,1,0,0,1,0,0\n"
                    .to_owned(),
            ),
            "2 instead of",
        ),
        (&states("[[0.1, 0.0], [0.0, -1.0]]"), good(), "stable equations"),
        (&states("[[-1.0, 0.0], [0.0, -2.0]]"), good(), "Re K̂(iω) is"),
        (&states("[[-1.0, 0.0], [0.0, -2.0]]"), good(), "no `activity` < 1 takes that"),
        (&states("[[-1.0, 0.0]]"), good(), "A of 1 × 1, not 1 × 2"),
    ] {
        let message = scenario(kernel, "3.0", &[file]).unwrap_err();
        assert!(message.contains(reason), "{kernel}: {message}");
    }
    let asymmetric =
        "omega,A00,A01,A10,A11,B00,B11\n0,1,0.1,0.101,1,0,0\n1,1,0,0,1,1,1\n2,1,0,0,1,0,0\n".to_owned();
    let message = scenario("radiation = \"a.csv\"", "1.0, 1.0", &[("a.csv", asymmetric)]).unwrap_err();
    assert!(message.contains("`asymmetry` ≥ 1.1e-3") && message.contains("at ω = 0"), "{message}");
    // What is negative by 10⁻³ at low frequencies is put right with a tolerance.
    let files = [("a.csv", csv(|omega, b| if omega < 0.12 { -1e-3 } else { b }))];
    let read = scenario("radiation = \"a.csv\", activity = 1e-2", "3.0", &files).unwrap();
    assert!(read.system.damping[0].active().is_none());
    assert!(read.warnings().join("\n").contains("the nearest B ≥ 0 is in its place"));
}

/// Added mass and radiation damping as boundary-element codes and programs about them write them.
#[test]
fn files_of_boundary_element_codes_are_read_or_refused() {
    let rows = |head: &str, line: &dyn Fn(f64, f64, f64) -> String| {
        (1..=400).fold(head.to_owned(), |text, k| {
            let omega = 0.05 * f64::from(k);
            let [added, damping] = row(omega);
            text + &line(omega, added, damping) + "\n"
        })
    };
    let mass = |kernel: &str, file: String| {
        scenario(&format!("radiation = \"a.dat\", {kernel}"), "3.0", &[("a.dat", file)])
            .map(|read| read.system.mass.diagonal()[0])
    };
    let plain = mass("added_to_mass = true", csv(|_, b| b)).unwrap();
    for (name, kernel, file) in [
        (
            "Tecplot file of NEMOH, one degree of freedom",
            "columns = { omega = 1, A = 2, B = 3 }",
            rows(
                "VARIABLES=\"w (rad/s)\"\n\"A 3 3\" \"B 3 3\"\nZone t=\"Motion of body 1 in DoF 3\",I=400,F=POINT\n",
                &|w, a, b| format!("  {w:.9E}  {a:.9E}  {b:.9E}"),
            ),
        ),
        (
            "BEMIO as CSV",
            "columns = { omega = \"w\", A = \"A33\", B = \"B33\" }",
            rows("w,T,A33,B33\n", &|w, a, b| format!("{w},{},{a},{b}", std::f64::consts::TAU / w)),
        ),
        (
            "data frame of Capytaine, one degree of freedom",
            "columns = { omega = \"omega\", A = \"added_mass\", B = \"radiation_damping\" }",
            rows(",omega,radiating_dof,influenced_dof,added_mass,radiation_damping\n", &|w, a, b| {
                format!("{:.0},{w},Heave,Heave,{a},{b}", w / 0.05)
            }),
        ),
        (
            "AQWA's listing with units behind slashes",
            "columns = { f = \"FREQ\", A = \"M33\", B = \"C33\" }",
            rows("FREQ/Hz;M33/kg;C33/Ns/m\n", &|w, a, b| format!("{};{a};{b}", w / std::f64::consts::TAU)),
        ),
    ] {
        let found = mass(kernel, file).unwrap();
        assert!((found - plain).abs() < 1e-6, "{name}: {found} {plain}");
    }
    let wamit = "  0.628E+01     3     3  0.500E+00  0.100E+00\n  0.628E+01     3     5  0.2E+00  0.1E+00\n";
    for (name, kernel, file, reason) in [
        (
            "WAMIT's .1",
            "added_to_mass = true",
            wamit.to_owned(),
            "numbers where the names of the columns are wanted",
        ),
        (
            "the same by numbers",
            "columns = { f = 1, A = 4, B = 5 }",
            format!("{wamit}{wamit}"),
            "each frequency once",
        ),
        (
            "WAMIT's .3 by names",
            "columns = { omega = \"w\", A = \"A\", B = \"B\" }",
            "0.6E+01 0.0 3 0.5 12.0 0.4 0.1\n".to_owned(),
            "no row has all names",
        ),
        (
            "a row for every pair of degrees of freedom",
            "columns = { omega = \"omega\", A = \"added_mass\", B = \"radiation_damping\" }",
            "omega,dof,added_mass,radiation_damping\n1,Surge,1,1\n1,Heave,1,1\n2,Surge,1,1\n".to_owned(),
            "columns of their own: ω = 1 stands there twice",
        ),
        (
            "a row of infinite frequency",
            "added_to_mass = true",
            "omega,A,B\n1,1,1\ninf,1,0\n".to_owned(),
            "the key `infinite`",
        ),
        (
            "NEMOH's CA.dat",
            "columns = { omega = 1, B = 2 }",
            "Nb de frequencies : 2\n 0.5\n 1.0 0.0 0.0\n 0.0 1.0 0.0\n".to_owned(),
            "frequencies",
        ),
    ] {
        let message = mass(kernel, file).unwrap_err();
        assert!(message.contains(reason), "{name}: {message}");
    }
    let noted = |lines: &str| {
        let file = csv(|_, b| b) + lines;
        scenario("radiation = \"a.dat\"", "3.0", &[("a.dat", file)]).unwrap().warnings().join("\n")
    };
    assert!(noted("7.77,,1\n").contains("1 row is left out, in which a number is missing: line 402"));
    assert!(
        noted("7.77,,1\n7.78,n/a,1\n")
            .contains("2 rows are left out, in which a number is missing: lines 402, 403")
    );
}
