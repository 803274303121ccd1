"""Finite responses on streams without end."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fvi import _arrays, _fvi
from fvi._errors import InputError, suggesting_class


def _made_again(kind: Any, arguments: dict[str, Any], coming: Any, state: bytes) -> Any:
    made = kind(**arguments)
    if coming is not None:
        made.exchange(coming)
    made.restore(state)
    return made


def _typed(name: str, given: ArrayLike, single: bool) -> NDArray[Any]:
    return _arrays.numbers(name, given).astype(np.float32 if single else np.float64)


@suggesting_class
class Convolver(_fvi.Convolver):
    """The convolution of a stream without end with finite responses, block by block, exact to rounding.

        y(k) = Σ_{n=0}^{L−1} w(n) x(k − latency − n) ,      x(j) = 0 for j < 0 .

    Parameters
    ----------
    response : array_like
        Of the shape (L,), one response; (channels, L), one for each channel; or (inputs, outputs, L), whose outputs are the sums over
        the inputs. An array of float32 is convolved in single precision, everything else in double precision.
    latency : int
        Samples by which outputs come later than their inputs; with the length of a block the work is a little less than with 0.
    channels : int, optional
        Number of channels that share one response.
    block : int, optional
        Samples of a call, if most have as many: the work is planned for them. Other calls remain possible.
    longest : int, optional
        Samples of the longest response for `exchange`, if it is longer than `response`.

    Attributes
    ----------
    inputs, outputs, latency, longest : int
    taken : int
        Samples taken since the beginning.
    exchange_left : int
        Samples until an exchange under way has ended, or 0.
    stages : list of tuple of int
        Samples of a block in each stage of transforms, with the largest number of pairs of blocks for an output.
    dtype : numpy.dtype
    nbytes : int

    Examples
    --------
    >>> import fvi
    >>> c = fvi.Convolver([0.5, 0.25])
    >>> c.process([1.0, 0.0, 2.0])
    array([0.5 , 0.25, 1.  ])
    >>> c.exchange([1.0], fade=2)
    >>> c.process([0.0, 4.0, 4.0])
    array([0.5, 3. , 4. ])
    """

    def __new__(
        cls,
        response: ArrayLike,
        latency: int = 0,
        *,
        channels: int | None = None,
        block: int | None = None,
        longest: int = 0,
    ) -> Self:
        single = np.asarray(response).dtype == np.float32
        array = _typed("response", response, single)
        if not 1 <= array.ndim <= 3 or 0 in array.shape:
            message = f"response: shape {array.shape}; (L,), (channels, L) or (inputs, outputs, L) is needed"
            raise InputError(message, "response", str(array.shape))
        if channels is not None and array.ndim > 1:
            raise InputError("channels: only with one response, of the shape (L,)", "channels", repr(channels))
        made = super().__new__(
            cls,
            single=bool(single),
            latency=_arrays.whole("latency", latency),
            block=None if block is None else _arrays.whole("block", block, 1),
            longest=_arrays.whole("longest", longest),
            **cls._arranged(array, 1 if channels is None else _arrays.whole("channels", channels, 1)),
        )
        made._arguments = {"latency": latency, "channels": channels, "block": block, "longest": made.longest}
        made._single, made._flat = bool(single), array.ndim == 1 and channels is None
        made._dimensions = array.ndim
        made._response, made._coming = array, None
        return made

    _arguments: dict[str, Any]
    _single: bool
    _flat: bool
    _dimensions: int
    _response: NDArray[Any]
    _coming: NDArray[Any] | None

    @staticmethod
    def _arranged(array: NDArray[Any], channels: int) -> dict[str, Any]:
        """The rows of the responses, and how they are arranged."""
        rows = np.ascontiguousarray(array.reshape(-1, array.shape[-1]))
        arrangement = {1: "shared", 2: "each", 3: "matrix"}[array.ndim]
        return {"rows": rows, "arrangement": arrangement, "outputs": channels if array.ndim == 1 else array.shape[-2]}

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(np.float32 if self._single else np.float64)

    def process(self, block: ArrayLike) -> NDArray[Any]:
        """Takes the next samples of every input and returns as many of every output.

        Parameters
        ----------
        block : array_like
            Of the shape (samples,) for one response without `channels`, otherwise (inputs, samples).

        Raises
        ------
        InputError
            If it has another shape or is not finite; nothing has been taken then.
        """
        array = _typed("block", block, self._single)
        if array.ndim != (1 if self._flat else 2) or (not self._flat and array.shape[0] != self.inputs):
            wanted = "(samples,)" if self._flat else f"({self.inputs}, samples)"
            raise InputError(f"block: shape {array.shape} instead of {wanted}", "block", str(array.shape))
        output: NDArray[Any] = super().process(np.ascontiguousarray(array.reshape(self.inputs, -1)))
        return output[0] if self._flat else output

    def exchange(self, new_response: ArrayLike, fade: int = 256) -> None:  # type: ignore[override]
        """Exchanges the responses while the stream goes on, from the next sample on: with i = 0, 1, …

            y = (1 − g) y_old + g y_new ,      g = min(1, i/fade) ,

        of the convolutions of the whole stream with the responses before and after.

        Parameters
        ----------
        new_response : array_like
            With as many dimensions, inputs and outputs as `response`, of `longest` samples or fewer.
        fade : int
            Samples of the crossfade; 0 changes at once.

        Raises
        ------
        InputError
            If the new response does not fit.
        RuntimeError
            If the last exchange has not ended.
        """
        array = _typed("new_response", new_response, self._single)
        if array.ndim != self._dimensions or 0 in array.shape or array.shape[:-1] != self._response.shape[:-1]:
            wanted = f"({''.join(f'{size}, ' for size in self._response.shape[:-1])}up to {self.longest})"
            raise InputError(f"new_response: shape {array.shape} instead of {wanted}", "new_response", str(array.shape))
        fade = _arrays.whole("fade", fade)
        if fade > 2**53:
            raise InputError(f"fade = {fade}: not allowed; allowed: up to 2⁵³", "fade", str(fade))
        self._settle()
        arranged = self._arranged(array, self.outputs)
        super().exchange(arranged["rows"], arranged["arrangement"], arranged["outputs"], fade)
        self._coming = array

    def _settle(self) -> None:
        if self._coming is not None and self.exchange_left == 0:
            self._response, self._coming = self._coming, None

    def clear(self) -> None:
        """Forgets all samples; an exchange under way ends."""
        super().clear()
        self._settle()

    def save(self) -> bytes:
        """The state, for `restore` of a convolver with the same arguments and exchanges, which continues bit-identically."""
        return super().save()

    def restore(self, state: bytes) -> None:
        """Takes over a saved state.

        Raises
        ------
        InputError
            If it is not the state of such a convolver, which is then unchanged.
        """
        super().restore(state)

    def __reduce__(self) -> tuple[Any, ...]:
        self._settle()
        return _made_again, (type(self), {"response": self._response, **self._arguments}, self._coming, self.save())

    def __repr__(self) -> str:
        inputs, outputs = self.inputs, self.outputs
        return f"<fvi.Convolver: {inputs} input(s), {outputs} output(s), {self.dtype}, {self.taken} samples, {self.nbytes} bytes>"
