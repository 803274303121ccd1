//! Transform of one block: half as long as the real data, and divided into pieces of bounded cost.

use core::f64::consts::TAU;

use pulp::{Arch, Simd, WithSimd, bytemuck};
use rustfft::Fft;
use rustfft::num_complex::Complex;

use crate::engines::plans::{Plan, Plans};
use crate::engines::scalar::Scalar;

/// Complex numbers of a packet.
pub(crate) const PACKET: usize = 16;

/// Sixteen complex numbers, real and imaginary parts separate, on whole cache lines.
///
/// The order of the numbers within a packet depends on the vector unit; products are independent of it.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(crate) struct Packet<T> {
    pub(crate) re: [T; PACKET],
    pub(crate) im: [T; PACKET],
}

impl<T: Scalar> Packet<T> {
    pub(crate) fn zero() -> Self {
        Self { re: [T::zero(); PACKET], im: [T::zero(); PACKET] }
    }
}

/// Right-angle transform of blocks of B samples, B = 16·2ⁱ.
///
/// 2B real numbers modulo X^{2B} + 1 are the B complex numbers z_j = x_j + i x_{j+B} modulo X^B − i, since
/// X^{2B} + 1 = (X^B − i)(X^B + i). The transform evaluates z at the B roots of X^B = i, and products of
/// values are products of polynomials; one complex transform of length B replaces a real one of length 2B,
/// without the final pass of that.
///
/// Evaluation goes down the tree X^M − c → X^{M/4} − g iᵏ, k = 0…3, g = c^{1/4}, with one set of constants
/// for a whole node, so that each pass runs along contiguous memory. Nodes of the size of a *leaf* are
/// twisted to X^L − 1 and transformed by a fast Fourier transform. Values are in the order of the leaves, of
/// which products are independent.
///
/// Every pass and leaf is divided into [`pieces`](Self::pieces), each touching at most 4·[`PIECE`] numbers or
/// one leaf.
pub(crate) struct Transform<T: Scalar> {
    block: usize,
    leaf: usize,
    /// Butterflies in one piece of a pass.
    piece: usize,
    passes: Vec<Vec<[Complex<T>; 3]>>,
    twist: Vec<Complex<T>>,
    leaves: Leaves<T>,
    unit: Arch,
}

/// The transform of a leaf.
enum Leaves<T> {
    /// In double precision for every scalar: no digits are lost within it.
    Double(Plan),
    /// In the precision of the scalar: faster for `f32`.
    Own(Plan<T>),
}

impl<T: Scalar> Leaves<T> {
    /// Complex numbers in double precision that hold the scratch of a leaf.
    fn scratch(&self) -> usize {
        match self {
            Self::Double(plan) => {
                T::transform_scratch(plan.forward.as_ref()).max(T::transform_scratch(plan.inverse.as_ref()))
            }
            Self::Own(plan) => {
                let numbers = |plan: &dyn Fft<T>| plan.get_inplace_scratch_len();
                let numbers = numbers(plan.forward.as_ref()).max(numbers(plan.inverse.as_ref()));
                (numbers * size_of::<Complex<T>>()).div_ceil(size_of::<Complex<f64>>())
            }
        }
    }

    fn forward(&self, numbers: &mut [Complex<T>], scratch: &mut [Complex<f64>]) {
        match self {
            Self::Double(plan) => T::transform(plan.forward.as_ref(), numbers, scratch),
            Self::Own(plan) => plan.forward.process_with_scratch(numbers, bytemuck::cast_slice_mut(scratch)),
        }
    }

    fn inverse(&self, numbers: &mut [Complex<T>], scratch: &mut [Complex<f64>]) {
        match self {
            Self::Double(plan) => T::transform(plan.inverse.as_ref(), numbers, scratch),
            Self::Own(plan) => plan.inverse.process_with_scratch(numbers, bytemuck::cast_slice_mut(scratch)),
        }
    }
}

