//! The stepper: fractionally damped systems of one to six coordinates, with callbacks for the potential.
//!
//! There is a function for each number of coordinates and place of the damping, so that a program links only
//! those that it calls: 20 to 42 kB of flash each on a Cortex-M4F. A single function with the number as
//! parameter would link all of them, 286 kB; saving through the stepper's table of calls would add 9 kB to
//! every program that never saves.

use core::ffi::c_void;

use fvi_core::{
    Coefficients, DampingTerm, Derivative, Fixed, Force, Galerkin, Instant, Integrator, Kernel, Mass,
    NodeGalerkin, Potential, Scheme, System,
};
use nalgebra::{SMatrix, SVector};

use crate::memory::{AnyMemory, FviMemory};
use crate::operator::{FVI_CAPUTO, FVI_RIEMANN_LIOUVILLE};
use crate::pointer::{check, reference, slice, slice_mut};
use crate::status::{FviStatus, status};
use crate::stored::{Storable, keep, kept, words};

/// Number of 64-bit words of a stepper for one coordinate.
pub const FVI_STEPPER_WORDS_1: usize = 48;
/// Number of 64-bit words of a stepper for two coordinates.
pub const FVI_STEPPER_WORDS_2: usize = 61;
/// Number of 64-bit words of a stepper for three coordinates.
pub const FVI_STEPPER_WORDS_3: usize = 79;
/// Number of 64-bit words of a stepper for four coordinates.
pub const FVI_STEPPER_WORDS_4: usize = 101;
/// Number of 64-bit words of a stepper for five coordinates.
pub const FVI_STEPPER_WORDS_5: usize = 126;
/// Number of 64-bit words of a stepper for six coordinates.
pub const FVI_STEPPER_WORDS_6: usize = 156;

/// Writes ∇U(q), n numbers, to `gradient`.
pub type FviGradient =
    Option<unsafe extern "C" fn(context: *mut c_void, position: *const f32, gradient: *mut f32)>;
/// Writes ∂²U/∂q², n² numbers row by row, to `hessian`. It must be the derivative of the gradient.
pub type FviHessian =
    Option<unsafe extern "C" fn(context: *mut c_void, position: *const f32, hessian: *mut f32)>;
/// Writes the external force F(t, q), n numbers, to `force`. Its dependence on q must be weak.
pub type FviForce =
    Option<unsafe extern "C" fn(context: *mut c_void, time: f32, position: *const f32, force: *mut f32)>;

/// A system M q̈ + ∇U(q) + ρ D^β q = F(t, q) + u and how it is integrated: the low-order fractional
/// variational integrator.
///
/// The number of coordinates n is that of the function that sets it up. Matrices are n×n numbers row by row.
/// After the stepper is set up, only the tables and the buffer of the memory and the object behind `context`
/// must remain valid.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FviSystem {
    /// Mass M, symmetric positive definite.
    pub mass: *const f32,
    /// Coefficients ρ of the damping, symmetric positive semidefinite.
    pub damping: *const f32,
    /// Damping order β, 0 ≤ β < 2.
    pub damping_order: f32,
    /// FVI_RIEMANN_LIOUVILLE or FVI_CAPUTO.
    pub derivative: u32,
    /// Memory with n channels whose kernel is that of D^β for the step size.
    pub memory: *const FviMemory,
    /// Step size h.
    pub step_size: f32,
    /// κ in [0, 1]: the potential is taken at κ q_k + (1−κ) q_{k+1}; ½ is the midpoint rule.
    pub kappa: f32,
    /// Initial position, n numbers.
    pub position: *const f32,
    /// Initial momentum, n numbers.
    pub momentum: *const f32,
    /// ∇U.
    pub gradient: FviGradient,
    /// ∂²U/∂q².
    pub hessian: FviHessian,
    /// External force, or NULL.
    pub force: FviForce,
    /// Passed to the callbacks unchanged.
    pub context: *mut c_void,
}

/// A stepper of any number of coordinates, in storage of the caller.
#[derive(Debug)]
pub struct FviStepper {
    _private: [u64; 0],
}

