//! Runge–Kutta convolution quadrature: weights, discrete principle, orders, agreement with independent values.

use std::collections::HashMap;

use fvi_core::RungeKutta;
use fvi_host::runge_kutta_weights::RungeKuttaWeights;
use fvi_tests::reference;

/// Runs `$body` with `$method` for each of the methods, `$family` 0 for Radau IIA and 1 for Lobatto IIIC.
macro_rules! for_each_method {
    (|$family:ident, $method:ident| $body:expr) => {{
        {
            let ($family, $method) = (0.0, RungeKutta::<1>::radau_iia().unwrap());
            $body
        }
        {
            let ($family, $method) = (0.0, RungeKutta::<2>::radau_iia().unwrap());
            $body
        }
        {
            let ($family, $method) = (0.0, RungeKutta::<3>::radau_iia().unwrap());
            $body
        }
        {
            let ($family, $method) = (1.0, RungeKutta::<2>::lobatto_iiic().unwrap());
            $body
        }
        {
            let ($family, $method) = (1.0, RungeKutta::<3>::lobatto_iiic().unwrap());
            $body
        }
        {
            let ($family, $method) = (1.0, RungeKutta::<4>::lobatto_iiic().unwrap());
            $body
        }
    }};
}

const ORDERS: [f64; 7] = [-0.5, 0.25, 0.5, 0.9375, 1.0625, 1.5, 1.875];

/// Planes of a table with `stages` stages, read as matrices.
struct Kernel {
    stages: usize,
    planes: Vec<f64>,
}

impl Kernel {
    fn new<const R: usize>(method: &RungeKutta<R>, exponent: f64, count: usize) -> Self {
        let weights = RungeKuttaWeights::new(method, exponent, 0.5, count).unwrap();
        Self { stages: R, planes: weights.planes() }
    }

    fn entry(&self, n: usize, i: usize, j: usize) -> f64 {
        self.planes[(i * self.stages + j) * self.count() + n]
    }

    fn count(&self) -> usize {
        self.planes.len() / (self.stages * self.stages)
    }

    fn size(&self, n: usize) -> f64 {
        self.entries().fold(0.0, |size, (i, j)| size.max(self.entry(n, i, j).abs()))
    }

    fn entries(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let stages = self.stages;
        (0..stages * stages).map(move |entry| (entry / stages, entry % stages))
    }
}

#[test]
fn matrix_weights_agree_with_twenty_five_digits_up_to_twenty_thousand() {
    let rows = reference::read("runge_kutta_weights.csv");
    let mut checked = 0;
    for exponent in ORDERS {
        for_each_method!(|family, method| {
            let kernel = Kernel::new(&method, exponent, 20_001);
            let scale = 0.5f64.powf(exponent);
            let belongs = |row: &&HashMap<String, f64>| {
                row["family"] == family && row["stages"] == kernel.stages as f64 && row["beta"] == exponent
            };
            for row in rows.iter().filter(belongs) {
                let (n, i, j) = (row["n"] as usize, row["row"] as usize, row["column"] as usize);
                let error = (kernel.entry(n, i, j) * scale - row["weight"]).abs();
                // W₂ of exponents a little above 1 is what a difference of numbers of the size of W₀ leaves.
                let size = if n == 2 { kernel.size(0) } else { kernel.size(n) };
                assert!(error <= 1e-14 * size * scale, "{family}, {exponent}, {row:?}: {error:e}");
                checked += 1;
            }
        });
    }
    assert_eq!(checked, 7 * 17 * (1 + 4 + 9 + 4 + 9 + 16));
}

