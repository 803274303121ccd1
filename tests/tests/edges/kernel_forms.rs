//! Kernels of every form with parameters drawn to their edges, as a scenario has them and as a formula.

use nalgebra::Complex;
use std::rc::Rc;

type Symbol = Rc<dyn Fn(Complex<f64>) -> Complex<f64>>;

/// A kernel in a scenario, its K(s) written out, and what follows from its formula.
#[derive(Clone)]
pub(super) struct Drawn {
    /// The value of `kernel`.
    pub(super) keys: String,
    pub(super) symbol: Symbol,
    /// K(s) ~ s^µ.
    pub(super) growth: f64,
    /// True if its cut is too narrow for an integral: then weights from transforms alone take it.
    pub(super) is_narrow: bool,
}

/// A number in (0, 1): near 0, near 1, or between.
fn edge(numbers: &mut impl FnMut() -> f64) -> f64 {
    let (choice, place) = (numbers(), numbers());
    let near = 10f64.powf(-3.0 + 2.0 * place);
    let number = if choice < 0.3 {
        near
    } else if choice < 0.6 {
        1.0 - near
    } else {
        0.05 + 0.9 * place
    };
    (number * 1e4).round() / 1e4
}

/// A time of a few decades about 1.
fn time(numbers: &mut impl FnMut() -> f64, decades: f64) -> f64 {
    let time = 10f64.powf(decades * (2.0 * numbers() - 1.0));
    format!("{time:.2e}").parse().expect("a number")
}

fn power(s: Complex<f64>, exponent: f64) -> Complex<f64> {
    s.powf(exponent)
}

fn drawn(keys: String, growth: f64, symbol: impl Fn(Complex<f64>) -> Complex<f64> + 'static) -> Drawn {
    Drawn { keys, symbol: Rc::new(symbol), growth, is_narrow: false }
}

/// The number of forms.
pub(super) const FORMS: usize = 9;

/// A passive kernel of a form, that grows at most like s.
pub(super) fn draw(form: usize, numbers: &mut impl FnMut() -> f64) -> Drawn {
    match form % FORMS {
        0 => {
            let order = edge(numbers);
            drawn(format!(r#"{{ form = "power", order = {order:?} }}"#), order, move |s| power(s, order))
        }
        1 => {
            let (order, rate) = (edge(numbers), time(numbers, 3.0));
            let keys = format!(r#"{{ form = "tempered", order = {order:?}, rate = {rate:?} }}"#);
            drawn(keys, order, move |s| {
                // (1 + x)^β − 1 loses its digits at small x.
                let x = s / rate;
                let beside = if x.norm() < 1e-4 {
                    x * order * (1.0 + x * (0.5 * (order - 1.0)) * (1.0 + x * ((order - 2.0) / 3.0)))
                } else {
                    power(x + 1.0, order) - 1.0
                };
                beside * rate.powf(order)
            })
        }
        form @ (2 | 3) => {
            let (order, time) = (edge(numbers), time(numbers, 3.0));
            let inner = if form == 2 { 0.0 } else { (order * edge(numbers) * 1e4).floor() / 1e4 };
            let keys =
                format!(r#"{{ form = "maxwell", order = {order:?}, inner = {inner:?}, time = {time:?} }}"#);
            let symbol =
                move |s: Complex<f64>| power(s * time, order) / (1.0 + power(s * time, order - inner));
            let is_narrow = order - inner > 0.9968;
            Drawn { is_narrow, ..drawn(keys, inner, symbol) }
        }
        4 => {
            let [first, second] = [time(numbers, 3.0), time(numbers, 3.0)];
            let [one, other] = [time(numbers, 1.0), time(numbers, 1.0)];
            let keys = format!(
                r#"{{ form = "prony", strengths = [{one:?}, {other:?}], times = [{first:?}, {second:?}] }}"#
            );
            let part = |g: f64, time: f64, s: Complex<f64>| s * (g * time) / (s * time + 1.0);
            drawn(keys, 0.0, move |s| part(one, first, s) + part(other, second, s))
        }
        form @ (5 | 6) => {
            let order = if form == 5 { edge(numbers) } else { 1.0 };
            let (exponent, time) = (edge(numbers), time(numbers, 2.0));
            let keys = format!(
                r#"{{ form = "havriliak-negami", order = {order:?}, power = {exponent:?}, time = {time:?} }}"#
            );
            let symbol = move |s: Complex<f64>| 1.0 - power(1.0 + power(s * time, order), -exponent);
            Drawn { is_narrow: order != 1.0 && order > 0.9968, ..drawn(keys, 0.0, symbol) }
        }
        7 => {
            let [first, second] = [edge(numbers), edge(numbers)];
            let keys = format!(r#"{{ symbol = "s^{first:?} + 0.2*s^{second:?}" }}"#);
            drawn(keys, first.max(second), move |s| power(s, first) + power(s, second) * 0.2)
        }
        _ => {
            let [first, second] = [edge(numbers), edge(numbers)];
            let keys = format!(r#"{{ symbol = "0.2*s^{first:?} + s^{second:?}/(1 + s^{second:?})" }}"#);
            let symbol = move |s| power(s, first) * 0.2 + power(s, second) / (1.0 + power(s, second));
            Drawn { is_narrow: second > 0.9968, ..drawn(keys, first, symbol) }
        }
    }
}