/// Storage of a stepper for one coordinate.
#[repr(C)]
#[derive(Debug)]
pub struct FviStepper1 {
    /// Internal state; not to be accessed by the caller. Set all words to zero before the first call.
    pub words: [u64; FVI_STEPPER_WORDS_1],
}

/// Storage of a stepper for two coordinates.
#[repr(C)]
#[derive(Debug)]
pub struct FviStepper2 {
    /// Internal state; not to be accessed by the caller. Set all words to zero before the first call.
    pub words: [u64; FVI_STEPPER_WORDS_2],
}

/// Storage of a stepper for three coordinates.
#[repr(C)]
#[derive(Debug)]
pub struct FviStepper3 {
    /// Internal state; not to be accessed by the caller. Set all words to zero before the first call.
    pub words: [u64; FVI_STEPPER_WORDS_3],
}

/// Storage of a stepper for four coordinates.
#[repr(C)]
#[derive(Debug)]
pub struct FviStepper4 {
    /// Internal state; not to be accessed by the caller. Set all words to zero before the first call.
    pub words: [u64; FVI_STEPPER_WORDS_4],
}

/// Storage of a stepper for five coordinates.
#[repr(C)]
#[derive(Debug)]
pub struct FviStepper5 {
    /// Internal state; not to be accessed by the caller. Set all words to zero before the first call.
    pub words: [u64; FVI_STEPPER_WORDS_5],
}

/// Storage of a stepper for six coordinates.
#[repr(C)]
#[derive(Debug)]
pub struct FviStepper6 {
    /// Internal state; not to be accessed by the caller. Set all words to zero before the first call.
    pub words: [u64; FVI_STEPPER_WORDS_6],
}

/// Potential and force of the caller.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Callbacks {
    gradient: unsafe extern "C" fn(*mut c_void, *const f32, *mut f32),
    hessian: unsafe extern "C" fn(*mut c_void, *const f32, *mut f32),
    force: FviForce,
    context: *mut c_void,
}

impl<const N: usize> Potential<f32, N> for Callbacks {
    /// The interface has no energy, so this is never called.
    fn value(&self, _: &SVector<f32, N>) -> f32 {
        f32::NAN
    }

    #[inline]
    fn gradient(&self, position: &SVector<f32, N>) -> SVector<f32, N> {
        let mut gradient = SVector::<f32, N>::zeros();
        // SAFETY: both point to N numbers, as the callback was promised.
        unsafe { (self.gradient)(self.context, position.as_ptr(), gradient.as_mut_ptr()) };
        gradient
    }

    #[inline]
    fn hessian(&self, position: &SVector<f32, N>) -> SMatrix<f32, N, N> {
        let mut hessian = SMatrix::<f32, N, N>::zeros();
        // SAFETY: N and N² numbers, as the callback was promised.
        unsafe { (self.hessian)(self.context, position.as_ptr(), hessian.as_mut_ptr()) };
        // Written row by row, stored column by column.
        hessian.transpose()
    }
}

impl<const N: usize> Force<f32, N> for Callbacks {
    #[inline]
    fn value(&self, instant: Instant<f32>, position: &SVector<f32, N>) -> SVector<f32, N> {
        let mut force = SVector::<f32, N>::zeros();
        if let Some(callback) = self.force {
            // SAFETY: both point to N numbers, as the callback was promised.
            unsafe { callback(self.context, instant.time, position.as_ptr(), force.as_mut_ptr()) };
        }
        force
    }
}

pub(crate) type Stepper<const N: usize, S> = Integrator<
    f32,
    Fixed<N>,
    System<f32, N, Callbacks, Callbacks>,
    S,
    DampingTerm<f32, Fixed<N>, AnyMemory<N>>,
>;

/// The low-order scheme, damped at the main nodes.
pub(crate) type AtMainNodes = Galerkin<f32, 1, 1>;

/// The low-order scheme, damped at its node.
pub(crate) type AtNode = NodeGalerkin<f32, 1, 1>;

