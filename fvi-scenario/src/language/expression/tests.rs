use super::*;
use core::f64::consts::PI;

fn coordinates(count: usize) -> Symbols {
    Symbols::new().with_time().with_coordinates(count)
}

fn value(text: &str) -> f64 {
    Expression::parse(text, &Symbols::new()).unwrap().value::<f64>(Moment::inside(0.0), &[])
}

fn at_time(text: &str, moment: Moment<f64>) -> f64 {
    Expression::parse(text, &coordinates(0)).unwrap().value(moment, &[])
}

fn second_order(text: &str, q: f64) -> (f64, f64, f64) {
    let expression = Expression::parse(text, &coordinates(1)).unwrap();
    let (value, gradient, hessian) = expression.hessian(Moment::inside(0.0), &SVector::<f64, 1>::new(q));
    (value, gradient[0], hessian[(0, 0)])
}

fn fault(text: &str) -> (ExpressionFault, usize) {
    let symbols = coordinates(2).with_parameter("stiffness", 2.0).unwrap();
    let error = Expression::parse(text, &symbols).unwrap_err();
    (error.fault.clone(), error.column())
}

#[test]
fn precedence_is_that_of_mathematics() {
    assert_eq!(value("1 + 2*3"), 7.0);
    assert_eq!(value("8 - 4 - 2"), 2.0);
    assert_eq!(value("16/4/2"), 2.0);
    assert_eq!(value("2^3^2"), 512.0);
    assert_eq!(value("-3^2"), -9.0);
    assert_eq!(value("(-3)^2"), 9.0);
    assert_eq!(value("2^-1"), 0.5);
    assert_eq!(value("2^-2^2"), 0.0625);
    assert_eq!(value("--3 - -2"), 5.0);
    assert_eq!(value("2*-3"), -6.0);
    assert_eq!(value("-2*3 + +1"), -5.0);
    assert_eq!(value("1e-3 + 2.5E+1 + .5 + 4."), 29.501);
    assert_eq!(value(" ( ( 2 ) * ( 3 + 4 ) ) "), 14.0);
}

#[test]
fn functions_have_their_usual_values() {
    let cases = [
        ("sin(pi/6)", 0.5),
        ("cos(pi/3)", 0.5),
        ("tan(pi/4)", 1.0),
        ("sinh(1)", 1.1752011936438014),
        ("cosh(1)", 1.5430806348152437),
        ("tanh(1)", 0.7615941559557649),
        ("exp(1)", core::f64::consts::E),
        ("log(exp(2))", 2.0),
        ("sqrt(2)", core::f64::consts::SQRT_2),
        ("abs(-3)", 3.0),
        ("gamma(0.5)", PI.sqrt()),
        ("gamma(5)", 24.0),
        ("min(2, 3) + 10*max(2, 3)", 32.0),
        ("step(0) + 10*step(-1e-300) + 100*step(2)", 101.0),
        ("sign(-2) + 10*sign(0) + 100*sign(3)", 99.0),
    ];
    for (text, expected) in cases {
        assert!((value(text) - expected).abs() <= 4e-16 * expected.abs(), "{text} = {}", value(text));
    }
}

#[test]
fn parameters_are_constants_and_pi_is_known() {
    let symbols = coordinates(1).with_parameter("k", 4.0).unwrap();
    let expression = Expression::parse("0.5*k*q0^2", &symbols).unwrap();
    let (energy, force, stiffness) = expression.hessian(Moment::inside(0.0), &SVector::<f64, 1>::new(3.0));
    assert_eq!((energy, force[0], stiffness[(0, 0)]), (18.0, 12.0, 4.0));
    assert_eq!(value("2*pi"), 2.0 * PI);
}

#[test]
fn names_with_a_meaning_cannot_be_parameters() {
    let refused = |name| coordinates(1).with_parameter(name, 1.0).unwrap_err();
    assert_eq!(refused("t"), ParameterNameError::Time);
    assert_eq!(refused("q0"), ParameterNameError::Variable);
    assert_eq!(refused("q7"), ParameterNameError::Variable);
    assert_eq!(refused("pi"), ParameterNameError::Constant);
    assert_eq!(refused("sin"), ParameterNameError::Function);
    assert_eq!(refused("2k"), ParameterNameError::NotAName);
    assert_eq!(refused(""), ParameterNameError::NotAName);
    assert!(coordinates(1).with_parameter("q", 1.0).is_ok());
    assert!(coordinates(1).with_parameter("µ_1", 1.0).is_ok());
}

