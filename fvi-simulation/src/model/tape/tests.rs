use super::*;
use fvi_scenario::language::expression::{Elementary, Expression, Moment, Symbols};
use nalgebra::{SMatrix, SVector};
use proptest::prelude::*;

fn symbols(coordinates: usize) -> Symbols {
    Symbols::new().with_time().with_coordinates(coordinates)
}

fn parse(text: &str, coordinates: usize) -> Expression {
    Expression::parse(text, &symbols(coordinates)).unwrap()
}

/// Gradient and the whole Hessian, from both parts of a compiled potential.
fn compiled<T: Elementary, const N: usize>(text: &str, q: [T; N]) -> (T, SVector<T, N>, SMatrix<T, N, N>) {
    let potential = CompiledPotential::<T>::compile(&parse(text, N), N);
    let mut registers = Vec::new();
    let mut gradient = [T::of(f64::NAN); N];
    let mut entries = vec![T::of(f64::NAN); potential.pattern().len()];
    potential.derivatives(&q, &mut registers, &mut gradient, &mut entries);
    let mut alone = [T::of(f64::NAN); N];
    potential.gradient(&q, &mut registers, &mut alone);
    let same = |(x, y): (&T, &T)| agree(x.to_f64(), y.to_f64(), 0.0);
    assert!(alone.iter().zip(&gradient).all(same), "{text}");
    let mut hessian = SMatrix::zeros();
    let rest = potential.pattern().iter().zip(&entries).map(|(&(i, j), &entry)| (i, j, entry));
    for (i, j, entry) in potential.quadratic().stiffness.iter().copied().chain(rest) {
        hessian[(i as usize, j as usize)] += entry;
        if i != j {
            hessian[(j as usize, i as usize)] += entry;
        }
    }
    (potential.value(&q, &mut registers), SVector::from(gradient), hessian)
}

fn dual<T: Elementary, const N: usize>(text: &str, q: [T; N]) -> (T, SVector<T, N>, SMatrix<T, N, N>) {
    parse(text, N).hessian(Moment::inside(T::zero()), &SVector::from(q))
}

/// True if two numbers are equal, to `tolerance` of the largest number of the result, or are the same special
/// value.
fn agree(found: f64, expected: f64, tolerance: f64) -> bool {
    found == expected || (found.is_nan() && expected.is_nan()) || (found - expected).abs() <= tolerance
}

#[test]
fn derivatives_without_a_quadratic_part_are_those_of_forward_differentiation_to_the_bit() {
    let texts = [
        "9.81*(1 - cos(q0)) + 0.3*cos(q0 - q1)",
        "sin(q0)*cos(q1) + tan(q0*q1)",
        "exp(q0 - q1^2)/(1 + q0^2)",
        "log(2 + q0*q1) - sqrt(3 + q0 + q1^3)",
        "sinh(q0)*cosh(q1)*tanh(q0 - 2*q1)",
        "(2 + q0)^(1 + q1) - 2^(q0*q1) + 0^(q1 + 2)*q0",
        "(1.3 + q0*q1)^2.7 + q0^-3/q1",
        "gamma(1.5 + q0*q1)*gamma(q1 - 1.7)",
        "max(q0, q1)^3 - min(q0^2, q1) + abs(q0 - q1)*q0",
        "step(q0 - 0.5)*q0^2 + sign(q0 - 1)*q1^2 + q0^7",
    ];
    for text in texts {
        for q in [[0.7, 0.4], [-0.3, 1.9]] {
            let (found, expected) = (compiled(text, q), dual(text, q));
            let bits = |(value, gradient, hessian): (f64, SVector<f64, 2>, SMatrix<f64, 2, 2>)| {
                let numbers = core::iter::once(value).chain(gradient.iter().chain(&hessian).copied());
                numbers
                    .map(|x| if x.is_nan() { f64::NAN.to_bits() } else { (x + 0.0).to_bits() })
                    .collect::<Vec<_>>()
            };
            assert_eq!(bits(found), bits(expected), "{text} at {q:?}: {found:?} {expected:?}");
            let single = q.map(|x| x as f32);
            let (found, expected) = (compiled(text, single), dual(text, single));
            for (found, expected) in found.2.iter().zip(&expected.2) {
                assert!(agree(f64::from(*found), f64::from(*expected), 1e-4), "{text}: {found} {expected}");
            }
        }
    }
}

