//! Defects of convolution quadrature of the derivative of a power of time, to full accuracy.

use fvi_core::{BdfOrder, ConvolutionWeights, DoubleDouble, ParameterError};

/// The defects of powers t^ν under convolution quadrature with step size 1,
///
/// ```text
/// d_k = Γ(ν+1)/Γ(ν+1−β) k^{ν−β} − Σ_{n=0}^{k} w_n (k−n)^ν ~ k^{ν−β−p} .
/// ```
///
/// The terms on the right, of size k^ν, cancel to d_k: in double precision rounding would be k^{β+p} units of
/// it. For small k the sum is therefore computed in double-double arithmetic, and from some k on by the
/// asymptotic expansion, in which the large terms cancel analytically. With z = e^{−s} and (γ_p(e^{−s})/s)^β
/// = Σ_m c_m s^m, c₀ = 1,
///
/// ```text
/// Σ_n n^ν e^{−ns} = Γ(ν+1) s^{−ν−1} + Σ_i ζ(−ν−i) (−s)^i/i! ,      s^μ ↔ k^{−μ−1}/Γ(−μ)
/// d_k ~ −Σ_{m≥p} c_m Γ(ν+1)/Γ(ν+1−β−m) k^{ν−β−m}
///       − Σ_{j≥0} k^{−β−1−j}/Γ(−β−j) Σ_{i+m=j} c_m ζ(−ν−i) (−1)^i/i! .
/// ```
///
/// Source: \[Lubich86\] for the error's leading term; \[FS\] ch. VI for expansions of coefficients from those
/// of a function at its singularity.
#[derive(Clone, Debug)]
pub(crate) struct PowerDefects {
    powers: Vec<Power>,
    /// From this step on the expansion holds to rounding.
    far: usize,
}

/// The defects of one power.
#[derive(Clone, Debug)]
struct Power {
    /// ν − β.
    reduced: f64,
    /// β + 1.
    tail: f64,
    /// d_k for k below `far`.
    near: Vec<f64>,
    /// Coefficients of k^{ν−β−m}, m = 0, 1, …
    regular: [f64; TERMS],
    /// Coefficients of k^{−β−1−j}, j = 0, 1, …
    start: [f64; TERMS],
}

/// Terms of the expansions. The first omitted term is below 10⁻¹⁶ of the defect wherever they are used.
const TERMS: usize = 24;

/// Number of steps until the contributions of the other zeros of γ_p, of absolute value 1/r, have decayed
/// like r^k, and the expansion has converged.
pub(crate) const FAR: [usize; 6] = [32, 48, 64, 96, 160, 384];

impl PowerDefects {
    /// The defects for the operator D^β by BDF p, for powers with the exponents ν ≥ 0.
    ///
    /// # Errors
    /// If β is outside (−1, 2).
    pub(crate) fn new(order: BdfOrder, beta: f64, exponents: &[f64]) -> Result<Self, ParameterError> {
        let far = FAR[order.get() - 1];
        // With the step size γ_p(0) the leading weight is 1.
        let leading = libm::pow(order.generating_function(0.0), beta);
        let mut weights = ConvolutionWeights::bdf(order, beta, 1.0)?;
        let weights: Vec<DoubleDouble> = (0..=far).map(|_| weights.next_monic()).collect();
        let symbol = symbol_expansion(order, beta);
        let powers = exponents.iter().map(|&nu| {
            let mut power = Power::expanded(nu, beta, &symbol);
            power.near = near_defects(nu, beta, leading, &weights, power.expansion(far));
            power
        });
        Ok(Self { powers: powers.collect(), far })
    }

    /// d_k of every power, k ≥ 1.
    pub(crate) fn at(&self, k: usize) -> impl Iterator<Item = f64> {
        self.powers.iter().map(move |power| match power.near.get(k) {
            Some(&defect) if k < self.far => defect,
            _ => power.expansion(k),
        })
    }

    /// Bytes of the table.
    pub(crate) fn bytes(&self) -> usize {
        self.powers.len() * (size_of::<Power>() + self.far * size_of::<f64>())
    }
}

impl Power {
    fn expanded(nu: f64, beta: f64, symbol: &[f64; TERMS]) -> Self {
        let (mut regular, mut start) = ([0.0; TERMS], [0.0; TERMS]);
        let mut ratio = libm::tgamma(nu + 1.0) * reciprocal_gamma(nu + 1.0 - beta);
        for (m, (place, c)) in regular.iter_mut().zip(symbol).enumerate().skip(1) {
            ratio *= nu + 1.0 - beta - m as f64;
            *place = -c * ratio;
        }
        // ζ(−ν−i) (−1)^i/i!; for ν = 0 the sum begins with 0⁰ = 1.
        let mut zetas = [0.0; TERMS];
        let mut factor = 1.0;
        for (i, place) in zetas.iter_mut().enumerate() {
            *place = factor * zeta_at_minus(nu + i as f64) + if nu == 0.0 && i == 0 { 1.0 } else { 0.0 };
            factor /= -(i as f64 + 1.0);
        }
        let mut reciprocal = reciprocal_gamma(-beta);
        for (j, place) in start.iter_mut().enumerate() {
            if j > 0 {
                reciprocal *= -beta - j as f64;
            }
            let sum: f64 = zetas[..=j].iter().zip(symbol[..=j].iter().rev()).map(|(zeta, c)| zeta * c).sum();
            *place = -reciprocal * sum;
        }
        Self { reduced: nu - beta, tail: beta + 1.0, near: Vec::new(), regular, start }
    }