/// Function pointers independent of the number of coordinates, so that a program links only the steppers that
/// it sets up.
#[derive(Clone, Copy)]
pub(crate) struct Calls {
    /// Number of coordinates, negative where the damping is at the node.
    pub(crate) kind: i32,
    step: unsafe fn(*mut u64, *const f32) -> Result<(), FviStatus>,
    state: unsafe fn(*mut u64, *mut f32, *mut f32, *mut u64) -> Result<(), FviStatus>,
}

/// A stepper in its storage. It begins with the function pointers, so that they can be found without knowing
/// N.
#[repr(C)]
pub(crate) struct Machine<const N: usize, S: Scheme<f32, Fixed<N>>> {
    calls: Calls,
    pub(crate) stepper: Stepper<N, S>,
}

impl Storable for Calls {
    const TAG: u64 = 0x6676_692d_7374_6570;
}

impl<const N: usize, S: Scheme<f32, Fixed<N>>> Storable for Machine<N, S> {
    const TAG: u64 = Calls::TAG;
}

/// Converts N² numbers to coefficients, to diagonal ones if possible.
///
/// # Safety
/// As [`slice`].
unsafe fn coefficients<const N: usize>(numbers: *const f32) -> Result<Coefficients<f32, N>, FviStatus> {
    // SAFETY: passed on.
    let matrix = SMatrix::<f32, N, N>::from_iterator(unsafe { slice(numbers, N * N) }?.iter().copied());
    let diagonal = matrix.diagonal();
    Ok(if matrix == SMatrix::from_diagonal(&diagonal) {
        Coefficients::Diagonal(diagonal)
    } else {
        Coefficients::Dense(matrix)
    })
}

/// # Safety
/// As [`slice`].
unsafe fn vector<const N: usize>(numbers: *const f32) -> Result<SVector<f32, N>, FviStatus> {
    // SAFETY: passed on.
    Ok(SVector::from_iterator(unsafe { slice(numbers, N) }?.iter().copied()))
}

/// # Safety
/// `storage` must hold the words of `Machine<N, S>`, `stepper` be writable, `system` as its type describes.
unsafe fn init<const N: usize, S: Scheme<f32, Fixed<N>>>(
    kind: i32,
    storage: *mut u64,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
    scheme: impl FnOnce(AtMainNodes) -> S,
) -> Result<(), FviStatus> {
    check(storage)?;
    check(stepper)?;
    // SAFETY: promised by the caller.
    let system = unsafe { reference(system) }?;
    let (Some(gradient), Some(hessian)) = (system.gradient, system.hessian) else {
        return Err(FviStatus::Null);
    };
    let derivative = match system.derivative {
        FVI_RIEMANN_LIOUVILLE => Derivative::RiemannLiouville,
        FVI_CAPUTO => Derivative::Caputo,
        _ => return Err(FviStatus::OutOfRange),
    };
    // SAFETY: promised by the caller.
    let (mass, rho) = unsafe { (coefficients::<N>(system.mass)?, coefficients::<N>(system.damping)?) };
    // SAFETY: promised by the caller.
    let (position, momentum) = unsafe { (vector::<N>(system.position)?, vector::<N>(system.momentum)?) };
    let mass = Mass::new(mass)?;
    let scheme = scheme(Galerkin::low_order(system.kappa)?);
    // SAFETY: promised by the caller.
    let memory = unsafe { AnyMemory::<N>::new(reference(system.memory)?) }?;
    let damping = DampingTerm::new(Kernel::given(f64::from(system.damping_order))?, rho, derivative, memory)?;
    let callbacks = Callbacks { gradient, hessian, force: system.force, context: system.context };
    let system_of_core = System { mass, potential: callbacks, force: callbacks };
    let integrator = Integrator::builder(system_of_core, scheme, system.step_size)
        .damping(damping)
        .position(position)
        .momentum(momentum)
        .build()?;
    let calls = Calls { kind, step: step::<N, S>, state: state::<N, S> };
    // SAFETY: the storage has enough words.
    unsafe { keep(storage, Machine { calls, stepper: integrator }) }?;
    // SAFETY: not NULL and aligned; writable as promised.
    unsafe { stepper.write(storage.cast()) };
    Ok(())
}