#[test]
fn values_along_many_points_have_the_bits_of_each_by_itself() {
    let long: Vec<String> = (0..700).map(|k| format!("sin(q0 + {k})*q1^2 + abs(q2 - {k})")).collect();
    let texts = [
        "9.81*(1 - cos(q0)) + q1*sin(q2)",
        "0.5*(q1 - q0)^2 + 0.25*0.7*(q1 - q0)^4 + 0.5*(q2 - q1)^2",
        "max(q0, q1)^3 - min(q0^2, q2) + exp(q1)/(1 + q0^2) + (2 + q0)^(1 + q1)",
        "7",
        // A sum longer than a window.
        &long.join(" + "),
    ];
    for text in texts {
        let potential = CompiledPotential::<f64>::compile(&parse(text, 3), 3);
        let (mut lanes, mut registers) = (LaneRegisters::default(), Vec::new());
        for turn in 0..2 {
            let point = |lane: usize| [0.3, -0.9, 1.7].map(|x| x * (0.1 * (lane + 7 * turn) as f64 - 0.4));
            let found = potential.values_along(&mut lanes, |places| {
                for (coordinate, place) in places.iter_mut().enumerate() {
                    *place = core::array::from_fn(|lane| point(lane)[coordinate]);
                }
            });
            for (lane, found) in found.iter().enumerate() {
                let expected = potential.value(&point(lane), &mut registers);
                assert_eq!(found.to_bits(), expected.to_bits(), "{text:.60} at {:?}", point(lane));
            }
        }
    }
}

#[test]
fn at_singular_points_the_conventions_are_those_of_forward_differentiation() {
    let texts = [
        "sqrt(q0^2 + q1^2)",
        "abs(q0)^1.5 + abs(q1)",
        "sqrt(q0)",
        "log(q0) + q1",
        "max(sqrt(q0), 1) + min(q0, q1)",
        "q0^2.5 + q0^0.5*q1",
        "abs(q0)^(1 + q1)",
        "step(q0)*q1 + sign(q0)*q1",
        "max(log(q0 - 1), q1)",
        "gamma(q0) + q1^9",
    ];
    for text in texts {
        let (found, expected) = (compiled(text, [0.0, 0.0]), dual(text, [0.0, 0.0]));
        assert!(agree(found.0, expected.0, 0.0), "{text}: {found:?} {expected:?}");
        for (found, expected) in found.1.iter().zip(&expected.1) {
            assert!(agree(*found, *expected, 0.0), "{text}: {found:?} {expected:?}");
        }
        for (found, expected) in found.2.iter().zip(&expected.2) {
            assert!(agree(*found, *expected, 0.0), "{text}: {found:?} {expected:?}");
        }
    }
}

#[test]
fn a_factor_of_zero_does_not_hide_that_a_value_does_not_exist() {
    assert!(compiled("0*log(q0)", [-1.0_f64]).0.is_nan());
}

#[test]
fn a_variable_that_does_not_occur_has_no_influence_even_where_the_value_does_not_exist() {
    let (value, gradient, _) = compiled("log(q0) - 3", [-1.0, 0.5, 0.5]);
    assert!(f64::is_nan(value));
    assert_eq!(gradient, SVector::from([-1.0, 0.0, 0.0]));
}

#[test]
fn what_is_quadratic_becomes_a_matrix() {
    let text = "0.5*1000*(q1 - q0)^2 + (q0 - 1)*(q2 + 3)/2 - q2 + 7 - -2*q0 + q1*0";
    let potential = CompiledPotential::<f64>::compile(&parse(text, 3), 3);
    assert!(potential.is_quadratic());
    assert_eq!(potential.pattern(), []);
    let quadratic = potential.quadratic();
    assert_eq!(quadratic.stiffness, [(0, 0, 1000.0), (1, 0, -1000.0), (1, 1, 1000.0), (2, 0, 0.5)]);
    assert_eq!(quadratic.linear, [(0, 3.5), (2, -1.5)]);
    assert_eq!(quadratic.constant, 5.5);
}

