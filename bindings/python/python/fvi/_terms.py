"""The terms of a system, given by expressions, arrays and functions."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fvi import _arrays
from fvi._errors import InputError, suggesting_class
from fvi._keyed import keys_of
from fvi._native import Native, native
from fvi._scenario import SEVERAL, Files, symmetric
from fvi._sparsity import sparse_hessian
from fvi._types import Action, Derivative, Direction, Real

Function = Callable[..., Any]


@suggesting_class
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
        ∂²U/∂q², N×N numbers or a sparse SciPy matrix. Default: differences of the gradient, with one further call for each
        coordinate, or with a `pattern` a few calls. The result is the same to rounding, since only the convergence of Newton's
        method depends on it. Sensitivities and gradients need it: it is compared with differences at the start there.
    pattern : sparse matrix or array_like, optional
        Sparsity pattern of ∂²U/∂q²: the nonzero entries of this matrix and their mirror images. Default: the pattern of a sparse
        `hessian` at the start of the run. With it systems of more than 32 coordinates stay sparse.

    Notes
    -----
    Each may be a function of C, a function pointer of ctypes with `argtypes` and `restype`, or what Numba's ``cfunc`` has compiled:

    | | C | Numba |
    |---|---|---|
    | value | ``double U(const double *q)`` | ``float64(CPointer(float64))`` |
    | gradient | ``void gradient(const double *q, double *out)`` | ``void(CPointer(float64), CPointer(float64))`` |
    | hessian | ``void hessian(const double *q, double *out)``, row by row | the same |

    Numbers that are not written are 0. Without functions of Python in it a run does not hold the interpreter's lock, and the runs
    of a batch are made on all cores, so that such functions are called at the same time.
    """

    value: Function
    gradient: Function
    hessian: Function | None = None
    pattern: Any = None


@suggesting_class
@dataclass(frozen=True)
class Force:
    """A force F(t, q, v) given by functions of the time and arrays of N positions and N velocities.

    Parameters
    ----------
    value : callable
        F(t, q, v), N numbers; or F(t, q), or F(t). Parameters with default values are not counted.
    jacobian : callable, optional
        ∂F/∂q, N×N numbers, with the same arguments as `value`. Default: differences of the force, if it depends on the position.
    velocity_jacobian : callable, optional
        ∂F/∂v, N×N numbers, entry (i, j) = ∂F_i/∂v_j, as a function of t, q and v. Default: differences of the force.

    Notes
    -----
    The velocity is that of the scheme's polynomial at the node where the force is evaluated, with collocation that of the stage;
    every scheme keeps its order. With a force that depends on the position the matrix of a step is full.

    At a grid point a force is evaluated at a time that differs from it by rounding, on the side of the current step: a force that
    jumps at a grid point, such as ``8.0*(t <= 1.0)``, jumps between two steps.

    Functions of C are taken as by `Potential`: ``void F(double t, const double *q, double *out)``, or with ``const double *v``
    behind q; the derivatives have the same arguments and write their matrices row by row.
    """

    value: Function
    jacobian: Function | None = None
    velocity_jacobian: Function | None = None


@suggesting_class
@dataclass(frozen=True)
class Damping:
    """A damping term ρ D^β q, or ρ K(D) q.

    Parameters
    ----------
    order : float, optional
        β, 0 ≤ β < 2.
    coefficient : array_like or sparse matrix, optional
        ρ: a diagonal or a symmetric positive semidefinite matrix.
    derivative : {"caputo", "riemann-liouville"}
        The function that the derivative acts on, as in `fvi.derivative`.
    attached, strength : array_like or sparse matrix, optional
        In place of `coefficient`: B, N rows and one column for each damper, and their strengths c ≥ 0; ρ = B diag(c) Bᵀ.
    kernel : Kernel, optional
        K(s), in place of `order`.
    allow_active : bool
        Whether a kernel that is not passive is allowed.
    along : str or list of str, optional
        In place of coordinates: an elongation g(q), an expression in q0, q1, … and the parameters, with a number as
        `coefficient`; or several, with a diagonal or a matrix. The force is −(∂g/∂q)ᵀ ρ K(D) g.
    """

    order: Real | None = None
    coefficient: Any = None
    derivative: Derivative = "caputo"
    attached: Any = None
    strength: ArrayLike | None = None
    kernel: Any = None
    allow_active: bool | None = None
    along: str | Sequence[str] | None = None


