"""One large run on many processes: fractional damping in PETSc's distributed systems.

`integrate` takes matrices and vectors distributed by PETSc and makes the same steps as `fvi.integrate` for a large linear system.
Matrices, products and solutions are PETSc's; each process stores the memory of its own rows, or of its own dampers, and
communicates nothing about the past. The guide is `book/src/use/cluster.md` of the repository.

Needs petsc4py, mpi4py and PETSc with real numbers: Debian's python3-petsc4py and python3-mpi4py, or conda-forge's petsc4py.
"""

try:
    import mpi4py as _mpi4py
    import petsc4py as _petsc4py
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"fvi.petsc needs the package {error.name}: install petsc4py and mpi4py (Debian: apt-get install python3-petsc4py "
        "python3-mpi4py, for its own python3 and environments made with --system-site-packages, and PETSC_DIR set to the directory "
        "/usr/lib/petscdir/petsc*/*-real; conda: conda install -c conda-forge petsc4py mpi4py)",
        name=error.name,
    ) from None

from fvi.petsc._integrate import integrate
from fvi.petsc._output import Mesh, Output

__all__ = ["Mesh", "Output", "integrate"]
