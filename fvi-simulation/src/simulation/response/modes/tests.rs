use super::super::Linearised;
use super::SystemMode;
use fvi_fft::transfer::TransferFunction;
use fvi_scenario::language::Document;
use fvi_scenario::scenario::Scenario;
use nalgebra::{Complex, DMatrix};
use std::path::Path;

fn linearised(text: &str, files: &[(&str, String)]) -> Linearised {
    let mut document = Document::new("s.toml", Path::new(""), text);
    for (name, content) in files {
        document = document.with_attached(name, content);
    }
    let scenario = Scenario::from_document(document).unwrap();
    Linearised::new(&scenario, &scenario.initial.position.clone()).unwrap()
}

fn modes(system: &Linearised, omega: f64, count: usize) -> Vec<SystemMode> {
    system.modes(omega, count, &mut || false).unwrap()
}

/// Entries of a matrix as a file in the coordinate format.
fn file(size: usize, entries: &[(usize, usize, f64)]) -> String {
    let head = format!("%%MatrixMarket matrix coordinate real symmetric\n{size} {size} {}\n", entries.len());
    entries
        .iter()
        .fold(head, |text, (row, column, entry)| text + &format!("{} {} {entry:e}\n", row + 1, column + 1))
}

/// A chain of unit masses and springs to a wall at both ends, 0.05 s^½ in each spring, and a damper 0.3 s^0.7
/// to the ground at a third of its length.
fn chain(size: usize) -> (Linearised, impl Fn(Complex<f64>) -> Complex<f64>) {
    let third = size / 3;
    let stiffness: Vec<_> = (0..size)
        .flat_map(|k| [Some((k, k, 2.0)), (k > 0).then_some((k, k.wrapping_sub(1), -1.0))])
        .flatten()
        .collect();
    let scaled: Vec<_> = stiffness.iter().map(|&(row, column, entry)| (row, column, 0.05 * entry)).collect();
    let text = "[system]\nmass = MASSES\nstiffness = \"k.mtx\"\n\
                [[system.damping]]\norder = 0.5\ncoefficient = \"c.mtx\"\n\
                [[system.damping]]\norder = 0.7\ncoefficient = \"d.mtx\"\n\
                [time]\nstep = 0.1\nsteps = 10\n[output]\ncoordinates = [0]\n";
    let text = text.replace("MASSES", &format!("[{}]", vec!["1.0"; size].join(", ")));
    let files = [
        ("k.mtx", file(size, &stiffness)),
        ("c.mtx", file(size, &scaled)),
        ("d.mtx", file(size, &[(third, third, 0.3)])),
    ];
    // The determinant by the pivots of a tridiagonal matrix, p_k = a_k − b²/p_{k−1}: the last one
    // vanishes with it.
    let last_pivot = move |s: Complex<f64>| {
        let spring = 1.0 + s.sqrt() * 0.05;
        let own =
            |k: usize| s * s + spring * 2.0 + if k == third { s.powf(0.7) * 0.3 } else { Complex::ZERO };
        (1..size).fold(own(0), |pivot, k| own(k) - spring * spring / pivot)
    };
    (linearised(&text, &files), last_pivot)
}

/// One coordinate has more motions than coordinates if its kernel has states: those of
/// (m s² + k)(s² + d s + w) + s² = 0.
#[test]
fn motions_of_the_states_of_a_kernel_are_found_beside_that_of_one_coordinate() {
    for (mass, stiffness, w, d, omega) in [
        (0.85, 10.76, 2.102, 1.448, 2.656),
        (2.52, 5.4, 2.356, 1.176, 11.03),
        (2.41, 9.93, 1.484, 1.196, 2.441),
        (2.21, 2.33, 1.248, 1.334, 1.318),
    ] {
        let states = format!("A = [[0.0, 1.0], [-{w}, -{d}]], B = [[1.0], [-{d}]], C = [[1.0, 0.0]]");
        let system = linearised(
            &format!(
                "[system]\nmass = [{mass}]\nstiffness = [[{stiffness}]]\n[[system.damping]]\n\
                 kernel = {{ states = {{ {states} }} }}\n[time]\nstep = 0.1\nsteps = 10\n"
            ),
            &[],
        );
        let found = modes(&system, omega, 6);
        assert!(!found.is_empty() && found.len() <= 2, "{found:?}");
        for mode in &found {
            let s = mode.place;
            let [own, kernel] = [s * s * mass + stiffness, s * s + s * d + w];
            let size = own.norm() * kernel.norm() + s.norm_sqr();
            assert!((own * kernel + s * s).norm() < 1e-12 * size, "{mode:?}");
        }
        if found.len() == 2 {
            assert!((found[0].place - found[1].place).norm() > 0.1, "{found:?}");
        }
    }
}

