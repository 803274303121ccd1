//! Vectors of numbers, for loops that are compiled once for each vector unit, which is chosen at run time.

use pulp::bytemuck::Pod;
use pulp::{Interleave, Simd};
use rustfft::num_complex::Complex;

/// Vector arithmetic of a scalar on the unit `S`, whose values prove that the machine has the unit.
///
/// A multiply–add is rounded once where that is one instruction, twice elsewhere.
pub trait Lanes: Pod {
    /// A vector of real numbers of the unit.
    type Reals<S: Simd>: Pod + Interleave;
    /// A vector of complex numbers of the unit.
    type Complexes<S: Simd>: Pod;

    /// The slice in whole vectors; an incomplete last one is left out.
    fn reals<S: Simd>(numbers: &[Self]) -> &[Self::Reals<S>];
    /// The slice in whole vectors, mutable.
    fn reals_mut<S: Simd>(numbers: &mut [Self]) -> &mut [Self::Reals<S>];
    /// The slice in whole vectors.
    fn complexes<S: Simd>(numbers: &[Complex<Self>]) -> &[Self::Complexes<S>];
    /// The slice in whole vectors, mutable.
    fn complexes_mut<S: Simd>(numbers: &mut [Complex<Self>]) -> &mut [Self::Complexes<S>];

    /// The number in every lane.
    fn in_lanes<S: Simd>(unit: S, number: Self) -> Self::Reals<S>;
    /// a + b
    fn plus<S: Simd>(unit: S, a: Self::Reals<S>, b: Self::Reals<S>) -> Self::Reals<S>;
    /// a − b
    fn minus<S: Simd>(unit: S, a: Self::Reals<S>, b: Self::Reals<S>) -> Self::Reals<S>;
    /// a·b
    fn times<S: Simd>(unit: S, a: Self::Reals<S>, b: Self::Reals<S>) -> Self::Reals<S>;
    /// a/b
    fn quotient<S: Simd>(unit: S, a: Self::Reals<S>, b: Self::Reals<S>) -> Self::Reals<S>;
    /// The smaller of two numbers.
    fn smaller<S: Simd>(unit: S, a: Self::Reals<S>, b: Self::Reals<S>) -> Self::Reals<S>;
    /// a·b + c
    fn plus_product<S: Simd>(
        unit: S,
        a: Self::Reals<S>,
        b: Self::Reals<S>,
        c: Self::Reals<S>,
    ) -> Self::Reals<S>;
    /// c − a·b
    fn minus_product<S: Simd>(
        unit: S,
        a: Self::Reals<S>,
        b: Self::Reals<S>,
        c: Self::Reals<S>,
    ) -> Self::Reals<S>;

    /// The complex number in every lane.
    fn complex_splat<S: Simd>(unit: S, number: Complex<Self>) -> Self::Complexes<S>;
    /// a + b
    fn complex_add<S: Simd>(unit: S, a: Self::Complexes<S>, b: Self::Complexes<S>) -> Self::Complexes<S>;
    /// a − b
    fn complex_sub<S: Simd>(unit: S, a: Self::Complexes<S>, b: Self::Complexes<S>) -> Self::Complexes<S>;
    /// a·b
    fn complex_mul<S: Simd>(unit: S, a: Self::Complexes<S>, b: Self::Complexes<S>) -> Self::Complexes<S>;
    /// ā·b
    fn conj_mul<S: Simd>(unit: S, a: Self::Complexes<S>, b: Self::Complexes<S>) -> Self::Complexes<S>;
    /// i·a
    fn times_i<S: Simd>(unit: S, a: Self::Complexes<S>) -> Self::Complexes<S>;

    /// Real and imaginary parts of interleaved numbers, in an order that is undone by
    /// [`interleave`](Lanes::interleave).
    fn separate<S: Simd>(unit: S, numbers: [Self::Reals<S>; 2]) -> [Self::Reals<S>; 2];
    /// The inverse of [`separate`](Lanes::separate).
    fn interleave<S: Simd>(unit: S, parts: [Self::Reals<S>; 2]) -> [Self::Reals<S>; 2];
}

