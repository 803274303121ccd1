"""Memories and operators, sample by sample."""

from __future__ import annotations

from typing import Any, Literal, Self

from numpy.typing import ArrayLike

from fvi import _arrays, _fvi
from fvi._types import Derivative, Engine, FloatArray, Precision, Real, Whole
from fvi._errors import InputError, suggesting_class
from fvi._keyed import exponent_or_kernel


def _made_again(kind: Any, arguments: dict[str, Any], state: bytes) -> Any:
    made = kind(**arguments)
    made.restore(state)
    return made


@suggesting_class
class Memory(_fvi.Memory):
    """A memory: the convolution of a kernel with samples that arrive one by one.

    For the weights W₀, W₁, … of s^exponent, or of another kernel, and the samples x₀, x₁, …

        (W ∗ x)_k = W₀ x_k + r_k ,      r_k = Σ_{n=1}^{k} W_n x_{k−n} ,

    `next_term` returns r_k, which does not depend on x_k, and `push` takes x_k.

    Parameters
    ----------
    exponent : float, optional
        In (−1, 2).
    kernel : Kernel, optional
        In place of `exponent`.
    step : float
        h > 0.
    order : int
        Order of the backward differentiation formula.
    family, stages
        As in `weights`; a sample of a Runge–Kutta method consists of one row of stages for each channel.
    channels : int
        Number of sequences.
    length : int
        Largest number of samples; all engines except "direct" plan for it.
    engine : {"direct", "block-fft", "real-time", "exponential-sum", "exponential-sum-core"}, optional
        Default: the fastest that is exact to rounding.
    samples : {"values", "differences"}
        What `push` takes: the values x_k, or, where the kernel benefits from it, their differences; the attribute `samples` shows
        which. Terms are then sums over differences, with the same W₀:

            (W ∗ x)_k = W₀ d_k + r_k ,      d_k = x_k − x_{k−1} ,    d_0 = x_0      ("increments", BDF) .

        If the differences are known more accurately than by subtraction, no digits are lost.
    tolerance : float, optional
        Relative error of each weight of an exponential sum, 4e-15 to 1e-6; default: rounding.
    states : {"f64", "f32"}, optional
        Precision of the state of an exponential sum; "f32" requires a `tolerance` of 5e-7 or more.
    threads : int, optional
        Threads that share the work for many channels; default: as many as the machine has, up to eight.

    Attributes
    ----------
    leading : ndarray, shape () or (stages, stages)
        W₀.
    engine : str
    samples : {"values", "increments", "rises"}
        What `push` takes: values; increments; or, with a Runge–Kutta method, the differences of the stages from the value at the
        end of the previous step.
    channels, stages, nbytes : int

    Examples
    --------
    >>> import fvi
    >>> m = fvi.Memory(exponent=0.5, step=1.0, channels=2)
    >>> m.push([1.0, 2.0])
    >>> m.next_term()
    array([-0.5, -1. ])
    >>> len(m), float(m.leading)
    (1, 1.0)
    """

    def __new__(
        cls,
        *,
        exponent: Real | None = None,
        kernel: Any = None,
        step: Real,
        order: Whole = 1,
        family: Literal["bdf", "radau-iia", "lobatto-iiic", "trapezoidal"] = "bdf",
        stages: Whole | None = None,
        channels: Whole = 1,
        length: Whole = 65536,
        engine: Engine | None = None,
        samples: Literal["values", "differences"] = "values",
        tolerance: Real | None = None,
        states: Precision | None = None,
        threads: Whole | None = None,
    ) -> Self:
        exponent, kernel = exponent_or_kernel(exponent, kernel)
        arguments: dict[str, Any] = {
            "exponent": exponent,
            "kernel": kernel,
            "step": _arrays.positive("step", step),
            "family": family,
            "order": _arrays.whole("order", order, 1),
            "stages": None if stages is None else _arrays.whole("stages", stages, 1),
            "channels": _arrays.whole("channels", channels, 1),
            "length": _arrays.whole("length", length, 1),
            "engine": engine,
            "samples": samples,
            "tolerance": None if tolerance is None else _arrays.real("tolerance", tolerance),
            "states": states,
            "threads": None if threads is None else _arrays.whole("threads", threads, 1),
        }
        made = super().__new__(cls, **arguments)
        made._arguments = arguments
        return made

    _arguments: dict[str, Any]

    def __reduce__(self) -> tuple[Any, ...]:
        return _made_again, (type(self), self._arguments, self.save())

    def next_term(self) -> FloatArray:
        """r_k, one number for each channel, or a row of stages for each channel.

        It may be called any number of times before a sample is pushed.

        Raises
        ------
        RuntimeError
            If the memory is full.
        """
        return super().next_term()

    def push(self, sample: ArrayLike) -> None:
        """Takes the sample x_k, in the shape of `next_term`.

        Raises
        ------
        InputError
            If it has another shape or is not finite.
        RuntimeError
            If the memory is full, which is then unchanged.
        """
        array = _arrays.numbers("sample", sample)
        shape = (self.channels,) if self.stages == 1 else (self.channels, self.stages)
        if array.shape != shape and not (array.ndim == 0 and shape == (1,)):
            raise InputError(f"sample: shape {array.shape} instead of {shape}", "sample", str(array.shape))
        super().push(array)

    def clear(self) -> None:
        """Removes all samples."""
        super().clear()

    def save(self) -> bytes:
        """The state, for `restore` of a memory with the same arguments, which continues bit-identically."""
        return super().save()

    def restore(self, state: bytes) -> None:
        """Takes over a saved state.

        Raises
        ------
        InputError
            If it is not the state of such a memory, which is then unchanged.
        """
        super().restore(state)

    def restore_channels(self, state: bytes, of: int, first: int, count: int, to: int) -> None:
        """Takes over some channels of the saved state of a memory that differs in the number of channels only.

        This redistributes channels among memories: `count` channels from `first` on, of the `of` channels in the state, are
        written to the channels from `to` on. A memory without samples takes the number of samples of the state. Available for
        exponential sums that store channels side by side (96 channels and more, or states in "f32").

        Raises
        ------
        InputError
            If it is not the state of such a memory, if either does not have these channels, or if its number of samples differs
            from that of this memory, which is then unchanged.
        """
        counts = {"of": of, "first": first, "count": count, "to": to}
        super().restore_channels(state, **{name: _arrays.whole(name, number) for name, number in counts.items()})

    def __repr__(self) -> str:
        return f"<fvi.Memory: {self.engine}, {self.channels} channel(s), {len(self)} samples, {self.nbytes} bytes>"