/// # Safety
/// As [`fvi_stepper_step`].
unsafe fn step<const N: usize, S: Scheme<f32, Fixed<N>>>(
    storage: *mut u64,
    input: *const f32,
) -> Result<(), FviStatus> {
    let input = if input.is_null() {
        SVector::zeros()
    } else {
        // SAFETY: promised by the caller.
        unsafe { vector::<N>(input) }?
    };
    // SAFETY: the calls lead here only from a `Machine<N, S>`.
    unsafe { kept::<Machine<N, S>>(storage) }?.stepper.step(&input)?;
    Ok(())
}

/// # Safety
/// As [`fvi_stepper_state`].
unsafe fn state<const N: usize, S: Scheme<f32, Fixed<N>>>(
    storage: *mut u64,
    position: *mut f32,
    momentum: *mut f32,
    steps: *mut u64,
) -> Result<(), FviStatus> {
    // SAFETY: the calls lead here only from a `Machine<N, S>`.
    let state = unsafe { kept::<Machine<N, S>>(storage) }?.stepper.state();
    // All arguments are checked before anything is written.
    if !steps.is_null() {
        check(steps)?;
    }
    for target in [position, momentum] {
        if !target.is_null() {
            check(target)?;
        }
    }
    for (target, source) in [(position, &state.position), (momentum, &state.momentum)] {
        let count = if target.is_null() { 0 } else { N };
        // SAFETY: writable for N numbers unless NULL.
        for (target, &source) in unsafe { slice_mut(target, count) }?.iter_mut().zip(source.iter()) {
            *target = source;
        }
    }
    if !steps.is_null() {
        // SAFETY: writable and aligned.
        unsafe { steps.write(state.step) };
    }
    Ok(())
}

const _: () = {
    assert!(words::<Machine<1, AtMainNodes>>() <= FVI_STEPPER_WORDS_1);
    assert!(words::<Machine<1, AtNode>>() <= FVI_STEPPER_WORDS_1);
    assert!(words::<Machine<2, AtMainNodes>>() <= FVI_STEPPER_WORDS_2);
    assert!(words::<Machine<2, AtNode>>() <= FVI_STEPPER_WORDS_2);
    assert!(words::<Machine<3, AtMainNodes>>() <= FVI_STEPPER_WORDS_3);
    assert!(words::<Machine<3, AtNode>>() <= FVI_STEPPER_WORDS_3);
    assert!(words::<Machine<4, AtMainNodes>>() <= FVI_STEPPER_WORDS_4);
    assert!(words::<Machine<4, AtNode>>() <= FVI_STEPPER_WORDS_4);
    assert!(words::<Machine<5, AtMainNodes>>() <= FVI_STEPPER_WORDS_5);
    assert!(words::<Machine<5, AtNode>>() <= FVI_STEPPER_WORDS_5);
    assert!(words::<Machine<6, AtMainNodes>>() <= FVI_STEPPER_WORDS_6);
    assert!(words::<Machine<6, AtNode>>() <= FVI_STEPPER_WORDS_6);
};

/// Sets up a stepper for one coordinate at t = 0 in `storage` and writes its address to `stepper`.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE, FVI_STATUS_OUT_OF_RANGE,
/// FVI_STATUS_WRONG_SIZE, FVI_STATUS_NOT_SYMMETRIC or FVI_STATUS_NOT_POSITIVE; then neither `storage` nor
/// `stepper` has changed.
///
/// # Safety
/// `storage` and `stepper` must be writable, `system` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_init_1(
    storage: *mut FviStepper1,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
) -> FviStatus {
    // SAFETY: promised by the caller; the words are as many as asserted above.
    status(unsafe { init::<1, AtMainNodes>(1, storage.cast(), system, stepper, |scheme| scheme) })
}

