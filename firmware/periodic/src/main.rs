//! A motor under a fractional PID controller that ticks in a periodic task of RTIC, while a slower task of a
//! lower priority changes the setpoint.
//!
//! The motor, T ÿ + ẏ = u with a drive that gives at most 2, is simulated in place of an encoder and a
//! bridge. `build.rs` makes the controller's constants; the struct below names its type.
#![no_std]
#![no_main]

use core::fmt::Write as _;
use core::panic::PanicInfo;

use cortex_m_semihosting::{debug, hio};
use rtic_monotonics::systick::prelude::*;

/// What `build.rs` has made: tables in flash, `AxisPid`, `new_axis`.
#[expect(unreachable_pub, reason = "the source is for a module of any visibility")]
mod constants {
    include!(concat!(env!("OUT_DIR"), "/axis.rs"));
}

systick_monotonic!(Mono, 1000);

/// Ticks of a second.
const SECOND: u32 = 1000;

/// An axis: its controller, and the motor.
struct Axis {
    pid: constants::AxisPid,
    position: f32,
    speed: f32,
}

impl Axis {
    fn new() -> Result<Self, fvi_core::ParameterError> {
        Ok(Self { pid: constants::new_axis()?, position: 0.0, speed: 0.0 })
    }

    /// Reads the position, ticks the controller and sets the drive.
    fn tick(&mut self, setpoint: f32) -> Result<(), fvi_core::PidError> {
        let output = self.pid.tick(setpoint, self.position)?;
        let (step, lag) = (1e-3, 0.1);
        self.speed += step / lag * (output - self.speed);
        self.position += step * self.speed;
        Ok(())
    }
}

#[rtic::app(device = lm3s6965, dispatchers = [UART0, UART1])]
mod app {
    use super::*;

    #[shared]
    struct Shared {
        setpoint: f32,
    }

    #[local]
    struct Local {
        axis: Axis,
    }

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        // The clock of the emulated part.
        Mono::start(cx.core.SYST, 25_000_000);
        let Ok(axis) = Axis::new() else { end(debug::EXIT_FAILURE) };
        if control::spawn().is_err() || operator::spawn().is_err() {
            end(debug::EXIT_FAILURE);
        }
        (Shared { setpoint: 3.0 }, Local { axis })
    }

    /// Every millisecond, whatever the operator does.
    #[task(shared = [setpoint], local = [axis], priority = 2)]
    async fn control(mut cx: control::Context) {
        let axis = cx.local.axis;
        let mut next = Mono::now();
        for tick in 0..=6 * SECOND {
            let setpoint = cx.shared.setpoint.lock(|setpoint| *setpoint);
            // A tick that is refused has changed nothing: the drive keeps its output.
            let refused = axis.tick(setpoint).is_err();
            if tick % SECOND == 0 || refused {
                report(tick, axis, refused);
            }
            next += 1.millis();
            Mono::delay_until(next).await;
        }
        end(debug::EXIT_SUCCESS)
    }

    /// Back to 1 after three and a half seconds.
    #[task(shared = [setpoint], priority = 1)]
    async fn operator(mut cx: operator::Context) {
        Mono::delay(3500.millis()).await;
        cx.shared.setpoint.lock(|setpoint| *setpoint = 1.0);
    }
}

fn report(tick: u32, axis: &Axis, refused: bool) {
    let Ok(mut out) = hio::hstdout() else { return };
    let said = if refused { ", refused" } else { "" };
    // Nothing is left to do if the debugger does not listen.
    let _ = writeln!(out, "{tick} ms: output {:.3}, position {:.3}{said}", axis.pid.output(), axis.position);
}

/// Ends the emulation.
fn end(status: debug::ExitStatus) -> ! {
    loop {
        debug::exit(status);
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    if let Ok(mut out) = hio::hstdout() {
        let _ = writeln!(out, "{info}");
    }
    end(debug::EXIT_FAILURE)
}
