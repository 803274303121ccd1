"""Frequency response of a damped structure."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fvi import _arrays, _fvi
from fvi._scenario import Scenario, by_path, source
from fvi._types import FloatArray

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class KernelCurves:
    """Moduli, creep and relaxation of a kernel.

    Attributes
    ----------
    name : str
        Description of the kernel.
    moduli : ndarray, shape (W,)
        K(iω), complex: the storage modulus is its real part, the loss modulus its imaginary part.
    t : ndarray, shape (W,)
        The times 1/ω, ascending.
    creep, relaxation : ndarray or None
        J(t) = L⁻¹[1/(s K(s))] and G(t) = L⁻¹[K(s)/s] at these times; None for kernels that are not passive.
    """

    name: str
    moduli: ComplexArray
    t: FloatArray
    creep: FloatArray | None
    relaxation: FloatArray | None


@dataclass(frozen=True)
class Response:
    """Frequency response and poles of a scenario.

    Attributes
    ----------
    omega : ndarray, shape (W,)
        Angular frequencies.
    response : ndarray, shape (W,)
        H(ω), complex: the displacement of the output under a force e^{iωt} on the input.
    discrete : ndarray or None
        H(ω) of the discrete scheme with its step h, for the frequencies up to π/h; None where it is left out.
    poles : ndarray or None
        Poles s with Im s ≥ 0, in ascending order of |s|; None where they are not computed.
    kernels : tuple of KernelCurves
        Curves of the kernel of each damping term.
    left_out : tuple of str
        Results that were left out, with the reasons.
    """

    omega: FloatArray
    response: ComplexArray
    discrete: ComplexArray | None
    poles: ComplexArray | None
    kernels: tuple[KernelCurves, ...]
    left_out: tuple[str, ...]

    @property
    def frequency(self) -> FloatArray:
        """The angular frequencies |s| of the poles."""
        return np.zeros(0) if self.poles is None else np.abs(self.poles)

    @property
    def damping(self) -> FloatArray:
        """The damping ratios −Re s/|s| of the poles."""
        return np.zeros(0) if self.poles is None else -self.poles.real / np.abs(self.poles)


def response(
    scenario: Scenario,
    omega: Sequence[float] | FloatArray | None = None,
    *,
    from_omega: float | None = None,
    to_omega: float | None = None,
    points: int = 400,
    input: int = 0,
    output: int = 0,
    about: Sequence[float] | FloatArray | None = None,
    overrides: Mapping[str, Any] | None = None,
    **keys: Any,
) -> Response:
    """The frequency response H(ω) = (−ω²M + K + Σ ρ K(iω))⁻¹ of a scenario, as the program `fvi response` computes it.

    Parameters
    ----------
    scenario : path or dict
        As in `run`.
    omega : array, optional
        Angular frequencies, ascending.
    from_omega, to_omega, points
        In place of `omega`: the first and the last angular frequency, and their number, equidistant on a logarithmic scale;
        defaults: 2π over the time of the run, and π over its step.
    input, output : int
        The coordinate on which the force acts, and the one whose displacement is computed.
    about : array, optional
        The point about which the system is linearised; default: the initial position.
    overrides, **keys
        As in `run`.

    Returns
    -------
    Response

    Examples
    --------
    >>> import fvi
    >>> oscillator = {"system": {"mass": [1.0], "potential": "2*q0^2", "damping": [{"order": 0.5, "coefficient": [0.1]}]},
    ...               "time": {"step": 0.1, "steps": 100}}
    >>> found = fvi.response(oscillator, [1.0])
    >>> bool(abs(found.response[0] - 1 / (4 - 1 + 0.1 * 1j**0.5)) < 1e-14)
    True
    >>> len(found.poles)
    1
    """
    given = source(scenario, by_path(overrides, keys))

    def numbers(name: str, values: Any) -> list[float] | None:
        if values is None:
            return None
        return [_arrays.real(name, value) for value in np.atleast_1d(np.asarray(values)).tolist()]

    record = _fvi.response(
        given,
        omega=numbers("omega", omega),
        from_omega=None if from_omega is None else _arrays.real("from_omega", from_omega),
        to_omega=None if to_omega is None else _arrays.real("to_omega", to_omega),
        points=_arrays.whole("points", points, 1),
        input=_arrays.whole("input", input),
        output=_arrays.whole("output", output),
        position=numbers("about", about),
    )

    def complex_numbers(pairs: list[tuple[float, float]] | None) -> ComplexArray | None:
        if pairs is None:
            return None
        return np.array(pairs, dtype=np.float64).reshape(-1, 2).view(np.complex128)[:, 0]

    def array(values: list[float] | None) -> FloatArray | None:
        return None if values is None else np.array(values)

    for warning in record["warnings"]:
        warnings.warn(warning, stacklevel=2)
    found = complex_numbers(record["response"])
    assert found is not None
    kernels = []
    for entry in record["kernels"]:
        moduli = complex_numbers(entry["moduli"])
        assert moduli is not None
        curves = array(entry["creep"]), array(entry["relaxation"])
        kernels.append(KernelCurves(entry["name"], moduli, np.array(entry["t"]), *curves))
    return Response(
        np.array(record["omega"]),
        found,
        complex_numbers(record["discrete"]),
        complex_numbers(record["poles"]),
        tuple(kernels),
        tuple(record["left_out"]),
    )