#[test]
fn whole_powers_are_regular_everywhere() {
    assert_eq!(second_order("q0^2", 0.0), (0.0, 0.0, 2.0));
    assert_eq!(second_order("q0^1", 0.0), (0.0, 1.0, 0.0));
    assert_eq!(second_order("q0^0", 0.0), (1.0, 0.0, 0.0));
    assert_eq!(second_order("q0^3", -2.0), (-8.0, 12.0, -12.0));
    assert_eq!(second_order("q0^4", 0.0), (0.0, 0.0, 0.0));
    assert_eq!(second_order("q0^-1", -2.0), (-0.5, -0.25, -0.25));
    assert_eq!(second_order("q0^9", -1.0), (-1.0, 9.0, -72.0));
    assert_eq!(second_order("q0^2.5", 0.0), (0.0, 0.0, 0.0));
    assert_eq!(second_order("abs(q0)^1.5", 0.0).1, 0.0);
}

#[test]
fn a_fractional_power_of_time_at_zero_has_no_derivative_in_the_coordinates() {
    let expression = Expression::parse("t^2.5 + sqrt(t)*q0 + q1", &coordinates(2)).unwrap();
    let (value, gradient) = expression.gradient(Moment::inside(0.0), &SVector::<f64, 2>::new(3.0, 4.0));
    assert_eq!((value, gradient[0], gradient[1]), (4.0, 0.0, 1.0));
}

#[test]
fn a_variable_that_does_not_occur_has_no_influence_even_where_a_slope_is_infinite() {
    let expression = Expression::parse("sqrt(q0)", &coordinates(2)).unwrap();
    let (_, gradient, hessian) = expression.hessian(Moment::inside(0.0), &SVector::<f64, 2>::new(0.0, 1.0));
    assert_eq!(gradient[0], f64::INFINITY);
    assert_eq!((gradient[1], hessian[(1, 1)], hessian[(0, 1)]), (0.0, 0.0, 0.0));
}

/// Derivatives against central differences of fourth order, in two coordinates, through every function.
#[test]
fn gradient_and_hessian_agree_with_difference_quotients() {
    let texts = [
        "sin(q0)*cos(q1) + tan(q0*q1)",
        "exp(q0 - q1^2)/(1 + q0^2)",
        "log(2 + q0*q1) - sqrt(3 + q0 + q1^3)",
        "sinh(q0)*cosh(q1)*tanh(q0 - 2*q1)",
        "(2 + q0)^(1 + q1)",
        "2^(q0*q1)",
        "(1.3 + q0*q1)^2.7",
        "gamma(1.5 + q0*q1)",
        "gamma(q1 - 1.7)",
        "max(q0, q1)^3 - min(q0^2, q1)",
        "abs(q0 - q1)*q0",
        "-q0^-3/q1",
        "step(q0 - t)*q0^2 + sign(q0 - 1)*q1^2",
    ];
    let q = SVector::<f64, 2>::new(0.7, 0.4);
    let moment = Moment::inside(0.5);
    let h = 1e-3;
    for text in texts {
        let expression = Expression::parse(text, &coordinates(2)).unwrap();
        let (value, gradient, hessian) = expression.hessian(moment, &q);
        let (first_value, first_gradient) = expression.gradient(moment, &q);
        assert_eq!(value, expression.value(moment, q.as_slice()), "{text}");
        assert_eq!((value, gradient), (first_value, first_gradient), "{text}");
        for i in 0..2 {
            let shifted = |steps: f64| {
                let mut point = q;
                point[i] += steps * h;
                expression.gradient(moment, &point)
            };
            let (far, near) = (shifted(2.0), shifted(1.0));
            let (back, far_back) = (shifted(-1.0), shifted(-2.0));
            let slope = (8.0 * (near.0 - back.0) - (far.0 - far_back.0)) / (12.0 * h);
            assert!(
                (gradient[i] - slope).abs() < 1e-8 * (1.0 + slope.abs()),
                "{text}: {} {slope}",
                gradient[i]
            );
            let curvature = ((near.1 - back.1) * 8.0 - (far.1 - far_back.1)) / (12.0 * h);
            for j in 0..2 {
                let (exact, quotient) = (hessian[(i, j)], curvature[j]);
                assert!(
                    (exact - quotient).abs() < 1e-8 * (1.0 + quotient.abs()),
                    "{text}: {exact} {quotient}"
                );
                assert_eq!(exact, hessian[(j, i)], "{text}");
            }
        }
    }
}

#[test]
fn the_derivatives_of_gamma_are_accurate() {
    // ψ(1) = −γ, Γ″(1) = γ² + π²/6, with Euler's γ.
    let euler = 0.577_215_664_901_532_9;
    let (value, first, second) = second_order("gamma(q0)", 1.0);
    assert_eq!(value, 1.0);
    assert!((first + euler).abs() < 1e-14);
    assert!((second - (euler * euler + PI * PI / 6.0)).abs() < 1e-13);
}