@suggesting_class
@dataclass(frozen=True)
class Load:
    """A force f a(t): a pattern over the coordinates times an amplitude over time.

    Parameters
    ----------
    pattern : array_like or dict
        f, N numbers; or ``{"coordinate": 17, "value": 1.0}``.
    amplitude : str, callable or (array_like, array_like)
        a: an expression in t and the parameters; a function of t; or times and values, linear in between and zero outside.
    """

    pattern: Any
    amplitude: Any


@suggesting_class
@dataclass(frozen=True)
class Element:
    """A potential of a few coordinates that is repeated for many sets of coordinates.

    Parameters
    ----------
    potential : str
        An expression in x0, x1, … and the parameters.
    coordinates : array_like of int, shape (E, n)
        For each repetition, the coordinates that x0, x1, … stand for.
    along : str or sequence of str
        In place of coordinates: the elongations that x0, x1, … stand for, expressions in q0, q1, … and the parameters.
    """

    potential: str
    coordinates: ArrayLike | None = None
    along: str | Sequence[str] | None = None


@suggesting_class
@dataclass(frozen=True)
class Event:
    """A zero crossing of a function of the motion.

    Parameters
    ----------
    when : str or callable
        An expression in t, q0, q1, … and the parameters; with scheme="collocation" in p0, p1, … too. Or a function of (t, q), with
        collocation of (t, q) or (t, q, p), that returns a number.
    direction : {"both", "rising", "falling"}
        Direction of the zero crossings that count.
    action : {"record", "stop"}
        Whether the run continues, or ends at the event.
    """

    when: str | Function
    direction: Direction = "both"
    action: Action = "record"


class Terms(NamedTuple):
    """The functions that the compiled part calls."""

    value: Function | None
    gradient: Function | None
    hessian: Function | None
    force: Function | None
    jacobian: Function | None
    takes_position: bool
    places: list[int] | None = None
    velocity_jacobian: Function | None = None
    takes_velocity: bool = False


def parameters_without_default(function: Function) -> int | None:
    """Number of parameters of a function without default; `None` where it cannot be determined, or is arbitrary."""
    if isinstance(function, Native):
        return int(function.of_time) + 1 + int(function.moves)
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return None
    if any(parameter.kind is inspect.Parameter.VAR_POSITIONAL for parameter in parameters):
        return None
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return sum(parameter.kind in positional and parameter.default is inspect.Parameter.empty for parameter in parameters)


def takes_position(function: Function) -> bool:
    """Whether a force is a function of time and position, or of time alone."""
    # A second parameter that has a default, as in ``lambda t, a=a: …``, does not count.
    asked = parameters_without_default(function)
    return asked is None or asked > 1


def terms_of(
    potential: str | Potential | None, force: str | Sequence[str] | Function | Force | None, name: str = ""
) -> tuple[list[str], Terms, list[str] | None]:
    """Expressions of the potential, functions, expressions of the force. `name` is the prefix of places in error messages."""
    texts: list[str] = []
    value = gradient = hessian = push = jacobian = velocity_jacobian = None
    of_position = of_velocity = False
    force_texts = None
    if isinstance(potential, str):
        texts.append(f"({potential})")
    elif isinstance(potential, Potential):
        given = (("value", potential.value), ("gradient", potential.gradient), ("hessian", potential.hessian))
        value, gradient, hessian = (native(f"{name}potential.{part}", f"potential.{part}", function) for part, function in given)
        for part, function in (("value", value), ("gradient", gradient), ("hessian", hessian)):
            if not callable(function) and not (part == "hessian" and function is None):
                place = f"{name}potential.{part}"
                raise InputError(f"{place} = {function!r}: a function is needed", place, repr(function))
    elif potential is not None:
        message = f"{name}potential: an expression in quotes or a fvi.Potential with value, gradient and hessian is needed"
        raise InputError(message, f"{name}potential", repr(potential))
    given_force: Any = native(f"{name}force", "force", force)
    if isinstance(force, str):
        force_texts = [force]
    elif isinstance(force, Force) or callable(given_force):
        push = given_force
        if isinstance(force, Force):
            push = native(f"{name}force.value", "force", force.value)
            jacobian = native(f"{name}force.jacobian", "force.jacobian", force.jacobian)
            velocity_jacobian = native(f"{name}force.velocity_jacobian", "force.velocity_jacobian", force.velocity_jacobian)
        if not callable(push):
            raise InputError(f"{name}force.value = {push!r}: a function is needed", f"{name}force.value", repr(push))
        asked = parameters_without_default(push)
        if asked is not None and asked > 3:
            raise InputError(f"{name}force: a function of (t, q, v), of (t, q) or of t is needed", f"{name}force", repr(push))
        of_velocity = asked == 3
        if velocity_jacobian is not None and not of_velocity:
            place = f"{name}force.velocity_jacobian"
            message = f"{place}: belongs to a force of (t, q, v); this one takes no velocity"
            raise InputError(message, place, repr(velocity_jacobian))
        of_position = takes_position(push)
        for part, matrix in (("jacobian", jacobian), ("velocity_jacobian", velocity_jacobian)):
            if isinstance(matrix, Native) and matrix.moves != of_velocity:
                place = f"{name}force.{part}"
                raise InputError(f"{place}: a function with the arguments of the force is needed", place, repr(matrix.owner))
    elif force is not None:
        force_texts = list(given_force)
        for index, text in enumerate(force_texts):
            if not isinstance(text, str):
                place = f"{name}force[{index}]"
                message = f"{place} = {text!r}: an expression in quotes is needed; or give a function of (t, q)"
                raise InputError(message, place, repr(text))
    terms = Terms(value, gradient, hessian, push, jacobian, of_position, None, velocity_jacobian, of_velocity)
    return texts, terms, force_texts