/// Butterflies in one piece of a pass, unless others are asked for.
const PIECE: usize = 64;

impl<T: Scalar> Transform<T> {
    /// Transform for blocks of `block` samples with leaves of at most `leaf` ≥ `PIECE`; both powers of two,
    /// at least 16.
    pub(crate) fn new(block: usize, leaf: usize, plans: &mut Plans, unit: Arch) -> Self {
        Self::with_leaves(block, leaf, PIECE, |size| Leaves::Double(plans.plan(size)), unit)
    }

    /// The same with leaves in the precision of the scalar, of at most `leaf` ≥ 32, and at most `piece`
    /// butterflies in a piece.
    pub(crate) fn in_own_precision(
        block: usize,
        leaf: usize,
        piece: usize,
        plans: &mut Plans<T>,
        unit: Arch,
    ) -> Self {
        Self::with_leaves(block, leaf, piece, |size| Leaves::Own(plans.plan(size)), unit)
    }

    fn with_leaves(
        block: usize,
        leaf: usize,
        piece: usize,
        leaves: impl FnOnce(usize) -> Leaves<T>,
        unit: Arch,
    ) -> Self {
        let mut size = block;
        let mut passes = Vec::new();
        // The constants of a node are powers of e^{2πi a/(4B)}: a node of size M has c = e^{2πi·aM/(4B)}; the
        // root has a = 1.
        let mut nodes = vec![1usize];
        while size > leaf {
            let quarter = size / 4;
            let constants = |&a: &usize| [1, 2, 3].map(|q| root_of_unity(a * quarter * q, 4 * block));
            passes.push(nodes.iter().map(constants).collect());
            let turn = block / quarter;
            nodes = nodes.iter().flat_map(|&a| (0..4).map(move |k| a + k * turn)).collect();
            size = quarter;
        }
        let twist =
            nodes.iter().flat_map(|&a| (0..size).map(move |j| root_of_unity(a * j, 4 * block))).collect();
        // A piece lies within one node, the smallest of which has four quarters as long as a leaf.
        Self { block, leaf: size, piece: piece.min(size), passes, twist, leaves: leaves(size), unit }
    }

    /// Packets of one spectrum.
    pub(crate) fn packets(&self) -> usize {
        self.block / PACKET
    }

    /// Complex numbers of scratch that a leaf needs.
    pub(crate) fn scratch(&self) -> usize {
        self.leaves.scratch()
    }

