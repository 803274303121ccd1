"""Models of fvi in programs of JAX; imported separately, needs the package ``jax``."""

from __future__ import annotations

import weakref
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from fvi._errors import InputError
from fvi._gradient import Recording
from fvi._model import Model, checked

KEPT = 64
"""Runs of one model whose steps are kept between the two passes."""

_recordings: weakref.WeakKeyDictionary[Model, OrderedDict[bytes, Recording]] = weakref.WeakKeyDictionary()
_checked: weakref.WeakKeyDictionary[Model, dict[tuple[str, ...], dict[str, tuple[int, ...]]]] = weakref.WeakKeyDictionary()
_shapes: weakref.WeakKeyDictionary[Model, tuple[int, int]] = weakref.WeakKeyDictionary()
_failures: weakref.WeakKeyDictionary[Model, Exception] = weakref.WeakKeyDictionary()


def integrate(model: Model, parameters: Mapping[str, Any]) -> tuple[jax.Array, jax.Array]:
    """The positions and momenta of a model, as a function that JAX differentiates in reverse mode.

    Parameters
    ----------
    model : Model
        The system, with steps of its own; its own numbers must be complete, since a run by them tells the shape.
    parameters : mapping of str to array
        Numbers of the model by the names of `Model.gradient`: numbers or vectors.

    Returns
    -------
    q, p : jax.Array
        Shape (rows, N).

    Raises
    ------
    InputError
        If the model has no number with a name, or another shape of it, or no gradient by it; also inside of `jax.jit`.
    StepError, Exception
        As `Model.gradient`. Inside of `jax.jit`, whose functions JAX calls, it is a ``JaxRuntimeError`` whose text ends with it.

    Notes
    -----
    The run and its gradient, that of `Model.gradient`, are made on the host in double precision; arrays have JAX's precision,
    which is single unless ``jax_enable_x64`` is set. `jax.jit`, `jax.grad` and `jax.vjp` apply, and `jax.vmap`, which makes one
    run after another. There is no forward mode and no second derivative.

    Examples
    --------
    >>> import fvi, fvi.jax, jax
    >>> model = fvi.Model(mass=[1.0], potential="0.5*k*q0^2", parameters={"k": 1.0}, position=[1.0], step=0.01, steps=100)
    >>> def last(k):
    ...     q, p = fvi.jax.integrate(model, {"k": k})
    ...     return q[-1, 0]
    >>> bool(abs(jax.grad(last)(1.0) + 0.42) < 0.01)
    True
    """
    checked(model, parameters)
    shapes = _known(model, tuple(parameters))
    given = {name: _shaped(name, value, shapes[name]) for name, value in parameters.items()}
    _failures.pop(model, None)
    try:
        q, p = jax.block_until_ready(_integrate(model, given))
    except jax.errors.JaxRuntimeError:
        if (failure := _failures.pop(model, None)) is None:
            raise
        raise failure from None
    return q, p


def _known(model: Model, names: tuple[str, ...]) -> dict[str, tuple[int, ...]]:
    """The shapes of the numbers with these names, by a run with the model's own."""
    known = _checked.setdefault(model, {})
    if names not in known:
        recording = model.record(names)
        rows, size = recording.result.q.shape
        _shapes[model], known[names] = (rows, size), recording.shapes
    return known[names]


def _shaped(name: str, value: Any, shape: tuple[int, ...]) -> jax.Array:
    array = jnp.asarray(value, dtype=jnp.result_type(float))
    if (array.shape, shape) == ((1,), ()):
        # A list of one number, if the model has one there.
        return array
    if array.shape not in ((), shape):
        raise InputError(f"{name}: shape {array.shape}, where {shape} is needed", name, str(array.shape))
    return jnp.broadcast_to(array, shape)


def _key(parameters: Mapping[str, Any]) -> bytes:
    return b"".join(name.encode() + b"=" + np.asarray(value).tobytes() + b";" for name, value in sorted(parameters.items()))


def _recorded(model: Model, parameters: Mapping[str, Any]) -> Recording:
    return model.record({name: np.asarray(value, dtype=np.float64) for name, value in parameters.items()})


def _forward(model: Model, parameters: dict[str, jax.Array], keep: bool) -> Any:
    dtype = jnp.result_type(float)

    def host(given: dict[str, Any]) -> tuple[Any, Any]:
        try:
            recording = _recorded(model, given)
        except Exception as error:
            _failures[model] = error
            raise
        if keep:
            kept = _recordings.setdefault(model, OrderedDict())
            kept[_key(given)] = recording
            while len(kept) > KEPT:
                kept.popitem(last=False)
        return recording.result.q.astype(dtype), recording.result.p.astype(dtype)

    shape = jax.ShapeDtypeStruct(_shapes[model], dtype)
    return jax.pure_callback(host, (shape, shape), parameters, vmap_method="sequential")


def _integrate_plain(model: Model, parameters: dict[str, jax.Array]) -> Any:
    return _forward(model, parameters, keep=False)


def _ahead(model: Model, parameters: dict[str, jax.Array]) -> Any:
    return _forward(model, parameters, keep=True), parameters


def _back(model: Model, parameters: dict[str, jax.Array], by: Any) -> Any:
    def host(given: dict[str, Any], q: Any, p: Any) -> dict[str, Any]:
        recording = _recordings.get(model, OrderedDict()).pop(_key(given), None) or _recorded(model, given)
        gradient = recording.gradient(np.asarray(q, dtype=np.float64), np.asarray(p, dtype=np.float64))
        return {name: np.asarray(gradient[name], dtype=given[name].dtype) for name in given}

    shapes = {name: jax.ShapeDtypeStruct(value.shape, value.dtype) for name, value in parameters.items()}
    return (jax.pure_callback(host, shapes, parameters, *by, vmap_method="sequential"),)


_integrate = jax.custom_vjp(_integrate_plain, nondiff_argnums=(0,))
_integrate.defvjp(_ahead, _back)
