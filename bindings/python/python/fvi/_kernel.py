"""Kernels: transfer functions of damping forces."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import ArrayLike

from fvi import _arrays
from fvi._errors import InputError
from fvi._keyed import Keyed
from fvi._types import Real

if TYPE_CHECKING:
    from fvi._exponentials import StateSpace
    from fvi._response import KernelCurves


def _of_bodies(infinite: ArrayLike | None, coordinates: Sequence[int] | None, added_to_mass: bool) -> dict[str, Any]:
    """The keys of kernels of floating bodies."""
    keys: dict[str, Any] = {}
    if infinite is not None:
        keys["infinite"] = np.asarray(_arrays.numbers("infinite", infinite)).tolist()
    if coordinates is not None:
        keys["coordinates"] = [_arrays.whole("coordinates", coordinate, 0) for coordinate in coordinates]
    if not added_to_mass:
        keys["added_to_mass"] = False
    return keys


@final
class Kernel(Keyed):
    """A kernel K(s) in place of s^β: the damping force is −ρ K(D) q.

    Made by `power`, `tempered`, `maxwell`, `prony`, `havriliak_negami`, `distributed`, `symbol`, `relaxation`,
    `relaxation_matrix`, `radiation`, `states` or `weights`;
    accepted by `Damping`, `Memory`, `weights` and `derivative`. A kernel that is not passive, which could feed energy into the
    motion, is refused by `integrate`; the error gives the frequency band. It is allowed if the damping has ``allow_active=True``.

    Examples
    --------
    >>> import fvi
    >>> fvi.Kernel.maxwell(order=0.6, time=1.0)
    Kernel(form='maxwell', order=0.6, inner=0.0, time=1.0)
    >>> fvi.weights(kernel=fvi.Kernel.prony([1.0], [1.0]), step=1.0, count=3)
    array([ 0.5  , -0.25 , -0.125])
    """

    @staticmethod
    def power(order: Real) -> Kernel:
        """s^β, the fractional derivative of order β, 0 ≤ β < 2."""
        return Kernel(form="power", order=_arrays.real("order", order))

    @staticmethod
    def tempered(order: Real, rate: Real) -> Kernel:
        """(s + a)^β − a^β with 0 < β < 2 and a = `rate` ≥ 0: a fractional derivative with a longest relaxation time 1/a."""
        return Kernel(form="tempered", order=_arrays.real("order", order), rate=_arrays.real("rate", rate))

    @staticmethod
    def maxwell(order: Real, time: Real, inner: Real = 0.0) -> Kernel:
        """(τs)^β/(1 + (τs)^(β−α)), 0 ≤ α = `inner` < β ≤ 1: the fractional Maxwell model; with a spring in parallel, the Zener
        model."""
        numbers = {"order": order, "inner": inner, "time": time}
        return Kernel(form="maxwell", **{name: _arrays.real(name, number) for name, number in numbers.items()})

    @staticmethod
    def prony(strengths: ArrayLike, times: ArrayLike) -> Kernel:
        """Σ g τ s/(1 + τ s), a Prony series of strengths g and relaxation times τ > 0."""
        lists = {"strengths": strengths, "times": times}
        numbers = {name: np.atleast_1d(_arrays.numbers(name, given)).tolist() for name, given in lists.items()}
        return Kernel(form="prony", **numbers)

    @staticmethod
    def havriliak_negami(order: Real, power: Real, time: Real) -> Kernel:
        """1 − (1 + (τs)^α)^(−γ), α = `order`, γ = `power`: Cole–Cole with γ = 1, Cole–Davidson with α = 1."""
        numbers = {"order": order, "power": power, "time": time}
        return Kernel(form="havriliak-negami", **{name: _arrays.real(name, number) for name, number in numbers.items()})

    @staticmethod
    def distributed(start: Real = 0.0, stop: Real = 1.0, time: Real = 1.0) -> Kernel:
        """((τs)^b − (τs)^a)/((b − a) ln(τs)), the mean of (τs)^β over all orders β from a = `start` to b = `stop`."""
        numbers = {"from": start, "to": stop, "time": time}
        return Kernel(form="distributed", **{name: _arrays.real(name, number) for name, number in numbers.items()})

    @staticmethod
    def symbol(expression: str) -> Kernel:
        """K(s) by an expression in s, analytic off the negative real axis, such as ``"s^0.6/(1 + s^0.6)"``."""
        if not isinstance(expression, str):
            raise InputError(f"expression = {expression!r}: a text is needed", "expression", repr(expression))
        return Kernel(symbol=expression)

    @staticmethod
    def relaxation(
        t: ArrayLike,
        G: ArrayLike,
        decay: Real | None = None,
        *,
        begin: Real | None = None,
        end: Real | None = None,
        activity: Real | None = None,
    ) -> Kernel:
        """K(s) = s Ĝ(s), the force ∫ G(t − τ) q̇(τ) dτ of a measured relaxation function.

        G is linear between the times t, which begin at 0, and decays like e^{−t/decay} after the last one; without `decay` it
        must be zero there. Up to tolerances, shares of the largest |G|, other numbers are amended, which warnings tell: `begin`,
        the difference of G(0) on the line through the first two rows from the first one, which is later; `end`, what is left at
        the last row, after which a line to 0 follows; `activity`, the smaller of two changes with which the kernel is passive, of
        G(0) alone, or of all rows to a falling convex function.
        """
        times, moduli = np.atleast_1d(_arrays.numbers("t", t)), np.atleast_1d(_arrays.numbers("G", G))
        if times.ndim != 1 or times.shape != moduli.shape:
            raise InputError(f"G: shape {moduli.shape} instead of {times.shape}, that of t", "G", str(moduli.shape))
        keys: dict[str, Any] = {"relaxation": np.column_stack([times, moduli]).tolist()}
        given = {"decay": decay, "begin": begin, "end": end, "activity": activity}
        keys.update({key: _arrays.positive(key, number) for key, number in given.items() if number is not None})
        return Kernel(**keys)

    @staticmethod
    def relaxation_matrix(
        files: Sequence[Sequence[str | os.PathLike[str]]],
        decay: Real | None = None,
        *,
        begin: Real | None = None,
        end: Real | None = None,
        activity: Real | None = None,
        asymmetry: Real | None = None,
    ) -> Kernel:
        """A relaxation function for each pair of coordinates, the force −Σ_j ∫ G_ij(t − τ) q̇_j(τ) dτ: Cummins' equation.

        `files` has N rows of N files with the columns t, G, each as for :meth:`relaxation`, with ``""`` for pairs without
        coupling; G is symmetric, or made so by the mean of G_ij and G_ji where they differ by no more than the share `asymmetry`
        of the largest |G|. The term, ``fvi.Damping(kernel=…)``, has no `coefficient`.
        """
        if isinstance(files, str) or not all(isinstance(row, Sequence) and not isinstance(row, str) for row in files):
            raise InputError(f"files = {files!r}: rows of files are needed", "files", repr(files))
        for entry in (entry for row in files for entry in row):
            if not isinstance(entry, str | os.PathLike):
                raise InputError(f"files: {entry!r}, where the name of a file is needed", "files", repr(entry))
        rows = [[os.path.abspath(entry) if entry != "" else "" for entry in row] for row in files]
        if any(len(row) != len(rows) for row in rows):
            shape = [len(row) for row in rows]
            raise InputError(f"files: rows of {shape} entries instead of {len(rows)} each", "files", repr(shape))
        keys: dict[str, Any] = {"relaxation": rows}
        given = {"decay": decay, "begin": begin, "end": end, "activity": activity, "asymmetry": asymmetry}
        keys.update({key: _arrays.positive(key, number) for key, number in given.items() if number is not None})
        return Kernel(**keys)

    @staticmethod
    def radiation(
        omega: ArrayLike,
        added_mass: ArrayLike | None,
        damping: ArrayLike,
        *,
        infinite: ArrayLike | None = None,
        coordinates: Sequence[int] | None = None,
        added_to_mass: bool = True,
        memory: Real | None = None,
        begin: Real | None = None,
        end: Real | None = None,
        activity: Real | None = None,
        asymmetry: Real | None = None,
        inconsistency: Real | None = None,
    ) -> Kernel:
        """The force −A(∞) q̈ − ∫ K(t − τ) q̇(τ) dτ of radiated waves, K̂(iω) = B(ω) + iω (A(ω) − A(∞)).

        `omega` has n frequencies in rad/s, `added_mass` and `damping` n numbers or n × N × N. A(∞) is `infinite`, or follows
        from A and B; it is added to the mass unless `added_to_mass` is false. `coordinates` are those that rows and columns
        belong to. The tolerances are shares of the largest damping: of what is left at the first and the last row (`begin`,
        `end`), of eigenvalues below 0 (`activity`), of what is not symmetric (`asymmetry`), and of A against B
        (`inconsistency`). The term, ``fvi.Damping(kernel=…)``, has no `coefficient`.
        """
        table: dict[str, Any] = {"omega": np.atleast_1d(_arrays.numbers("omega", omega)).tolist()}
        for name, key, values in (("added_mass", "A", added_mass), ("damping", "B", damping)):
            if values is not None:
                table[key] = np.atleast_1d(_arrays.numbers(name, values)).tolist()
        keys: dict[str, Any] = {"radiation": table, **_of_bodies(infinite, coordinates, added_to_mass)}
        given = {"memory": memory, "begin": begin, "end": end, "activity": activity}
        given |= {"asymmetry": asymmetry, "inconsistency": inconsistency}
        keys.update({key: _arrays.positive(key, number) for key, number in given.items() if number is not None})
        return Kernel(**keys)

    @staticmethod
    def states(
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        D: ArrayLike | None = None,
        *,
        infinite: ArrayLike | None = None,
        coordinates: Sequence[int] | None = None,
        added_to_mass: bool = True,
        activity: Real | None = None,
        asymmetry: Real | None = None,
    ) -> Kernel:
        """The force −A(∞) q̈ − y of equations of states, ẋ = A x + B q̇, y = C x + D q̇, in their poles and residues.

        The term, ``fvi.Damping(kernel=…)``, has no `coefficient`; other arguments as for :meth:`radiation`.
        """
        named = {"A": A, "B": B, "C": C} | ({} if D is None else {"D": D})
        table = {name: np.atleast_2d(_arrays.numbers(name, values)).tolist() for name, values in named.items()}
        keys: dict[str, Any] = {"states": table, **_of_bodies(infinite, coordinates, added_to_mass)}
        given = {"activity": activity, "asymmetry": asymmetry}
        keys.update({key: _arrays.positive(key, number) for key, number in given.items() if number is not None})
        return Kernel(**keys)

    @staticmethod
    def weights(weights: ArrayLike | str | os.PathLike[str], step: Real | None = None) -> Kernel:
        """The memory Σ w_n q_{k−n} with given weights w_0, w_1, …, or those of a file with the columns n, weight.

        They apply to the time step of the run; `step`, if given, must be equal to it. A run of K steps needs K + 1 weights. Since
        K(s) itself is not known, exponential sums, variable steps and Runge–Kutta families are not available.
        """
        keys: dict[str, Any] = {}
        if isinstance(weights, str | os.PathLike):
            keys["weights"] = os.path.abspath(weights)
        else:
            numbers = np.asarray(_arrays.numbers("weights", weights))
            if numbers.ndim != 1 or numbers.size == 0:
                raise InputError(f"weights: shape {numbers.shape} instead of a list of one number at least", "weights", str(numbers.shape))
            keys["weights"] = numbers.tolist()
        if step is not None:
            keys["step"] = _arrays.positive("step", step)
        return Kernel(**keys)

    def curves(self, omega: ArrayLike | None = None) -> KernelCurves:
        """Moduli K(iω), and creep and relaxation at the times 1/ω.

        Parameters
        ----------
        omega : array_like, optional
            Angular frequencies, ascending; default: 200 from 10⁻³ to 10³.

        Returns
        -------
        KernelCurves

        Raises
        ------
        InputError
            If K(s) is not known, as of a kernel given by weights, or is a matrix.

        Examples
        --------
        >>> import fvi
        >>> bool(abs(fvi.Kernel.power(0.5).curves([4.0]).moduli[0] - 2j**0.5 * 2**0.5) < 1e-12)
        True
        """
        from fvi._response import response

        if "weights" in self._keys:
            raise InputError("weights: K(s) is not known from them", "weights", repr(self))
        frequencies = np.geomspace(1e-3, 1e3, 200) if omega is None else np.atleast_1d(_arrays.numbers("omega", omega))
        if frequencies.size == 0:
            raise InputError("omega: no frequencies", "omega", repr(omega))
        term: dict[str, Any] = {"kernel": self.keys, "allow_active": True}
        if "states" not in self._keys:
            term["coefficient"] = [1.0]
        elif (rows := len(self._keys["states"]["C"])) > 1:
            raise InputError(f"states: K(s) is a matrix of {rows} rows; `response` shows what it does to a system", "states", str(rows))
        time = {"step": float(np.pi / frequencies.max()), "steps": 1, "allow_unstable": True}
        scenario = {"system": {"mass": [1.0], "stiffness": [1.0], "damping": [term]}, "time": time}
        return response(scenario, frequencies).kernels[0]

    def state_space(
        self, step: float, *, order: int = 1, band: Sequence[float] | None = None, tolerance: float = 1e-12
    ) -> StateSpace:
        """K(D) at equal steps as a system of first order: that of `exponentials`, for other programs.

        Parameters
        ----------
        step : float
            h > 0.
        order : int
            Order of the backward differentiation formula, 1 to 6.
        band, tolerance
            As in `exponentials`: a band of frequencies needs fewer states.

        Returns
        -------
        StateSpace
            The matrices A, B, C, D of x_{k+1} = A x_k + B u_k, y_k = C x_k + D u_k, for samples u_k from a state of rest.

        Raises
        ------
        InputError
            As `exponentials`.

        Examples
        --------
        >>> import fvi
        >>> A, B, C, D = fvi.Kernel.prony([1.0], [0.5]).state_space(step=0.1)
        >>> round(float(D[0, 0]), 4)
        0.8333
        """
        from fvi._exponentials import exponentials

        return exponentials(kernel=self, step=step, order=order, band=band, tolerance=tolerance).state_space()

    def plot(self, omega: ArrayLike | None = None, axes: Any = None, *, unit: str = "", time_unit: str = "") -> Any:
        """Draws moduli, loss factor, creep and relaxation, as `KernelCurves.plot`.

        Parameters
        ----------
        omega : array_like, optional
            As in `curves`.
        axes, unit, time_unit
            As in `KernelCurves.plot`.

        Returns
        -------
        sequence of three matplotlib axes
            With their `figure`, and its `savefig`.
        """
        return self.curves(omega).plot(axes, unit=unit, time_unit=time_unit)

    def _repr_html_(self) -> str:
        """The kernel and its parameters, for notebooks."""
        from fvi._result import html_table

        return html_table(self._keys, [[str(value)[:200] for value in self._keys.values()]])

    def __repr__(self) -> str:
        return f"Kernel({', '.join(f'{name}={value!r}' for name, value in self._keys.items())})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Kernel) and self._keys == other._keys

    def __hash__(self) -> int:
        return hash(repr(self))