/// Sets up a stepper for two coordinates at t = 0 in `storage` and writes its address to `stepper`.
///
/// Returns what fvi_stepper_init_1 returns.
///
/// # Safety
/// `storage` and `stepper` must be writable, `system` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_init_2(
    storage: *mut FviStepper2,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
) -> FviStatus {
    // SAFETY: promised by the caller; the words are as many as asserted above.
    status(unsafe { init::<2, AtMainNodes>(2, storage.cast(), system, stepper, |scheme| scheme) })
}

/// Sets up a stepper for three coordinates at t = 0 in `storage` and writes its address to `stepper`.
///
/// Returns what fvi_stepper_init_1 returns.
///
/// # Safety
/// `storage` and `stepper` must be writable, `system` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_init_3(
    storage: *mut FviStepper3,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
) -> FviStatus {
    // SAFETY: promised by the caller; the words are as many as asserted above.
    status(unsafe { init::<3, AtMainNodes>(3, storage.cast(), system, stepper, |scheme| scheme) })
}

/// Sets up a stepper for four coordinates at t = 0 in `storage` and writes its address to `stepper`.
///
/// Returns what fvi_stepper_init_1 returns.
///
/// # Safety
/// `storage` and `stepper` must be writable, `system` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_init_4(
    storage: *mut FviStepper4,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
) -> FviStatus {
    // SAFETY: promised by the caller; the words are as many as asserted above.
    status(unsafe { init::<4, AtMainNodes>(4, storage.cast(), system, stepper, |scheme| scheme) })
}

/// Sets up a stepper for five coordinates at t = 0 in `storage` and writes its address to `stepper`.
///
/// Returns what fvi_stepper_init_1 returns.
///
/// # Safety
/// `storage` and `stepper` must be writable, `system` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_init_5(
    storage: *mut FviStepper5,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
) -> FviStatus {
    // SAFETY: promised by the caller; the words are as many as asserted above.
    status(unsafe { init::<5, AtMainNodes>(5, storage.cast(), system, stepper, |scheme| scheme) })
}

/// Sets up a stepper for six coordinates at t = 0 in `storage` and writes its address to `stepper`.
///
/// Returns what fvi_stepper_init_1 returns.
///
/// # Safety
/// `storage` and `stepper` must be writable, `system` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_init_6(
    storage: *mut FviStepper6,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
) -> FviStatus {
    // SAFETY: promised by the caller; the words are as many as asserted above.
    status(unsafe { init::<6, AtMainNodes>(6, storage.cast(), system, stepper, |scheme| scheme) })
}

/// Sets up a stepper for one coordinate at t = 0 in `storage` and writes its address to `stepper`; the
/// fractional force acts at κ q_k + (1−κ) q_{k+1}, like the potential, instead of at the end of the step.
///
/// With κ = ½ the momentum is of order 2 too, and with weights of order 1 or 2 every step size is stable. The
/// memory takes one sample in each step and none at t = 0. Returns what fvi_stepper_init_1 returns.
///
/// # Safety
/// `storage` and `stepper` must be writable, `system` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_init_at_node_1(
    storage: *mut FviStepper1,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
) -> FviStatus {
    // SAFETY: promised by the caller; the words are as many as asserted above.
    status(unsafe { init::<1, AtNode>(-1, storage.cast(), system, stepper, NodeGalerkin::new) })
}

/// Sets up a stepper for two coordinates at t = 0 in `storage` and writes its address to `stepper`, damped as
/// with fvi_stepper_init_at_node_1.
///
/// Returns what fvi_stepper_init_1 returns.
///
/// # Safety
/// `storage` and `stepper` must be writable, `system` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_init_at_node_2(
    storage: *mut FviStepper2,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
) -> FviStatus {
    // SAFETY: promised by the caller; the words are as many as asserted above.
    status(unsafe { init::<2, AtNode>(-2, storage.cast(), system, stepper, NodeGalerkin::new) })
}

