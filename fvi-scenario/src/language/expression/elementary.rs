//! The elementary functions of `f32` and `f64`, all from `libm`.

use fvi_core::Real;
use special::Gamma;

/// A scalar with the functions of expressions.
///
/// nalgebra's own functions come from the platform when it is built for a host; these never do.
pub trait Elementary: Real {
    /// √x, rounded correctly.
    fn square_root(self) -> Self;
    /// eˣ.
    fn exponential(self) -> Self;
    /// Natural logarithm.
    fn logarithm(self) -> Self;
    /// sin x, x in radians.
    fn sine(self) -> Self;
    /// cos x, x in radians.
    fn cosine(self) -> Self;
    /// tan x, x in radians.
    fn tangent(self) -> Self;
    /// The angle in (−π/2, π/2) with the tangent x.
    fn arc_tangent(self) -> Self;
    /// The angle in [−π/2, π/2] with the sine x.
    fn arc_sine(self) -> Self;
    /// The angle in [0, π] with the cosine x.
    fn arc_cosine(self) -> Self;
    /// The angle in [−π, π] of the point (x, y), for y and x.
    fn arc_tangent_of(self, x: Self) -> Self;
    /// sinh x.
    fn hyperbolic_sine(self) -> Self;
    /// cosh x.
    fn hyperbolic_cosine(self) -> Self;
    /// tanh x.
    fn hyperbolic_tangent(self) -> Self;
    /// Γ(x).
    fn gamma_function(self) -> Self;

    /// (sin x, cos x), the same bits as from [`sine`](Self::sine) and [`cosine`](Self::cosine).
    fn sine_cosine(self) -> (Self, Self);

    /// ψ(x), the derivative of ln Γ; computed in double precision.
    ///
    /// Not-a-number for x < −1000, where Γ has long underflown to zero between its poles.
    fn digamma_function(self) -> Self {
        let x = self.to_f64();
        Self::of(if x > -1000.0 { x.digamma() } else { f64::NAN })
    }

    /// ψ′(x), likewise.
    fn trigamma_function(self) -> Self {
        let x = self.to_f64();
        Self::of(if x > -1000.0 { x.trigamma() } else { f64::NAN })
    }
}

macro_rules! elementary {
    ($scalar:ty, $pair:path, $angle:path, $($name:ident = $function:path),* $(,)?) => {
        impl Elementary for $scalar {
            $(
                #[inline]
                fn $name(self) -> Self {
                    $function(self)
                }
            )*

            #[inline]
            fn arc_tangent_of(self, x: Self) -> Self {
                $angle(self, x)
            }

            #[inline]
            fn sine_cosine(self) -> (Self, Self) {
                $pair(self)
            }
        }
    };
}

elementary!(
    f64,
    libm::sincos,
    libm::atan2,
    square_root = libm::sqrt,
    exponential = libm::exp,
    logarithm = libm::log,
    sine = libm::sin,
    cosine = libm::cos,
    tangent = libm::tan,
    arc_tangent = libm::atan,
    arc_sine = libm::asin,
    arc_cosine = libm::acos,
    hyperbolic_sine = libm::sinh,
    hyperbolic_cosine = libm::cosh,
    hyperbolic_tangent = libm::tanh,
    gamma_function = libm::tgamma,
);

elementary!(
    f32,
    libm::sincosf,
    libm::atan2f,
    square_root = libm::sqrtf,
    exponential = libm::expf,
    logarithm = libm::logf,
    sine = libm::sinf,
    cosine = libm::cosf,
    tangent = libm::tanf,
    arc_tangent = libm::atanf,
    arc_sine = libm::asinf,
    arc_cosine = libm::acosf,
    hyperbolic_sine = libm::sinhf,
    hyperbolic_cosine = libm::coshf,
    hyperbolic_tangent = libm::tanhf,
    gamma_function = libm::tgammaf,
);