@suggesting_class
class Operator(_fvi.Operator):
    """The fractional operator D^exponent on a stream: takes a sample x_k and returns (D x)_k.

    Parameters
    ----------
    exponent : float
        In (−1, 2): positive for derivatives, negative for integrals.
    step : float
        h > 0.
    order : int
        Order of the backward differentiation formula, 1 to 6.
    start : {"riemann-liouville", "caputo"}
        The function that the derivative acts on, as in `derivative`.
    slope : float, optional
        x'(0), needed for "caputo" and an exponent above 1.
    length : int
        Largest number of samples.
    engine : str, optional
        As in `Memory`.

    Examples
    --------
    >>> import fvi
    >>> half = fvi.Operator(exponent=-0.5, step=0.01)
    >>> y = [half.push(1.0) for _ in range(101)]
    >>> abs(y[-1] - 1.1284) < 5e-3  # 2/√π
    True
    """

    def __new__(
        cls,
        *,
        exponent: Real,
        step: Real,
        order: Whole = 1,
        start: Derivative = "riemann-liouville",
        slope: Real | None = None,
        length: Whole = 65536,
        engine: Engine | None = None,
    ) -> Self:
        exponent, step = _arrays.real("exponent", exponent), _arrays.positive("step", step)
        if start not in ("caputo", "riemann-liouville"):
            message = f'start = {start!r}: not allowed; allowed: "caputo", "riemann-liouville"'
            raise InputError(message, "start", repr(start))
        rising = start == "caputo" and exponent > 1.0
        if rising != (slope is not None):
            message = "slope: needed" if rising else 'slope: only'
            raise InputError(f'{message} with start = "caputo" and an exponent above 1', "slope", repr(slope))
        if exponent <= 0.0:
            start = "riemann-liouville"
        if slope is not None:
            slope = _arrays.real("slope", slope)
        arguments: dict[str, Any] = {
            "exponent": exponent,
            "step": step,
            "order": _arrays.whole("order", order, 1),
            "start": start,
            "length": _arrays.whole("length", length, 1),
            "engine": engine,
        }
        made = super().__new__(cls, rise=None if slope is None else slope * step, **arguments)
        made._arguments = arguments | {"slope": slope}
        return made

    _arguments: dict[str, Any]

    def __reduce__(self) -> tuple[Any, ...]:
        return _made_again, (type(self), self._arguments, self.save())

    def push(self, sample: float) -> float:
        """Takes x_k and returns (D x)_k.

        Raises
        ------
        InputError
            If the sample or the result is not finite; the operator is then unchanged.
        RuntimeError
            If it has taken `length` samples.
        """
        return super().push(sample)

    def push_many(self, samples: ArrayLike) -> FloatArray:
        """Takes several samples and returns as many values."""
        array = _arrays.numbers("samples", samples)
        if array.ndim != 1:
            raise InputError(f"samples: shape {array.shape} instead of one dimension", "samples", str(array.shape))
        return super().push_many(array)

    def save(self) -> bytes:
        """The state, for `restore` of an operator with the same arguments, which continues bit-identically."""
        return super().save()

    def restore(self, state: bytes) -> None:
        """Takes over a saved state; raises `InputError` if it is not the state of such an operator."""
        super().restore(state)
