//! The Runge–Kutta methods of convolution quadrature.

use crate::error::ParameterError;
use crate::linear::invert_rows;
use crate::quadrature::Quadrature;

/// Implicit Runge–Kutta method of R stages: nodes c, weights b, matrix A, with b the last row of A (stiffly
/// accurate).
///
/// Such a method makes a convolution quadrature of D^β whose weights are R×R matrices,
///
/// ```text
/// Δ(z) = A⁻¹ − z A⁻¹ 1 bᵀ A⁻¹ ,      Σ_n W_n zⁿ = (Δ(z)/h)^β ,      (D^β X)_k = Σ_{n=0}^{k} W_n X_{k−n} ,
/// ```
///
/// where X_k holds the values at the times t_k + c_i h of step k. Source: \[LO93\]; the methods are those of
/// \[HW\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RungeKutta<const R: usize> {
    quadrature: Quadrature<R>,
    matrix: [[f64; R]; R],
}

/// Rows of A, and the nodes c. The weights b are the last row.
type Tableau = (&'static [&'static [f64]], &'static [f64]);

const ROOT_5: f64 = 2.23606797749979;
const ROOT_6: f64 = 2.449489742783178;

/// Radau IIA of 1…3 stages, order 2R − 1.
const RADAU_IIA: [Tableau; 3] = [
    (&[&[1.0]], &[1.0]),
    (&[&[5.0 / 12.0, -1.0 / 12.0], &[0.75, 0.25]], &[1.0 / 3.0, 1.0]),
    (
        &[
            &[
                (88.0 - 7.0 * ROOT_6) / 360.0,
                (296.0 - 169.0 * ROOT_6) / 1800.0,
                (-2.0 + 3.0 * ROOT_6) / 225.0,
            ],
            &[
                (296.0 + 169.0 * ROOT_6) / 1800.0,
                (88.0 + 7.0 * ROOT_6) / 360.0,
                (-2.0 - 3.0 * ROOT_6) / 225.0,
            ],
            &[(16.0 - ROOT_6) / 36.0, (16.0 + ROOT_6) / 36.0, 1.0 / 9.0],
        ],
        &[(4.0 - ROOT_6) / 10.0, (4.0 + ROOT_6) / 10.0, 1.0],
    ),
];

/// Lobatto IIIC of 2…4 stages, order 2R − 2.
const LOBATTO_IIIC: [Tableau; 3] = [
    (&[&[0.5, -0.5], &[0.5, 0.5]], &[0.0, 1.0]),
    (
        &[
            &[1.0 / 6.0, -1.0 / 3.0, 1.0 / 6.0],
            &[1.0 / 6.0, 5.0 / 12.0, -1.0 / 12.0],
            &[1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0],
        ],
        &[0.0, 0.5, 1.0],
    ),
    (
        &[
            &[1.0 / 12.0, -ROOT_5 / 12.0, ROOT_5 / 12.0, -1.0 / 12.0],
            &[1.0 / 12.0, 0.25, (10.0 - 7.0 * ROOT_5) / 60.0, ROOT_5 / 60.0],
            &[1.0 / 12.0, (10.0 + 7.0 * ROOT_5) / 60.0, 0.25, -ROOT_5 / 60.0],
            &[1.0 / 12.0, 5.0 / 12.0, 5.0 / 12.0, 1.0 / 12.0],
        ],
        &[0.0, 0.276393202250021, 0.7236067977499789, 1.0],
    ),
];

/// Nodes of Radau IIA of 5 and 7 stages, the zeros of P_R(2c − 1) − P_{R−1}(2c − 1).
const RADAU_NODES: [&[f64]; 2] = [
    &[0.05710419611451768, 0.2768430136381238, 0.5835904323689168, 0.8602401356562195, 1.0],
    &[
        0.029316427159784893,
        0.1480785996684843,
        0.3369846902811543,
        0.5586715187715501,
        0.7692338620300545,
        0.9269456713197411,
        1.0,
    ],
];

impl<const R: usize> RungeKutta<R> {
    /// Radau IIA of R stages, order 2R − 1; one stage is the implicit Euler method.
    ///
    /// # Errors
    /// If R is not one of 1, 2, 3, 5, 7.
    pub fn radau_iia() -> Result<Self, ParameterError> {
        let nodes = RADAU_NODES.iter().find_map(|nodes| <[f64; R]>::try_from(*nodes).ok());
        if let Some(nodes) = nodes {
            return Ok(Self::of_radau_nodes(nodes));
        }
        let tableau = R.checked_sub(1).and_then(|index| RADAU_IIA.get(index));
        Self::from_tableau(tableau, "stages of Radau IIA", "one of 1, 2, 3, 5, 7")
    }

