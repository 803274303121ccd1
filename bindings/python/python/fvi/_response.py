"""Frequency response of a damped structure."""

from __future__ import annotations

import html
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Unpack

import numpy as np
from numpy.typing import NDArray

from fvi import _arrays, _fvi
from fvi._datasets import _module, appearance_of, dataset
from fvi._errors import InputError
from fvi._result import Picture, html_table, labelled, new_axes
from fvi._scenario import Scenario, by_path
from fvi._system import System, scenario_of, source_of
from fvi._types import FloatArray, Real, ResponseKeys, Whole

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

    def plot(self, axes: Any = None, *, unit: str = "", time_unit: str = "") -> Picture:
        """Draws moduli, loss factor, and creep and relaxation.

        Parameters
        ----------
        axes : sequence of three matplotlib axes, optional
            Axes to draw in; default: a new figure.
        unit, time_unit : str
            Units of the modulus and of the time, for the labels.

        Returns
        -------
        sequence of three matplotlib axes
            With their `figure`, and its `savefig`. The third is empty for kernels that are not passive.
        """
        axes = new_axes(axes, 1, 3, (11.0, 3.4))
        omega = 1.0 / self.t[::-1]
        moduli, loss, course = axes
        moduli.loglog(omega, self.moduli.real, label="storage")
        moduli.loglog(omega, self.moduli.imag, label="loss")
        moduli.set_ylabel(labelled("modulus", unit))
        loss.semilogx(omega, self.moduli.imag / self.moduli.real)
        loss.set_ylabel("loss factor")
        for other in (moduli, loss):
            other.set_xlabel(labelled("ω", f"1/{time_unit}" if time_unit else ""))
        for values, name, of in ((self.creep, "creep", f"1/{unit}" if unit else ""), (self.relaxation, "relaxation", unit)):
            if values is not None:
                course.loglog(self.t, values, label=labelled(name, of))
        course.set_xlabel(labelled("t", time_unit))
        for other in (moduli, course):
            if other.get_legend_handles_labels()[0]:
                other.legend(fontsize="small")
        loss.set_title(self.name)
        return Picture(axes)


@dataclass(frozen=True, eq=False)
class Mode:
    """A damped motion x e^{st} without a force, (s²M + K + Σ ρ K(s)) x = 0.

    Attributes
    ----------
    s : complex
        With Im s > 0.
    shape : ndarray, shape (N,)
        x, complex, of all coordinates; the largest is 1.
    near : float
        The angular frequency near which it was sought.
    residual : float
        |(s²M + K + Σ ρ K(s)) x| over the sum of the lengths of its terms.
    of_tables : float or None
        Where kernels are tables up to a time T: what tables up to T/2 change of s, relative to |s|.
    """

    s: complex
    shape: ComplexArray
    near: float
    residual: float
    of_tables: float | None

    @property
    def frequency(self) -> float:
        """|s|, the angular frequency of the corresponding undamped motion."""
        return abs(self.s)

    @property
    def damping(self) -> float:
        """The damping ratio −Re s/|s|."""
        return -self.s.real / abs(self.s)


