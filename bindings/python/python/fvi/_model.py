"""Systems that are integrated several times."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from fvi import _arrays, _fvi
from fvi._errors import InputError
from fvi._integrate import _integrated, integrate
from fvi._result import Result
from fvi._scenario import ready
from fvi._terms import Damping

RIVALS = {"velocity": "momentum", "momentum": "velocity", "steps": "end", "end": "steps"}
"""Arguments that say the same in another way: the one given takes the place of the other."""

OPTIONS = ("precision", "check", "progress", "keep_memory")


class Model:
    """A system that is integrated several times, with other loads, initial states or damping coefficients.

    Work common to the runs is done once: reading and checking matrices, symbolic factorisation, and the numerical factorisation
    where the matrix of the step is the same, as for other loads and initial states. A damping coefficient that is a multiple of
    an earlier one needs no check either. Results are bit-identical to those of `integrate`.

    Parameters
    ----------
    mass : array_like or sparse matrix
        As in `integrate`.
    **arguments
        Other arguments of `integrate`, as defaults for its calls.

    Notes
    -----
    Large matrices are copied: later changes of the arrays have no effect. A model keeps its last matrices and factors, two for
    each sparsity pattern, until it is deleted.

    Examples
    --------
    Which damping has the tip of a chain at rest soonest?

    >>> import numpy as np, fvi
    >>> chain = fvi.Model(mass=np.ones(3), stiffness=[[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]],
    ...                   position=[0.1, 0.2, 0.3], step=0.05, end=20.0)
    >>> left = [chain.integrate(damping=fvi.Damping(0.5, rho * np.ones(3))).energy[-1] for rho in (0.1, 0.4)]
    >>> bool(left[1] < left[0])
    True
    """

    def __init__(self, *, mass: Any, **arguments: Any) -> None:
        self._arguments: dict[str, Any] = {}
        self._prepared = _fvi.Prepared()
        mass = ready("mass", mass, None)
        self._size: int | None = None if mass.shape == (1,) else mass.shape[0]
        self._arguments = self._taken({"mass": mass, **arguments})

    def integrate(self, **changes: Any) -> Result:
        """Integrates it.

        Parameters
        ----------
        **changes
            Arguments of `integrate`, in addition to the model's own or in place of them.

        Returns
        -------
        Result

        Raises
        ------
        InputError, StepError, Exception
            As `integrate`.
        """
        if changes.get("continue_from") is not None:
            # The result itself refers to its system and to the data prepared for it.
            return integrate(**changes)
        arguments = self._merged(self._taken(changes))
        arguments.pop("continue_from")
        options = {name: arguments.pop(name) for name in OPTIONS}
        return _integrated(arguments, prepared=self._prepared, **options)

    def _taken(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Arguments with large matrices converted once."""
        taken = dict(given)
        if taken.get("stiffness") is not None:
            taken["stiffness"] = ready("stiffness", taken["stiffness"], self._size)
        if isinstance(terms := taken.get("damping"), (Damping, Mapping)):
            taken["damping"] = terms = [terms]
        if isinstance(terms, (list, tuple)):
            taken["damping"] = [self._damping(f"damping[{index}]", term) for index, term in enumerate(terms)]
        return taken

    def _damping(self, place: str, term: Any) -> Any:
        if isinstance(term, Damping) and _is_large(term.coefficient):
            coefficient = ready(f"{place}.coefficient", term.coefficient, self._size)
            return replace(term, coefficient=coefficient)
        return term

    def _merged(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """The arguments of a call, merged with those of the model."""
        own = {name: value for name, value in self._arguments.items() if RIVALS.get(name) not in changes}
        try:
            bound = inspect.signature(integrate).bind(**{**own, **changes})
        except TypeError as error:
            raise InputError(f"{error}; the model has {', '.join(self._arguments)}", "position") from None
        bound.apply_defaults()
        return dict(bound.arguments)

    def __repr__(self) -> str:
        size = "any number of" if self._size is None else str(self._size)
        return f"Model({size} coordinates; {', '.join(self._arguments)})"


def _is_large(given: Any) -> bool:
    return _arrays.is_sparse(given) or getattr(given, "ndim", 0) == 2
