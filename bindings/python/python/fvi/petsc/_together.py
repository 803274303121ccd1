"""Errors and decisions common to all ranks."""

from __future__ import annotations

import hashlib
import pickle
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fvi._errors import InputError


class Together:
    """A communicator on which an error of one rank is raised by all.

    If a rank raised alone, the others would wait for it in the next collective operation. An error that may occur on one rank
    only is therefore caught there and passed to `agree`, which every rank calls at the same place.
    """

    def __init__(self, comm: Any) -> None:
        self.comm = comm
        self.rank: int = comm.Get_rank()
        self.size: int = comm.Get_size()

    def agree(self, error: BaseException | None, *wishes: bool) -> list[bool]:
        """Raises the error of the lowest rank with one, on all ranks; otherwise returns the requests made by any rank."""
        mine = np.array([0 if error is None else self.size - self.rank, *wishes], dtype=np.int64)
        all_of = np.empty_like(mine)
        self.comm.Allreduce(mine, all_of, op=MPI.MAX)
        if all_of[0] > 0:
            self._raise(error, self.size - int(all_of[0]))
        return [bool(wish) for wish in all_of[1:]]

    def _raise(self, error: BaseException | None, first: int) -> None:
        texts = self.comm.allgather(None if error is None else str(error))
        content = self.comm.bcast(_packed(error) if self.rank == first else None, root=first)
        common: BaseException = pickle.loads(content)
        # If not all ranks have the same error, the message names the rank.
        if any(text != texts[first] for text in texts) and common.args and isinstance(common.args[0], str):
            common.args = (f"rank {first}: {common.args[0]}", *common.args[1:])
        raise common from error

    def same(self, values: dict[str, Any]) -> None:
        """Raises `InputError` on all ranks if an argument differs between them."""
        everywhere = self.comm.allgather({name: repr(value) for name, value in values.items()})
        for rank, others in enumerate(everywhere):
            for name, text in everywhere[0].items():
                other = others.get(name, "nothing")
                if other != text:
                    raise InputError(f"{name}: {text} on rank 0, {other} on rank {rank}; all ranks have to say the same", name, other)

    def sum(self, number: float) -> float:
        return float(self.comm.allreduce(number, op=MPI.SUM))

    def largest(self, number: float) -> float:
        return float(self.comm.allreduce(number, op=MPI.MAX))


def text_of(given: Any) -> str:
    """A text of an argument that must be equal on all ranks: the numbers, or a digest of many; for a distributed object only its
    type."""
    if given is None or isinstance(given, (str, bool)):
        return repr(given)
    if isinstance(given, PETSc.Object):
        return type(given).__name__
    numbers = np.asarray(given, dtype=np.float64)
    if numbers.size <= 4:
        return repr(numbers.tolist())
    return f"{numbers.size} numbers, {hashlib.sha256(numbers.tobytes()).hexdigest()[:16]}"


def _packed(error: BaseException | None) -> bytes:
    """An exception as bytes; for one that cannot be pickled its message."""
    try:
        content = pickle.dumps(error)
        if isinstance(pickle.loads(content), BaseException):
            return content
    except Exception:
        pass
    return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