    /// Radau IIA from its nodes, by the W transformation:
    ///
    /// ```text
    /// A = W X Wᵀ B ,      W_ik = √(2k+1) P_k(2c_i − 1) ,      B = diag(b) ,      b_i = 1 / Σ_k W_ik² ,
    /// X_{k,k−1} = −X_{k−1,k} = 1 / (2 √(4k² − 1)) ,      X_00 = ½ ,      X_{R−1,R−1} = 1 / (4R − 2)
    /// ```
    ///
    /// for k = 0 … R − 1, other entries of X being 0. Nothing in it is ill conditioned. Source: \[HW\] IV.5.
    fn of_radau_nodes(nodes: [f64; R]) -> Self {
        let polynomials = nodes.map(|node| {
            let (x, mut before, mut value) = (2.0 * node - 1.0, 0.0, 1.0);
            let mut k = 0.0;
            [(); R].map(|()| {
                let normed = libm::sqrt(2.0 * k + 1.0) * value;
                let next = ((2.0 * k + 1.0) * x * value - k * before) / (k + 1.0);
                (before, value, k) = (value, next, k + 1.0);
                normed
            })
        });
        let squares = polynomials.map(|row| row.iter().map(|number| number * number).sum::<f64>());
        let matrix = polynomials.map(|row| {
            // The row of W X.
            let mut integrals = [0.0; R];
            for (k, &number) in row.iter().enumerate() {
                let of = |k: usize| 0.5 / libm::sqrt((4 * k * k) as f64 - 1.0);
                let mut add = |place: Option<usize>, part: f64| {
                    if let Some(integral) = place.and_then(|place| integrals.get_mut(place)) {
                        *integral += number * part;
                    }
                };
                add(k.checked_sub(1), if k > 0 { of(k) } else { 0.0 });
                add(Some(k + 1), -of(k + 1));
                let diagonal = if k == 0 { 0.5 } else { 0.0 };
                add(Some(k), if k + 1 == R { 1.0 / (4 * R - 2) as f64 } else { diagonal });
            }
            let mut entries = [0.0; R];
            for ((entry, other), square) in entries.iter_mut().zip(&polynomials).zip(&squares) {
                *entry = integrals.iter().zip(other).map(|(a, b)| a * b).sum::<f64>() / square;
            }
            entries
        });
        let weights = matrix.last().copied().unwrap_or([0.0; R]);
        Self { quadrature: Quadrature { nodes, weights }, matrix }
    }

    /// Lobatto IIIC of R stages, order 2R − 2, with a node at each end of the step.
    ///
    /// # Errors
    /// If R is not one of 2…4.
    pub fn lobatto_iiic() -> Result<Self, ParameterError> {
        let tableau = R.checked_sub(2).and_then(|index| LOBATTO_IIIC.get(index));
        Self::from_tableau(tableau, "stages of Lobatto IIIC", "one of 2, 3, 4")
    }

    fn from_tableau(
        tableau: Option<&Tableau>,
        parameter: &'static str,
        allowed: &'static str,
    ) -> Result<Self, ParameterError> {
        let error = ParameterError { parameter, value: R as f64, allowed };
        let (rows, nodes) = tableau.ok_or(error)?;
        let mut matrix = [[0.0; R]; R];
        for (place, row) in matrix.iter_mut().zip(*rows) {
            *place = <[f64; R]>::try_from(*row).map_err(|_| error)?;
        }
        let nodes = <[f64; R]>::try_from(*nodes).map_err(|_| error)?;
        let weights = matrix.last().copied().ok_or(error)?;
        Ok(Self { quadrature: Quadrature { nodes, weights }, matrix })
    }

    /// The quadrature of nodes c and weights b.
    pub fn quadrature(&self) -> &Quadrature<R> {
        &self.quadrature
    }

    /// The square A² of the matrix, row by row.
    pub fn square(&self) -> [[f64; R]; R] {
        self.matrix.map(|row| {
            let mut sum = [0.0; R];
            for (&factor, other) in row.iter().zip(&self.matrix) {
                sum.iter_mut().zip(other).for_each(|(sum, &number)| *sum += factor * number);
            }
            sum
        })
    }

