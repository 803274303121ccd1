"""Systems given by arrays, expressions and functions."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fvi import _arrays
from fvi._errors import InputError
from fvi._result import Result
from fvi._run import Progress, compute
from fvi._scenario import SHORT_NAMES, by_path, source
from fvi._types import FloatArray

Function = Callable[..., Any]


@dataclass(frozen=True)
class Potential:
    """A potential U(q) given by functions of an array of N positions.

    Parameters
    ----------
    value : callable
        U(q), a number.
    gradient : callable
        ∇U(q), N numbers.
    hessian : callable, optional
        ∂²U/∂q², N×N numbers. Without it differences of the gradient serve, one call more for each coordinate; the result is
        the same to rounding, since Newton's method corrects for them.
    """

    value: Function
    gradient: Function
    hessian: Function | None = None


@dataclass(frozen=True)
class Force:
    """A force F(t, q) given by functions of the time and an array of N positions.

    Parameters
    ----------
    value : callable
        F(t, q), N numbers; or F(t), if it takes one argument.
    jacobian : callable, optional
        ∂F/∂q, N×N numbers, as a function of t and q. Without it differences of the force serve, where it takes a position.

    Notes
    -----
    At a grid point a force is asked for within rounding of the time, on the side of the step that asks: a force that jumps at
    a grid point, such as ``8.0*(t <= 1.0)``, jumps between two steps.
    """

    value: Function
    jacobian: Function | None = None


@dataclass(frozen=True)
class Damping:
    """A damping term ρ D^β q.

    Parameters
    ----------
    order : float
        β, 0 ≤ β < 2.
    coefficient : array_like or sparse matrix
        ρ: a diagonal or a symmetric positive semidefinite matrix.
    derivative : {"caputo", "riemann-liouville"}
        What the derivative acts on.
    """

    order: float
    coefficient: Any
    derivative: str = "caputo"


class _Terms(NamedTuple):
    """What the compiled half calls."""

    value: Function | None
    gradient: Function | None
    hessian: Function | None
    force: Function | None
    jacobian: Function | None
    takes_position: bool


def integrate(
    *,
    mass: Any,
    position: ArrayLike,
    step: float,
    steps: int | None = None,
    end: float | None = None,
    momentum: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    stiffness: Any = None,
    potential: str | Potential | None = None,
    force: str | Sequence[str] | Function | Force | None = None,
    damping: Damping | Mapping[str, Any] | Iterable[Damping | Mapping[str, Any]] = (),
    parameters: Mapping[str, float] | None = None,
    precision: str = "f64",
    check: bool = True,
    progress: Progress | None = None,
    overrides: Mapping[str, Any] | None = None,
    **keys: Any,
) -> Result:
    """Integrates M q̈ + K q + ∇U(q) = F(t, q) − Σ ρ D^β q.

    Parameters
    ----------
    mass : array_like or sparse matrix
        M: the diagonal, or a symmetric positive definite matrix. It says how many coordinates N there are.
    position : array_like
        q(0), N numbers, or one for all coordinates.
    step, steps, end : number
        Step size h, and either the number of steps or the end of the time.
    momentum, velocity : array_like, optional
        p(0) = M v(0) or v(0); at rest without them.
    stiffness : array_like or sparse matrix, optional
        K, symmetric: adds ½ qᵀKq to the potential.
    potential : str or Potential, optional
        U(q): an expression in q0, q1, … and the parameters, or functions.
    force : str, list of str, callable or Force, optional
        F(t, q): an expression for each coordinate in t, q0, … and the parameters, or a function of (t, q), or of t alone.
    damping : Damping or list of Damping, optional
        The damping terms; dictionaries with the same keys serve as well.
    parameters : mapping of str to float, optional
        Named constants of the expressions.
    precision, check, progress, overrides
        As in `run`.
    **keys
        How to integrate, by the names in a scenario: scheme="low-order" (kappa=0.5), "galerkin" (degree, quadrature, points),
        "explicit-euler" or "implicit-euler"; convolution="bdf" (order from 1 to 6), "radau-iia" or "lobatto-iiic" (stages);
        at; starting; engine, tolerance, capacity, overflow; every; allow_unstable; energy_guard; title.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        If an argument cannot be used; its `key` names it.
    StepError
        If a step failed; what was computed is in its `result`.
    Exception
        What a function raises ends the step and reaches the caller with its traceback; what was computed until then is in
        the attribute `result` of the exception.

    Notes
    -----
    Functions are called with new arrays, several times a step, from the thread that calls this; with expressions the
    interpreter is released. A function's value may be anything that `numpy.asarray` makes numbers of.

    Examples
    --------
    A mass on a spring with a fractional damper, and the same with functions:

    >>> import numpy as np, fvi
    >>> common = dict(mass=[1.0], position=[1.0], step=0.01, steps=1000,
    ...               damping=fvi.Damping(order=0.5, coefficient=[0.2]), order=2)
    >>> r = fvi.integrate(stiffness=[4.0], **common)
    >>> spring = fvi.Potential(lambda q: 2.0 * q @ q, lambda q: 4.0 * q, lambda q: [[4.0]])
    >>> s = fvi.integrate(potential=spring, **common)
    >>> bool(np.abs(r.q - s.q).max() < 1e-12)
    True

    A pendulum driven by a force that depends on the time only:

    >>> r = fvi.integrate(mass=[1.0], potential="-9.81*cos(q0)", force=lambda t: [np.sin(3.0 * t)],
    ...                   position=[0.1], step=0.01, end=2.0)
    >>> r.q.shape
    (201, 1)
    """
    mass_array = _arrays.matrix("mass", mass)
    if np.ndim(mass_array) == 1 and mass_array.shape == (1,) and np.ndim(mass) == 0:
        mass_array = np.full(max(1, np.size(position)), mass_array[0])
    size = mass_array.shape[0]
    system: dict[str, Any] = {"mass": _symmetric("mass", mass_array)}
    if parameters is not None:
        system["parameters"] = dict(parameters)
    texts, functions, force_texts = _terms(potential, force)
    if stiffness is not None:
        texts.append(_quadratic(_symmetric("stiffness", _arrays.matrix("stiffness", stiffness, size))))
    if texts:
        system["potential"] = " + ".join(texts)
    if force_texts is not None:
        system["force"] = force_texts
    system["damping"] = _damping(damping, size)
    initial: dict[str, Any] = {"position": _arrays.vector("position", position, size)}
    if velocity is not None and momentum is None:
        initial["velocity"] = _arrays.vector("velocity", velocity, size)
    else:
        initial["momentum"] = _arrays.vector("momentum", 0.0 if momentum is None else momentum, size)
        if velocity is not None:
            raise InputError("velocity: cannot stand beside momentum: give one of them", "velocity")
    time: dict[str, Any] = {"step": step if isinstance(step, int) else _arrays.real("step", step)}
    if (steps is None) == (end is None):
        raise InputError("steps: give either steps or end", "steps")
    if steps is not None:
        time["steps"] = _arrays.whole("steps", steps)
    else:
        time["end"] = _arrays.real("end", end)
    scenario = {"system": system, "initial": initial, "time": time}
    changes = by_path(overrides, keys)
    terms = functions if any((functions.gradient, functions.force)) else None
    try:
        return compute(source(scenario, changes), precision=precision, check=check, progress=progress, terms=terms)
    except InputError as error:
        raise _named_after_argument(error) from error.__cause__


def _terms(
    potential: str | Potential | None, force: str | Sequence[str] | Function | Force | None
) -> tuple[list[str], _Terms, list[str] | None]:
    """Expressions of the potential, functions, expressions of the force."""
    texts: list[str] = []
    value = gradient = hessian = push = jacobian = None
    takes_position = False
    force_texts = None
    if isinstance(potential, str):
        texts.append(f"({potential})")
    elif isinstance(potential, Potential):
        value, gradient, hessian = potential.value, potential.gradient, potential.hessian
        for name, function in (("value", value), ("gradient", gradient), ("hessian", hessian)):
            if not callable(function) and not (name == "hessian" and function is None):
                raise InputError(f"potential.{name} = {function!r}: a function is needed", f"potential.{name}", repr(function))
    elif potential is not None:
        message = "potential: an expression in quotes or a fvi.Potential with value, gradient and hessian is needed"
        raise InputError(message, "potential", repr(potential))
    if isinstance(force, str):
        force_texts = [force]
    elif isinstance(force, Force) or callable(force):
        push, jacobian = (force.value, force.jacobian) if isinstance(force, Force) else (force, None)
        if not callable(push):
            raise InputError(f"force.value = {push!r}: a function is needed", "force.value", repr(push))
        takes_position = _takes_position(push)
    elif force is not None:
        force_texts = list(force)
        for index, text in enumerate(force_texts):
            if not isinstance(text, str):
                message = f"force[{index}] = {text!r}: an expression in quotes is needed; or give a function of (t, q)"
                raise InputError(message, f"force[{index}]", repr(text))
    return texts, _Terms(value, gradient, hessian, push, jacobian, takes_position), force_texts


def _takes_position(function: Function) -> bool:
    """Whether a force is a function of time and position, or of time alone."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return True
    try:
        signature.bind(0.0, None)
    except TypeError:
        return False
    return True