    /// Bytes of tables.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.twist.as_slice())
            + self.passes.iter().map(|pass| size_of_val(pass.as_slice())).sum::<usize>()
    }

    fn pieces_of_pass(&self) -> usize {
        (self.block / 4).div_ceil(self.piece)
    }

    /// Number of pieces of a transform, forward or inverse.
    pub(crate) fn pieces(&self) -> usize {
        self.passes.len() * self.pieces_of_pass() + self.block / self.leaf
    }

    /// Cost of a piece of a forward transform, in complex multiply–adds of [`Products`](super::level).
    pub(crate) fn forward_cost(&self, piece: usize) -> usize {
        if piece < self.passes.len() * self.pieces_of_pass() { 2 * 4 * self.piece } else { 6 * self.leaf }
    }

    /// Cost of a piece of an inverse transform.
    pub(crate) fn inverse_cost(&self, piece: usize) -> usize {
        self.forward_cost(self.pieces() - 1 - piece)
    }

    /// Kind and range of piece `piece` of a forward transform, or of an inverse one counted from the end.
    fn locate(&self, piece: usize) -> PieceKind {
        let per_pass = self.pieces_of_pass();
        let (mut pass, mut within) = (0, piece);
        while pass < self.passes.len() && within >= per_pass {
            within -= per_pass;
            pass += 1;
        }
        if pass == self.passes.len() {
            return PieceKind::Leaf(within);
        }
        // Sizes of nodes are powers of two.
        let quarter = self.block >> (2 * pass + 2);
        let first = within * self.piece;
        let butterfly = first & (quarter - 1);
        let butterflies = butterfly..quarter.min(butterfly + self.piece);
        PieceKind::Pass { pass, node: first >> quarter.trailing_zeros(), butterflies }
    }

    /// Runs piece `piece` of the forward transform of the real block `samples`, padded with B zeros.
    pub(crate) fn forward(
        &self,
        piece: usize,
        samples: &[T],
        spectrum: &mut [Packet<T>],
        polynomial: &mut [Complex<T>],
        scratch: &mut [Complex<f64>],
    ) {
        match self.locate(piece) {
            PieceKind::Leaf(_) if self.passes.is_empty() => load(samples, polynomial),
            PieceKind::Pass { pass: 0, ref butterflies, .. } => {
                for quarter in 0..4 {
                    let start = quarter * self.block / 4;
                    let range = start + butterflies.start..start + butterflies.end;
                    load(&samples[range.clone()], &mut polynomial[range]);
                }
            }
            _ => {}
        }
        self.forward_in_place(piece, polynomial, spectrum, scratch);
    }

    /// Runs piece `piece` of the forward transform of z = `polynomial`, which is overwritten.
    pub(crate) fn forward_in_place(
        &self,
        piece: usize,
        polynomial: &mut [Complex<T>],
        spectrum: &mut [Packet<T>],
        scratch: &mut [Complex<f64>],
    ) {
        match self.locate(piece) {
            PieceKind::Pass { pass, node, butterflies } => {
                let quarters = self.quarters(pass, node, butterflies, polynomial);
                self.unit.dispatch(ForwardPass { constants: self.passes[pass][node], quarters });
            }
            PieceKind::Leaf(leaf) => {
                let range = leaf * self.leaf..(leaf + 1) * self.leaf;
                let packets = range.start / PACKET..range.end / PACKET;
                let numbers = &mut polynomial[range.clone()];
                self.unit.dispatch(Twist { numbers, twist: &self.twist[range] });
                self.leaves.forward(numbers, scratch);
                self.unit.dispatch(Separate { numbers, spectrum: &mut spectrum[packets] });
            }
        }
    }

    /// The packets of the spectrum that a piece of a forward transform writes.
    pub(crate) fn packets_of(&self, piece: usize) -> core::ops::Range<usize> {
        match self.locate(piece) {
            PieceKind::Pass { .. } => 0..0,
            PieceKind::Leaf(leaf) => leaf * self.leaf / PACKET..(leaf + 1) * self.leaf / PACKET,
        }
    }

    /// Runs piece `piece` of the inverse transform, B times the inverse; the last pieces write the
    /// imaginary parts, which are the upper B of the 2B real numbers, to `output`.
    pub(crate) fn inverse(
        &self,
        piece: usize,
        spectrum: &[Packet<T>],
        output: &mut [T],
        polynomial: &mut [Complex<T>],
        scratch: &mut [Complex<f64>],
    ) {
        match self.locate(self.pieces() - 1 - piece) {
            PieceKind::Leaf(leaf) => {
                let range = leaf * self.leaf..(leaf + 1) * self.leaf;
                let packets = range.start / PACKET..range.end / PACKET;
                let numbers = &mut polynomial[range.clone()];
                self.unit.dispatch(Gather { numbers, spectrum: &spectrum[packets] });
                self.leaves.inverse(numbers, scratch);
                self.unit.dispatch(Untwist { numbers, twist: &self.twist[range] });
                if self.passes.is_empty() {
                    store(numbers, output);
                }
            }
            PieceKind::Pass { pass, node, butterflies } => {
                let quarters = self.quarters(pass, node, butterflies.clone(), polynomial);
                self.unit.dispatch(InversePass { constants: self.passes[pass][node], quarters });
                if pass == 0 {
                    for quarter in 0..4 {
                        let start = quarter * self.block / 4;
                        let range = start + butterflies.start..start + butterflies.end;
                        store(&polynomial[range.clone()], &mut output[range]);
                    }
                }
            }
        }
    }

    /// The given butterflies in the four quarters of a node.
    fn quarters<'a>(
        &self,
        pass: usize,
        node: usize,
        butterflies: Butterflies,
        polynomial: &'a mut [Complex<T>],
    ) -> [&'a mut [Complex<T>]; 4] {
        let size = self.block >> (2 * pass);
        let (lower, upper) = polynomial[node * size..(node + 1) * size].split_at_mut(size / 2);
        let (first, second) = lower.split_at_mut(size / 4);
        let (third, fourth) = upper.split_at_mut(size / 4);
        [first, second, third, fourth].map(|quarter| &mut quarter[butterflies.clone()])
    }
}