#[test]
fn single_precision_agrees_with_double() {
    let expression = Expression::parse("sin(3*q0)*exp(-q0)/gamma(q0) + q0^2.5", &coordinates(1)).unwrap();
    let double = expression.hessian(Moment::inside(0.0), &SVector::<f64, 1>::new(0.625));
    let single = expression.hessian(Moment::inside(0.0), &SVector::<f32, 1>::new(0.625));
    assert!((double.0 - f64::from(single.0)).abs() < 1e-6);
    assert!((double.1[0] - f64::from(single.1[0])).abs() < 1e-5);
    assert!((double.2[(0, 0)] - f64::from(single.2[(0, 0)])).abs() < 1e-4);
}

#[test]
fn a_jump_at_a_grid_point_is_seen_from_the_side_it_is_approached_from() {
    for steps in [1.0, 3.0, 7.0, 1e6] {
        // Grid times are rounded products: 3·0.1 lies above 0.3, 7·0.1 is 0.7000000000000001.
        let grid = steps * 0.1;
        let jump = format!("step(t - {})", steps / 10.0);
        assert_eq!(at_time(&jump, Moment::from_left(grid)), 0.0, "{jump}");
        assert_eq!(at_time(&jump, Moment::from_right(grid)), 1.0, "{jump}");
        let end = format!("step({} - t)", steps / 10.0);
        assert_eq!(at_time(&end, Moment::from_left(grid)), 1.0, "{end}");
        assert_eq!(at_time(&end, Moment::from_right(grid)), 0.0, "{end}");
        let sign = format!("sign({} - t)", steps / 10.0);
        assert_eq!(at_time(&sign, Moment::from_left(grid)), 1.0, "{sign}");
        assert_eq!(at_time(&sign, Moment::from_right(grid)), -1.0, "{sign}");
    }
    assert_eq!(at_time("step(1 - t)", Moment::inside(1.0)), 1.0);
    assert_eq!(at_time("step(sin(2*pi*t))", Moment::from_left(2.5)), 1.0);
    assert_eq!(at_time("step(sin(2*pi*t))", Moment::from_right(2.5)), 0.0);
    let single = Expression::parse("step(t - 0.3)", &coordinates(0)).unwrap();
    assert_eq!(single.value(Moment::from_left(3.0 * 0.1_f32), &[]), 0.0);
    assert_eq!(single.value(Moment::from_right(3.0 * 0.1_f32), &[]), 1.0);
}

#[test]
fn only_jumps_see_a_side() {
    let exactly = 0.3;
    assert_eq!(at_time("t", Moment::from_left(exactly)), exactly);
    assert_eq!(at_time("t*step(t - 0.3) + max(t, 0)", Moment::from_right(exactly)), 2.0 * exactly);
    assert_eq!(at_time("step(t)", Moment::from_right(0.0)), 1.0);
}

#[test]
fn mistakes_are_named_with_their_column() {
    use ExpressionFault as Fault;
    assert_eq!(fault(""), (Fault::Empty, 1));
    assert_eq!(fault("   "), (Fault::Empty, 1));
    assert_eq!(fault("(q0 + 1"), (Fault::Unclosed, 1));
    assert_eq!(fault("2*sin(q0"), (Fault::Unclosed, 6));
    assert_eq!(fault("q0 + 1)"), (Fault::Unopened, 7));
    assert_eq!(fault(")"), (Fault::Unopened, 1));
    assert_eq!(fault("q0 q1"), (Fault::MissingOperator, 4));
    assert_eq!(fault("2q0"), (Fault::MissingOperator, 2));
    assert_eq!(fault("q0(1)"), (Fault::MissingOperator, 3));
    assert_eq!(fault("q0 + "), (Fault::MissingOperand, 6));
    assert_eq!(fault("()"), (Fault::MissingOperand, 2));
    assert_eq!(fault("q0**2"), (Fault::UnexpectedCharacter { character: '*' }, 4));
    assert_eq!(fault("q0 − 1"), (Fault::UnexpectedCharacter { character: '−' }, 4));
    assert_eq!(fault("1.2.3"), (Fault::MissingOperator, 4));
    assert_eq!(fault("."), (Fault::BadNumber { text: ".".to_owned() }, 1));
    assert_eq!(fault("1e999"), (Fault::BadNumber { text: "1e999".to_owned() }, 1));
    assert_eq!(fault("q0 + sin"), (Fault::MissingArgument { name: "sin".to_owned() }, 6));
    assert_eq!(fault("max(q0)"), (Fault::ArgumentCount { name: "max".to_owned(), expected: 2, found: 1 }, 1));
    assert_eq!(
        fault("sin(1, 2)"),
        (Fault::ArgumentCount { name: "sin".to_owned(), expected: 1, found: 2 }, 1)
    );
    assert_eq!(fault("q0*(1/0)"), (Fault::NotFinite { value: f64::INFINITY }, 5));
    assert_eq!(fault("1 + sin"), (Fault::MissingArgument { name: "sin".to_owned() }, 5));
    assert!(matches!(fault("0.5*q2^2"), (Fault::UnknownName { name, .. }, 5) if name == "q2"));
    assert!(matches!(fault("sine(q0)"), (Fault::UnknownFunction { suggestion: Some("sin"), .. }, 1)));
}

