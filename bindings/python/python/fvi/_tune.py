"""Gains and orders of fractional controllers for a plant."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fvi import _fvi
from fvi._datasets import _module, dataset
from fvi._errors import suggesting
from fvi._result import Picture, html_table, labelled, new_axes
from fvi._scenario import Scenario, by_path, source
from fvi._system import System, scenario_of, source_of
from fvi._types import FloatArray

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Tuning:
    """A tuned controller, with margins and responses of its loop.

    Attributes
    ----------
    kp, ki, lam, kd, mu : float
        Gains and orders; of the series form ki = kp/T_i and kd = kp T_d; `record` also contains T_i and T_d.
    margins, sampled_margins : dict
        `gain_margin`, `gain_reduction`, `phase_margin` (degrees), `delay_margin`, `gain_crossovers`, `phase_crossovers`,
        `ms`, `ms_at`, `mt`, `mt_at`; of the loop in continuous time, and of the sampled one.
    record : dict
        The content of the program's `tune.json`.
    controller : str
        `[controller]` of a scenario, as TOML.
    omega : ndarray, shape (W,)
        Angular frequencies.
    plant, loop, sampled_loop : ndarray, shape (W,)
        P, L = C P, and L of the sampled loop, NaN above π/sample.
    t, step, control, load : ndarray, shape (K,)
        Times, the measured value and the output after a unit step of the setpoint, and the measured value after one of
        a load at the plant's input; of the loop in continuous time.
    """

    kp: float
    ki: float
    lam: float
    kd: float
    mu: float
    margins: dict[str, Any]
    sampled_margins: dict[str, Any]
    record: dict[str, Any]
    controller: str
    omega: FloatArray
    plant: ComplexArray
    loop: ComplexArray
    sampled_loop: ComplexArray
    t: FloatArray
    step: FloatArray
    control: FloatArray
    load: FloatArray

    def plot(self, axes: Any = None, *, unit: str = "", time_unit: str = "") -> Picture:
        """Draws the loop's magnitude and phase over the frequency, its Nyquist curve, and the responses to steps.

        Parameters
        ----------
        axes : sequence of four matplotlib axes, optional
            Axes to draw in; default: a new figure.
        unit, time_unit : str
            Units of the measured value and of the time, for the labels.

        Returns
        -------
        sequence of four matplotlib axes
            With their `figure`, and its `savefig`. The dashed curves are those of the sampled loop.
        """
        magnitude, plane, phase, course = axes = new_axes(axes, 2, 2, (9.0, 6.0))
        for loop, line, name in ((self.loop, "-", "continuous"), (self.sampled_loop, "--", "sampled")):
            known = np.isfinite(loop)
            omega, values = self.omega[known], loop[known]
            magnitude.loglog(omega, np.abs(values), line, label=name, linewidth=1)
            phase.semilogx(omega, np.degrees(np.unwrap(np.angle(values))), line, linewidth=1)
            near = np.abs(values) < 4.0
            plane.plot(values.real[near], values.imag[near], line, linewidth=1)
        magnitude.axhline(1.0, color="0.5", linewidth=0.8)
        phase.axhline(-180.0, color="0.5", linewidth=0.8)
        plane.plot([-1.0], [0.0], "+", color="black")
        plane.set_aspect("equal", adjustable="datalim")
        magnitude.set_ylabel("|L|")
        magnitude.legend(fontsize="small")
        phase.set_ylabel("phase of L (°)")
        phase.set_xlabel(labelled("ω", f"1/{time_unit}" if time_unit else ""))
        plane.set_xlabel("Re L")
        plane.set_ylabel("Im L")
        for course_of, name in ((self.step, "setpoint"), (self.load, "load")):
            course.plot(self.t, course_of, label=f"after a step of the {name}", linewidth=1)
        course.set_xlabel(labelled("t", time_unit))
        course.set_ylabel(labelled("measured value", unit))
        course.legend(fontsize="small")
        return Picture(axes)

    def to_pandas(self) -> Any:
        """The margins as a pandas DataFrame: a row for each number of `margins`, in columns `continuous` and `sampled`, NaN where
        there is none."""
        names = [name for name, value in self.margins.items() if isinstance(value, (int, float))]

        def column(margins: dict[str, Any]) -> list[float]:
            return [float(value) if isinstance(value := margins.get(name), (int, float)) else np.nan for name in names]

        pandas = _module("pandas", "to_pandas()")
        columns = {"continuous": column(self.margins), "sampled": column(self.sampled_margins)}
        return pandas.DataFrame(columns, index=pandas.Index(names, name="margin"))

    def to_xarray(self) -> Any:
        """The frequency responses over ``omega`` and the responses to steps over ``t`` as an xarray Dataset with names; gains and orders
        are attributes."""
        of_frequency = {name: ("omega", getattr(self, name)) for name in ("plant", "loop", "sampled_loop")}
        of_time = {name: ("t", getattr(self, name)) for name in ("step", "control", "load")}
        numbers = {name: getattr(self, name) for name in ("kp", "ki", "lam", "kd", "mu")}
        return dataset({**of_frequency, **of_time}, {"omega": ("omega", self.omega), "t": ("t", self.t)}, {}, numbers)

    def _repr_html_(self) -> str:
        """Gains, orders and margins, for notebooks."""
        gains = [[f"{number:.6g}" for number in (self.kp, self.ki, self.lam, self.kd, self.mu)]]
        names = [name for name, value in self.margins.items() if isinstance(value, (int, float))]

        def cell(margins: dict[str, Any], name: str) -> str:
            value = margins.get(name)
            return f"{value:.6g}" if isinstance(value, (int, float)) else "–"

        rows = [[name, cell(self.margins, name), cell(self.sampled_margins, name)] for name in names]
        return html_table(("kp", "ki", "λ", "kd", "μ"), gains) + html_table(("margin", "continuous", "sampled"), rows)


@suggesting
def tune(problem: Scenario, *, overrides: Mapping[str, Any] | None = None) -> Tuning:
    """Tunes gains and orders of a controller for a plant, as the program `fvi tune` does.

    Parameters
    ----------
    problem : path or dict
        A file or a dictionary with its keys: `plant`, `controller`, `specification`. There `plant.scenario` is a path, a
        dictionary as in `run`, or a `System`, whose steps are then those of `controller.sample`.
    overrides : mapping, optional
        Values in place of the problem's, by paths such as ``"specification.phase_margin"``.

    Returns
    -------
    Tuning

    Raises
    ------
    InputError
        If a key cannot be used.
    RuntimeError
        If no controller meets the specification, or its loop would be unstable.

    Examples
    --------
    >>> import fvi
    >>> found = fvi.tune({"plant": {"transfer": "1.0263/(s*(0.71*s + 1))"},
    ...                   "controller": {"structure": "pd", "sample": 1e-8},
    ...                   "specification": {"crossover": 2.51, "phase_margin": 83.9, "flat_phase": True}})
    >>> print(f"{found.kp:.5f} {found.kd / found.kp:.6f} {found.mu:.6f}")
    2.69908 0.619222 0.969410
    """
    problem, plant = _with_plant(problem)
    text, controller, (response, steps) = _fvi.tune(source(problem, dict(overrides or {})), plant)
    record = json.loads(text)
    for warning in record["warnings"]:
        warnings.warn(warning, stacklevel=3)
    curves = np.array(response)
    times = np.array(steps)

    def complex_numbers(column: int) -> ComplexArray:
        return np.ascontiguousarray(curves[:, column : column + 2]).view(np.complex128)[:, 0]

    return Tuning(
        kp=record["kp"],
        ki=record["ki"],
        lam=record["lambda"],
        kd=record["kd"],
        mu=record["mu"],
        margins=record["margins"],
        sampled_margins=record["sampled_margins"],
        record=record,
        controller=controller,
        omega=curves[:, 0],
        plant=complex_numbers(1),
        loop=complex_numbers(3),
        sampled_loop=complex_numbers(5),
        t=times[:, 0],
        step=times[:, 1],
        control=times[:, 2],
        load=times[:, 3],
    )


def _with_plant(problem: Scenario) -> tuple[Scenario, Any]:
    """The problem, and the scenario of its plant if that is not a file."""
    plant = problem.get("plant") if isinstance(problem, Mapping) else None
    given = plant.get("scenario") if isinstance(plant, Mapping) else None
    if not isinstance(problem, Mapping) or not isinstance(plant, Mapping) or not isinstance(given, (Mapping, System)):
        return problem, None
    controller = problem.get("controller")
    sample = controller.get("sample") if isinstance(controller, Mapping) else None
    steps = {"step": sample, "steps": 1} if isinstance(given, System) else {}
    scenario, changes = scenario_of(given, steps)
    return {**problem, "plant": {**plant, "scenario": "scenario"}}, source_of(scenario, by_path(None, changes))[1]