def on_its_pattern(terms: Terms, potential: Any, position: Any, name: str = "") -> Terms:
    """The functions with a Hessian on its pattern, if that is known and the system is solved as a sparse one."""
    if not isinstance(potential, Potential) or terms.takes_position or len(position) <= SEVERAL:
        return terms
    hessian = sparse_hessian(potential, position, f"{name}potential")
    if hessian is None:
        return terms
    return terms._replace(hessian=hessian, places=hessian.places)


def with_loads(functions: Terms, driven: list[tuple[str, Any, Function]]) -> Terms:
    """The functions, with loads whose amplitudes are functions of time added to the force."""
    push, of_position = functions.force, functions.takes_position

    def loads(t: float) -> Any:
        total = 0.0
        for name, pattern, amplitude in driven:
            value = _arrays.returned(name, amplitude(t))
            if value.size != 1:
                raise InputError(f"{name} has returned {value.size} numbers; one is needed", name, str(value.shape))
            total = total + pattern * float(value.reshape(()))
        return total

    def pushed(*arguments: Any) -> Any:
        own = 0.0 if push is None else _arrays.returned("force", push(*arguments))
        return own + loads(arguments[0])

    return functions._replace(force=pushed, takes_position=push is not None and of_position)


def loads_of(
    given: Any,
    argument: str,
    key: str,
    size: int,
    files: Files,
    driven: list[tuple[str, Any, Function]] | None = None,
) -> list[dict[str, Any]]:
    """The entries of loads for a key of the scenario; records of their amplitudes are added to `files`, patterns whose amplitudes
    are functions to `driven`."""
    loads: list[dict[str, Any]] = []
    for index, load in enumerate(_arrays.several(argument, given, (Load, Mapping), "a fvi.Load")):
        place = f"{argument}[{index}]"
        if isinstance(load, Load):
            load = {"pattern": load.pattern, "amplitude": load.amplitude}
        if not isinstance(load, Mapping):
            raise InputError(f"{place} = {load!r}: a fvi.Load is needed", place, repr(load))
        entries = dict(load)
        pattern, amplitude = entries.get("pattern"), entries.get("amplitude")
        if pattern is not None and not isinstance(pattern, (Mapping, str)):
            if _arrays.is_sparse(pattern):
                pattern = pattern.toarray().ravel()
            entries["pattern"] = _arrays.vector(f"{place}.pattern", pattern, size)
        if callable(amplitude):
            if driven is None:
                name = f"{place}.amplitude"
                raise InputError(f"{name}: an expression or a record is needed in a load case", name, repr(amplitude))
            if isinstance(pattern, Mapping):
                coordinate = _arrays.whole(f"{place}.pattern.coordinate", pattern.get("coordinate"))
                if coordinate >= size:
                    name, value = f"{place}.pattern.coordinate", str(coordinate)
                    raise InputError(f"{name} = {value}: not allowed; allowed: a coordinate below {size}", name, value)
                entries["pattern"] = np.zeros(size)
                entries["pattern"][coordinate] = _arrays.real(f"{place}.pattern.value", pattern.get("value", 1.0))
            elif pattern is None or isinstance(pattern, str):
                name = f"{place}.pattern"
                raise InputError(f"{name} = {pattern!r}: numbers are needed with a function of time", name, repr(pattern))
            driven.append((f"{place}.amplitude", entries["pattern"], amplitude))
            continue
        if isinstance(amplitude, (tuple, list)):
            name = f"{key}[{len(loads)}].csv"
            files[name] = _record(f"{place}.amplitude", amplitude)
            entries["amplitude"] = {"file": name}
        loads.append(entries)
    return loads