    fn expansion(&self, k: usize) -> f64 {
        let k = k as f64;
        let horner = |terms: &[f64; TERMS]| terms.iter().rev().fold(0.0, |sum, term| sum / k + term);
        horner(&self.regular) * libm::pow(k, self.reduced) + horner(&self.start) * libm::pow(k, -self.tail)
    }
}

/// d_k for k below the last index of the weights, which are divided by `leading`. The coefficient of k^{ν−β},
/// which would have to be known to 30 digits, is chosen such that the sum at the last index has the defect
/// `last` of the expansion.
fn near_defects(nu: f64, beta: f64, leading: f64, weights: &[DoubleDouble], last: f64) -> Vec<f64> {
    let far = weights.len() - 1;
    let logarithms: Vec<DoubleDouble> = (0..=far).map(|k| logarithm(k.max(1) as f64)).collect();
    let power = |k: usize, exponent: DoubleDouble| match k {
        0 if nu == 0.0 => DoubleDouble::ONE,
        0 => DoubleDouble::ZERO,
        _ => exponential(exponent.multiply(logarithms[k])),
    };
    let samples: Vec<DoubleDouble> = (0..=far).map(|k| power(k, DoubleDouble::exact(nu))).collect();
    let quadrature = |k: usize| {
        let pairs = weights[..=k].iter().zip(samples[..=k].iter().rev());
        pairs.fold(DoubleDouble::ZERO, |sum, (weight, sample)| sum.add(weight.multiply(*sample)))
    };
    let reduced = DoubleDouble::exact(nu).add(DoubleDouble::exact(-beta));
    let derivative =
        quadrature(far).add(DoubleDouble::exact(last / leading)).multiply(power(far, reduced.scale(-1.0)));
    let defect = |k: usize| {
        let exact = if k == 0 { DoubleDouble::ZERO } else { derivative.multiply(power(k, reduced)) };
        leading * exact.add(quadrature(k).scale(-1.0)).to_f64()
    };
    (0..far).map(defect).collect()
}

/// Coefficients of (γ_p(e^{−s})/s)^β in powers of s.
fn symbol_expansion(order: BdfOrder, beta: f64) -> [f64; TERMS] {
    // γ_p is the logarithm s = Σ xⁱ/i of x = 1 − e^{−s} without the terms i > p.
    const LONG: usize = TERMS + 1;
    let mut x = [0.0; LONG];
    let mut factor = 1.0;
    for (i, place) in x.iter_mut().enumerate().skip(1) {
        factor /= i as f64;
        *place = factor;
        factor = -factor;
    }
    let mut base = [0.0; TERMS];
    base[0] = 1.0;
    let mut power = [0.0; LONG];
    power[0] = 1.0;
    for i in 1..LONG {
        let mut next = [0.0; LONG];
        for (m, place) in next.iter_mut().enumerate() {
            *place = (0..=m).map(|j| power[j] * x[m - j]).sum();
        }
        power = next;
        if i > order.get() {
            for (place, term) in base.iter_mut().zip(&power[1..]) {
                *place -= term / i as f64;
            }
        }
    }
    let mut symbol = [0.0; TERMS];
    symbol[0] = 1.0;
    for m in 1..TERMS {
        let sum: f64 = (1..=m).map(|j| (beta * j as f64 - (m - j) as f64) * base[j] * symbol[m - j]).sum();
        symbol[m] = sum / m as f64;
    }
    symbol
}

/// 1/Γ(x), zero at the poles.
pub fn reciprocal_gamma(x: f64) -> f64 {
    if x <= 0.0 && x == libm::floor(x) { 0.0 } else { 1.0 / libm::tgamma(x) }
}

/// ζ(−x) for x ≥ 0, by the functional equation from ζ(1 + x).
pub(crate) fn zeta_at_minus(x: f64) -> f64 {
    use core::f64::consts::PI;
    if x == 0.0 {
        return -0.5;
    }
    let sine = libm::sin(0.5 * PI * libm::fmod(x, 4.0));
    -libm::pow(2.0 * PI, -x) / PI * sine * libm::tgamma(1.0 + x) * zeta(1.0 + x)
}