@dataclass(frozen=True)
class Response:
    """Frequency response and poles of a scenario.

    Attributes
    ----------
    omega : ndarray, shape (W,)
        Angular frequencies.
    response : ndarray, shape (W,)
        H(ω), complex: the displacement of the output under a force e^{iωt} on the input.
    omega_between : ndarray
        Further frequencies between those of `omega`, ascending, where the response is sharp, so that pictures show resonances
        that lie between two of `omega`; empty where `omega` was given.
    between : ndarray
        H(ω) at `omega_between`.
    discrete : ndarray or None
        H(ω) of the discrete scheme with its step h, for the frequencies up to π/h; None where it is left out.
    poles : ndarray or None
        Poles s with Im s ≥ 0, in ascending order of |s|; None where they are not computed.
    kernels : tuple of KernelCurves
        Curves of the kernel of each damping term.
    left_out : tuple of str
        Results that were left out, with the reasons.
    modes : tuple of Mode
        The damped modes near the frequencies `near`.
    """

    omega: FloatArray
    response: ComplexArray
    omega_between: FloatArray
    between: ComplexArray
    discrete: ComplexArray | None
    poles: ComplexArray | None
    kernels: tuple[KernelCurves, ...]
    left_out: tuple[str, ...]
    modes: tuple[Mode, ...] = ()
    _units: dict[str, str] = field(default_factory=dict, repr=False, compare=False)

    def to_pandas(self) -> Any:
        """The response over the frequencies `omega` as a pandas DataFrame: `response` and `discrete`, complex, which is NaN where it is
        left out."""
        pandas = _module("pandas", "to_pandas()")
        columns = {"response": self.response, "discrete": self._discrete()}
        return pandas.DataFrame(columns, index=pandas.Index(self.omega, name="omega"))

    def to_xarray(self) -> Any:
        """Everything as an xarray Dataset, with names, and the unit of time where the scenario names it: `response` and `discrete` over
        ``omega``, `between` over ``omega_between``, `moduli`, `creep` and `relaxation` of each ``kernel``, poles, and modes with their
        shapes."""
        variables: dict[str, tuple[Any, Any]] = {
            "response": ("omega", self.response),
            "discrete": ("omega", self._discrete()),
            "between": ("omega_between", self.between),
        }
        places: dict[str, tuple[Any, Any]] = {"omega": ("omega", self.omega), "omega_between": ("omega_between", self.omega_between)}
        if self.poles is not None:
            places["pole"] = ("pole", self.poles)
        if self.kernels:
            places.update(t=("t", self.kernels[0].t), kernel=("kernel", [kernel.name for kernel in self.kernels]))
            variables["moduli"] = (("kernel", "omega"), np.array([kernel.moduli for kernel in self.kernels]))
            for name in ("creep", "relaxation"):
                curves = [getattr(kernel, name) for kernel in self.kernels]
                missing = np.full_like(self.kernels[0].t, np.nan)
                variables[name] = (("kernel", "t"), np.array([missing if curve is None else curve for curve in curves]))
        if self.modes:
            places["mode"] = ("mode", np.array([mode.s for mode in self.modes]))
            variables["shape"] = (("mode", "coordinate"), np.array([mode.shape for mode in self.modes]))
        return dataset(variables, places, self._units, {"left_out": list(self.left_out)})

    def _discrete(self) -> ComplexArray:
        """H of the discrete scheme over all frequencies, NaN where there is none."""
        filled = np.full(self.omega.shape, complex(np.nan, np.nan))
        if self.discrete is not None:
            filled[: len(self.discrete)] = self.discrete
        return filled

    @property
    def frequency(self) -> FloatArray:
        """The angular frequencies |s| of the poles."""
        return np.zeros(0) if self.poles is None else np.abs(self.poles)

    @property
    def damping(self) -> FloatArray:
        """The damping ratios −Re s/|s| of the poles."""
        return np.zeros(0) if self.poles is None else -self.poles.real / np.abs(self.poles)

    def plot(
        self,
        kind: Literal["bode", "nyquist"] = "bode",
        axes: Any = None,
        *,
        unit: str = "",
        frequency_unit: str = "rad/s",
        label: str | None = None,
    ) -> Picture:
        """Draws the response as Bode's diagram, magnitude and phase over the frequency, or as Nyquist's curve.

        Parameters
        ----------
        kind : {"bode", "nyquist"}
            Two axes, or one.
        axes : matplotlib axes, or a sequence of two
            Axes to draw in; default: a new figure.
        unit, frequency_unit : str
            Units for the labels; with "Hz" the frequencies are divided by 2π.
        label : str, optional
            Name of the curve in the legend.

        Returns
        -------
        sequence of matplotlib axes
            With their `figure`, and its `savefig`. The dashed curve is that of the discrete scheme.
        """
        if kind not in ("bode", "nyquist"):
            raise InputError(f'kind = {kind!r}: not allowed; allowed: "bode", "nyquist"', "kind", repr(kind))
        order = np.argsort(np.concatenate([self.omega, self.omega_between]))
        places = np.concatenate([self.omega, self.omega_between])[order]
        curves: list[tuple[FloatArray, ComplexArray, str, str | None]] = [
            (places, np.concatenate([self.response, self.between])[order], "-", label)
        ]
        if self.discrete is not None:
            of_scheme = "discrete" if label is None else f"{label}, discrete"
            curves.append((self.omega[: len(self.discrete)], self.discrete, "--", of_scheme))
        if kind == "nyquist":
            (plane,) = axes = new_axes(axes, 1, 1, (5.0, 5.0))
            for _, values, line, name in curves:
                plane.plot(values.real, values.imag, line, label=name, linewidth=1)
            plane.set_aspect("equal", adjustable="datalim")
            plane.set_xlabel(labelled("Re H", unit))
            plane.set_ylabel(labelled("Im H", unit))
            return Picture(axes)
        above, below = axes = new_axes(axes, 2, 1, (6.0, 5.0), sharex=True)
        scale = 2.0 * np.pi if frequency_unit == "Hz" else 1.0
        for omega, values, line, name in curves:
            above.loglog(omega / scale, np.abs(values), line, label=name, linewidth=1)
            below.semilogx(omega / scale, np.degrees(np.unwrap(np.angle(values))), line, linewidth=1)
        above.set_ylabel(labelled("|H|", unit))
        below.set_ylabel("phase (°)")
        below.set_xlabel(labelled("frequency" if frequency_unit == "Hz" else "ω", frequency_unit))
        if above.get_legend_handles_labels()[0]:
            above.legend(fontsize="small")
        return Picture(axes)

    def _repr_html_(self) -> str:
        """Frequencies and damping ratios of the poles, for notebooks."""
        omega = f"{len(self.omega)} frequencies, ω = {self.omega[0]:.6g} … {self.omega[-1]:.6g}" if len(self.omega) else "no frequencies"
        rows = [
            [f"{pole.real:.6g} {'+' if pole.imag >= 0 else '−'} {abs(pole.imag):.6g} i", f"{frequency:.6g}", f"{ratio:.6g}"]
            for pole, frequency, ratio in zip(np.zeros(0) if self.poles is None else self.poles, self.frequency, self.damping)
        ]
        said = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in self.left_out)
        return f"<p>{omega}</p>{html_table(('pole s', '|s|', 'damping ratio'), rows)}<ul>{said}</ul>"


