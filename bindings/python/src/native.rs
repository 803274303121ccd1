//! Functions of C, called without the interpreter.
#![expect(unsafe_code, reason = "the caller vouches for the functions behind the addresses")]

use pyo3::prelude::*;

/// A function of C, U(q) or one that writes numbers, as `fvi._native.Native` has checked it: its address and
/// the object that keeps it.
pub(crate) struct NativeFunction {
    address: usize,
    _owner: Py<PyAny>,
}

impl NativeFunction {
    /// The function behind a `Native`; `None` for any other object.
    pub(crate) fn of(given: &Bound<'_, PyAny>) -> PyResult<Option<Self>> {
        let Some(address) = given.getattr_opt("fvi_address")? else { return Ok(None) };
        Ok(Some(Self { address: address.extract()?, _owner: given.clone().unbind() }))
    }

    /// Calls it: U(q) if it `returns` its value, else with the arguments that there are and `out` behind
    /// them.
    pub(crate) fn call(
        &self,
        returns: bool,
        (time, position, velocity): (Option<f64>, Option<&[f64]>, Option<&[f64]>),
        out: &mut [f64],
    ) {
        type Value = unsafe extern "C" fn(*const f64) -> f64;
        type OfPosition = unsafe extern "C" fn(*const f64, *mut f64);
        type OfTime = unsafe extern "C" fn(f64, *const f64, *mut f64);
        type InMotion = unsafe extern "C" fn(f64, *const f64, *const f64, *mut f64);
        let (q, to) = (position.unwrap_or(&[]).as_ptr(), out.as_mut_ptr());
        let address = self.address as *const ();
        // SAFETY: `Native` takes only functions that declare this signature, and keeps them; that they write
        // as many numbers as they are documented to, their caller vouches for.
        unsafe {
            match (time, velocity) {
                _ if returns => {
                    let value = std::mem::transmute::<*const (), Value>(address)(q);
                    out.iter_mut().for_each(|out| *out = value);
                }
                (None, _) => std::mem::transmute::<*const (), OfPosition>(address)(q, to),
                (Some(time), None) => std::mem::transmute::<*const (), OfTime>(address)(time, q, to),
                (Some(time), Some(velocity)) => {
                    std::mem::transmute::<*const (), InMotion>(address)(time, q, velocity.as_ptr(), to);
                }
            }
        }
    }
}
