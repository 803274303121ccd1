"""Memories and operators, sample by sample."""

from __future__ import annotations

from typing import Any, Self

from numpy.typing import ArrayLike

from fvi import _arrays, _fvi
from fvi._types import FloatArray
from fvi._errors import InputError
from fvi._kernel import exponent_or_kernel


def _made_again(kind: Any, arguments: dict[str, Any], state: bytes) -> Any:
    made = kind(**arguments)
    made.restore(state)
    return made


class Memory(_fvi.Memory):
    """A memory: the convolution of a kernel with samples that arrive one by one.

    For the weights W₀, W₁, … of s^exponent, or of another kernel, and the samples x₀, x₁, …

        (W ∗ x)_k = W₀ x_k + r_k ,      r_k = Σ_{n=1}^{k} W_n x_{k−n} ,

    `next_term` gives r_k, which is known before x_k is, and `push` takes x_k.

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
        As in `weights`; a sample of a Runge–Kutta method is one row of stages for each channel.
    channels : int
        Sequences side by side.
    length : int
        Most samples that it takes; the engines except "direct" plan for it.
    engine : {"direct", "block-fft", "real-time", "exponential-sum", "exponential-sum-core"}, optional
        Without it, the fastest that is exact to rounding.
    samples : {"values", "differences"}
        What is pushed: the values x_k; or differences of them where the kernel has something to gain, which the attribute
        `samples` tells. Terms are then those of weights that belong to differences, and W₀ stays:

            (W ∗ x)_k = W₀ d_k + r_k ,      d_k = x_k − x_{k−1} ,    d_0 = x_0      ("increments", BDF) .

        Who knows the differences better than as such loses none of their digits.
    tolerance : float, optional
        Relative error of each weight of an exponential sum, 4e-15 to 1e-6; without it rounding.
    states : {"f64", "f32"}, optional
        In what an exponential sum keeps its state; "f32" takes a `tolerance` of 5e-7 or more.
    threads : int, optional
        Threads that share the work where there are many channels; without it as many as the machine has, up to eight.

    Attributes
    ----------
    leading : ndarray, shape () or (stages, stages)
        W₀.
    engine : str
    samples : {"values", "increments", "rises"}
        What `push` takes: values; increments; or with the stages of a Runge–Kutta method what each is beyond the end of the
        step before.
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
        exponent: float | None = None,
        kernel: Any = None,
        step: float,
        order: int = 1,
        family: str = "bdf",
        stages: int | None = None,
        channels: int = 1,
        length: int = 65536,
        engine: str | None = None,
        samples: str = "values",
        tolerance: float | None = None,
        states: str | None = None,
        threads: int | None = None,
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

        It may be asked for any number of times before a sample is pushed.

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
            If the memory is full; it is as before.
        """
        array = _arrays.numbers("sample", sample)
        shape = (self.channels,) if self.stages == 1 else (self.channels, self.stages)
        if array.shape != shape and not (array.ndim == 0 and shape == (1,)):
            raise InputError(f"sample: shape {array.shape} instead of {shape}", "sample", str(array.shape))
        super().push(array)

    def clear(self) -> None:
        """Forgets all samples."""
        super().clear()

    def save(self) -> bytes:
        """The state, for `restore` of a memory made alike: it goes on with the same bits."""
        return super().save()

    def restore(self, state: bytes) -> None:
        """Takes over a saved state.

        Raises
        ------
        InputError
            If it is not that of such a memory, which then is as before.
        """
        super().restore(state)

    def restore_channels(self, state: bytes, of: int, first: int, count: int, to: int) -> None:
        """Takes over some channels of a saved state, that of a memory which differs in the number of its channels only.

        So channels are divided among memories anew: those from `first` on, `count` of them, of the `of` that the state has, go
        to the channels from `to` on. A memory without samples begins with as many as the state has seen. Exponential sums with
        channels side by side (96 and more, or states in "f32") offer it.

        Raises
        ------
        InputError
            If it is not the state of such a memory, if the channels are not there in either, or if it has seen another number
            of samples than this memory has; the memory is as before.
        """
        counts = {"of": of, "first": first, "count": count, "to": to}
        super().restore_channels(state, **{name: _arrays.whole(name, number) for name, number in counts.items()})

    def __repr__(self) -> str:
        return f"<fvi.Memory: {self.engine}, {self.channels} channel(s), {len(self)} samples, {self.nbytes} bytes>"


class Operator(_fvi.Operator):
    """The fractional operator D^exponent on a stream: takes a sample, gives back (D x)_k.

    Parameters
    ----------
    exponent : float
        In (−1, 2): positive for derivatives, negative for integrals.
    step : float
        h > 0.
    order : int
        Order of the backward differentiation formula, 1 to 6.
    start : {"riemann-liouville", "caputo"}
        What it acts on; as in `derivative`.
    slope : float, optional
        x'(0), needed for "caputo" and an exponent above 1.
    length : int
        Most samples that it takes.
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
        exponent: float,
        step: float,
        order: int = 1,
        start: str = "riemann-liouville",
        slope: float | None = None,
        length: int = 65536,
        engine: str | None = None,
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
        """Takes x_k, gives back (D x)_k.

        Raises
        ------
        InputError
            If the sample or the result is not finite; the operator is as before.
        RuntimeError
            If it has taken `length` samples.
        """
        return super().push(sample)

    def push_many(self, samples: ArrayLike) -> FloatArray:
        """Takes several samples, gives back as many values."""
        array = _arrays.numbers("samples", samples)
        if array.ndim != 1:
            raise InputError(f"samples: shape {array.shape} instead of one dimension", "samples", str(array.shape))
        return super().push_many(array)

    def save(self) -> bytes:
        """The state, for `restore` of an operator made alike: it goes on with the same bits."""
        return super().save()

    def restore(self, state: bytes) -> None:
        """Takes over a saved state; raises `InputError` if it is not that of such an operator."""
        super().restore(state)
