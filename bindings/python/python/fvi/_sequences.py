"""Fractional derivatives of samples, and convolution-quadrature weights."""

from __future__ import annotations

import math
import operator
import re
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from fvi import _arrays, _fvi
from fvi._types import Derivative, Engine, FloatArray, Real, Whole
from fvi._errors import InputError, suggesting
from fvi._kernel import Kernel
from fvi._keyed import exponent_or_kernel, keys_of


@suggesting
def derivative(
    x: ArrayLike,
    order: float | Kernel,
    step: Real,
    *,
    axis: Whole = -1,
    quadrature: Literal["bdf1", "bdf2", "bdf3", "bdf4", "bdf5", "bdf6"] = "bdf1",
    start: Derivative = "caputo",
    slope: ArrayLike | None = None,
    starting: ArrayLike = (),
    engine: Engine | None = None,
) -> FloatArray:
    """Fractional derivative D^order of samples at equal distances, along an axis; integral where the order is negative.

    Parameters
    ----------
    x : array_like
        Samples x(0), x(h), x(2h), … along `axis`.
    order : float or Kernel
        Order of the derivative, −1 < order < 2; or K(D) in its place.
    step : float
        h > 0.
    axis : int
        The axis of time.
    quadrature : {"bdf1", …, "bdf6"}
        The backward differentiation formula of the convolution quadrature; "bdf1" gives the Grünwald–Letnikov sum.
    start : {"caputo", "riemann-liouville"}
        The function that the derivative acts on: x(t) − x(0) (for an order above 1, x(t) − x(0) − x'(0) t), or x itself. For
        integrals there is no difference.
    slope : array_like, optional
        x'(0) for "caputo" and an order above 1, a number for each sequence. Default: the derivative at t = 0 of the polynomial
        through the first p + 1 samples, with p the order of the quadrature.
    starting : sequence of float, optional
        Exponents ν for which starting weights make t^ν exact, beginning with the sample whose index is the number of exponents.
        Without them the formula of order p has its full order only if x begins like t^p or smoother.
    engine : str, optional
        The memory engine; default: the fastest that is exact to rounding.

    Returns
    -------
    ndarray
        The derivative, in the shape of `x`.

    Raises
    ------
    InputError
        If an argument cannot be used; its `key` names it.

    Notes
    -----
    (D x)_k = Σ_{n=0}^{k} w_n x_{k−n} with the weights of `weights` [Lubich86], in O(K) operations if the number of samples K is
    above 16 384. The rounding error is that of the plain sum, a few u Σ |w_n||x_{k−n}|, whereas that of a transform is relative
    to the largest sample.

    Over the first samples the error is that of the quadrature, whatever the step: the half derivative of t begins with √h in place of
    2 √(h/π), 11 % too small, by "bdf1", and has an error of 1.3 % at the tenth sample. `starting` removes it for the given
    powers.

    Examples
    --------
    The half derivative of t is 2 √(t/π):

    >>> import numpy as np, fvi
    >>> t = np.linspace(0.0, 1.0, 1001)
    >>> y = fvi.derivative(t, order=0.5, step=1e-3, quadrature="bdf2")
    >>> bool(abs(y[-1] - 2 / np.sqrt(np.pi)) < 1e-6)
    True

    and the half integral of that is t again:

    >>> z = fvi.derivative(2 * np.sqrt(t / np.pi), order=-0.5, step=1e-3)
    >>> bool(np.abs(z - t).max() < 1e-3)
    True
    """
    samples = _arrays.numbers("x", x)
    if samples.ndim == 0:
        raise InputError("x: shape () instead of one dimension at least", "x", "()")
    keys = None
    if isinstance(order, Kernel):
        keys = keys_of("order", order)
        # The growth for large s determines which terms Caputo's form subtracts.
        order, *_ = _fvi.kernel_facts(keys)
    else:
        order = _arrays.real("order", order)
    if not -1.0 < order < 2.0:
        raise InputError(f"order = {order}: not allowed; allowed: −1 < order < 2", "order", str(order))
    step = _arrays.positive("step", step)
    match = re.fullmatch(r"bdf([1-6])", quadrature) if isinstance(quadrature, str) else None
    if match is None:
        raise InputError(f'quadrature = {quadrature!r}: not allowed; allowed: "bdf1" … "bdf6"', "quadrature", repr(quadrature))
    formula = int(match[1])
    if start not in ("caputo", "riemann-liouville"):
        raise InputError(f'start = {start!r}: not allowed; allowed: "caputo", "riemann-liouville"', "start", repr(start))
    try:
        axis = operator.index(axis)
    except TypeError:
        raise InputError(f"axis = {axis!r}: not allowed; allowed: a whole number", "axis", repr(axis)) from None
    if not -samples.ndim <= axis < samples.ndim:
        raise InputError(f"axis = {axis}: not allowed; allowed: an axis of x, which has {samples.ndim}", "axis", str(axis))
    moved = np.moveaxis(samples, axis, 0)
    columns = moved.reshape(moved.shape[0], math.prod(moved.shape[1:]))
    if start == "caputo" and (order > 0.0 or keys is not None) and len(columns) > 0:
        acted_on = columns - columns[0]
        if order > 1.0:
            acted_on -= _rise(columns, moved.shape[1:], formula, step, slope) * np.arange(len(columns))[:, None]
    else:
        acted_on = columns
    if slope is not None and not (start == "caputo" and order > 1.0):
        message = 'slope: only with start = "caputo" and an order above 1'
        raise InputError(message, "slope", repr(slope))
    exponents = _arrays.numbers("starting", starting).ravel().tolist()
    exponent = order if keys is None else None
    result = _fvi.derivative(np.ascontiguousarray(acted_on), exponent, keys, step, formula, exponents, engine)
    return np.moveaxis(result.reshape(moved.shape), 0, axis)