/// The zero of a function next to a place, by the secant method.
fn zero_of(function: &impl Fn(Complex<f64>) -> Complex<f64>, near: Complex<f64>) -> Complex<f64> {
    let (mut before, mut now) = (near * (1.0 + 1e-7), near);
    let mut value = function(before);
    for _ in 0..50 {
        let next = function(now);
        let change = next * (now - before) / (next - value);
        if !(change.re.is_finite() && change.im.is_finite()) {
            break;
        }
        (before, value) = (now, next);
        now -= change;
        if change.norm() < 1e-15 * now.norm() {
            break;
        }
    }
    now
}

#[test]
fn modes_of_a_chain_of_700_are_zeros_of_its_determinant() {
    let (system, determinant) = chain(700);
    for omega in [0.05, 0.5, 1.3, 1.9] {
        let found = modes(&system, omega, 5);
        assert_eq!(found.len(), 5, "{omega}");
        for mode in &found {
            let exact = zero_of(&determinant, mode.place);
            assert!((mode.place - exact).norm() < 1e-9 * exact.norm(), "{} {exact}", mode.place);
            assert!(mode.residual < 1e-10 && mode.damping() > 0.0, "{mode:?}");
            let largest = mode.shape.iter().map(|entry| entry.norm()).fold(0.0, fvi_core::max_or_nan);
            assert!((largest - 1.0).abs() < 1e-12 && mode.shape.len() == 700);
        }
        // Five different ones, ordered by their distance.
        let distances: Vec<f64> =
            found.iter().map(|mode| (mode.place - Complex::new(0.0, omega)).norm()).collect();
        assert!(distances.is_sorted(), "{distances:?}");
        for (k, one) in found.iter().enumerate() {
            assert!(found[..k].iter().all(|other| (one.place - other.place).norm() > 1e-5));
        }
    }
}

/// Beyond its band hundreds of zeros lie side by side, across the edge of the disc.
#[test]
fn modes_at_the_end_of_a_band_are_told_apart() {
    for (size, omega) in [(200, 2.6), (500, 2.6), (200, 3.5)] {
        let (system, determinant) = chain(size);
        let found = modes(&system, omega, 5);
        assert_eq!(found.len(), 5, "{size}");
        for (k, mode) in found.iter().enumerate() {
            let exact = zero_of(&determinant, mode.place);
            assert!((mode.place - exact).norm() < 1e-10, "{} {exact}", mode.place);
            assert!(found[..k].iter().all(|other| (mode.place - other.place).norm() > 1e-6));
        }
    }
}

/// A square membrane of unit masses and springs, with damping by 0.02 s^½ of its stiffness.
fn membrane(side: usize) -> Linearised {
    let at = |i: usize, j: usize| i * side + j;
    let mut entries = Vec::new();
    for i in 0..side {
        for j in 0..side {
            entries.push((at(i, j), at(i, j), 4.0));
            entries.extend((i > 0).then(|| (at(i, j), at(i - 1, j), -1.0)));
            entries.extend((j > 0).then(|| (at(i, j), at(i, j - 1), -1.0)));
        }
    }
    let damping: Vec<_> = entries.iter().map(|&(row, column, entry)| (row, column, 0.02 * entry)).collect();
    let size = side * side;
    let text = format!(
        "[system]\nmass = [{}]\nstiffness = \"k.mtx\"\n[[system.damping]]\norder = 0.5\ncoefficient = \"c.mtx\"\n[time]\nstep = 0.1\nsteps = 10\n[output]\ncoordinates = [0]\n",
        vec!["1.0"; size].join(", ")
    );
    linearised(&text, &[("k.mtx", file(size, &entries)), ("c.mtx", file(size, &damping))])
}

