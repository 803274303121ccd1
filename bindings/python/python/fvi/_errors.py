"""The exceptions of the package."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from difflib import get_close_matches
from functools import wraps
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class InputError(ValueError):
    """An argument, or a key of a scenario, that cannot be used.

    Attributes
    ----------
    key : str
        The argument, or the key as a path such as ``system.damping[0].order``; empty for a file as a whole.
    value : str
        The value given, as text.

    Examples
    --------
    >>> import fvi
    >>> try:
    ...     fvi.weights(exponent=2.5, step=0.01, count=3)
    ... except fvi.InputError as error:
    ...     print(error.key, error.value)
    exponent 2.5
    """

    key: str
    value: str

    def __init__(self, message: str, key: str = "", value: str = "") -> None:
        super().__init__(message)
        self.key = key
        self.value = value

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        return type(self), (str(self), self.key, self.value)


class StepError(RuntimeError):
    """A step failed, or a run ended early for another reason.

    Attributes
    ----------
    result : Result, dict of Result or None
        What was computed until then; for load cases a dictionary by their names.
    """

    result: Any

    def __init__(self, message: str, result: Any = None) -> None:
        super().__init__(message)
        self.result = result

    def __reduce__(self) -> tuple[type[StepError], tuple[str, Any]]:
        return type(self), (str(self), self.result)


def suggesting(function: Callable[P, R]) -> Callable[P, R]:
    """A function that tells a misspelt argument by the name that was meant."""
    known = inspect.signature(function).parameters
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in known.values()):
        raise TypeError(f"{function.__qualname__} takes any keyword")

    @wraps(function)
    def called(*args: P.args, **keywords: P.kwargs) -> R:
        for name in keywords:
            if name not in known:
                near = get_close_matches(name, known, 1)
                advice = f"; did you mean {near[0]}?" if near else ""
                called_by = function.__qualname__.removesuffix(".__init__").removesuffix(".__new__")
                raise TypeError(f"{called_by}() got an unexpected keyword argument {name!r}{advice}")
        return function(*args, **keywords)

    return called


C = TypeVar("C", bound=type)


def suggesting_class(made: C) -> C:
    """A class whose constructor does."""
    if "__new__" in vars(made):
        setattr(made, "__new__", staticmethod(suggesting(made.__new__)))
    else:
        setattr(made, "__init__", suggesting(getattr(made, "__init__")))
    return made
