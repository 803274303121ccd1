"""Errors and decisions that all ranks have in common."""

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

    A rank that raised alone would leave the others waiting for it in the next product or sum. So what may fail on one rank only is
    caught there and brought to `agree`, which every rank calls at the same place.
    """

    def __init__(self, comm: Any) -> None:
        self.comm = comm
        self.rank: int = comm.Get_rank()
        self.size: int = comm.Get_size()

    def agree(self, error: BaseException | None, *wishes: bool) -> list[bool]:
        """Raises the error of the lowest rank that has one, on all ranks; otherwise says which wishes some rank has."""
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
        # Who is alone with an error wants to know it.
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
    """What an argument says that all ranks have to say alike: numbers as they are, or a digest of many; only the kind of what is
    distributed."""
    if given is None or isinstance(given, (str, bool)):
        return repr(given)
    if isinstance(given, PETSc.Object):
        return type(given).__name__
    numbers = np.asarray(given, dtype=np.float64)
    if numbers.size <= 4:
        return repr(numbers.tolist())
    return f"{numbers.size} numbers, {hashlib.sha256(numbers.tobytes()).hexdigest()[:16]}"


def _packed(error: BaseException | None) -> bytes:
    """An exception as bytes; one that cannot be sent as what it says."""
    try:
        content = pickle.dumps(error)
        if isinstance(pickle.loads(content), BaseException):
            return content
    except Exception:
        pass
    return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