#[test]
fn a_quadratic_part_is_found_inside_sums_that_are_multiplied() {
    let text = "3*2*(q0^2/4 - (0.5*q1^2 - cos(q0)) + q1^4)/2 - 1";
    let potential = CompiledPotential::<f64>::compile(&parse(text, 2), 2);
    assert_eq!(potential.quadratic().stiffness, [(0, 0, 1.5), (1, 1, -3.0)]);
    assert_eq!(potential.pattern(), [(0, 0), (1, 1)]);
    let q = [0.3, 0.7];
    let (found, expected) = (compiled(text, q), dual(text, q));
    assert_eq!(found.0, expected.0);
    assert!((found.1 - expected.1).amax() < 1e-14 && (found.2 - expected.2).amax() < 1e-14);
}

#[test]
fn what_is_not_quadratic_stays_whole() {
    for text in ["9.81*(1 - cos(q0))", "q0^3", "q0*q0*q0", "1/q0", "q0^2*cos(q1)", "1e300*q0*(1e300*q0)"] {
        let potential = CompiledPotential::<f64>::compile(&parse(text, 2), 2);
        assert!(!potential.is_quadratic() && *potential.quadratic() == QuadraticPart::default(), "{text}");
    }
    let none = CompiledPotential::<f64>::compile(&parse("3 - 1", 1), 1);
    assert!(none.is_quadratic() && none.quadratic().stiffness.is_empty());
}

/// Nonlinear springs between neighbours.
fn chain(coordinates: usize) -> String {
    let spring = |i: usize| format!("0.5*(q{i} - q{})^2 + 0.25*10*(q{i} - q{})^4", i - 1, i - 1);
    format!("cos(q0) + {}", (1..coordinates).map(spring).collect::<Vec<_>>().join(" + "))
}

#[test]
fn a_long_chain_has_a_banded_pattern_and_agrees_with_its_formula() {
    // Long enough for several windows.
    let n = 1000;
    let potential = CompiledPotential::<f64>::compile(&parse(&chain(n), n), n);
    let band = (0..n as u32).flat_map(|i| [(i, i.wrapping_sub(1)), (i, i)]).skip(1);
    assert!(potential.pattern().iter().copied().eq(band));
    let q: Vec<f64> = (0..n).map(|i| (i as f64 * 0.7).sin()).collect();
    let (mut registers, mut gradient, mut entries) = (Vec::new(), vec![0.0; n], vec![0.0; 2 * n - 1]);
    potential.derivatives(&q, &mut registers, &mut gradient, &mut entries);
    for i in 0..n {
        let stretch = |i: usize| if (1..n).contains(&i) { q[i] - q[i - 1] } else { 0.0 };
        let tension = |i| stretch(i) + 10.0 * stretch(i).powi(3);
        let stiffness = |i| if (1..n).contains(&i) { 30.0 * stretch(i).powi(2) } else { 0.0 };
        let wall = if i == 0 { [-q[0].sin(), -q[0].cos()] } else { [0.0; 2] };
        assert!((gradient[i] - (tension(i) - tension(i + 1) + wall[0])).abs() < 1e-13, "{i}");
        assert!((entries[2 * i] - (stiffness(i) + stiffness(i + 1) + wall[1])).abs() < 1e-12, "{i}");
        if i > 0 {
            assert!((entries[2 * i - 1] + stiffness(i)).abs() < 1e-12, "{i}");
        }
    }
    assert_eq!(potential.value(&q, &mut registers), parse(&chain(n), n).value(Moment::inside(0.0), &q));
}

#[test]
fn the_work_of_a_chain_grows_with_its_length() {
    let operations = |n: usize| {
        let text: Vec<_> = (1..n).map(|i| format!("(q{i} - q{})^4", i - 1)).collect();
        CompiledPotential::<f64>::compile(&parse(&text.join(" + "), n), n).operations() as f64
    };
    let (short, long) = (operations(9) / 8.0, operations(2001) / 2000.0);
    assert!(short >= 5.0 && long <= 1.05 * short, "{short} and {long} operations for a spring");
}

