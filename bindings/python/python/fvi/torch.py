"""Models of fvi in programs of PyTorch; imported separately, needs the package ``torch``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from fvi._model import Model, checked


def integrate(model: Model, parameters: Mapping[str, Any]) -> tuple[Any, Any]:
    """The positions and momenta of a model, as a function that PyTorch differentiates.

    Parameters
    ----------
    model : Model
        The system.
    parameters : mapping of str to tensor
        Numbers of the model by the names of `Model.gradient`: numbers or vectors.

    Returns
    -------
    q, p : tensor
        Shape (rows, N), in double precision, on the processor.

    Raises
    ------
    InputError, StepError, Exception
        As `Model.gradient`.

    Notes
    -----
    The gradient is that of `Model.gradient`; it is not differentiated again. For a batch stack the results of several calls,
    ``torch.stack([fvi.torch.integrate(model, {"k": k})[0] for k in ks])``.

    Examples
    --------
    >>> import fvi, fvi.torch, torch
    >>> model = fvi.Model(mass=[1.0], potential="0.5*k*q0^2", parameters={"k": 1.0}, position=[1.0], step=0.01, steps=100)
    >>> k = torch.tensor(1.0, dtype=torch.float64, requires_grad=True)
    >>> q, p = fvi.torch.integrate(model, {"k": k})
    >>> q[-1, 0].backward()
    >>> bool(abs(k.grad + 0.42) < 0.01)
    True
    """
    checked(model, parameters)
    names = tuple(parameters)
    values = [torch.as_tensor(parameters[name], dtype=torch.float64).cpu() for name in names]
    q, p = _Integrate.apply(model, names, *values)
    return q, p


class _Integrate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, model: Model, names: tuple[str, ...], *values: Any) -> Any:
        recording = model.record({name: value.detach().numpy() for name, value in zip(names, values)})
        ctx.recording, ctx.names, ctx.shapes = recording, names, [value.shape for value in values]
        return torch.from_numpy(recording.result.q.copy()), torch.from_numpy(recording.result.p.copy())

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, q: Any, p: Any) -> Any:
        gradient = ctx.recording.gradient(q.detach().numpy(), p.detach().numpy())
        arrays = [np.atleast_1d(np.asarray(gradient[name])) for name in ctx.names]
        # A single number has stood for all of a vector.
        by = [torch.from_numpy(array if shape else array.sum(keepdims=True)).reshape(shape) for array, shape in zip(arrays, ctx.shapes)]
        return (None, None, *by)