type Butterflies = core::ops::Range<usize>;

enum PieceKind {
    Pass { pass: usize, node: usize, butterflies: Butterflies },
    Leaf(usize),
}

/// e^{2πi·numerator/denominator}, correctly rounded up to the library's sine; denominator a multiple of 8.
fn root_of_unity<T: Scalar>(numerator: usize, denominator: usize) -> Complex<T> {
    let position = numerator % denominator;
    let quarter = denominator / 4;
    // Only angles up to π/4 are evaluated; the others follow by symmetry.
    let within = position % quarter;
    let angle = |count: usize| TAU * count as f64 / denominator as f64;
    let (cosine, sine) = if 2 * within <= quarter {
        (libm::cos(angle(within)), libm::sin(angle(within)))
    } else {
        (libm::sin(angle(quarter - within)), libm::cos(angle(quarter - within)))
    };
    let (re, im) = match position / quarter {
        0 => (cosine, sine),
        1 => (-sine, cosine),
        2 => (-cosine, -sine),
        _ => (sine, -cosine),
    };
    Complex::new(T::of(re), T::of(im))
}

/// z = x + 0i
fn load<T: Scalar>(samples: &[T], polynomial: &mut [Complex<T>]) {
    for (number, &sample) in polynomial.iter_mut().zip(samples) {
        *number = Complex::new(sample, T::zero());
    }
}

/// The imaginary parts.
fn store<T: Scalar>(polynomial: &[Complex<T>], output: &mut [T]) {
    for (out, number) in output.iter_mut().zip(polynomial) {
        *out = number.im;
    }
}

/// Σ_q b_q i^{kq} for k = 0…3.
#[inline(always)]
fn four_point<T: Scalar, S: Simd>(unit: S, b: [T::Complexes<S>; 4]) -> [T::Complexes<S>; 4] {
    let even = T::complex_add(unit, b[0], b[2]);
    let odd = T::complex_sub(unit, b[0], b[2]);
    let sum = T::complex_add(unit, b[1], b[3]);
    let turn = T::times_i(unit, T::complex_sub(unit, b[1], b[3]));
    [
        T::complex_add(unit, even, sum),
        T::complex_add(unit, odd, turn),
        T::complex_sub(unit, even, sum),
        T::complex_sub(unit, odd, turn),
    ]
}

struct ForwardPass<'a, T> {
    constants: [Complex<T>; 3],
    quarters: [&'a mut [Complex<T>]; 4],
}

impl<T: Scalar> WithSimd for ForwardPass<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, unit: S) {
        let [g1, g2, g3] = self.constants.map(|constant| T::complex_splat(unit, constant));
        let [first, second, third, fourth] = self.quarters.map(T::complexes_mut::<S>);
        let rest = second.iter_mut().zip(third.iter_mut().zip(fourth.iter_mut()));
        for (q0, (q1, (q2, q3))) in first.iter_mut().zip(rest) {
            let b1 = T::complex_mul(unit, g1, *q1);
            let b2 = T::complex_mul(unit, g2, *q2);
            let b3 = T::complex_mul(unit, g3, *q3);
            [*q0, *q1, *q2, *q3] = four_point::<T, S>(unit, [*q0, b1, b2, b3]);
        }
    }
}

