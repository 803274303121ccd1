//! Polynomials by their roots.

/// Coefficients of `last` Π(s − root), from s⁰ on.
pub(super) fn polynomial(roots: &[[f64; 2]], last: f64) -> Vec<f64> {
    roots.iter().fold(vec![last], |product, &[re, im]| {
        let factor = if im == 0.0 { vec![-re, 1.0] } else { vec![re * re + im * im, -2.0 * re, 1.0] };
        let mut next = vec![0.0; product.len() + factor.len() - 1];
        for (i, a) in product.iter().enumerate() {
            factor.iter().enumerate().for_each(|(j, b)| next[i + j] += a * b);
        }
        next
    })
}
