#!/usr/bin/env python3
"""The cantilever of make.py as one run on many ranks, its matrices assembled by all of them (scikit-fem, petsc4py, mpi4py).

    mpiexec -n 2 python -m mpi4py distributed.py CELLS ACROSS STEPS DIRECTORY [PETSc's options]

CELLS along the length, ACROSS in both other directions: 3 CELLS (ACROSS + 1)² coordinates. A rank has the nodes of some cross-sections.
Runs STEPS steps with damping in proportion to the stiffness and a damper at the tip, writes DIRECTORY, and goes on from a checkpoint in
it. `book/src/use/cluster.md` explains it.
"""

import sys

import numpy as np
import petsc4py

petsc4py.init(sys.argv)

from petsc4py import PETSc  # noqa: E402
from skfem import Basis, BilinearForm, ElementHex1, ElementVector, MeshHex  # noqa: E402
from skfem.helpers import ddot, dot, eye, sym_grad, trace  # noqa: E402

YOUNG, POISSON = 1.0, 0.3


@BilinearForm
def stiffness_form(u, v, _):
    lam, mu = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), YOUNG / (2 * (1 + POISSON))
    strain = sym_grad(u)
    return ddot(2 * mu * strain + lam * eye(trace(strain), 3), sym_grad(v))


@BilinearForm
def mass_form(u, v, _):
    return dot(u, v)


class Beam:
    """Length 1, cross-section 0.1 × 0.1; E = 1, ν = 0.3, density 1, clamped at x = 0.

    A node (i, j, k) of the tensor grid, i = 1…cells, has the rows 3 ((i − 1)(across + 1)² + j (across + 1) + k) + 0, 1, 2.
    """

    def __init__(self, comm, cells, across):
        rank, ranks = comm.getRank(), comm.getSize()
        self.plane, self.across = 3 * (across + 1) ** 2, across
        # Cross-sections first … last − 1 are those of this rank; it has the cells on their left.
        first, last = (1 + cells * part // ranks for part in (rank, rank + 1))
        self.size, self.local = cells * self.plane, (last - first) * self.plane
        x, y = np.linspace(0.0, 1.0, cells + 1), np.linspace(0.0, 0.1, across + 1)
        self.mass, self.stiffness = (self._matrix(comm) for _ in range(2))
        self.points, self.cells = np.empty((0, 3)), np.empty((0, 8), dtype=int)
        self.rows = np.empty((0, 3), dtype=int)
        if last > first:
            mesh = MeshHex.init_tensor(x[first - 1 : last], y, y)
            basis = Basis(mesh, ElementVector(ElementHex1()))
            i, j, k = (np.rint(p * n).astype(int) for p, n in zip(mesh.p, (cells, 10 * across, 10 * across)))
            rows = 3 * ((i - 1) * (across + 1) ** 2 + j * (across + 1) + k)
            rows = np.where(i > 0, rows + np.arange(3)[:, None], -1)
            of_dof = np.empty(basis.N, dtype=PETSc.IntType)
            of_dof[basis.nodal_dofs] = rows
            for matrix, form in ((self.mass, mass_form), (self.stiffness, stiffness_form)):
                self._add(matrix, form.assemble(basis).tocsr(), of_dof)
            self.points, self.cells, self.rows = mesh.p.T.copy(), mesh.t[_corners_as_in_vtk(mesh)].T.copy(), rows.T.copy()
        for matrix in (self.mass, self.stiffness):
            matrix.assemble()
        self.stiffness.setNearNullSpace(self._rigid_body_modes(x, y, first, last))

    def _matrix(self, comm):
        matrix = PETSc.Mat().create(comm)
        matrix.setSizes(((self.local, self.size), (self.local, self.size)), bsize=3)
        matrix.setType("aij")
        matrix.setPreallocationNNZ((81, 81))
        return matrix

    @staticmethod
    def _add(matrix, rows, of_dof):
        """Adds the matrix of this rank's cells; rows of the neighbour on the left travel in assemble()."""
        rows = rows.tocoo()
        row, column = of_dof[rows.row], of_dof[rows.col]
        free = (row >= 0) & (column >= 0)
        row, column, values = row[free], column[free], rows.data[free]
        order = np.lexsort((column, row))
        row, column, values = row[order], column[order], values[order]
        own, starts = np.unique(row, return_index=True)
        starts = np.append(starts, len(row)).astype(PETSc.IntType)
        matrix.setValuesIJV(starts, column, values, addv=True, rowmap=own.astype(PETSc.IntType))

    def _rigid_body_modes(self, x, y, first, last):
        """Shifts and rotations, by which multigrid knows elastic bodies."""
        nodes = np.stack(np.meshgrid(x[first:last], y, y, indexing="ij"), axis=-1)
        coordinates = self.vector()
        coordinates.setBlockSize(3)
        coordinates.setArray(nodes.ravel())
        return PETSc.NullSpace().createRigidBody(coordinates)

    def vector(self):
        return self.stiffness.createVecLeft()

    def load(self, total):
        """A force over the end face, downwards, as a vector."""
        pattern = self.vector()
        first, end = pattern.getOwnershipRange()
        rows = np.arange(self.size - self.plane + 2, self.size, 3)
        own = rows[(rows >= first) & (rows < end)]
        pattern.getArray()[own - first] = -total / (self.across + 1) ** 2
        return pattern

    def damper(self):
        """B of a damper that holds the tip sideways: one column."""
        comm = self.stiffness.getComm()
        attached = PETSc.Mat().createAIJ(((self.local, self.size), (None, 1)), nnz=(1, 1), comm=comm)
        first, end = attached.getOwnershipRange()
        if first <= self.tip < end:
            attached.setValue(self.tip, 0, 1.0)
        attached.assemble()
        return attached

    @property
    def tip(self):
        return self.size - 2


def _corners_as_in_vtk(mesh):
    """The corners of a cell of the grid in the order of VTK: round the lower face, then round the upper one."""
    corners = mesh.p[:, mesh.t[:, 0]]
    place = {tuple(corner): index for index, corner in enumerate((corners > corners.mean(axis=1, keepdims=True)).T.tolist())}
    face = [(0, 0), (1, 0), (1, 1), (0, 1)]
    return [place[x, y, z] for z in (0, 1) for x, y in face]


def main():
    import fvi
    import fvi.petsc

    cells, across, steps = (int(text) for text in sys.argv[1:4])
    beam = Beam(PETSc.COMM_WORLD, cells, across)
    mesh = fvi.petsc.Mesh(beam.points, beam.cells, "hexahedron", beam.rows)
    result = fvi.petsc.integrate(
        beam.mass,
        beam.stiffness,
        position=0.0,
        step=1.0,
        steps=steps,
        damping=[fvi.Damping(0.6, 0.02 * beam.stiffness), fvi.Damping(0.35, attached=beam.damper(), strength=[1e-5])],
        loads=fvi.Load(beam.load(1e-6), "step(200 - t)"),
        coordinates=[beam.size - 1, beam.tip],
        every=10,
        output=fvi.petsc.Output(sys.argv[4], snapshots=50, mesh=mesh),
        resume=True,
    )
    if PETSc.COMM_WORLD.getRank() == 0:
        print(f"{beam.size} coordinates on {PETSc.COMM_WORLD.getSize()} ranks:", result)
        print({name: result.summary[name] for name in ("solver", "memory", "seconds")})


if __name__ == "__main__":
    main()
