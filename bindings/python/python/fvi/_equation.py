"""Fractional differential equations."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fvi import _arrays, _fvi
from fvi._errors import InputError, suggesting
from fvi._result import ending
from fvi._run import Progress, _outside, check_progress, raise_with, raised_in
from fvi._scenario import source
from fvi._terms import Event, Function, Terms
from fvi._types import FloatArray, Real, Whole


@dataclass(frozen=True, repr=False, eq=False)
class Solution:
    """The solution of a fractional differential equation.

    Attributes
    ----------
    t : ndarray
        Times: those of `t_eval`, or of the steps.
    x : ndarray, rows × unknowns
        Unknowns at these times.
    success : bool
        Whether the end, or an event that ends the solution, was reached.
    status : int
        0 at the end, 1 at an event that ends the solution, −1 where no step could be made.
    message : str
        How it ended.
    t_events, x_events : list of ndarray
        Times of each event, and the unknowns there, row by row.
    steps : int
        Steps made.
    warnings : tuple of str
        Warnings; they are issued as well.
    """

    t: FloatArray
    x: FloatArray
    success: bool
    status: int
    message: str
    t_events: list[FloatArray]
    x_events: list[FloatArray]
    steps: int
    warnings: tuple[str, ...]
    _record: str = field(repr=False)

    @property
    def summary(self) -> dict[str, Any]:
        """The record of the run, with the inputs as used."""
        record: dict[str, Any] = json.loads(self._record)
        return record

    def __repr__(self) -> str:
        rows, unknowns = self.x.shape
        span = f", t = {self.t[0]:g} … {self.t[-1]:g}" if rows else ""
        return f"Solution({self.message!r}, {rows} rows of {unknowns} unknown{'s' * (unknowns != 1)}{span})"


@suggesting
def solve_fde(
    right: Function | str | Sequence[str],
    order: float | Sequence[float] | None,
    span: float | Sequence[float],
    initial: ArrayLike | Sequence[Any],
    rtol: Real = 1e-6,
    t_eval: ArrayLike | None = None,
    args: tuple[Any, ...] = (),
    *,
    terms: Sequence[Any] | None = None,
    derivative: str = "caputo",
    derivatives: Mapping[str, Any] | Sequence[Any] | None = None,
    jac: Function | None = None,
    events: Any = (),
    parameters: Mapping[str, float] | None = None,
    scale: Real | None = None,
    max_step: Real | None = None,
    must_hit: ArrayLike | None = None,
    stages: Whole | None = None,
    progress: Progress | None = None,
) -> Solution:
    """Solves D^α x = f(t, x) for one or several unknowns, with steps chosen for a tolerance.

    Parameters
    ----------
    right : callable or list of str
        f(t, x, *args), which returns a number for each unknown, with `derivatives` f(t, x, d, *args); or an expression for each in
        t, x0, x1, …, the names of derivatives and the parameters.
        Expressions are faster by far, and have exact derivatives.
    order : float or list of float
        α > 0, one for all unknowns or one for each; `None` with `terms`.
    span : (float, float) or float
        The start t₀, where the derivatives begin, and the end; or the end alone, from 0. Expressions need t₀ = 0.
    initial : array_like
        x(t₀) of each unknown; for orders above 1 a list [x(t₀), x'(t₀), …] for each, as many values as the order rounded up.
    rtol : float
        Error allowed, from 1e-13 to 0.1, relative to the largest value of an unknown so far or, while that is smaller, to `scale`.
    t_eval : array_like, optional
        Increasing times of the rows; default: the steps.
    args : tuple
        Further arguments of the functions.
    terms : list, optional
        In place of `order`, for Σ a_j D^{α_j} x = f: for each equation a list of pairs (α, a), or of dictionaries with `order` and
        `coefficient`; for one unknown the list alone.
    derivative : {"caputo", "riemann-liouville"}
        The derivative.
    derivatives : mapping or list, optional
        Derivatives D^s x_i that f depends on, of orders below the largest of their unknown: {name: (i, s)} for expressions, a list
        of pairs (i, s), or such a mapping, for a function, whose argument d has their values in this sequence.
    jac : callable, optional
        ∂f/∂x(t, x, *args), a matrix; with `derivatives` (∂f/∂x, ∂f/∂d)(t, x, d, *args), side by side. Default: differences.
    events : callable, Event or list of them, optional
        Functions event(t, x, *args) whose zero crossings are found, with the attributes `terminal` (True or False) and
        `direction` of `scipy.integrate.solve_ivp`; or `Event` objects with expressions in t, x0, ….
    parameters : mapping, optional
        Named constants of the expressions.
    scale : float, optional
        Size of unknowns below which errors are absolute; default: 1.
    max_step : float, optional
        The longest step.
    must_hit : array_like, optional
        Increasing times where steps end: those of jumps and kinks of a function. Those of expressions are known, and jumps that a
        function shows near the ends of steps are found; one that is smaller than what the function changes on a step anyway, or
        narrower than a step, is seen at these times only.
    stages : {1, 2, 3, 5, 7}, optional
        Stages of the Radau IIA method, of order 2 stages − 1; default: by `rtol`.
    progress : callable, optional
        As in `run`.

    Returns
    -------
    Solution
        With `success` false, and the reason in `message`, where the solution could not be continued to the end, as at a blow-up.

    Raises
    ------
    InputError
        If an argument cannot be used; its `key` names it.
    Exception
        An exception raised by a function, with its traceback.

    Examples
    --------
    >>> import numpy as np, fvi
    >>> r = fvi.solve_fde(lambda t, x: -x, 0.5, (0, 1), [1.0], rtol=1e-8, t_eval=[0.0, 0.25, 1.0])
    >>> np.round(r.x[:, 0], 6)
    array([1.      , 0.61569 , 0.427584])
    >>> r = fvi.solve_fde(["-k*x0"], 1.8, (0, 10), [[1.0, 0.0]], parameters={"k": 4.0})
    >>> r.success, r.x.shape[1]
    (True, 1)
    """
    begin, end = _span(span)
    expressions = [right] if isinstance(right, str) else None
    if expressions is None and not callable(right):
        if not isinstance(right, Iterable) or isinstance(right, (bytes, Mapping)):
            raise InputError(f"right = {right!r}: a function, or a list of expressions, is needed", "right", repr(right))
        expressions = list(right)
        for index, text in enumerate(expressions):
            if not isinstance(text, str):
                place = f"right[{index}]"
                raise InputError(f"{place} = {text!r}: an expression in quotes is needed, or one function for all", place, repr(text))
    if expressions is not None and begin != 0.0:
        message = f"span[0] = {begin}: expressions count the time from 0, where the derivatives begin; give a function for another start"
        raise InputError(message, "span[0]", str(begin))
    if not isinstance(args, (tuple, list)):
        raise InputError(f"args = {args!r}: a tuple is needed", "args", repr(args))
    if expressions is not None and args and not _has_functions(events):
        raise InputError("args: belong to functions; expressions have parameters", "args", repr(args))
    if not isinstance(derivative, str):
        raise InputError(f"derivative = {derivative!r}: a text is needed", "derivative", repr(derivative))
    if jac is not None and not callable(jac):
        raise InputError(f"jac = {jac!r}: a function is needed", "jac", repr(jac))
    if terms is not None and (isinstance(terms, (str, bytes)) or not isinstance(terms, (Sequence, np.ndarray))):
        raise InputError(f"terms = {terms!r}: a list of terms is needed", "terms", repr(terms))
    if np.ndim(order if order is not None else 0.0) > 1 or isinstance(order, (str, bytes)):
        raise InputError(f"order = {order!r}: a number, or one for each unknown, is needed", "order", repr(order))
    if order is not None and np.ndim(order) == 0:
        order = _arrays.real("order", order)
    equation: dict[str, Any] = {"derivative": derivative}
    if (order is None) == (terms is None):
        raise InputError("order: give either an order or terms", "order", repr(order))
    values = _initial(initial)
    count = len(expressions) if expressions is not None else _unknowns(order, terms, values)
    if count == 1 and values and not isinstance(values[0], list):
        values = [values]
    equation["initial"] = values
    equation["right"] = expressions if expressions is not None else ["0"] * count
    if terms is not None:
        equation["terms"] = _terms(terms, count)
    else:
        assert order is not None
        equation["order"] = order if np.ndim(order) == 0 else [float(number) for number in _arrays.numbers("order", order)]
    named = _derivatives(derivatives, expressions is not None)
    if named:
        equation["derivatives"] = named
    if parameters is not None:
        if not isinstance(parameters, Mapping):
            raise InputError(f"parameters = {parameters!r}: names with numbers are needed", "parameters", repr(parameters))
        equation["parameters"] = {name: _arrays.real(f"parameters.{name}", value) for name, value in parameters.items()}
    time: dict[str, Any] = {"end": end - begin, "tolerance": _arrays.real("rtol", rtol)}
    if scale is not None:
        time["scale"] = _arrays.real("scale", scale)
    if max_step is not None and max_step != np.inf:
        time["longest"] = _arrays.real("max_step", max_step)
    scenario: dict[str, Any] = {"equation": equation, "time": time}
    if stages is not None:
        scenario["convolution"] = {"stages": _arrays.whole("stages", stages, 1)}
    if t_eval is not None:
        scenario["output"] = {"times": _times("t_eval", t_eval, (begin, end))}
    if must_hit is not None:
        # At both ends of the span steps end anyway.
        time["must_hit"] = [at for at in _times("must_hit", must_hit, (begin, end)) if 0.0 < at < end - begin]
    described, watched = _events(events, begin, args, count)
    if described:
        scenario["event"] = described
    functions = None
    if expressions is None and callable(right):
        function = _shifted(right, begin, args)
        slopes = None if jac is None else _shifted(jac, begin, args)
        if slopes is not None and not named:
            slopes = _of_numbers(slopes, begin, count)
        if named:
            function = _of_derivatives("right", right, begin, args, (count, len(named)))
            slopes = None if jac is None else _of_derivatives("jac", jac, begin, args, (count, len(named)))
        if (shortest := _shortest(function, equation, time)) is not None:
            time["shortest"] = shortest
        functions = Terms(None, None, None, function, slopes, True)
    elif jac is not None:
        raise InputError("jac: belongs to a function; expressions have their own derivatives", "jac", repr(jac))
    try:
        motions, raised, _ = _fvi.run(
            source(scenario, {}), precision="f64", progress=check_progress(progress), terms=functions, events=watched, keep=False
        )
    except InputError as error:
        raise _named(error, begin) from None
    ((_, (t, x, *_), ended, summary),) = motions
    record = summary.json()
    t, x = _increasing(t + begin, x)
    solution = _solution(t, x, json.loads(ended), record, len(described), begin)
    if raised is not None:
        solution = replace(solution, message=raised_in(raised, t))
        raise_with(_named(raised, begin) if isinstance(raised, InputError) else raised, solution)
    for warning in solution.warnings:
        warnings.warn(warning, stacklevel=_outside())
    return solution


def _increasing(t: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rows at times that numbers tell apart: behind a start other than 0 the first steps are shorter. The first row stays, and
    else the last of several at one time."""
    last = np.append(t[1:] > t[:-1], True)
    last[t == t[0]] = False
    last[0] = True
    return (t, x) if last.all() else (t[last], x[last])


def _solution(t: FloatArray, x: FloatArray, ended: Mapping[str, Any], record: str, events: int, begin: float) -> Solution:
    status, message = ending(ended)
    for path, name in NAMES:
        message = message.replace(f"`{path}`", f"`{name}`")
    happened: list[list[tuple[float, Any]]] = [[] for _ in range(events)]
    for event in json.loads(record).get("events", []) if events else []:
        happened[event["event"]].append((event["time"] + begin, event["x"]))
    t_events = [np.array([time for time, _ in one]) for one in happened]
    x_events = [np.array([values for _, values in one]).reshape(len(one), x.shape[1]) for one in happened]
    success = status == 0
    if ended["status"] == "event":
        status = 1
    return Solution(t, x, success, status, _later(message, begin), t_events, x_events, ended["steps"], tuple(ended.get("warnings", ())), record)


def _times(name: str, times: ArrayLike, span: tuple[float, float]) -> list[float]:
    """Times within the span, from its begin on."""
    numbers = _arrays.numbers(name, times)
    begin, end = span
    if numbers.ndim != 1:
        raise InputError(f"{name}: shape {numbers.shape} instead of a list of times", name, str(numbers.shape))
    for index, at in enumerate(numbers):
        if not begin <= at <= end:
            place = f"{name}[{index}]"
            raise InputError(f"{place} = {at:g}: not allowed; allowed: {begin:g} ≤ t ≤ {end:g}, the span", place, str(at))
    return [float(at) - begin for at in numbers]


def _span(span: Any) -> tuple[float, float]:
    if np.ndim(span) == 0:
        return 0.0, _arrays.real("span", span)
    numbers = _arrays.numbers("span", span)
    if numbers.shape != (2,) or not numbers[1] > numbers[0]:
        raise InputError(f"span = {span!r}: (start, end) with a later end is needed", "span", repr(span))
    return float(numbers[0]), float(numbers[1])


def _initial(initial: Any) -> list[Any]:
    """Initial values: a number, or a list of them, for each unknown."""
    if np.ndim(initial) == 0 if not isinstance(initial, (list, tuple)) else False:
        return [_arrays.real("initial", initial)]
    values: list[Any] = []
    for index, value in enumerate(initial):
        place = f"initial[{index}]"
        if isinstance(value, (list, tuple, np.ndarray)) and np.ndim(value) > 0:
            numbers = _arrays.numbers(place, value)
            if numbers.ndim != 1:
                raise InputError(f"{place}: shape {numbers.shape} instead of a list of numbers", place, str(numbers.shape))
            values.append([float(number) for number in numbers])
        else:
            values.append(_arrays.real(place, value))
    return values


def _unknowns(order: Any, terms: Any, initial: Sequence[Any]) -> int:
    """Number of unknowns of a function: that of orders or terms, or of initial values."""
    if order is not None and np.ndim(order) > 0:
        return len(order)
    if terms is not None:
        return 1 if len(terms) and _is_term(terms[0]) else len(terms)
    nested = any(isinstance(value, list) for value in initial)
    # One unknown of an order above 1 may have its values in one list.
    return 1 if order is not None and order > 1 and not nested else len(initial)


def _is_term(entry: Any) -> bool:
    """Whether it is a term, and not a list of terms."""
    if not isinstance(entry, (Mapping, Sequence, np.ndarray)):
        raise InputError(f"terms: {entry!r} in place of a pair (order, coefficient), or a list of them", "terms", repr(entry))
    return isinstance(entry, Mapping) or (len(entry) == 2 and not any(isinstance(part, (Mapping, Sequence, np.ndarray)) for part in entry))


def _terms(terms: Sequence[Any], count: int) -> list[Any]:
    def one(term: Any, place: str) -> dict[str, Any]:
        if isinstance(term, Mapping):
            return dict(term)
        pair = _arrays.numbers(place, term)
        if pair.shape != (2,):
            raise InputError(f"{place} = {term!r}: a pair (order, coefficient) is needed", place, repr(term))
        return {"order": float(pair[0]), "coefficient": float(pair[1])}

    if count == 1 and len(terms) and _is_term(terms[0]):
        return [[one(term, f"terms[{index}]") for index, term in enumerate(terms)]]
    return [[one(term, f"terms[{row}][{index}]") for index, term in enumerate(of_row)] for row, of_row in enumerate(terms)]


def _derivatives(given: Any, by_name: bool) -> dict[str, Any]:
    """Derivatives as a table of an equation, for functions under names of their sequence."""
    if given is None:
        return {}
    if not isinstance(given, Mapping) and (by_name or isinstance(given, str) or not isinstance(given, Iterable)):
        raise InputError("derivatives: {name: (unknown, order)} is needed, whose names the expressions use", "derivatives", repr(given))
    table: dict[str, Any] = {}
    entries = given.items() if isinstance(given, Mapping) else ((f"[{index}]", entry) for index, entry in enumerate(given))
    for index, (name, entry) in enumerate(entries):
        place = f"derivatives[{name!r}]" if isinstance(given, Mapping) else f"derivatives{name}"
        if isinstance(entry, Mapping):
            content = dict(entry)
            if "order" in content:
                content["order"] = _arrays.real(f"{place}['order']", content["order"])
        elif isinstance(entry, (tuple, list)) and len(entry) == 2:
            content = {"of": entry[0], "order": _arrays.real(f"{place}[1]", entry[1])}
        else:
            raise InputError(f"{place} = {entry!r}: a pair (unknown, order) is needed", place, repr(entry))
        if "of" in content and not isinstance(content["of"], str):
            content["of"] = f"x{_arrays.whole(place, content['of'], 0)}"
        if not isinstance(name, str):
            raise InputError(f"{place}: a name is a text", place, repr(name))
        table[name if by_name else f"d{index:04}"] = content
    return table


def _of_derivatives(key: str, function: Callable[..., Any], begin: float, args: tuple[Any, ...], sizes: tuple[int, int]) -> Function:
    """A function of (t, x, d) as one of time and coordinates, of which the derivatives d are the last and nothing pushes them."""
    count, further = sizes
    shape = (count, count + further) if key == "jac" else (count,)

    def of_coordinates(t: float, q: FloatArray) -> FloatArray:
        values = _arrays.returned(key, function(t + begin, q[:count], q[count:], *args))
        if values.size != np.prod(shape):
            raise InputError(f"{key}: returned {values.size} numbers instead of {' × '.join(map(str, shape))}", key, str(values.shape))
        values = values.reshape(shape)
        return np.concatenate([values, np.zeros((further, *shape[1:]))])

    return of_coordinates


MOST = 100.0
"""Size of a function at the start beyond which the shortest step is chosen for it; expressions are looked at by the reader."""


def _shortest(right: Function, equation: Mapping[str, Any], time: Mapping[str, Any]) -> float | None:
    """The shortest step for a function that is large at the start, where the solution begins like f t^α."""
    values = [value if isinstance(value, list) else [value] for value in equation["initial"]]
    if not all(values):
        return None
    start = [value[0] for value in values]
    for one in equation.get("derivatives", {}).values():
        # A derivative of whole order begins at its own value; what is wrong here is told by the reader.
        of, order = str(one.get("of", ""))[1:], float(one.get("order", 0.0))
        if not of.isdecimal() or int(of) >= len(values):
            return None
        whole = order == int(order) and int(order) < len(values[int(of)])
        start.append(values[int(of)][int(order)] if whole else 0.0)
    size = np.abs(_arrays.returned("right", right(1e-12 * time["end"], np.array(start))))
    if not np.isfinite(size).all() or size.max(initial=0.0) < MOST:
        return None
    if not all(row and all("order" in term for term in row) for row in equation.get("terms", [])):
        return None
    orders = [max(term["order"] for term in row) for row in equation["terms"]] if "terms" in equation else np.atleast_1d(equation["order"])
    power = min(1.0, *(float(order) for order in orders), 1.0)
    most = 10.0 * float(size.max()) * time["end"] ** power / time.get("scale", 1.0)
    return float(time["end"] * max(1e-140, min(1e-12, (0.03 * time["tolerance"] / most) ** (1.0 / power))))


TIMES = re.compile(r"\bt = ([-+]?[0-9.]+(?:e[-+]?[0-9]+)?)")


def _later(text: str, begin: float) -> str:
    """A message with times as the caller counts them."""
    return TIMES.sub(lambda found: f"t = {float(found[1]) + begin:.10g}", text) if begin != 0.0 else text


def _of_numbers(slopes: Function, begin: float, count: int) -> Function:
    """∂f/∂x whose entries are numbers, or infinite."""

    def of_numbers(t: float, x: FloatArray) -> Any:
        values = _arrays.returned("jac", slopes(t, x))
        if np.isnan(values).any():
            raise InputError(f"jac: returned not a number at t = {t + begin:g}, x = {x[:count]}", "jac", "nan")
        return values

    return of_numbers


def _shifted(function: Function, begin: float, args: tuple[Any, ...]) -> Function:
    """A function of (t, x) whose time counts from the start."""
    if begin == 0.0 and not args:
        return function
    return lambda t, x: function(t + begin, x, *args)


def _has_functions(events: Any) -> bool:
    """Whether any of the events is a function."""
    several = events if isinstance(events, (tuple, list)) else [events]
    return any(callable(event) or callable(getattr(event, "when", None)) for event in several)


def _events(given: Any, begin: float, args: tuple[Any, ...], count: int) -> tuple[list[dict[str, Any]], list[Any]]:
    """Events as entries of a scenario, and their functions."""
    several: Iterable[Any] = [given] if callable(given) or isinstance(given, (Event, Mapping)) else () if given is None else given
    if not isinstance(several, Iterable):
        raise InputError(f"events = {given!r}: functions of (t, x), or fvi.Event, are needed", "events", repr(given))
    entries: list[dict[str, Any]] = []
    watched: list[Any] = []
    for index, event in enumerate(several):
        if isinstance(event, Event):
            event = {"when": event.when, "direction": event.direction, "action": event.action}
        elif callable(event):
            sign = _arrays.real(f"events[{index}].direction", getattr(event, "direction", 0.0))
            direction = "rising" if sign > 0 else "falling" if sign < 0 else "both"
            terminal = getattr(event, "terminal", False)
            if terminal not in (False, True):
                place, reason = f"events[{index}].terminal", "True stops at the first crossing; later ones are recorded, not counted"
                raise InputError(f"{place} = {terminal!r}: {reason}", place, repr(terminal))
            action = "stop" if terminal else "record"
            event = {"when": event, "direction": direction, "action": action}
        elif not isinstance(event, Mapping):
            place = f"events[{index}]"
            raise InputError(f"{place} = {event!r}: a function of (t, x) or a fvi.Event is needed", place, repr(event))
        event = dict(event)
        function = None
        if callable(when := event.get("when")):
            # A placeholder expression for the function.
            event["when"], function = "t - 1", _of_unknowns(when, begin, args, count)
        elif isinstance(when, str) and begin != 0.0:
            event["when"] = re.sub(r"\bt\b", f"(t + {begin!r})", when)
        entries.append(event)
        watched.append(function)
    return entries, watched


def _of_unknowns(when: Function, begin: float, args: tuple[Any, ...], count: int) -> Callable[[float, FloatArray, FloatArray], Any]:
    def of_unknowns(t: float, x: FloatArray, _: FloatArray) -> Any:
        value = when(t + begin, x[:count], *args)
        # No crossing would ever be seen.
        if np.ndim(value) == 0 and isinstance(value, (float, np.floating)) and np.isnan(value):
            raise InputError(f"events: returned not a number at t = {t + begin:g}, x = {x[:count]}", "events", "nan")
        return value

    return of_unknowns


NAMES = (
    ("equation.", ""),
    ("time.tolerance", "rtol"),
    ("time.end", "span"),
    ("time.longest", "max_step"),
    ("time.scale", "scale"),
    ("time.must_hit", "must_hit"),
    ("convolution.stages", "stages"),
    ("output.times", "t_eval"),
    ("event", "events"),
    ("force.jacobian", "jac"),
    ("force", "right"),
)
"""Keys of a scenario, and the arguments that they come from."""


def _named(error: InputError, begin: float = 0.0) -> InputError:
    """An error about a key of a scenario, as one about the argument that it came from, with times as the caller counts them."""
    if begin != 0.0:
        error = InputError(_later(str(error), begin), error.key, error.value).with_traceback(error.__traceback__)
    if error.key == "potential":
        # What the functions have returned at the start.
        text = str(error).partition("is not finite")[2].replace("q =", "x =")
        return InputError(f"right: is not finite{text}", "right", error.value)
    if "derivatives.d0" in error.key:
        # Derivatives of functions have no names.
        shown = [re.sub(r"derivatives\.d(\d{4})", lambda found: f"derivatives[{int(found[1])}]", text) for text in (str(error), error.key)]
        error = InputError(shown[0], shown[1], error.value).with_traceback(error.__traceback__)
    for path, name in NAMES:
        if error.key.startswith(path) and not error.key.startswith(f"{path}s"):
            key = name + error.key[len(path) :]
            text = str(error).replace(error.key, key).replace("equation.", "")
            return InputError(text, key, error.value).with_traceback(error.__traceback__)
    return error
