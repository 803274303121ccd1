//! The Lagrange–d'Alembert integrator of the linearly damped oscillator, as [JO] Algorithm 2 states it.

/// q̈ + ρ q̇ + q = 0 from q₀, p₀.
#[derive(Clone, Copy, Debug)]
pub(super) struct LinearOscillator {
    /// ρ.
    pub(super) coefficient: f64,
    /// q₀.
    pub(super) position: f64,
    /// p₀.
    pub(super) momentum: f64,
}

/// Positions q_0…q_`steps` of the integrator with the midpoint rule and the discrete forces f⁻ = 0, f⁺ = −ρ
/// (q_{k+1} − q_k).
///
/// ```text
/// D₁L_d(q_k, q_{k+1}) + D₂L_d(q_{k−1}, q_k) + f⁺(q_{k−1}, q_k) = 0 ,      p₀ = −D₁L_d(q₀, q₁)
/// L_d(a, b) = (b − a)²/(2h) − h ((a + b)/2)²/2
/// ```
///
/// A recursion over positions alone: no momenta after the first, no memory. Source: \[JO\] Algorithm 2,
/// Corollary 4.2.
pub(super) fn positions(oscillator: &LinearOscillator, step_size: f64, steps: usize) -> Vec<f64> {
    let h = step_size;
    // D₁L_d(a, b) = −(b − a)/h − h (a + b)/4 ,  D₂L_d(a, b) = (b − a)/h − h (a + b)/4
    let second_slot = |a: f64, b: f64| (b - a) / h - 0.25 * h * (a + b);
    // The b with −D₁L_d(a, b) = impulse.
    let next = |a: f64, impulse: f64| (impulse + a * (1.0 / h - 0.25 * h)) / (1.0 / h + 0.25 * h);
    let mut positions = vec![oscillator.position];
    let mut impulse = oscillator.momentum;
    for k in 0..steps {
        let (here, there) = (positions[k], next(positions[k], impulse));
        impulse = second_slot(here, there) - oscillator.coefficient * (there - here);
        positions.push(there);
    }
    positions
}