def _symmetric(name: str, given: FloatArray) -> FloatArray:
    """A matrix that is symmetric to rounding, as its symmetric part."""
    if given.ndim == 1:
        return given
    with np.errstate(over="ignore"):
        off = np.abs(given - given.T)
    row, column = (int(index) for index in np.unravel_index(np.argmax(off), off.shape))
    if off[row, column] > 64 * np.finfo(float).eps * np.abs(given).max():
        message = (
            f"{name}: not symmetric: entry ({row}, {column}) is {given[row, column]}, "
            f"entry ({column}, {row}) is {given[column, row]}"
        )
        raise InputError(message, name, f"entry ({row}, {column})")
    return given if off[row, column] == 0.0 else 0.5 * given + 0.5 * given.T


def _quadratic(stiffness: FloatArray) -> str:
    """½ qᵀKq as an expression, which the library reads back as a matrix."""
    if stiffness.ndim == 1:
        stiffness = np.diag(stiffness)
    terms = [
        f"{float(stiffness[row, column]) * (0.5 if row == column else 1.0)!r}*q{row}*q{column}"
        for row, column in zip(*(index.tolist() for index in np.nonzero(np.tril(stiffness))))
    ]
    return "(" + (" + ".join(terms) or "0") + ")"


def _damping(given: Any, size: int) -> list[dict[str, Any]]:
    if isinstance(given, (Damping, Mapping)):
        given = [given]
    terms = []
    for index, term in enumerate(given):
        place = f"damping[{index}]"
        if isinstance(term, Damping):
            term = {"order": term.order, "coefficient": term.coefficient, "derivative": term.derivative}
        if not isinstance(term, Mapping):
            raise InputError(f"{place} = {term!r}: a fvi.Damping is needed", place, repr(term))
        entries = dict(term)
        if "order" in entries:
            entries["order"] = _arrays.real(f"{place}.order", entries["order"])
        if "coefficient" in entries:
            name = f"{place}.coefficient"
            coefficient = _arrays.matrix(name, entries["coefficient"], size)
            entries["coefficient"] = _symmetric(name, coefficient)
        terms.append(entries)
    return terms


def _named_after_argument(error: InputError) -> InputError:
    """An error about a key of a scenario, as one about the argument that it came from."""
    arguments = {path: name for name, path in SHORT_NAMES.items()} | {
        f"system.{name}": name for name in ("mass", "potential", "force", "damping")
    }
    for path, name in arguments.items():
        if error.key == path or error.key.startswith((f"{path}.", f"{path}[")):
            key = name + error.key[len(path) :]
            renamed = InputError(str(error).replace(error.key, key, 1), key, error.value)
            return renamed.with_traceback(error.__traceback__)
    return error


