//! Controllers whose constants a program on a host has computed and checked: what is left to check is that
//! nobody has edited them, and that is done when they are compiled.

use core::fmt;
use core::marker::PhantomData;

use crate::error::ParameterError;
use crate::exponential_sum::{ExponentialTable, Layout, TableSource, TabulatedSum};
use crate::memory::{ActsOn, Memory};
use crate::memoryless::Memoryless;
use crate::pid_law::{
    AntiWindup, Bumpless, DerivativeFilter, DerivativeOf, PidConstants, PidGains, PidLaw, PidSettings,
};
use crate::real::Real;
use crate::saving::{BASIS, mix};

/// A table of plain numbers with all that an operator of one channel needs: its scale and the kind of its
/// samples, which [`Kernel::exponential_sum`](crate::Kernel::exponential_sum) has found on a host.
///
/// [`new`](SealedTable::new) computes the seal of these constants and compares. Evaluated in a constant, as
/// in files that `fvi controller` prints, a number that has been edited is an error of compilation, and
/// nothing of the check is left in the program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SealedTable<T: 'static> {
    table: ExponentialTable<&'static [T]>,
    scale: T,
    acts_on: ActsOn,
    seal: u32,
}

/// The type that stands for a sealed table.
pub trait GeneratedKernel<T: 'static>: 'static {
    /// The table.
    const TABLE: SealedTable<T>;
}

/// The kernel of a [`GeneratedSum`], known to the compiler.
pub struct Generated<K>(PhantomData<K>);

impl<K> Clone for Generated<K> {
    fn clone(&self) -> Self {
        Self(PhantomData)
    }
}

impl<K> fmt::Debug for Generated<K> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Generated")
    }
}

/// The memory of an [`ExponentialSum`](crate::ExponentialSum) of one channel whose table is part of its type,
/// so that the compiler knows every length. It computes the same bits.
///
/// Differences, if the table is for these, are those of a signal that may jump.
pub type GeneratedSum<T, K, B> = TabulatedSum<T, Generated<K>, B>;

impl<T: Real, K: GeneratedKernel<T>> TableSource<T> for Generated<K> {
    #[inline(always)]
    fn table(&self) -> ExponentialTable<&[T]> {
        const { K::TABLE.table }
    }

    #[inline(always)]
    fn scale(&self) -> T {
        K::TABLE.scale
    }

    #[inline(always)]
    fn layout(&self) -> Layout {
        const { Layout::of(&K::TABLE.table, 1) }
    }

    #[inline(always)]
    fn acts_on(&self) -> ActsOn {
        K::TABLE.acts_on
    }

    #[inline(always)]
    fn forgets(&self) -> bool {
        false
    }

    /// The count of an endless memory never reaches its end.
    #[inline(always)]
    fn has_room(&self, len: u64) -> bool {
        K::TABLE.table.horizon == ExponentialTable::<()>::ENDLESS || len < K::TABLE.table.horizon
    }

    #[inline(always)]
    fn jumps(&self) -> bool {
        matches!(K::TABLE.acts_on, ActsOn::Increments)
    }

    #[inline(always)]
    fn expect_jumps(&mut self) {}
}

impl<T, K, B> GeneratedSum<T, K, B>
where
    T: Real,
    K: GeneratedKernel<T>,
    B: AsRef<[T]> + AsMut<[T]>,
{
    /// A memory without samples.
    ///
    /// # Errors
    /// If the state has another length than [`ExponentialTable::state_len`] for one channel.
    #[inline(always)]
    pub fn generated(state: B) -> Result<Self, ParameterError> {
        let (length, right) = (state.as_ref().len(), const { K::TABLE.table.state_len(1) });
        if length == right {
            return Ok(Self::with_kernel(Generated(PhantomData), state));
        }
        Err(ParameterError {
            parameter: "state length",
            value: length as f64,
            allowed: "the table's state_len",
        })
    }
}

/// A memory with the seal of its constants, by which a [`sealed`](PidLaw::sealed) law knows it.
pub trait GeneratedMemory<T>: Memory<T> {
    /// The seal.
    const SEAL: u32;
}

impl<T, K, B> GeneratedMemory<T> for GeneratedSum<T, K, B>
where
    T: Real,
    K: GeneratedKernel<T>,
    B: AsRef<[T]> + AsMut<[T]>,
{
    const SEAL: u32 = K::TABLE.seal;
}

/// It has no constants.
impl<T: Real> GeneratedMemory<T> for Memoryless<T> {
    const SEAL: u32 = 1;
}

/// A scalar whose constants can be sealed, for programs that generate them.
pub trait Sealing: Real {
    /// [`SealedTable::seal`].
    fn table_seal(table: &ExponentialTable<&[Self]>, scale: Self, acts_on: ActsOn) -> u32;

    /// [`PidLaw::seal`].
    fn law_seal(law: &PidLaw<Self>, memories: [u32; 3]) -> u32;
}

const fn folded(hash: u64) -> u32 {
    (hash ^ (hash >> 32)) as u32
}

