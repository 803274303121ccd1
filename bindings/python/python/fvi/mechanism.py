"""Mechanisms in words: kinetic energies, constraints and elongations of common ones, and pictures of their motion.

Each function returns keywords for `fvi.integrate`, `fvi.System` and `fvi.Model`; what they take beside them (damping, start,
steps) is added there:

>>> import fvi
>>> from fvi import mechanism
>>> arm = mechanism.pendulum_chain([1.0, 0.7], [1.0, 0.8])
>>> joints = [fvi.Damping(0.5, 1.2, along=joint) for joint in mechanism.joints(2)]
>>> r = fvi.integrate(**arm, damping=joints, position=[1.0, 1.6], step=0.02, end=1.0, scheme="galerkin", degree=2)
>>> r.q.shape
(51, 2)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fvi._errors import InputError
from fvi._result import Picture, Result, new_axes

__all__ = [
    "angle",
    "body_rates",
    "distance",
    "joints",
    "pendulum_chain",
    "pendulum_points",
    "quaternion_rates",
    "rigid_body",
    "rotation",
    "stroboscope",
    "truss",
]

_GRAVITY = 9.81


def _numbers(values: ArrayLike, name: str, *, positive: bool = True) -> list[float]:
    found = np.asarray(values, dtype=float)
    if found.ndim != 1 or found.size == 0 or not np.isfinite(found).all() or (positive and (found <= 0).any()):
        allowed = "a list of positive numbers" if positive else "a list of finite numbers"
        raise InputError(f"{name} = {values!r}: not allowed; allowed: {allowed}", name, str(values))
    return [float(number) for number in found]


def _sum(terms: Iterable[str]) -> str:
    return " + ".join(terms) or "0"


def pendulum_chain(lengths: ArrayLike, masses: ArrayLike, *, gravity: float = _GRAVITY) -> dict[str, Any]:
    """A chain of point masses on massless rods in a vertical plane, by the angles q0, q1, … of the rods from the vertical.

    Parameters
    ----------
    lengths, masses : array_like of n positive numbers
        Of the rods, from the suspension on, and at their ends.
    gravity : float
        Its acceleration, downwards.

    Returns
    -------
    dict
        `kinetic`, T = ½ Σ_jk M_jk cos(q_j − q_k) v_j v_k with M_jk = l_j l_k Σ_{i ≥ max(j, k)} m_i, and `potential`.

    Examples
    --------
    >>> from fvi import mechanism
    >>> mechanism.pendulum_chain([0.5], [2.0], gravity=10.0)
    {'kinetic': '0.25*v0^2', 'potential': '-10.0*cos(q0)'}
    """
    rods, ends = _numbers(lengths, "lengths"), _numbers(masses, "masses")
    if len(rods) != len(ends):
        raise InputError(f"masses: {len(ends)} numbers; allowed: {len(rods)}, one for each length", "masses", str(masses))
    carried = np.cumsum(ends[::-1])[::-1]
    kinetic = [f"{0.5 * float(carried[j]) * rods[j] ** 2!r}*v{j}^2" for j in range(len(rods))]
    for k in range(len(rods)):
        for j in range(k):
            kinetic.append(f"{float(carried[k]) * rods[j] * rods[k]!r}*v{j}*v{k}*cos(q{j} - q{k})")
    potential = [f"{-gravity * float(carried[j]) * rods[j]!r}*cos(q{j})" for j in range(len(rods))]
    return {"kinetic": _sum(kinetic), "potential": _sum(potential)}


def joints(count: int) -> list[str]:
    """The angles of the joints of a chain whose links have the angles q0, q1, …: q0, q1 − q0, q2 − q1, …

    Examples
    --------
    >>> from fvi import mechanism
    >>> mechanism.joints(3)
    ['q0', 'q1 - q0', 'q2 - q1']
    """
    return ["q0" if joint == 0 else f"q{joint} - q{joint - 1}" for joint in range(count)]


def pendulum_points(lengths: ArrayLike) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """The places of the joints of a chain of `pendulum_chain` for its angles, n + 1 rows of x and y, for `stroboscope`."""
    rods = np.array(_numbers(lengths, "lengths"))

    def points(q: NDArray[np.float64]) -> NDArray[np.float64]:
        steps = np.stack([rods * np.sin(q), -rods * np.cos(q)], axis=1)
        return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])

    return points


def truss(
    masses: Sequence[float | None],
    bars: Iterable[tuple[int, int, float]],
    *,
    fixed: Mapping[int, tuple[float, float]] | None = None,
    gravity: float = _GRAVITY,
) -> dict[str, Any]:
    """Point masses in a vertical plane and rigid massless bars between them: linkages, cables, closed loops.

    Parameters
    ----------
    masses : sequence of float or None
        The mass at each node; None (or any number) at fixed ones.
    bars : iterable of (node, node, length)
        The bars.
    fixed : mapping of node to (x, y), optional
        The nodes that do not move, and where they are.
    gravity : float
        Its acceleration, along −y.

    Returns
    -------
    dict
        `mass`, `potential` and `constraints`. The free nodes have the coordinates q0, q1; q2, q3; … (x and y) in their order.

    Examples
    --------
    A four-bar linkage between two bearings:

    >>> from fvi import mechanism
    >>> bars = [(0, 1, 0.5), (1, 2, 1.2), (2, 3, 1.0)]
    >>> four_bar = mechanism.truss([None, 1.0, 1.0, None], bars, fixed={0: (0.0, 0.0), 3: (1.3, 0.0)})
    >>> four_bar["constraints"][1]
    '(q0 - q2)^2 + (q1 - q3)^2 - 1.44'
    """
    places = _places(len(masses), dict(fixed or {}))
    free = [node for node in range(len(masses)) if node not in (fixed or {})]
    # None is not a number, and is refused at a node that moves.
    weights = _numbers(np.array([masses[node] for node in free], dtype=float), "masses")
    constraints = []
    for index, (one, other, length) in enumerate(bars):
        name = f"bars[{index}]"
        if not (0 <= one < len(masses) and 0 <= other < len(masses) and one != other and length > 0):
            allowed = f"two nodes from 0 to {len(masses) - 1} and a positive length"
            raise InputError(f"{name} = {(one, other, length)}: not allowed; allowed: {allowed}", name, str((one, other, length)))
        if one not in free and other not in free:
            raise InputError(f"{name}: both of its nodes are fixed; allowed: one that moves", name, str((one, other)))
        (x, y), (u, v) = places[one], places[other]
        constraints.append(f"({x} - {u})^2 + ({y} - {v})^2 - {length * length!r}")
    heights = [f"{gravity * weight!r}*{places[node][1]}" for node, weight in zip(free, weights, strict=True)]
    return {
        "mass": [weight for weight in weights for _ in range(2)],
        "potential": _sum(heights) if gravity else "0",
        "constraints": constraints,
    }


def _places(count: int, fixed: Mapping[int, tuple[float, float]]) -> list[tuple[str, str]]:
    """The coordinates of nodes, in words."""
    places, next_coordinate = [], 0
    for node in range(count):
        if node in fixed:
            x, y = fixed[node]
            places.append((f"({float(x)!r})", f"({float(y)!r})"))
        else:
            places.append((f"q{next_coordinate}", f"q{next_coordinate + 1}"))
            next_coordinate += 2
    return places


def distance(one: Sequence[str | float], other: Sequence[str | float]) -> str:
    """The distance of two points whose places are given in words or by numbers, as an elongation.

    Examples
    --------
    >>> from fvi import mechanism
    >>> mechanism.distance(["q0", "q1"], [1.5, 0.2])
    'sqrt((q0 - (1.5))^2 + (q1 - (0.2))^2)'
    """
    if len(one) != len(other) or not one:
        raise InputError("distance: points of two lengths; allowed: two points of as many numbers", "other", str(other))
    return f"sqrt({_sum(f'({_word(a)} - {_word(b)})^2' for a, b in zip(one, other, strict=True))})"


def angle(one: Sequence[str | float], other: Sequence[str | float]) -> str:
    """The angle of the direction from one point of the plane to another, from the x axis, as an elongation.

    Examples
    --------
    >>> from fvi import mechanism
    >>> mechanism.angle(["q0", "q1"], ["q2", "q3"])
    'atan2(q3 - q1, q2 - q0)'
    """
    (x, y), (u, v) = one, other
    return f"atan2({_word(v)} - {_word(y)}, {_word(u)} - {_word(x)})"


def _word(part: str | float) -> str:
    if isinstance(part, str):
        return part if part.isidentifier() else f"({part})"
    return f"({float(part)!r})"


def rigid_body(
    inertia: ArrayLike,
    *,
    mass: float = 1.0,
    arm: ArrayLike | None = None,
    gravity: float = _GRAVITY,
    own: float | None = None,
) -> dict[str, Any]:
    """A rigid body by the unit quaternion q0, q1, q2, q3 (scalar first) that turns body axes into those of space.

    Parameters
    ----------
    inertia : array_like of 3 or 3 × 3
        J in body axes: principal moments, or the matrix; about the fixed point if `arm` is given, about the centre of mass otherwise.
    mass : float
        Its mass.
    arm : array_like of 3, optional
        The centre of mass in body axes, from the point about which it turns. Without it the body flies, and its centre is at
        q4, q5, q6.
    gravity : float
        Its acceleration, along −z.
    own : float, optional
        J₀ > 0, an inertia of the length of the quaternion, which does not move; default: the mean of the principal moments.

    Returns
    -------
    dict
        `kinetic`, ½ ωᵀJω with the body rates ω = 2 Im(q* q̇) and ½ J₀ (2 q·q̇)²; `potential`; and `constraints`, |q|² = 1.

    Examples
    --------
    >>> import numpy as np, fvi
    >>> from fvi import mechanism
    >>> top = mechanism.rigid_body([0.2, 0.2, 0.1], mass=1.0, arm=[0.0, 0.0, 0.3])
    >>> q = [np.cos(0.2), np.sin(0.2), 0.0, 0.0]
    >>> v = mechanism.quaternion_rates(q, [0.0, 0.0, 40.0])
    >>> r = fvi.integrate(**top, position=q, velocity=v, step=0.002, end=0.2, scheme="galerkin", degree=2)
    >>> bool(abs(np.linalg.norm(r.q[-1]) - 1) < 1e-13)
    True
    """
    moments = np.asarray(inertia, dtype=float)
    moments = np.diag(moments) if moments.shape == (3,) else moments
    if moments.shape != (3, 3) or not np.allclose(moments, moments.T) or (np.linalg.eigvalsh(moments) <= 0).any():
        allowed = "three positive moments, or a symmetric positive definite matrix of 3 × 3"
        raise InputError(f"inertia = {inertia!r}: not allowed; allowed: {allowed}", "inertia", str(inertia))
    if not mass > 0:
        raise InputError(f"mass = {mass}: not allowed; allowed: a positive number", "mass", str(mass))
    length = float(np.trace(moments) / 3) if own is None else float(own)
    if not length > 0:
        raise InputError(f"own = {own}: not allowed; allowed: a positive number", "own", str(own))
    rates = [
        "(q0*v1 - q1*v0 - q2*v3 + q3*v2)",
        "(q0*v2 - q2*v0 - q3*v1 + q1*v3)",
        "(q0*v3 - q3*v0 - q1*v2 + q2*v1)",
    ]
    kinetic = [f"{2 * float(moments[i, i])!r}*{rates[i]}^2" for i in range(3)]
    kinetic += [
        f"{4 * float(moments[i, j])!r}*{rates[i]}*{rates[j]}" for j in range(3) for i in range(j) if moments[i, j] != 0
    ]
    kinetic.append(f"{2 * length!r}*(q0*v0 + q1*v1 + q2*v2 + q3*v3)^2")
    if arm is None:
        kinetic.append(f"{0.5 * float(mass)!r}*(v4^2 + v5^2 + v6^2)")
        potential = f"{float(mass) * gravity!r}*q6"
    else:
        r = _numbers(arm, "arm", positive=False)
        if len(r) != 3:
            raise InputError(f"arm: {len(r)} numbers; allowed: 3", "arm", str(arm))
        height = [
            f"{2 * r[0]!r}*(q1*q3 - q0*q2)",
            f"{2 * r[1]!r}*(q2*q3 + q0*q1)",
            f"{r[2]!r}*(q0^2 - q1^2 - q2^2 + q3^2)",
        ]
        potential = f"{float(mass) * gravity!r}*({_sum(height)})"
    return {
        "kinetic": _sum(kinetic),
        "potential": potential,
        "constraints": ["q0^2 + q1^2 + q2^2 + q3^2 - 1"],
    }


def _quaternion(q: ArrayLike) -> NDArray[np.float64]:
    found = np.asarray(q, dtype=float)
    if found.shape[-1:] != (4,):
        raise InputError("q: not four numbers; allowed: a quaternion, scalar first", "q", str(q))
    return found


def quaternion_rates(q: ArrayLike, rates: ArrayLike) -> NDArray[np.float64]:
    """q̇ = ½ q (0, ω) for a unit quaternion and the body rates ω; the initial velocity of `rigid_body`."""
    w, x, y, z = _quaternion(q)
    a, b, c = np.asarray(rates, dtype=float)
    product = [-x * a - y * b - z * c, w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a]
    return 0.5 * np.array(product)


def body_rates(q: ArrayLike, velocity: ArrayLike) -> NDArray[np.float64]:
    """The body rates ω = 2 Im(q* q̇) of a unit quaternion and its velocity."""
    w, x, y, z = _quaternion(q)
    a, b, c, d = _quaternion(velocity)
    return 2.0 * np.array([w * b - x * a - y * d + z * c, w * c - y * a - z * b + x * d, w * d - z * a - x * c + y * b])


def rotation(q: ArrayLike) -> NDArray[np.float64]:
    """The rotation matrix of a unit quaternion: body axes into those of space."""
    w, x, y, z = _quaternion(q)
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def stroboscope(
    result: Result,
    points: Callable[[NDArray[np.float64]], Any],
    *,
    frames: int = 25,
    trace: int | None = -1,
    axes: Any = None,
    unit: str = "",
) -> Picture:
    """Draws a mechanism at equal intervals of time, the later the darker, and the way of one of its points.

    Parameters
    ----------
    result : Result
        The motion, with all coordinates.
    points : callable
        For the position q, points (x, y) that are joined by lines: an array of two columns or a list of pairs; or a list of
        such polygons.
    frames : int
        How often it is drawn.
    trace : int, optional
        The row of the first polygon whose way is drawn, from the end if negative; None for none.
    axes : matplotlib axes, optional
        Axes to draw in; default: a new figure.
    unit : str
        Unit of the places, for the labels.

    Returns
    -------
    sequence of one matplotlib axes
        With its `figure`, and its `savefig`.
    """
    if frames < 1:
        raise InputError(f"frames = {frames}: not allowed; allowed: a number from 1", "frames", str(frames))

    def polygons(q: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        found = points(q)
        is_one = not isinstance(found, list | tuple) or np.ndim(found[0]) == 1
        made = [np.asarray(part, dtype=float) for part in ([found] if is_one else found)]
        if any(part.ndim != 2 or part.shape[1] != 2 for part in made):
            raise InputError("points: no rows of x and y; allowed: polygons of two columns", "points", "")
        return made

    (place,) = axes = new_axes(axes, 1, 1, (5.6, 5.2))
    times = np.linspace(result.t[0], result.t[-1], frames)
    rows = np.unique(np.searchsorted(result.t, times).clip(0, len(result.t) - 1))
    for order, row in enumerate(rows):
        shade = 0.15 + 0.85 * (order + 1) / len(rows)
        for part in polygons(result.q[row]):
            place.plot(part[:, 0], part[:, 1], "o-", color="tab:blue", alpha=shade, linewidth=1, markersize=2)
    if trace is not None:
        way = np.array([polygons(q)[0][trace] for q in result.q])
        place.plot(way[:, 0], way[:, 1], color="tab:orange", linewidth=0.8)
    place.set_aspect("equal")
    suffix = f" [{unit}]" if unit else ""
    place.set_xlabel(f"x{suffix}")
    place.set_ylabel(f"y{suffix}")
    return Picture(axes)
