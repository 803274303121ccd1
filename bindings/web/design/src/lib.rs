//! A fractional PID controller for the design page: its ticks and response by fvi-core, its tables by
//! fvi-fft.
//!
//! JavaScript writes the numbers of [`Settings`] at [`settings`], calls [`begin`] and then [`tick`], or
//! [`response`], and reads the reason of a refusal at [`text`].

use std::cell::RefCell;

use fvi_core::{
    AntiWindup, DerivativeFilter, ExponentialSum, FractionalPid, Kernel, ParameterError, PidGains, PidLaw,
    PidSettings, Real,
};
use fvi_fft::Aligned;
use fvi_fft::exponentials::controller_source::ControllerTables;
use fvi_fft::exponentials::exponential_table::{ExponentialKernel, SMALLEST_TOLERANCE};

/// Numbers that JavaScript writes, in this order.
#[derive(Clone, Copy, Default)]
#[repr(C)]
struct Settings {
    /// K_p, K_i, K_d of u = K_p (b r − y) + K_i I^λ (r − y) + K_d D^μ (c r − y).
    gains: [f64; 3],
    /// λ and μ.
    orders: [f64; 2],
    /// b and c.
    weights: [f64; 2],
    /// T and ν of the filter 1/(1 + (T s)^ν) of the derivative; T = 0 for none.
    filter: [f64; 2],
    /// Smallest and largest output, and the largest change per unit of time; not finite for no limit.
    limits: [f64; 3],
    /// Tracking time of the back-calculation; 0 for none.
    tracking: f64,
    /// h, the time between ticks.
    sample: f64,
}

impl Settings {
    fn law<T: Real>(&self) -> Result<PidLaw<T>, ParameterError> {
        let [proportional, integral, derivative] = self.gains.map(T::of);
        let [time, order] = self.filter;
        let [lower, upper, rate] = self.limits;
        PidLaw::new(PidSettings {
            integral_order: self.orders[0],
            derivative_order: self.orders[1],
            setpoint_weights: self.weights.map(T::of),
            derivative_filter: match time {
                0.0 => DerivativeFilter::None,
                time if order == 1.0 => DerivativeFilter::FirstOrder { time },
                time => DerivativeFilter::Fractional { time, order },
            },
            limits: [T::of(lower), T::of(upper)],
            rate_limit: T::of(rate),
            anti_windup: match self.tracking {
                0.0 => AntiWindup::None,
                time => AntiWindup::BackCalculation { time },
            },
            ..PidSettings::new(PidGains::Parallel { proportional, integral, derivative }, self.sample)
        })
    }
}

type Sum = ExponentialSum<f64, Aligned<f64>, Vec<f64>>;

type Pid = FractionalPid<f64, Sum, Sum, PidLaw<f64>, Sum>;

/// All data that persists between calls.
#[derive(Default)]
struct Room {
    settings: Settings,
    /// Tables of exponentials with the numbers on which they depend: orders and filter.
    tables: Option<([f64; 4], ControllerTables)>,
    pid: Option<Pid>,
    answer: [f64; 2],
    text: String,
}

thread_local! {
    static ROOM: RefCell<Room> = RefCell::default();
}

fn enter<T>(visit: impl FnOnce(&mut Room) -> T) -> T {
    ROOM.with_borrow_mut(visit)
}

/// A controller before its first tick, with the memories that a run of the program has.
fn fresh(room: &mut Room) -> Result<Pid, String> {
    let law = room.settings.law::<f64>().map_err(|error| error.to_string())?;
    let Settings { orders: [lambda, mu], filter: [time, order], .. } = room.settings;
    let about = [lambda, mu, if time == 0.0 { 0.0 } else { 1.0 }, order];
    let tables = match room.tables.take() {
        Some((of, tables)) if of == about => tables,
        _ => ControllerTables::new(&law, 1 << 20, SMALLEST_TOLERANCE).map_err(|error| error.to_string())?,
    };
    let memory = |kernel: Result<Kernel, ParameterError>, table: &ExponentialKernel| {
        let table = table.table::<f64>();
        let state = vec![0.0; table.borrow().state_len(1)];
        kernel.and_then(|kernel| kernel.exponential_sum(table, 1, state))
    };
    let parts = || {
        let integral = memory(law.integral_kernel(), &tables.integral)?;
        let derivative = memory(law.derivative_kernel(), &tables.derivative)?;
        let filter = match (law.filter_kernel()?, &tables.filter) {
            (Some(kernel), Some(table)) => Some(memory(Ok(kernel), table)?),
            _ => None,
        };
        FractionalPid::with_parts(law, integral, Some(derivative), filter)
    };
    let made = parts().map_err(|error: ParameterError| error.to_string());
    room.tables = Some((about, tables));
    made
}

/// Address of the settings.
#[unsafe(no_mangle)]
extern "C" fn settings() -> *mut f64 {
    enter(|room| (&raw mut room.settings).cast())
}

/// Number of settings.
#[unsafe(no_mangle)]
extern "C" fn settings_len() -> usize {
    size_of::<Settings>() / size_of::<f64>()
}

/// Address of the text of the last refusal.
#[unsafe(no_mangle)]
extern "C" fn text() -> *const u8 {
    enter(|room| room.text.as_ptr())
}

/// Length of that text in bytes of UTF-8.
#[unsafe(no_mangle)]
extern "C" fn text_len() -> usize {
    enter(|room| room.text.len())
}

/// A controller before its first tick; false if it is refused, for the reason in [`text`].
#[unsafe(no_mangle)]
extern "C" fn begin() -> bool {
    enter(|room| match fresh(room) {
        Ok(pid) => {
            room.pid = Some(pid);
            true
        }
        Err(reason) => {
            (room.pid, room.text) = (None, reason);
            false
        }
    })
}

/// The output for a setpoint and a measured value; NaN if the tick is refused.
#[unsafe(no_mangle)]
extern "C" fn tick(setpoint: f64, measured: f64) -> f64 {
    enter(|room| match room.pid.as_mut().map(|pid| pid.tick(setpoint, measured)) {
        Some(Ok(output)) => output,
        refused => {
            room.text = match refused {
                Some(Err(error)) => error.to_string(),
                _ => "no controller has begun".to_owned(),
            };
            f64::NAN
        }
    })
}

/// The response of the law, as it ticks, to the measured value at ω in radians per unit of time: address of
/// its real and imaginary parts, with the sign of r − y; null if it has none.
#[unsafe(no_mangle)]
extern "C" fn response(omega: f64) -> *const f64 {
    enter(|room| {
        let law = room.settings.law::<f64>().map_err(|error| error.to_string());
        match law.map(|law| law.response(omega)) {
            Ok(Some(found)) => {
                room.answer = [found.measured.re, found.measured.im];
                room.answer.as_ptr()
            }
            refused => {
                room.text = match refused {
                    Err(reason) => reason,
                    _ => format!("no response at the frequency {omega}"),
                };
                std::ptr::null()
            }
        }
    })
}