def response(
    scenario: Scenario,
    omega: Sequence[float] | FloatArray | None = None,
    *,
    from_omega: Real | None = None,
    to_omega: Real | None = None,
    points: Whole = 400,
    input: Whole = 0,
    output: Whole = 0,
    about: Sequence[float] | FloatArray | None = None,
    near: float | Sequence[float] | FloatArray | None = None,
    modes: Whole = 6,
    discrete: bool = True,
    overrides: Mapping[str, Any] | None = None,
    **keys: Unpack[ResponseKeys],
) -> Response:
    """The frequency response H(ω) = (−ω²M + K + Σ ρ K(iω))⁻¹ of a scenario, as the program `fvi response` computes it.

    Parameters
    ----------
    scenario : path, dict or System
        As in `run`; a system alone needs `omega`.
    omega : array, optional
        Angular frequencies, ascending.
    from_omega, to_omega, points
        In place of `omega`: the first and the last angular frequency, and their number, equidistant on a logarithmic scale;
        defaults: 2π over the time of the run, and π over its step.
    input, output : int
        The coordinate on which the force acts, and the one whose displacement is computed.
    about : array, optional
        The point about which the system is linearised; default: the initial position.
    near : float or array, optional
        Angular frequencies near which damped modes are sought, of systems of any size: those nearest to iω in the plane of s,
        in |s − iω| < 0.999 ω, as many as the argument principle counts.
    modes : int
        Their number near each of these frequencies.
    discrete : bool
        False: without the response of the discrete scheme, which takes as long as the response itself.
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
    >>> mode, = fvi.response(oscillator, [1.0], near=2.0, modes=1).modes
    >>> float(abs(mode.s - found.poles[0])) < 1e-13, complex(mode.shape[0])
    (True, (1+0j))
    """
    if isinstance(scenario, System) and not {"step", "grid"} & keys.keys():
        # Only the response of the scheme depends on the steps.
        if omega is None:
            raise InputError("omega: needed for a system without steps", "omega", "None")
        if np.size(omega) == 0:
            raise InputError("omega: one frequency is needed at least", "omega", "[]")
        keys = {**keys, "step": np.pi / max(np.max(omega), np.finfo(float).tiny), "steps": 1}
    scenario, changed = scenario_of(scenario, keys)
    _, given = source_of(scenario, by_path(overrides, changed, response))

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
        near=numbers("near", near),
        modes=_arrays.whole("modes", modes, 1),
        discrete=discrete,
    )

    def complex_numbers(pairs: list[tuple[float, float]] | None) -> ComplexArray | None:
        if pairs is None:
            return None
        return np.array(pairs, dtype=np.float64).reshape(-1, 2).view(np.complex128)[:, 0]

    def array(values: list[float] | None) -> FloatArray | None:
        return None if values is None else np.array(values)

    for warning in record["warnings"]:
        warnings.warn(warning, stacklevel=2)
    found, between = complex_numbers(record["response"]), complex_numbers(record["between"])
    assert found is not None and between is not None
    kernels = []
    for entry in record["kernels"]:
        moduli = complex_numbers(entry["moduli"])
        assert moduli is not None
        curves = array(entry["creep"]), array(entry["relaxation"])
        kernels.append(KernelCurves(entry["name"], moduli, np.array(entry["t"]), *curves))
    return Response(
        np.array(record["omega"]),
        found,
        np.array(record["omega_between"], dtype=float),
        between,
        complex_numbers(record["discrete"]),
        complex_numbers(record["poles"]),
        tuple(kernels),
        tuple(record["left_out"]),
        tuple(_mode(entry) for entry in record["modes"]),
        appearance_of(given)[1],
    )


def _mode(entry: Mapping[str, Any]) -> Mode:
    shape = np.array(entry["shape"], dtype=np.float64).reshape(-1, 2).view(np.complex128)[:, 0]
    return Mode(complex(*entry["s"]), shape, entry["near"], entry["residual"], entry["of_tables"])