def _rise(columns: FloatArray, shape: tuple[int, ...], formula: int, step: float, slope: Any) -> FloatArray:
    """Initial slope times step of each column."""
    if slope is not None:
        given = _arrays.numbers("slope", slope)
        try:
            return step * np.broadcast_to(given, shape).reshape(-1)
        except ValueError:
            message = f"slope: shape {given.shape} instead of {shape}, a number for each sequence"
            raise InputError(message, "slope", str(given.shape)) from None
    first = columns[: formula + 1]
    # Coefficients of the derivative at 0 of the polynomial through 0, 1, …, p.
    powers = np.vander(np.arange(len(first)), increasing=True).T
    right = np.zeros(len(first))
    right[1:2] = 1.0
    rise: FloatArray = np.linalg.solve(powers, right) @ first
    return rise


@suggesting
def weights(
    *,
    exponent: Real | None = None,
    kernel: Any = None,
    step: Real,
    count: Whole,
    order: Whole = 1,
    family: Literal["bdf", "radau-iia", "lobatto-iiic", "trapezoidal"] = "bdf",
    stages: Whole | None = None,
) -> FloatArray:
    """Weights w₀, …, w_{count−1} of the convolution quadrature of s^exponent, or of another kernel.

    Parameters
    ----------
    exponent : float, optional
        In (−1, 2): positive for derivatives, negative for integrals.
    kernel : Kernel, optional
        In place of `exponent`, with the family "bdf".
    step : float
        h > 0.
    count : int
        Number of weights.
    order : int
        Order of the backward differentiation formula, 1 to 6.
    family : {"bdf", "trapezoidal", "radau-iia", "lobatto-iiic"}
        The method; the weights of a Runge–Kutta method are matrices.
    stages : int, optional
        Stages of the Runge–Kutta method: 1 to 3 (Radau IIA), 2 to 4 (Lobatto IIIC).

    Returns
    -------
    ndarray, shape (count,) or (count, stages, stages)
        Each weight is accurate to rounding.

    Examples
    --------
    >>> import fvi
    >>> fvi.weights(exponent=0.5, step=1.0, count=4)
    array([ 1.    , -0.5   , -0.125 , -0.0625])
    >>> fvi.weights(exponent=0.5, step=0.01, count=4, family="radau-iia", stages=2).shape
    (4, 2, 2)
    """
    exponent, keys = exponent_or_kernel(exponent, kernel)
    return _fvi.weights(
        family,
        _arrays.whole("order", order, 1),
        None if stages is None else _arrays.whole("stages", stages, 1),
        exponent,
        keys,
        _arrays.positive("step", step),
        _arrays.whole("count", count),
    )