#[test]
fn an_unknown_name_comes_with_the_known_ones() {
    let symbols = coordinates(1).with_parameter("stiffness", 2.0).unwrap();
    let error = Expression::parse("stifness*q0", &symbols).unwrap_err();
    assert_eq!(error.to_string(), "unknown name `stifness` (column 1)");
    assert_eq!(error.advice().unwrap(), "did you mean `stiffness`? Known here: t, q0, stiffness, pi");
    // `t` is as near.
    let error = Expression::parse("-q", &symbols).unwrap_err();
    assert!(error.advice().unwrap().starts_with("did you mean `q0`?"));
}

#[test]
fn of_many_coordinates_a_message_names_the_first_and_the_last() {
    let advice = |count, text| Expression::parse(text, &coordinates(count)).unwrap_err().advice().unwrap();
    assert_eq!(advice(2000, "frequency"), "known here: t, q0, q1, …, q1999, pi");
    assert!(advice(8, "frequency").contains("q6, q7"));
    assert!(advice(2000, "q2000").starts_with("did you mean `q"));
}

#[test]
fn hostile_nesting_is_refused_before_the_stack_runs_out() {
    for text in ["(".repeat(100_000), "-(".repeat(100_000), "2^".repeat(100_000), "sin(".repeat(100_000)] {
        assert!(Expression::parse(&text, &coordinates(1)).is_err());
    }
    let deep = format!("q0{}{}", " + (2*(q0".repeat(100), "))".repeat(100));
    assert_eq!(fault(&deep).0, ExpressionFault::TooDeep);
    assert_eq!(value(&format!("{}1{}", "(".repeat(100), ")".repeat(100))), 1.0);
    assert_eq!(value(&format!("{}1", "-".repeat(10_001))), -1.0);
}

#[test]
fn sums_and_products_may_have_any_number_of_terms() {
    let sum = format!("q0{}", " + q0 - 1".repeat(100_000));
    let (value, first, second) = second_order(&sum, 3.0);
    assert_eq!((value, first, second), (200_003.0, 100_001.0, 0.0));
    let product = format!("q0{}", "*2/2".repeat(100_000));
    assert_eq!(second_order(&product, 3.0), (3.0, 1.0, 0.0));
    // Evaluated from left to right, as without brackets: 1e16 + 1 + 1 loses both ones.
    assert_eq!(second_order("q0 + 1 + 1 - q0", 1e16).0, 0.0);
    // A part without variables is evaluated as a number: no derivative of √t at t = 0.
    let root = Expression::parse("t^0.5 + t*2 + q0*q0", &coordinates(1)).unwrap();
    assert_eq!(
        root.gradient(Moment::inside(0.0), &SVector::<f64, 1>::new(3.0)),
        (9.0, SVector::<f64, 1>::new(6.0))
    );
}

#[test]
fn a_number_made_before_a_variable_comes_has_no_derivative() {
    // 1/t is infinite; evaluated with derivatives, it would make the derivative by q0 0·∞.
    let expression = Expression::parse("1/t*q0", &coordinates(1)).unwrap();
    let (_, gradient) = expression.gradient(Moment::inside(0.0), &SVector::<f64, 1>::new(1.0));
    assert_eq!(gradient[0], f64::INFINITY);
}

#[test]
fn sine_and_cosine_in_one_are_those_computed_alone() {
    for step in -40_000..40_000 {
        // From below the smallest argument that differs from its sine to beyond every branch of the argument
        // reduction.
        let x = f64::from(step % 40) * 1.37 * 10f64.powf(f64::from(step / 1000) * 0.25);
        let (sine, cosine) = x.sine_cosine();
        assert_eq!((sine.to_bits(), cosine.to_bits()), (x.sine().to_bits(), x.cosine().to_bits()), "{x}");
        let x = x as f32;
        let (sine, cosine) = x.sine_cosine();
        assert_eq!((sine.to_bits(), cosine.to_bits()), (x.sine().to_bits(), x.cosine().to_bits()), "{x}");
    }
}

#[test]
fn an_endless_name_is_answered_at_once_and_in_short() {
    let error = Expression::parse(&"k".repeat(1_000_000), &coordinates(1)).unwrap_err();
    assert!(error.to_string().len() < 200, "{}", error.to_string().len());
    assert_eq!(nearest(&"k".repeat(1_000_000), ["k", "kk"].into_iter()), None);
    assert_eq!(nearest("stifness", ["mass", "stiffness"].into_iter()), Some("stiffness"));
}