struct InversePass<'a, T> {
    constants: [Complex<T>; 3],
    quarters: [&'a mut [Complex<T>]; 4],
}

impl<T: Scalar> WithSimd for InversePass<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, unit: S) {
        let [g1, g2, g3] = self.constants.map(|constant| T::complex_splat(unit, constant));
        let [first, second, third, fourth] = self.quarters.map(T::complexes_mut::<S>);
        let rest = second.iter_mut().zip(third.iter_mut().zip(fourth.iter_mut()));
        for (q0, (q1, (q2, q3))) in first.iter_mut().zip(rest) {
            // i^{−kq} gives the same sums with the second and the fourth exchanged.
            let [b0, b3, b2, b1] = four_point::<T, S>(unit, [*q0, *q1, *q2, *q3]);
            *q0 = b0;
            *q1 = T::conj_mul(unit, g1, b1);
            *q2 = T::conj_mul(unit, g2, b2);
            *q3 = T::conj_mul(unit, g3, b3);
        }
    }
}

/// z_j ζʲ
struct Twist<'a, T> {
    numbers: &'a mut [Complex<T>],
    twist: &'a [Complex<T>],
}

impl<T: Scalar> WithSimd for Twist<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, unit: S) {
        let twist = T::complexes::<S>(self.twist);
        for (number, &twist) in T::complexes_mut::<S>(self.numbers).iter_mut().zip(twist) {
            *number = T::complex_mul(unit, twist, *number);
        }
    }
}

/// z_j ζ⁻ʲ
struct Untwist<'a, T> {
    numbers: &'a mut [Complex<T>],
    twist: &'a [Complex<T>],
}

impl<T: Scalar> WithSimd for Untwist<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, unit: S) {
        let twist = T::complexes::<S>(self.twist);
        for (number, &twist) in T::complexes_mut::<S>(self.numbers).iter_mut().zip(twist) {
            *number = T::conj_mul(unit, twist, *number);
        }
    }
}

/// Interleaved numbers to packets.
struct Separate<'a, T> {
    numbers: &'a [Complex<T>],
    spectrum: &'a mut [Packet<T>],
}

impl<T: Scalar> WithSimd for Separate<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, unit: S) {
        let numbers: &[T] = bytemuck::cast_slice(self.numbers);
        for (packet, numbers) in self.spectrum.iter_mut().zip(numbers.as_chunks::<{ 2 * PACKET }>().0) {
            let pairs = T::reals::<S>(numbers).as_chunks::<2>().0;
            let (re, im) = (T::reals_mut::<S>(&mut packet.re), T::reals_mut::<S>(&mut packet.im));
            for ((&pair, re), im) in pairs.iter().zip(re).zip(im) {
                [*re, *im] = T::separate(unit, pair);
            }
        }
    }
}

/// Packets to interleaved numbers.
struct Gather<'a, T> {
    numbers: &'a mut [Complex<T>],
    spectrum: &'a [Packet<T>],
}

