//! Coordinates of the search for poles: in the plane, and beside the start of a cut where a kernel has no
//! bound.

use fvi_fft::sums::{max_or_nan, min_or_nan};
use nalgebra::{Complex, DMatrix};
use std::f64::consts::PI;

/// ln of the largest term that is computed.
const LARGEST: f64 = 600.0;

/// The start s = −a of a cut where kernels have no bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Branch {
    /// a.
    pub(super) start: f64,
    /// Half the width of the box about it, in ln |s| and in the angle, that has a chart of its own.
    pub(super) reach: f64,
    /// True if no cut begins before it.
    pub(super) is_first: bool,
    /// ln |u| below which the kernels outweigh everything else, so that there is no zero.
    pub(super) nearest: f64,
}

/// A coordinate w.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Chart {
    /// w = ln s.
    Plane,
    /// w = ln u with s = −a (1 − u).
    Beside(Branch),
}

/// A place of the search.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) chart: Chart,
    pub(super) coordinate: Complex<f64>,
    /// s, rounded.
    pub(super) s: Complex<f64>,
}

impl Chart {
    pub(super) fn place(self, coordinate: Complex<f64>) -> Place {
        let of_coordinate = polar(coordinate.re, coordinate.im);
        let s = match self {
            Self::Plane => of_coordinate,
            Self::Beside(Branch { start, .. }) => {
                Complex::new(-start * (1.0 - of_coordinate.re), start * of_coordinate.im)
            }
        };
        Place { chart: self, coordinate, s }
    }
}

impl Place {
    /// False beside a branch point where the plane's chart is searched too, outside of the box.
    pub(super) fn is_of_its_chart(&self) -> bool {
        let Chart::Beside(Branch { reach, .. }) = self.chart else { return true };
        // ln(1 − u), the distance from the branch point in ln s.
        let u = polar(self.coordinate.re, self.coordinate.im);
        let size = 0.5 * libm::log1p(u.re * (u.re - 2.0) + u.im * u.im);
        size.abs() <= reach && libm::atan2(u.im, 1.0 - u.re).abs() <= reach
    }
}

/// ln |u| below which ρ |u|^{−γ} of the terms (γ, ρ) that have no bound at a place outweighs `rest`, the norm
/// of everything else there.
pub(super) fn nearest(terms: &[(f64, &DMatrix<f64>)], rest: f64) -> f64 {
    let eigenvalues = |rho: &DMatrix<f64>| fvi_fft::dense::symmetric_eigenvalues(rho.clone());
    let sizes = terms.iter().flat_map(|(_, rho)| {
        let least = 1e-12 * rho.norm();
        let sizes: Vec<f64> = eigenvalues(rho).iter().map(|value| value.abs()).collect();
        sizes.into_iter().filter(move |size| *size > least)
    });
    let smallest = sizes.fold(f64::INFINITY, min_or_nan);
    let whole = rest + terms.iter().map(|(_, rho)| rho.norm()).sum::<f64>();
    // Terms of two powers are told apart by the ratio of their sizes, |u|^{γ₁ − γ₂}.
    let between = terms.iter().flat_map(|(one, _)| terms.iter().map(move |(other, _)| (one - other).abs()));
    let powers = || terms.iter().map(|(power, _)| *power);
    let slowest = powers().chain(between.filter(|gap| *gap > 0.0)).fold(1.0, min_or_nan);
    let nearest = -libm::log(1e3 * max_or_nan(1.0, whole / smallest)) / slowest;
    // Where the largest term would overflow, it has outweighed everything else long ago.
    max_or_nan(nearest, -LARGEST / powers().fold(0.0, max_or_nan))
}

/// e^{x + iy}; at y = π on the upper side of the negative real axis.
pub(super) fn polar(x: f64, angle: f64) -> Complex<f64> {
    let size = libm::exp(x);
    if angle == PI {
        return Complex::new(-size, 0.0);
    }
    Complex::new(size * libm::cos(angle), size * libm::sin(angle))
}
