"""A fractional PID controller, sample by sample."""

from __future__ import annotations

import json
from typing import Self, Unpack

from fvi import _arrays, _fvi
from fvi._errors import InputError
from fvi._types import ControllerKeys, Real, Whole


class FractionalPid(_fvi.FractionalPid):
    """A fractional PID controller: that of ``[controller]`` in scenarios and of firmware, in double precision.

        u = kp (b r − y) + ki I^lam (r − y) + kd D^mu (c r − y)_f + u_ff     within limits

    It remembers the whole past, by exponential sums that are exact to rounding. The derivative starts from rest: the first
    output has none, at any value; with derivative="riemann-liouville" the values before the first tick count as zero.

    Parameters
    ----------
    sample : float
        Sampling time h > 0.
    kp, ki, kd : float
        Gains.
    lam, mu : float
        Orders of integral and derivative, above 0 and below 2.
    length : int
        Largest number of samples.
    **keys
        Further keys of ``[controller]`` by their names: setpoint_weights, derivative, derivative_filter, limits, rate_limit,
        anti_windup; form="series" with integral_time, derivative_time, filter_ratio in place of ki and kd.

    Attributes
    ----------
    output : float
        The last output.
    integral : float
        The integral term.
    is_manual : bool

    Raises
    ------
    InputError
        If an argument cannot be used; its `key` is the name of the argument.

    Examples
    --------
    >>> import fvi
    >>> pid = fvi.FractionalPid(sample=0.01, kp=2.0, ki=1.0, lam=0.9, limits=[-1.0, 1.0])
    >>> pid.tick(0.25, 0.0) == 2.0 * 0.25 + 0.01**0.9 * 0.25
    True
    >>> pid.tick(10.0, 0.0)
    1.0
    >>> pid.manual(0.5)
    >>> pid.tick(10.0, 0.0)
    0.5
    """

    def __new__(
        cls,
        *,
        sample: Real,
        kp: Real = 0.0,
        ki: Real | None = None,
        lam: Real = 1.0,
        kd: Real | None = None,
        mu: Real = 1.0,
        length: Whole = 1_000_000,
        **keys: Unpack[ControllerKeys],
    ) -> Self:
        step = _arrays.positive("sample", sample)
        given = {"kp": kp, "ki": ki, "lambda": lam, "kd": kd, "mu": mu}
        numbers = {
            name: _arrays.real("lam" if name == "lambda" else name, number)
            for name, number in given.items()
            if number is not None
        }
        # Keys of the loop outside of the controller do not apply to this object.
        table = {**json.loads(json.dumps(keys, default=list)), **numbers}
        table |= {"sample": step, "measures": "q0", "setpoint": "0", "drives": [1.0]}
        document = {
            "system": {"mass": [1.0]},
            "time": {"step": step, "steps": _arrays.whole("length", length, 1)},
            "controller": table,
        }
        return super().__new__(cls, json.dumps(document), length)

    def tick(
        self,
        setpoint: Real,
        measured: Real,
        feed_forward: Real = 0.0,
        applied: Real | None = None,
        limited: bool = False,
    ) -> float:
        """Takes setpoint and measured value and returns the output; a sample that is refused changes nothing.

        Parameters
        ----------
        setpoint, measured : float
            r and y.
        feed_forward : float
            Added to the output inside its limits.
        applied : float, optional
            Value that the actuator applied for the previous output.
        limited : bool
            Whether something behind the controller is at a limit; the integral term can then only decrease in magnitude.

        Returns
        -------
        float
        """
        return super().tick(setpoint, measured, feed_forward, applied, limited)

    def set_gains(self, kp: Real, ki: Real, kd: Real) -> None:
        """Changes the gains, from the next tick on; the integral absorbs what this changes in the output.

        Parameters
        ----------
        kp, ki, kd : float
            Gains as in Rust and C, the factors of 1, I^lam and D^mu: in the series form kp, 1/T_i (0 for no integral) and T_d.

        Raises
        ------
        InputError
            If a gain is out of range.
        """
        super().set_gains(kp, ki, kd)

    def response(self, omega: float) -> tuple[complex, complex]:  # type: ignore[override]
        """Frequency response of the discrete law without limits at ω, 0 < ω ≤ π/sample: C_r and C_y of u = C_r r − C_y y."""
        parts = super().response(_arrays.positive("omega", omega))
        if parts is None:
            raise InputError(f"omega = {omega}: not allowed; allowed: at most pi / sample", "omega", str(omega))
        return complex(parts[0], parts[1]), complex(parts[2], parts[3])