macro_rules! seals {
    ($scalar:ident) => {
        impl Sealing for $scalar {
            fn table_seal(table: &ExponentialTable<&[Self]>, scale: Self, acts_on: ActsOn) -> u32 {
                SealedTable::<Self>::seal(table, scale, acts_on)
            }

            fn law_seal(law: &PidLaw<Self>, memories: [u32; 3]) -> u32 {
                PidLaw::<Self>::seal(law.settings(), law.constants(), memories)
            }
        }

        impl SealedTable<$scalar> {
            /// The constants, if this is their seal; otherwise somebody has edited them.
            pub const fn new(
                table: ExponentialTable<&'static [$scalar]>,
                scale: $scalar,
                acts_on: ActsOn,
                seal: u32,
            ) -> Option<Self> {
                let right = Self::seal(&table, scale, acts_on) == seal;
                if right { Some(Self { table, scale, acts_on, seal }) } else { None }
            }

            /// The seal of constants: a hash of all their bits.
            pub const fn seal(table: &ExponentialTable<&[$scalar]>, scale: $scalar, acts_on: ActsOn) -> u32 {
                let mut hash = mix(BASIS, scale.to_bits() as u64);
                hash = mix(hash, acts_on as u64);
                hash = mix(hash, table.stages as u64 | (table.slow_blocks as u64) << 32);
                hash = mix(hash, table.far_blocks as u64);
                hash = mix(mix(hash, table.horizon), table.step_size.to_bits());
                let mut rest = table.head;
                while let [number, behind @ ..] = rest {
                    (hash, rest) = (mix(hash, number.to_bits() as u64), behind);
                }
                hash = mix(hash, table.head.len() as u64);
                rest = table.exponentials;
                while let [number, behind @ ..] = rest {
                    (hash, rest) = (mix(hash, number.to_bits() as u64), behind);
                }
                folded(hash)
            }
        }

        impl PidLaw<$scalar> {
            /// A law of settings that a host has checked, with the constants that follow from them, for
            /// memories with these seals (those of integral, derivative and filter; 0 for none), if `seal` is
            /// the seal of all that; otherwise somebody has edited it.
            ///
            /// For constants, as in the files that `fvi controller` prints. [`new`](PidLaw::new) checks
            /// settings that are chosen by hand.
            pub const fn sealed(
                settings: PidSettings<$scalar>,
                constants: PidConstants<$scalar>,
                memories: [u32; 3],
                seal: u32,
            ) -> Option<Self> {
                let right = Self::seal(&settings, &constants, memories) == seal;
                if right { Some(Self::of_constants(settings, constants, memories)) } else { None }
            }

            /// The seal of a law: a hash of all its bits.
            pub const fn seal(
                settings: &PidSettings<$scalar>,
                constants: &PidConstants<$scalar>,
                [integral, derivative, filter]: [u32; 3],
            ) -> u32 {
                const fn add(hash: u64, number: $scalar) -> u64 {
                    mix(hash, number.to_bits() as u64)
                }
                let mut hash = mix(mix(BASIS, integral as u64), derivative as u64 | (filter as u64) << 32);
                hash = match settings.gains {
                    PidGains::Parallel { proportional, integral, derivative } => {
                        add(add(add(mix(hash, 0), proportional), integral), derivative)
                    }
                    PidGains::Series { proportional, integral_rate, derivative_time, filter_ratio } => {
                        let hash = add(add(mix(hash, 1), proportional), integral_rate);
                        add(add(hash, derivative_time), filter_ratio)
                    }
                };
                hash = mix(mix(hash, settings.integral_order.to_bits()), settings.derivative_order.to_bits());
                hash = mix(hash, if let Some(sample) = settings.sample { sample.to_bits() } else { 0 });
                let ([b, c], [lower, upper]) = (settings.setpoint_weights, settings.limits);
                hash = add(add(add(add(hash, b), c), lower), upper);
                hash = add(hash, settings.rate_limit);
                let of = match settings.derivative_of {
                    DerivativeOf::ValuesFromRest => 0,
                    DerivativeOf::Values => 1,
                    DerivativeOf::MeasuredRate => 2,
                };
                let bumpless = match settings.bumpless {
                    Bumpless::Whole => 0,
                    Bumpless::ExceptProportional => 1,
                    Bumpless::Nothing => 2,
                };
                hash = mix(hash, of | bumpless << 8);
                hash = match settings.derivative_filter {
                    DerivativeFilter::None => mix(hash, 0),
                    DerivativeFilter::FirstOrder { time } => mix(mix(hash, 1), time.to_bits()),
                    DerivativeFilter::Fractional { time, order } => {
                        mix(mix(mix(hash, 2), time.to_bits()), order.to_bits())
                    }
                };
                hash = match settings.anti_windup {
                    AntiWindup::None => mix(hash, 0),
                    AntiWindup::BackCalculation { time } => mix(mix(hash, 1), time.to_bits()),
                    AntiWindup::Conditional => mix(hash, 2),
                };
                let &PidConstants { tracking, filter_time, filter_share, step, stride } = constants;
                folded(add(add(add(add(add(hash, tracking), filter_time), filter_share), step), stride))
            }
        }
    };
}

seals!(f32);
seals!(f64);