/// Of a membrane of 15 × 15 masses, k_i + k_j = 4 for 15 pairs: a fifteenfold mode.
#[test]
fn a_mode_is_found_as_often_as_it_is() {
    let system = membrane(15);
    let equation = |s: Complex<f64>| s * s + (s.sqrt() * 0.02 + 1.0) * 4.0;
    let exact = zero_of(&equation, Complex::new(0.0, 2.0));
    for count in [1, 3, 15] {
        let found = modes(&system, exact.im, count);
        assert_eq!(found.len(), 15, "{count}");
        assert!(found.iter().all(|mode| (mode.place - exact).norm() < 1e-10), "{count}");
    }
}

/// It has double frequencies too, which the damping keeps.
#[test]
fn modes_of_a_square_are_counted_as_often_as_they_are() {
    let system = membrane(12);
    let value = |j: usize| 2.0 - 2.0 * (std::f64::consts::PI * j as f64 / 13.0).cos();
    let exact = |one: usize, other: usize| {
        let stiffness = value(one) + value(other);
        let equation = |s: Complex<f64>| s * s + (s.sqrt() * 0.02 + 1.0) * stiffness;
        zero_of(&equation, Complex::new(0.0, stiffness.sqrt()))
    };
    // (1, 2) and (2, 1) are the two nearest, then (2, 2), (1, 1), and (1, 3) with (3, 1).
    let omega = (value(1) + value(2)).sqrt();
    let found = modes(&system, omega, 2);
    assert_eq!(found.len(), 2, "{:?}", found.iter().map(|mode| mode.place).collect::<Vec<_>>());
    for mode in &found {
        assert!((mode.place - exact(1, 2)).norm() < 1e-10, "{} {}", mode.place, exact(1, 2));
    }
    let overlap: Complex<f64> = found[0].shape.iter().zip(&found[1].shape).map(|(a, b)| a.conj() * b).sum();
    let length = |mode: &SystemMode| mode.shape.iter().map(|entry| entry.norm_sqr()).sum::<f64>().sqrt();
    assert!(overlap.norm() < 0.999 * length(&found[0]) * length(&found[1]));
    // One of two that are as near brings the other.
    assert_eq!(modes(&system, omega, 1).len(), 2);
}

#[test]
fn few_modes_are_all_there_are_and_equal_the_poles() {
    let text = "[system]\nmass = [1.0, 2.0]\nstiffness = [[3.0, -1.0], [-1.0, 4.0]]\n\
                [[system.damping]]\norder = 0.6\ncoefficient = [[0.3, 0.1], [0.1, 0.2]]\n\
                [[system.damping]]\nkernel = { form = \"prony\", strengths = [0.5], times = [0.4] }\ncoefficient = [1.0, 0.0]\n\
                [time]\nstep = 0.1\nsteps = 10\n";
    let system = linearised(text, &[]);
    let poles: Vec<_> = system.poles().unwrap().into_iter().filter(|pole| pole.place.im > 0.0).collect();
    let found = modes(&system, 1.6, 6);
    assert_eq!(found.len(), 2, "{found:?}");
    for mode in found {
        let nearest = poles
            .iter()
            .map(|pole| (pole.place - mode.place).norm())
            .fold(f64::INFINITY, fvi_core::min_or_nan);
        assert!(nearest < 1e-12, "{mode:?} {poles:?}");
        let s = mode.place;
        let [one, two] =
            [TransferFunction::power(0.6).unwrap(), TransferFunction::prony(&[0.5], &[0.4]).unwrap()];
        let (k, p) = (one.value(s), two.value(s));
        let entry = |m: f64, c: f64, k0: f64, k1: f64| s * s * m + c + k * k0 + p * k1;
        let matrix = DMatrix::from_row_slice(
            2,
            2,
            &[
                entry(1.0, 3.0, 0.3, 1.0),
                entry(0.0, -1.0, 0.1, 0.0),
                entry(0.0, -1.0, 0.1, 0.0),
                entry(2.0, 4.0, 0.2, 0.0),
            ],
        );
        let x = nalgebra::DVector::from_vec(mode.shape);
        assert!((matrix * x).norm() < 1e-12);
    }
}

#[test]
fn a_stopped_search_is_an_error() {
    let (system, _) = chain(90);
    let mut asked = 0;
    let found = system.modes(0.5, 3, &mut || {
        asked += 1;
        asked > 4
    });
    assert!(found.is_err() && asked > 4);
    assert!(system.modes(-1.0, 3, &mut || false).unwrap_err().contains("positive"));
    assert!(system.modes(1.0, 0, &mut || false).is_err());
}