    /// The inverse of the matrix, row by row.
    ///
    /// # Errors
    /// If there is none.
    pub fn inverse(&self) -> Result<[[f64; R]; R], ParameterError> {
        let singular =
            |_| ParameterError { parameter: "determinant of the method", value: 0.0, allowed: "not zero" };
        invert_rows(&self.matrix).map_err(singular)
    }

    /// The matrix A, row by row.
    pub fn matrix(&self) -> &[[f64; R]; R] {
        &self.matrix
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// B(p): Σ b_i c_i^{k−1} = 1/k for k ≤ p; C(q): Σ_j a_ij c_j^{k−1} = c_i^k/k for k ≤ q.
    fn assert_conditions<const R: usize>(method: &RungeKutta<R>, order: i32, stage_order: i32) {
        let (c, b) = (method.quadrature().nodes(), method.quadrature().weights());
        for k in 1..=order {
            let sum: f64 = (0..R).map(|i| b[i] * c[i].powi(k - 1)).sum();
            assert!((sum - 1.0 / f64::from(k)).abs() < 4e-16, "{R} stages, B({k})");
        }
        for k in 1..=stage_order {
            for i in 0..R {
                let sum: f64 = (0..R).map(|j| method.matrix()[i][j] * c[j].powi(k - 1)).sum();
                assert!((sum - c[i].powi(k) / f64::from(k)).abs() < 4e-16, "{R} stages, C({k}), row {i}");
            }
        }
        assert_eq!(method.matrix()[R - 1], *b);
        assert_eq!(c[R - 1], 1.0);
    }

    #[test]
    fn methods_have_their_orders_and_are_stiffly_accurate() {
        assert_conditions(&RungeKutta::<1>::radau_iia().unwrap(), 1, 1);
        assert_conditions(&RungeKutta::<2>::radau_iia().unwrap(), 3, 2);
        assert_conditions(&RungeKutta::<3>::radau_iia().unwrap(), 5, 3);
        assert_conditions(&RungeKutta::<5>::radau_iia().unwrap(), 9, 5);
        assert_conditions(&RungeKutta::<7>::radau_iia().unwrap(), 13, 7);
        assert_conditions(&RungeKutta::<2>::lobatto_iiic().unwrap(), 2, 1);
        assert_conditions(&RungeKutta::<3>::lobatto_iiic().unwrap(), 4, 2);
        assert_conditions(&RungeKutta::<4>::lobatto_iiic().unwrap(), 6, 3);
        // The constant first column distinguishes Lobatto IIIC from its relatives.
        let method = RungeKutta::<4>::lobatto_iiic().unwrap();
        assert!(method.matrix().iter().all(|row| row[0] == method.quadrature().weights()[0]));
    }

    #[test]
    fn other_numbers_of_stages_are_refused() {
        assert!(RungeKutta::<0>::radau_iia().is_err());
        assert!(RungeKutta::<4>::radau_iia().is_err());
        assert!(RungeKutta::<6>::radau_iia().is_err());
        assert!(RungeKutta::<8>::radau_iia().is_err());
        assert!(RungeKutta::<1>::lobatto_iiic().is_err());
        assert!(RungeKutta::<5>::lobatto_iiic().is_err());
    }

    fn assert_inverse<const R: usize>(method: &RungeKutta<R>) {
        let inverse = method.inverse().unwrap();
        for (i, row) in method.matrix().iter().enumerate() {
            for j in 0..R {
                let entry: f64 = row.iter().zip(&inverse).map(|(a, inverse)| a * inverse[j]).sum();
                let identity = f64::from(u8::from(i == j));
                assert!((entry - identity).abs() < 1e-13, "{R} stages, {i}, {j}: {entry}");
            }
        }
    }

    #[test]
    fn the_inverse_undoes_the_matrix() {
        assert_inverse(&RungeKutta::<1>::radau_iia().unwrap());
        assert_inverse(&RungeKutta::<2>::radau_iia().unwrap());
        assert_inverse(&RungeKutta::<3>::radau_iia().unwrap());
        assert_inverse(&RungeKutta::<7>::radau_iia().unwrap());
        assert_inverse(&RungeKutta::<2>::lobatto_iiic().unwrap());
        assert_inverse(&RungeKutta::<4>::lobatto_iiic().unwrap());
    }
}