impl<T: Scalar> WithSimd for Gather<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, unit: S) {
        let numbers: &mut [T] = bytemuck::cast_slice_mut(self.numbers);
        for (packet, numbers) in self.spectrum.iter().zip(numbers.as_chunks_mut::<{ 2 * PACKET }>().0) {
            let pairs = T::reals_mut::<S>(numbers).as_chunks_mut::<2>().0;
            let (re, im) = (T::reals::<S>(&packet.re), T::reals::<S>(&packet.im));
            for ((pair, &re), &im) in pairs.iter_mut().zip(re).zip(im) {
                *pair = T::interleave(unit, [re, im]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Σ_j x_j w_{B+i−j} for i < B, directly.
    fn middle_product(samples: &[f64], segment: &[f64]) -> Vec<f64> {
        let block = samples.len();
        (0..block).map(|i| (0..block).map(|j| samples[j] * segment[block + i - j]).sum()).collect()
    }

    #[test]
    fn products_of_values_are_the_middle_product() {
        for (block, leaf) in
            [(16, 64), (64, 64), (256, 256), (256, 64), (1024, 256), (1024, 64), (4096, 64), (2048, 512)]
        {
            let transform = Transform::<f64>::new(block, leaf, &mut Plans::new(), Arch::new());
            let samples: Vec<f64> = (0..block).map(|j| (0.3 * j as f64 * j as f64).sin()).collect();
            let segment: Vec<f64> =
                (0..2 * block).map(|j| (0.7 * j as f64 * j as f64).cos() / block as f64).collect();
            let polynomial = &mut vec![Complex::new(7.0, 7.0); block];
            let scratch = &mut vec![Complex::new(7.0, 7.0); transform.scratch()];
            let (mut x, mut w) =
                (vec![Packet::zero(); transform.packets()], vec![Packet::zero(); transform.packets()]);
            for piece in 0..transform.pieces() {
                transform.forward(piece, &samples, &mut x, polynomial, scratch);
            }
            for j in 0..block {
                polynomial[j] = Complex::new(segment[j], segment[j + block]);
            }
            for piece in 0..transform.pieces() {
                transform.forward_in_place(piece, polynomial, &mut w, scratch);
            }
            for (x, w) in x.iter_mut().zip(&w) {
                for l in 0..PACKET {
                    let product = Complex::new(x.re[l], x.im[l]) * Complex::new(w.re[l], w.im[l]);
                    (x.re[l], x.im[l]) = (product.re, product.im);
                }
            }
            let mut output = vec![f64::NAN; block];
            for piece in 0..transform.pieces() {
                transform.inverse(piece, &x, &mut output, polynomial, scratch);
            }
            for (found, expected) in output.iter().zip(middle_product(&samples, &segment)) {
                let found = found / block as f64;
                assert!((found - expected).abs() < 1e-14, "block {block} leaf {leaf}: {found} {expected}");
            }
        }
    }

    #[test]
    fn roots_of_unity_keep_their_digits_and_their_symmetries() {
        let root = |numerator| root_of_unity::<f64>(numerator, 4096);
        for a in (0..=1024).filter(|&a| a != 512) {
            let (here, mirrored, turned) = (root(a), root(1024 - a), root(a + 1024));
            assert_eq!((here.re, here.im), (mirrored.im, mirrored.re), "{a}");
            assert_eq!((turned.re, turned.im), (-here.im, here.re), "{a}");
            assert_eq!(root(a + 2048), -here, "{a}");
            assert!((here.norm() - 1.0).abs() < 4e-16, "{a}");
        }
        assert_eq!(root(1).im, (TAU / 4096.0).sin());
        assert_eq!(root(1024), Complex::new(0.0, 1.0));
    }

    #[test]
    fn pieces_cost_their_butterflies_and_leaves_forth_and_back() {
        // 1024 → 256 → 64: 2 passes of 256 butterflies in pieces of 64, each with four products for two
        // transforms; 16 leaves.
        let transform = Transform::<f64>::new(1024, 128, &mut Plans::new(), Arch::new());
        assert_eq!(transform.pieces(), 2 * 4 + 16);
        // A twist for each number, three constants for the root and for each of its four nodes.
        assert_eq!(transform.bytes(), (1024 + 3 * (1 + 4)) * 16);
        let costs: Vec<usize> = (0..24).map(|piece| transform.forward_cost(piece)).collect();
        assert_eq!((&costs[..8], &costs[8..]), (&[512; 8][..], &[384; 16][..]));
        let back: Vec<usize> = (0..24).rev().map(|piece| transform.inverse_cost(piece)).collect();
        assert_eq!(back, costs);
    }
}