/// ζ(s) for s > 1: a finite sum and the Euler–Maclaurin formula for the remainder.
fn zeta(s: f64) -> f64 {
    /// B_{2k}/(2k)!, k = 1, 2, …
    const BERNOULLI: [f64; 6] = [
        1.0 / 12.0,
        -1.0 / 720.0,
        1.0 / 30_240.0,
        -1.0 / 1_209_600.0,
        1.0 / 47_900_160.0,
        -691.0 / 1_307_674_368_000.0,
    ];
    const SUMMED: f64 = 16.0;
    let mut sum = 0.0;
    let mut n = SUMMED - 1.0;
    while n >= 1.0 {
        sum += libm::pow(n, -s);
        n -= 1.0;
    }
    let last = libm::pow(SUMMED, -s);
    let mut rest = last * SUMMED / (s - 1.0) + 0.5 * last;
    let mut derivative = s * last / SUMMED;
    for (k, bernoulli) in BERNOULLI.iter().enumerate() {
        rest += bernoulli * derivative;
        let order = 2.0 * k as f64 + 1.0;
        derivative *= (s + order) * (s + order + 1.0) / (SUMMED * SUMMED);
    }
    sum + rest
}

/// ln x: one step of Newton's method for e^y = x doubles the digits of the ordinary logarithm.
fn logarithm(x: f64) -> DoubleDouble {
    let rough = DoubleDouble::exact(libm::log(x));
    let correction = exponential(rough.scale(-1.0)).scale(x).add(DoubleDouble::exact(-1.0));
    rough.add(correction)
}

/// e^x: Taylor's series for a 512th of the remainder modulo ln 2, squared nine times.
fn exponential(x: DoubleDouble) -> DoubleDouble {
    const LN_2_LOW: f64 = 2.319_046_813_846_299_6e-17;
    const SQUARINGS: i32 = 9;
    let multiple = libm::round(x.to_f64() / core::f64::consts::LN_2);
    let whole = DoubleDouble::product(core::f64::consts::LN_2, multiple)
        .add(DoubleDouble::product(LN_2_LOW, multiple));
    let part = x.add(whole.scale(-1.0)).scale(libm::ldexp(1.0, -SQUARINGS));
    // e^y − 1, so that no digits are lost beside the 1.
    let mut sum = DoubleDouble::ZERO;
    for i in (1..=10).rev() {
        sum = part.multiply(sum.add(DoubleDouble::ONE)).divide(f64::from(i));
    }
    for _ in 0..SQUARINGS {
        sum = sum.scale(2.0).add(sum.multiply(sum));
    }
    sum.add(DoubleDouble::ONE).scale(libm::ldexp(1.0, multiple as i32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_in_double_double_keep_thirty_digits() {
        // e^{ln x} = x, and ln 10 = 2.302585092994045684017991454684…
        for x in [2.0, 3.0, 10.0, 383.0] {
            let back = exponential(logarithm(x)).add(DoubleDouble::exact(-x)).to_f64();
            assert!(back.abs() < 1e-29 * x, "{x}: {back:e}");
        }
        let rest = logarithm(10.0).add(DoubleDouble::exact(-core::f64::consts::LN_10));
        assert!((rest.to_f64() + 2.170_756_223_382_249_4e-16).abs() < 1e-30, "{rest:?}");
    }

    #[test]
    fn the_zeta_function_left_of_zero() {
        for (x, known) in
            [(0.0, -0.5), (1.0, -1.0 / 12.0), (3.0, 1.0 / 120.0), (0.5, -0.207_886_224_977_354_57)]
        {
            assert!((zeta_at_minus(x) - known).abs() < 4e-16, "{x}");
        }
        assert!(zeta_at_minus(2.0).abs() < 1e-17);
    }

    #[test]
    fn sums_and_expansions_meet() {
        // The two computations are independent except for the leading coefficient, which is taken from the
        // last step of the sums.
        for order in 1..=6 {
            let bdf = BdfOrder::new(order).unwrap();
            for (beta, nu) in [(0.5, 0.0), (0.5, 1.25), (1.5, 2.5), (0.75, 3.0), (1.9, 0.6), (-0.5, 1.0)] {
                let defects = PowerDefects::new(bdf, beta, &[nu]).unwrap();
                for k in [7 * defects.far / 8, defects.far - 1] {
                    let (sum, expansion) = (defects.at(k).next().unwrap(), defects.powers[0].expansion(k));
                    assert!(
                        (sum - expansion).abs() <= 2e-13 * expansion.abs(),
                        "BDF {order}, β = {beta}, ν = {nu}, k = {k}: {sum:e} {expansion:e}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_defect_of_a_square_has_all_its_digits() {
        // BDF 1, β = ½, ν = 2 at k = 1 000: values from 40-digit arithmetic.
        let defects = PowerDefects::new(BdfOrder::GRUNWALD_LETNIKOV, 0.5, &[2.0]).unwrap();
        let far = defects.at(1000).next().unwrap();
        let near = defects.at(20).next().unwrap();
        assert!((far / FAR_DEFECT - 1.0).abs() < 1e-15, "{far:e}");
        assert!((near / NEAR_DEFECT - 1.0).abs() < 1e-15, "{near:e}");
    }

    const FAR_DEFECT: f64 = 17.839_382_559_610_654;
    const NEAR_DEFECT: f64 = 2.509_943_548_451_718;
}