def _record(name: str, given: Sequence[Any]) -> bytes:
    """Times and values as the content of a CSV file."""
    if len(given) != 2:
        raise InputError(f"{name}: {len(given)} entries instead of times and values", name, str(len(given)))
    times, values = (_arrays.numbers(f"{name}[{index}]", column) for index, column in enumerate(given))
    if times.ndim != 1 or times.shape != values.shape:
        shapes = f"{times.shape} and {values.shape}"
        raise InputError(f"{name}: shapes {shapes} instead of two of the same length", name, shapes)
    early = np.flatnonzero(np.diff(times) <= 0.0)
    if early.size > 0:
        index = int(early[0]) + 1
        value = str(times[index])
        raise InputError(f"{name}[0][{index}] = {value}: not allowed; allowed: times that increase", f"{name}[0][{index}]", value)
    rows = (f"{time!r},{value!r}\n" for time, value in zip(times.tolist(), values.tolist()))
    return ("t,a\n" + "".join(rows)).encode()


def elements_of(given: Any, argument: str) -> list[dict[str, Any]]:
    """The entries of elements."""
    elements = []
    for index, element in enumerate(_arrays.several(argument, given, (Element, Mapping), "a fvi.Element")):
        place = f"{argument}[{index}]"
        if isinstance(element, Element):
            keys = {"potential": element.potential, "coordinates": element.coordinates, "along": element.along}
            element = {key: value for key, value in keys.items() if value is not None}
        if not isinstance(element, Mapping):
            raise InputError(f"{place} = {element!r}: a fvi.Element is needed", place, repr(element))
        elements.append(dict(element))
    return elements


Watched = list[Function | None]
"""For each event the function of (t, q, p) that it watches; `None` where it has an expression."""


def events_of(given: Any, argument: str, collocation: bool) -> tuple[list[dict[str, Any]], Watched]:
    """Events as entries of a scenario, and their functions."""
    entries, watched = [], Watched()
    for index, event in enumerate(_arrays.several(argument, given, (Event, Mapping), "a fvi.Event")):
        place = f"{argument}[{index}]"
        if isinstance(event, Event):
            event = {"when": event.when, "direction": event.direction, "action": event.action}
        if not isinstance(event, Mapping):
            raise InputError(f"{place} = {event!r}: a fvi.Event is needed", place, repr(event))
        event = dict(event)
        function = None
        if callable(when := event.get("when")):
            # A placeholder expression for the function.
            event["when"], function = "t - 1", _watched(when, f"{place}.when", collocation)
        entries.append(event)
        watched.append(function)
    return entries, watched


def _watched(when: Function, place: str, collocation: bool) -> Function:
    """A function of (t, q, p) from one that may have fewer parameters."""
    asked = parameters_without_default(when)
    if asked == 3 and not collocation:
        message = (
            f'{place}: a function of (t, q) is needed; momenta inside of steps are known with scheme="collocation" only'
        )
        raise InputError(message, place, repr(when))
    if asked == 1:
        return lambda t, q, p: when(t)
    if asked == 3:
        return when
    return lambda t, q, p: when(t, q)


def damping_of(given: Any, size: int, argument: str = "damping") -> list[dict[str, Any]]:
    """The entries of damping terms."""
    terms = []
    for index, term in enumerate(_arrays.several(argument, given, (Damping, Mapping), "a fvi.Damping")):
        place = f"{argument}[{index}]"
        if isinstance(term, Damping):
            term = {field.name: getattr(term, field.name) for field in fields(term)}
        if not isinstance(term, Mapping):
            raise InputError(f"{place} = {term!r}: a fvi.Damping is needed", place, repr(term))
        entries = {key: value for key, value in dict(term).items() if value is not None}
        if "order" in entries:
            entries["order"] = _arrays.real(f"{place}.order", entries["order"])
        if "kernel" in entries:
            entries["kernel"] = keys_of(f"{place}.kernel", entries["kernel"])
        if "coefficient" in entries and not isinstance(entries["coefficient"], str):
            name = f"{place}.coefficient"
            along = entries.get("along")
            if isinstance(along, str):
                entries["coefficient"] = _arrays.real(name, entries["coefficient"])
            else:
                coefficient = _arrays.matrix(name, entries["coefficient"], size if along is None else len(along))
                entries["coefficient"] = symmetric(name, coefficient)
        if "attached" in entries and not (_arrays.is_sparse(entries["attached"]) or isinstance(entries["attached"], str)):
            entries["attached"] = _arrays.numbers(f"{place}.attached", entries["attached"])
        terms.append(entries)
    return terms


