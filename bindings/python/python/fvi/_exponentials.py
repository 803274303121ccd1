"""Kernels as decaying exponentials, and as systems of first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fvi import _arrays, _fvi
from fvi._errors import InputError, suggesting
from fvi._keyed import exponent_or_kernel
from fvi._types import FloatArray, Real, Whole


class StateSpace(NamedTuple):
    """x_{k+1} = A x_k + B u_k, y_k = C x_k + D u_k, with one input and one output, at equal steps."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray


@dataclass(frozen=True, eq=False)
class Exponentials:
    """Weights of convolution quadrature as a head and decaying exponentials: w_n = head[n] for n < len(head), and beyond

        w_n = Σ_j coefficients[j] e^(−rates[j] n) .

    Attributes
    ----------
    head : array
        The first weights, unit time^(−β).
    rates, coefficients : array
        Rates per step, ascending, and coefficients in the unit of a weight.
    step : float
        h.
    """

    head: FloatArray
    rates: FloatArray
    coefficients: FloatArray
    step: float

    def weights(self, count: int) -> FloatArray:
        """The first `count` weights."""
        n = np.arange(len(self.head), max(_arrays.whole("count", count), len(self.head)))
        tail = np.exp(-np.outer(n, self.rates)) @ self.coefficients
        return np.concatenate([self.head, tail])[:count]

    def state_space(self) -> StateSpace:
        """The system of first order with these weights as the response to a unit sample: the samples of the head on a delay line,
        and one state for each exponential.

        Returns
        -------
        StateSpace
        """
        # Without a head the first weight is the sum of the coefficients.
        head = self.head if len(self.head) else self.weights(1)
        delays, count = len(head) - 1, len(self.rates)
        A, B = np.zeros((delays + count, delays + count)), np.zeros((delays + count, 1))
        A[range(1, delays), range(delays - 1)] = 1.0
        A[range(delays, delays + count), range(delays, delays + count)] = np.exp(-self.rates)
        # What leaves the head enters the exponentials.
        entering = self.coefficients * np.exp(-self.rates * len(head))
        if delays:
            B[0, 0] = 1.0
            A[delays:, delays - 1] = entering
        else:
            B[:, 0] = entering
        C = np.concatenate([head[1:], np.ones(count)])[np.newaxis]
        return StateSpace(A, B, C, np.array([[head[0]]]))

    def __repr__(self) -> str:
        return f"Exponentials(head of {len(self.head)}, {len(self.rates)} exponentials, step={self.step})"


@suggesting
def exponentials(
    *,
    exponent: Real | None = None,
    kernel: Any = None,
    step: Real,
    order: Whole = 1,
    increments: bool = False,
    horizon: Whole | None = None,
    band: Sequence[float] | None = None,
    tolerance: Real = 1e-12,
) -> Exponentials:
    """The weights of `weights` as a head and decaying exponentials, for a memory of constant cost and size.

    Parameters
    ----------
    exponent : float, optional
        In (−1, 2): positive for derivatives, negative for integrals.
    kernel : Kernel, optional
        In place of `exponent`: a kernel whose singularities lie on the negative real axis.
    step : float
        h > 0.
    order : int
        Order of the backward differentiation formula, 1 to 6.
    increments : bool
        Whether the weights are those for differences x_k − x_{k−1}, which lose less to rounding; for kernels that grow.
    horizon : int, optional
        Largest lag at which they hold; default: no end.
    band : pair of float, optional
        As few exponentials as the frequencies between these need, in cycles per unit of time: there the response is within the
        tolerance.
    tolerance : float
        Relative error of every weight, 4e-15 to 0.1; with a band that of the response, 1e-7 to 0.1.

    Returns
    -------
    Exponentials

    Raises
    ------
    InputError
        If an argument cannot be used, or there is no such table.

    Examples
    --------
    >>> import numpy as np, fvi
    >>> table = fvi.exponentials(exponent=0.5, step=0.01)
    >>> bool(np.allclose(table.weights(1000), fvi.weights(exponent=0.5, step=0.01, count=1000), rtol=1e-11))
    True
    >>> fvi.Kernel.maxwell(order=0.6, time=1.0).state_space(step=0.01).A.shape[0] < 200
    True
    """
    exponent, keys = exponent_or_kernel(exponent, kernel)
    if band is not None and horizon is not None:
        raise InputError("horizon: a table for a band has no end", "horizon", repr(horizon))
    limits = None if band is None else _arrays.vector("band", band, 2).tolist()
    step = _arrays.positive("step", step)
    numbers = _fvi.exponentials(
        _arrays.whole("order", order, 1),
        exponent,
        keys,
        step,
        bool(increments),
        None if horizon is None else _arrays.whole("horizon", horizon, 1),
        limits,
        _arrays.positive("tolerance", tolerance),
    )
    return Exponentials(numbers[0], numbers[1], numbers[2], step)