#[test]
fn powers_of_the_matrix_symbol_form_a_semigroup() {
    for (a, b) in [(0.25, 0.25), (0.75, 0.75), (0.3, 0.7), (-0.5, 0.5), (0.95, 0.95), (-0.5, 1.5), (1.0, 0.5)]
    {
        for_each_method!(|_family, method| {
            let count = 100;
            let (left, right, sum) = (
                Kernel::new(&method, a, count),
                Kernel::new(&method, b, count),
                Kernel::new(&method, a + b, count),
            );
            for k in 0..count {
                let size: f64 = (0..=k).map(|n| left.size(n) * right.size(k - n)).sum();
                for (i, j) in sum.entries() {
                    let terms = (0..=k).flat_map(|n| (0..sum.stages).map(move |l| (n, l)));
                    let product: f64 =
                        terms.map(|(n, l)| left.entry(n, i, l) * right.entry(k - n, l, j)).sum();
                    let error = (product - sum.entry(k, i, j)).abs();
                    assert!(error <= 1e-14 * size, "{a} + {b}, {} stages, n = {k}: {error:e}", sum.stages);
                }
            }
        });
    }
}

/// Σ_k Σ_i b_i (D₋^α X)_{k,i} (D₊^α Y)_{k,i}, the advanced operator being (D₊Y)_k = Σ_n B⁻¹ W_nᵀ B Y_{k+n}.
fn restricted_action(half: &Kernel, b: &[f64], x: &[Vec<f64>], y: &[Vec<f64>]) -> f64 {
    let (steps, stages) = (x.len(), half.stages);
    let mut action = 0.0;
    for k in 0..steps {
        for i in 0..stages {
            let (mut retarded, mut advanced) = (0.0, 0.0);
            for j in 0..stages {
                retarded += (0..=k).map(|n| half.entry(n, i, j) * x[k - n][j]).sum::<f64>();
                advanced +=
                    (0..steps - k).map(|n| b[j] / b[i] * half.entry(n, j, i) * y[k + n][j]).sum::<f64>();
            }
            action += b[i] * retarded * advanced;
        }
    }
    action
}

#[test]
fn the_restricted_variation_of_the_action_gives_the_force_at_the_stages() {
    // δX = δY = δ: the variation is Σ_k Σ_i b_i ((D₋^{2α} X) + (D₊^{2α} Y))_{k,i} δ_{k,i}, by the semigroup and the adjoint.
    for alpha in [0.25, 0.5, 0.75] {
        for_each_method!(|_family, method| {
            let steps = 12;
            let (half, whole) =
                (Kernel::new(&method, alpha, steps), Kernel::new(&method, 2.0 * alpha, steps));
            let (b, stages) = (method.quadrature().weights(), whole.stages);
            let path = |a: f64, c: f64| -> Vec<Vec<f64>> {
                (0..steps)
                    .map(|k| (0..stages).map(|i| (a * k as f64 + c * i as f64).sin()).collect())
                    .collect()
            };
            let (x, y, delta) = (path(0.7, 0.3), path(1.9, 0.8), path(2.3, 1.1));
            let moved = |path: &[Vec<f64>], by: f64| -> Vec<Vec<f64>> {
                let rows = path.iter().zip(&delta);
                rows.map(|(row, d)| row.iter().zip(d).map(|(x, d)| x + by * d).collect()).collect()
            };
            // The action is quadratic, so a central difference is its derivative.
            let variation = 0.5
                * (restricted_action(&half, b, &moved(&x, 1.0), &moved(&y, 1.0))
                    - restricted_action(&half, b, &moved(&x, -1.0), &moved(&y, -1.0)));
            let (mut expected, mut size) = (0.0, 0.0);
            for k in 0..steps {
                for i in 0..stages {
                    for j in 0..stages {
                        for n in 0..=k {
                            let forces = [
                                b[i] * whole.entry(n, i, j) * x[k - n][j] * delta[k][i],
                                b[i] * whole.entry(n, i, j) * y[k][i] * delta[k - n][j],
                            ];
                            expected += forces.iter().sum::<f64>();
                            size += forces.iter().map(|force| force.abs()).sum::<f64>();
                        }
                    }
                }
            }
            assert!((variation - expected).abs() <= 1e-14 * size, "{alpha}: {variation} and {expected}");
        });
    }
}