class Functions(NamedTuple):
    """The functions contained in a scenario."""

    terms: Terms | None = None
    events: Watched = []

    def __bool__(self) -> bool:
        return self.terms is not None or any(self.events)


def out_of(scenario: Mapping[str, Any]) -> tuple[dict[str, Any], Functions, Files]:
    """Splits a scenario's dictionary that contains objects of `integrate`: the dictionary without functions, the functions, and
    the records of its loads."""
    scenario = dict(scenario)
    system = scenario.get("system")
    files: Files = {}
    if not isinstance(system, Mapping) or "mass" not in system:
        return scenario, Functions(), files
    system = scenario["system"] = dict(system)
    initial = scenario.get("initial")
    position = initial.get("position") if isinstance(initial, Mapping) else None
    if isinstance(system["mass"], (int, float, np.number)):
        system["mass"] = np.full(max(1, np.size(position)) if position is not None else 1, float(system["mass"]))
    shape = getattr(system["mass"], "shape", None)
    size = int(shape[0]) if shape else len(system["mass"]) if isinstance(system["mass"], (list, tuple)) else None
    if isinstance(initial, Mapping) and size is not None:
        spread = {
            key: np.full(size, float(value)) if isinstance(value, (int, float, np.number)) and not isinstance(value, bool) else value
            for key, value in initial.items()
        }
        initial = scenario["initial"] = spread
        position = initial.get("position")
    potential, force = system.get("potential"), system.get("force")
    terms = Terms(None, None, None, None, None, False)
    if isinstance(potential, Potential) or isinstance(force, Force) or callable(force):
        in_code = (potential if isinstance(potential, Potential) else None, force if not isinstance(force, (str, list, tuple)) else None)
        _, terms, _ = terms_of(*in_code, "system.")
        if in_code[0] is not None:
            start = np.zeros(size or 0) if position is None else np.asarray(position, dtype=np.float64)
            terms = on_its_pattern(terms, system.pop("potential"), start, "system.")
        if in_code[1] is not None:
            del system["force"]
    given = system.get("damping")
    if isinstance(given, Damping) or (isinstance(given, (list, tuple)) and any(isinstance(term, Damping) for term in given)):
        _size_known(size, "system.damping")
        system["damping"] = damping_of(given, size or 0, "system.damping")
    given = system.get("load")
    if given is not None and not isinstance(given, str) and _has(given, Load, "amplitude"):
        _size_known(size, "system.load")
        driven: list[tuple[str, Any, Function]] = []
        system["load"] = loads_of(given, "system.load", "system.load", size or 0, files, driven)
        if not system["load"]:
            del system["load"]
        if driven:
            terms = with_loads(terms, driven)
    given = system.get("element")
    if given is not None and not isinstance(given, str) and _has(given, Element):
        system["element"] = elements_of(given, "system.element")
    watched = Watched()
    given = scenario.get("event")
    if given is not None and not isinstance(given, str) and _has(given, Event, "when"):
        scheme = scenario.get("scheme")
        kind = scheme.get("kind") if isinstance(scheme, Mapping) else scheme
        scenario["event"], watched = events_of(given, "event", kind == "collocation")
    in_use = terms.gradient is not None or terms.force is not None
    return scenario, Functions(terms if in_use else None, watched), files


def _has(given: Any, kind: type, key: str = "") -> bool:
    """Whether the entries contain an object of the package, or a dictionary with a value that no file can contain."""
    if isinstance(given, (kind, Mapping)):
        given = [given]
    if not isinstance(given, Iterable):
        return False
    entries = list(given)
    in_code = (entry.get(key) for entry in entries if isinstance(entry, Mapping))
    return any(isinstance(entry, kind) for entry in entries) or any(
        callable(value) or isinstance(value, (tuple, list)) for value in in_code
    )


def _size_known(size: int | None, key: str) -> None:
    if size is None:
        raise InputError(f"{key}: with objects of fvi in it the mass has to be an array", key)