#[test]
fn what_every_term_shares_reaches_every_window() {
    let n = 500;
    let text = (1..n).map(|i| format!("exp(q0)*cos(q{i} - q0)")).collect::<Vec<_>>().join(" + ");
    let potential = CompiledPotential::<f64>::compile(&parse(&text, n), n);
    let q: Vec<f64> = (0..n).map(|i| (i as f64 * 0.7).sin()).collect();
    let (mut gradient, mut entries) = (vec![0.0; n], vec![0.0; 2 * n - 1]);
    potential.derivatives(&q, &mut Vec::new(), &mut gradient, &mut entries);
    let factor = q[0].exp();
    let (mut slope, mut curvature) = (0.0, 0.0);
    for i in 1..n {
        let (sine, cosine) = (q[i] - q[0]).sin_cos();
        slope += factor * (cosine + sine);
        curvature += factor * 2.0 * sine;
        assert!((gradient[i] + factor * sine).abs() < 1e-14, "{i}");
        assert_eq!(potential.pattern()[2 * i - 1..=2 * i], [(i as u32, 0), (i as u32, i as u32)]);
        assert!((entries[2 * i - 1] - factor * (cosine - sine)).abs() < 1e-14, "{i}");
        assert!((entries[2 * i] + factor * cosine).abs() < 1e-14, "{i}");
    }
    assert!((gradient[0] - slope).abs() < 1e-11 && (entries[0] - curvature).abs() < 1e-11);
}

#[test]
fn a_sum_of_ten_thousand_terms_compiles() {
    let text = (0..10_000).map(|i| format!("sin({i}*q0)")).collect::<Vec<_>>().join(" - ");
    let potential = CompiledPotential::<f64>::compile(&parse(&text, 1), 1);
    assert_eq!(potential.pattern(), [(0, 0)]);
    assert_eq!(potential.value(&[0.0], &mut Vec::new()), 0.0);
}

#[test]
fn the_room_to_work_in_may_hold_anything() {
    let potential = CompiledPotential::<f64>::compile(&parse("q0*cos(q1)", 2), 2);
    let mut registers = vec![f64::NAN; 3];
    let mut gradient = [0.0; 2];
    potential.gradient(&[2.0, 0.0], &mut registers, &mut gradient);
    assert_eq!(gradient, [1.0, 0.0]);
    registers.fill(f64::NAN);
    assert_eq!(potential.value(&[2.0, 0.0], &mut registers), 2.0);
}

fn force(components: &[&str]) -> CompiledForce<f64> {
    let count = components.len();
    CompiledForce::compile(&components.iter().map(|text| parse(text, count)).collect::<Vec<_>>())
}

#[test]
fn forces_are_known_by_what_they_depend_on() {
    let facts = |components: &[&str]| {
        let force = force(components);
        (
            force.is_zero(),
            force.is_constant(),
            force.depends_on_time(),
            force.depends_on_position(),
            force.is_affine(),
        )
    };
    assert_eq!(facts(&[]), (true, true, false, false, true));
    assert_eq!(facts(&["0", "1 - 1"]), (true, true, false, false, true));
    assert_eq!(facts(&["0", "2"]), (false, true, false, false, true));
    assert_eq!(facts(&["0", "8*step(1 - t)"]), (false, false, true, false, true));
    assert_eq!(facts(&["-2*q0 + q1/4", "sin(t) - q1"]), (false, false, true, true, true));
    assert_eq!(facts(&["q0*t", "1"]), (false, false, true, true, false));
    assert_eq!(facts(&["q0^2", "1"]), (false, false, false, true, false));
}

