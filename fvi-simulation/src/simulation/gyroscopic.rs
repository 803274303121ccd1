//! Gyroscopic forces −G v at the nodes of a step.

use crate::simulation::stability;
use fvi_core::{Block, Real, add_multiple};
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::Scenario;

/// G v at the nodes of a step, v being the velocity of the polynomial there.
///
/// With the nodes at q_k + e_1, …, q_k + e_R on a polynomial of degree R that begins at q_k, v_i = Σ_j W_ij
/// e_j with W_ij = ℓ_j′(c_i)/h: G acts like a damping without memory. As eᵀGe = 0 it does no work, and a
/// scheme of Gauss points is Gauss collocation of M v̇ = −∇U − G v.
#[derive(Clone, Debug)]
pub(super) struct Gyroscopic<T, B> {
    skew: B,
    /// W, row by row.
    weights: Vec<T>,
}

impl<T: Real, B: Block<T>> Gyroscopic<T, B> {
    /// For nodes at these fractions of steps of the length h; zero must not be among them.
    pub(super) fn new(skew: B, fractions: &[T], h: T) -> Self {
        let slope = |i: usize, j: usize| {
            // ℓ_j = τ/c_j Π_{l≠j} (τ − c_l)/(c_j − c_l), differentiated factor by factor.
            let (mut value, mut derivative) = (T::one(), T::zero());
            let others = fractions.iter().enumerate().filter(|&(l, _)| l != j).map(|(_, &c)| c);
            for zero in std::iter::once(T::zero()).chain(others) {
                let inverse = T::one() / (fractions[j] - zero);
                let factor = (fractions[i] - zero) * inverse;
                derivative = derivative * factor + value * inverse;
                value *= factor;
            }
            derivative / h
        };
        let count = fractions.len();
        let weights =
            (0..count).flat_map(|i| (0..count).map(move |j| (i, j))).map(|(i, j)| slope(i, j)).collect();
        Self { skew, weights }
    }

    /// Adds G v_i of every node to `force`. `scratch` has N numbers at least.
    pub(super) fn add(&self, increments: &[T], force: &mut [T], scratch: &mut [T]) {
        let nodes = self.weights.len().isqrt().max(1);
        let coordinates = increments.len() / nodes;
        let velocity = &mut scratch[..coordinates];
        for (weights, force) in self.weights.chunks(nodes).zip(force.chunks_exact_mut(coordinates.max(1))) {
            velocity.fill(T::zero());
            for (&weight, increment) in weights.iter().zip(increments.chunks_exact(coordinates.max(1))) {
                add_multiple(velocity, weight, increment);
            }
            self.skew.multiply_add(T::one(), velocity, force);
        }
    }

    /// Calls `visit(i, j, W_ij, G)` for every W_ij.
    pub(super) fn visit(&self, mut visit: impl FnMut(usize, usize, T, &B)) {
        let nodes = self.weights.len().isqrt();
        for (index, &weight) in self.weights.iter().enumerate() {
            visit(index / nodes, index % nodes, weight, &self.skew);
        }
    }
}

/// Refuses gyroscopic forces with schemes whose stability with them is not known: known are those that are
/// stable at every step for any stiffness. The coefficients of the damping decide it, so that it is no row of
/// the table of combinations.
pub(super) fn check_step(scenario: &Scenario) -> Result<(), InputError> {
    if scenario.time.allow_unstable || stability::takes_gyroscopic(scenario) {
        return Ok(());
    }
    let with =
        "`system.gyroscopic` and damping: the step of this scheme is limited, and not checked with both"
            .to_owned();
    let allowed =
        "\"low-order\" with kappa = 0.5 and `convolution.order` up to 2; or `time.allow_unstable = true`"
            .to_owned();
    Err(scenario.error_at("scheme", Problem::Incompatible { with, allowed }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Matrix;

    #[test]
    fn velocities_are_those_of_the_polynomial() {
        // τ² and 2 τ − 3 τ³ at three nodes of a step of length ½.
        let (nodes, h) = ([0.25, 0.5, 1.0], 0.5);
        let skew = Matrix::of_entries(2, [(0, 1, -3.0), (1, 0, 3.0)].into_iter());
        let gyroscopic = Gyroscopic::new(skew, &nodes, h);
        let increments: Vec<f64> = nodes.iter().flat_map(|&c| [c * c, 2.0 * c - 3.0 * c * c * c]).collect();
        let (mut force, mut scratch) = (vec![1.0; 6], vec![f64::NAN; 2]);
        gyroscopic.add(&increments, &mut force, &mut scratch);
        for (&c, force) in nodes.iter().zip(force.chunks(2)) {
            let velocity = [2.0 * c / h, (2.0 - 9.0 * c * c) / h];
            for (found, exact) in force.iter().zip([1.0 - 3.0 * velocity[1], 1.0 + 3.0 * velocity[0]]) {
                assert!((found - exact).abs() < 1e-12, "{c}: {found}, not {exact}");
            }
        }
        let mut count = 0;
        gyroscopic.visit(|i, j, weight, _| {
            assert_eq!(weight, gyroscopic.weights[3 * i + j]);
            count += 1;
        });
        assert_eq!(count, 9);
    }
}