/// Sets up a stepper for three coordinates at t = 0 in `storage` and writes its address to `stepper`, damped
/// as with fvi_stepper_init_at_node_1.
///
/// Returns what fvi_stepper_init_1 returns.
///
/// # Safety
/// `storage` and `stepper` must be writable, `system` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_init_at_node_3(
    storage: *mut FviStepper3,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
) -> FviStatus {
    // SAFETY: promised by the caller; the words are as many as asserted above.
    status(unsafe { init::<3, AtNode>(-3, storage.cast(), system, stepper, NodeGalerkin::new) })
}

/// Sets up a stepper for four coordinates at t = 0 in `storage` and writes its address to `stepper`, damped
/// as with fvi_stepper_init_at_node_1.
///
/// Returns what fvi_stepper_init_1 returns.
///
/// # Safety
/// `storage` and `stepper` must be writable, `system` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_init_at_node_4(
    storage: *mut FviStepper4,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
) -> FviStatus {
    // SAFETY: promised by the caller; the words are as many as asserted above.
    status(unsafe { init::<4, AtNode>(-4, storage.cast(), system, stepper, NodeGalerkin::new) })
}

/// Sets up a stepper for five coordinates at t = 0 in `storage` and writes its address to `stepper`, damped
/// as with fvi_stepper_init_at_node_1.
///
/// Returns what fvi_stepper_init_1 returns.
///
/// # Safety
/// `storage` and `stepper` must be writable, `system` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_init_at_node_5(
    storage: *mut FviStepper5,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
) -> FviStatus {
    // SAFETY: promised by the caller; the words are as many as asserted above.
    status(unsafe { init::<5, AtNode>(-5, storage.cast(), system, stepper, NodeGalerkin::new) })
}

/// Sets up a stepper for six coordinates at t = 0 in `storage` and writes its address to `stepper`, damped as
/// with fvi_stepper_init_at_node_1.
///
/// Returns what fvi_stepper_init_1 returns.
///
/// # Safety
/// `storage` and `stepper` must be writable, `system` as its type describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_init_at_node_6(
    storage: *mut FviStepper6,
    system: *const FviSystem,
    stepper: *mut *mut FviStepper,
) -> FviStatus {
    // SAFETY: promised by the caller; the words are as many as asserted above.
    status(unsafe { init::<6, AtNode>(-6, storage.cast(), system, stepper, NodeGalerkin::new) })
}

/// Makes one step with the input u, n numbers held over the step, or NULL for none.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE,
/// FVI_STATUS_MEMORY_FULL, FVI_STATUS_NOT_CONVERGED or FVI_STATUS_SINGULAR; then the stepper is unchanged,
/// and the step may be tried again.
///
/// # Safety
/// `stepper` must come from fvi_stepper_init_n or point to zeroed storage, `input` be NULL or hold n numbers.
/// The callbacks must not call this function on the same stepper.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_step(stepper: *mut FviStepper, input: *const f32) -> FviStatus {
    status((|| {
        let storage = stepper.cast::<u64>();
        // SAFETY: set up or zeroed, as promised; every `Machine` begins with its calls.
        let calls = *unsafe { kept::<Calls>(storage) }?;
        // SAFETY: promised by the caller.
        unsafe { (calls.step)(storage, input) }
    })())
}

/// Writes position and momentum, n numbers each, and the number of steps made; each pointer may be NULL.
///
/// Where damping acts at the main nodes, the momentum is the one after the kick at the end of the step, of
/// order 1; at the node there is one momentum only.
///
/// Returns FVI_STATUS_NULL if `stepper` is NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.
///
/// # Safety
/// `stepper` must come from fvi_stepper_init_n or point to zeroed storage, the others be NULL or writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_stepper_state(
    stepper: *const FviStepper,
    position: *mut f32,
    momentum: *mut f32,
    steps: *mut u64,
) -> FviStatus {
    status((|| {
        let storage = stepper.cast_mut().cast::<u64>();
        // SAFETY: set up or zeroed, as promised; every `Machine` begins with its calls.
        let calls = *unsafe { kept::<Calls>(storage) }?;
        // SAFETY: promised by the caller.
        unsafe { (calls.state)(storage, position, momentum, steps) }
    })())
}