#[test]
fn the_parts_of_a_force_add_up() {
    let force = force(&["2 - 3*q0 + q1/4 + 5*t", "t*q1^2 + q0", "7", "sin(t)", "0"]);
    assert_eq!(force.linear(), [(0, 0, -3.0), (0, 1, 0.25)]);
    assert_eq!(force.pattern(), [(1, 0), (1, 1)]);
    let q = [1.0, 8.0, 0.0, 0.0, 0.0];
    let (mut registers, mut value, mut jacobian) = (Vec::new(), [f64::NAN; 5], [f64::NAN; 2]);
    let moment = Moment::inside(2.0);
    let expected = [11.0, 129.0, 7.0, 2f64.sin(), 0.0];
    force.value(moment, &q, &mut registers, &mut value);
    assert_eq!(value, expected);
    value.fill(f64::NAN);
    force.derivatives(moment, &q, &mut registers, &mut value, &mut jacobian);
    assert_eq!((value, jacobian), (expected, [1.0, 32.0]));
    force.load(moment, &mut registers, &mut value);
    assert_eq!(value, [12.0, 0.0, 7.0, 2f64.sin(), 0.0]);
}

#[test]
fn a_jump_of_a_force_is_seen_from_the_side_it_is_approached_from() {
    let force = force(&["t*step(t - 0.3)", "q0*step(t - 0.3)"]);
    let at = |moment| {
        let mut value = [f64::NAN; 2];
        force.value(moment, &[2.0, 0.0], &mut Vec::new(), &mut value);
        value
    };
    assert_eq!(at(Moment::from_left(3.0 * 0.1)), [0.0, 0.0]);
    assert_eq!(at(Moment::from_right(0.3)), [0.3, 2.0]);
}

/// Random expressions in q0, q1, q2 with nested functions, mostly regular for q between 0.2 and 1.
fn expressions() -> impl Strategy<Value = String> {
    let leaf = prop_oneof![
        3 => (0..3).prop_map(|i| format!("q{i}")),
        1 => (1..40).prop_map(|n| format!("{}", f64::from(n) / 8.0)),
    ];
    leaf.prop_recursive(5, 40, 3, |inner| {
        let operators = prop::sample::select(vec!["+", "-", "*", "/"]);
        let functions = prop::sample::select(vec!["sin", "cos", "tanh", "exp", "abs", "sign", "sqrt", "gamma", "-"]);
        let choices = prop::sample::select(vec!["min", "max"]);
        prop_oneof![
            4 => prop::collection::vec((operators, inner.clone()), 2..4).prop_map(|operands| {
                let joined: String = operands.iter().map(|(operator, operand)| format!(" {operator} {operand}")).collect();
                format!("(1{joined})")
            }),
            2 => (functions, inner.clone()).prop_map(|(function, x)| format!("{function}({x})")),
            1 => (choices, inner.clone(), inner.clone()).prop_map(|(choice, x, y)| format!("{choice}({x}, {y})")),
            2 => (inner.clone(), prop::sample::select(vec!["0", "1", "2", "3", "5", "-1", "-2", "0.5", "2.5"]))
                .prop_map(|(x, exponent)| format!("({x})^{exponent}")),
            1 => (inner.clone(), inner).prop_map(|(x, y)| format!("abs({x})^({y})")),
        ]
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]
    #[test]
    fn random_expressions_agree_with_forward_differentiation(
        text in expressions(),
        q in prop::array::uniform3(0.2..1.0_f64),
    ) {
        let Ok(expression) = Expression::parse(&text, &symbols(3)) else { return Ok(()) };
        let (value, gradient, hessian) = expression.hessian(Moment::inside(0.0), &SVector::from(q));
        let found = compiled(&text, q);
        prop_assert!(agree(found.0, value, 0.0), "{} {} {}", text, found.0, value);
        // Forward differentiation passes through values that are not numbers even where they do not matter:
        // √(−1) to the power 0.
        prop_assume!(gradient.iter().chain(&hessian).all(|number| number.is_finite()));
        // A quadratic part that is split off is rounded differently; the difference of two large ones
        // cancels.
        let size = gradient.amax().max(hessian.amax());
        prop_assume!(size < 1e6);
        for (found, expected) in found.1.iter().chain(&found.2).zip(gradient.iter().chain(&hessian)) {
            prop_assert!(agree(*found, *expected, 1e-13 * size.max(1.0)), "{} {} {}", text, found, expected);
        }
    }
}