macro_rules! lanes {
    (
        $scalar:ident, $reals:ident, $complexes:ident, $as_reals:ident, $as_reals_mut:ident, $as_complexes:ident,
        $as_complexes_mut:ident, $splat:ident, $add:ident, $sub:ident, $mul:ident, $div:ident, $min:ident, $mul_add:ident, $neg_mul_add:ident, $complex_splat:ident,
        $complex_add:ident, $complex_sub:ident, $complex_mul:ident, $conj_mul:ident, $swap:ident, $conj:ident,
        $separate:ident, $interleave:ident
    ) => {
        impl Lanes for $scalar {
            type Reals<S: Simd> = S::$reals;
            type Complexes<S: Simd> = S::$complexes;

            #[inline(always)]
            fn reals<S: Simd>(numbers: &[Self]) -> &[Self::Reals<S>] {
                S::$as_reals(numbers).0
            }
            #[inline(always)]
            fn reals_mut<S: Simd>(numbers: &mut [Self]) -> &mut [Self::Reals<S>] {
                S::$as_reals_mut(numbers).0
            }
            #[inline(always)]
            fn complexes<S: Simd>(numbers: &[Complex<Self>]) -> &[Self::Complexes<S>] {
                S::$as_complexes(numbers).0
            }
            #[inline(always)]
            fn complexes_mut<S: Simd>(numbers: &mut [Complex<Self>]) -> &mut [Self::Complexes<S>] {
                S::$as_complexes_mut(numbers).0
            }
            #[inline(always)]
            fn in_lanes<S: Simd>(unit: S, number: Self) -> Self::Reals<S> {
                unit.$splat(number)
            }
            #[inline(always)]
            fn plus<S: Simd>(unit: S, a: Self::Reals<S>, b: Self::Reals<S>) -> Self::Reals<S> {
                unit.$add(a, b)
            }
            #[inline(always)]
            fn minus<S: Simd>(unit: S, a: Self::Reals<S>, b: Self::Reals<S>) -> Self::Reals<S> {
                unit.$sub(a, b)
            }
            #[inline(always)]
            fn times<S: Simd>(unit: S, a: Self::Reals<S>, b: Self::Reals<S>) -> Self::Reals<S> {
                unit.$mul(a, b)
            }
            #[inline(always)]
            fn quotient<S: Simd>(unit: S, a: Self::Reals<S>, b: Self::Reals<S>) -> Self::Reals<S> {
                unit.$div(a, b)
            }
            #[inline(always)]
            fn smaller<S: Simd>(unit: S, a: Self::Reals<S>, b: Self::Reals<S>) -> Self::Reals<S> {
                unit.$min(a, b)
            }
            #[inline(always)]
            fn plus_product<S: Simd>(
                unit: S,
                a: Self::Reals<S>,
                b: Self::Reals<S>,
                c: Self::Reals<S>,
            ) -> Self::Reals<S> {
                unit.$mul_add(a, b, c)
            }
            #[inline(always)]
            fn minus_product<S: Simd>(
                unit: S,
                a: Self::Reals<S>,
                b: Self::Reals<S>,
                c: Self::Reals<S>,
            ) -> Self::Reals<S> {
                unit.$neg_mul_add(a, b, c)
            }
            #[inline(always)]
            fn complex_splat<S: Simd>(unit: S, number: Complex<Self>) -> Self::Complexes<S> {
                unit.$complex_splat(number)
            }
            #[inline(always)]
            fn complex_add<S: Simd>(
                unit: S,
                a: Self::Complexes<S>,
                b: Self::Complexes<S>,
            ) -> Self::Complexes<S> {
                unit.$complex_add(a, b)
            }
            #[inline(always)]
            fn complex_sub<S: Simd>(
                unit: S,
                a: Self::Complexes<S>,
                b: Self::Complexes<S>,
            ) -> Self::Complexes<S> {
                unit.$complex_sub(a, b)
            }
            #[inline(always)]
            fn complex_mul<S: Simd>(
                unit: S,
                a: Self::Complexes<S>,
                b: Self::Complexes<S>,
            ) -> Self::Complexes<S> {
                unit.$complex_mul(a, b)
            }
            #[inline(always)]
            fn conj_mul<S: Simd>(
                unit: S,
                a: Self::Complexes<S>,
                b: Self::Complexes<S>,
            ) -> Self::Complexes<S> {
                unit.$conj_mul(a, b)
            }
            #[inline(always)]
            fn times_i<S: Simd>(unit: S, a: Self::Complexes<S>) -> Self::Complexes<S> {
                // i(x + iy) = −y + ix, the conjugate taken first and the parts exchanged.
                unit.$swap(unit.$conj(a))
            }
            #[inline(always)]
            fn separate<S: Simd>(unit: S, numbers: [Self::Reals<S>; 2]) -> [Self::Reals<S>; 2] {
                unit.$separate(numbers)
            }
            #[inline(always)]
            fn interleave<S: Simd>(unit: S, parts: [Self::Reals<S>; 2]) -> [Self::Reals<S>; 2] {
                unit.$interleave(parts)
            }
        }
    };
}

lanes!(
    f32,
    f32s,
    c32s,
    as_simd_f32s,
    as_mut_simd_f32s,
    as_simd_c32s,
    as_mut_simd_c32s,
    splat_f32s,
    add_f32s,
    sub_f32s,
    mul_f32s,
    div_f32s,
    min_f32s,
    mul_add_e_f32s,
    negate_mul_add_e_f32s,
    splat_c32s,
    add_c32s,
    sub_c32s,
    mul_e_c32s,
    conj_mul_e_c32s,
    swap_re_im_c32s,
    conj_c32s,
    deinterleave_shfl_f32s,
    interleave_shfl_f32s
);
lanes!(
    f64,
    f64s,
    c64s,
    as_simd_f64s,
    as_mut_simd_f64s,
    as_simd_c64s,
    as_mut_simd_c64s,
    splat_f64s,
    add_f64s,
    sub_f64s,
    mul_f64s,
    div_f64s,
    min_f64s,
    mul_add_e_f64s,
    negate_mul_add_e_f64s,
    splat_c64s,
    add_c64s,
    sub_c64s,
    mul_e_c64s,
    conj_mul_e_c64s,
    swap_re_im_c64s,
    conj_c64s,
    deinterleave_shfl_f64s,
    interleave_shfl_f64s
);
