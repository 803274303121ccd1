#!/usr/bin/env python3
"""Matrices and loads of two structures, made with scikit-fem (pip install scikit-fem scipy).

    make.py cantilever DIRECTORY [CELLS]    a cantilever of a viscoelastic solid in 3D
    make.py plate DIRECTORY [CELLS]         a simply supported plate under a moving load

CELLS along the length; without it the sizes of the files in this directory. Writes M, K (scipy.sparse.save_npz) and loads (numpy.save).
The matrices hold the free coordinates only.
"""

import sys
from pathlib import Path

import numpy as np
import scipy.sparse as sparse
from skfem import (
    Basis,
    BilinearForm,
    ElementHex1,
    ElementTriMorley,
    ElementVector,
    MeshHex,
    MeshTri,
    condense,
)
from skfem.helpers import dd, ddot, dot, eye, sym_grad, trace


def cantilever(directory, cells):
    """Length 1, cross-section 0.1 × 0.1; E = 1, ν = 0.3, density 1, clamped at x = 0, pulled down at the free end.

    The unit of time is length √(density/E).
    """
    across = max(2, cells // 10)
    line = np.linspace
    mesh = MeshHex.init_tensor(line(0, 1, cells + 1), line(0, 0.1, across + 1), line(0, 0.1, across + 1))
    basis = Basis(mesh, ElementVector(ElementHex1()))
    young, nu = 1.0, 0.3
    lam, mu = young * nu / ((1 + nu) * (1 - 2 * nu)), young / (2 * (1 + nu))

    @BilinearForm
    def stiffness(u, v, _):
        strain = sym_grad(u)
        stress = 2 * mu * strain + lam * eye(trace(strain), 3)
        return ddot(stress, sym_grad(v))

    @BilinearForm
    def mass(u, v, _):
        return dot(u, v)

    held = basis.get_dofs(lambda x: np.isclose(x[0], 0.0)).all()
    end = basis.get_dofs(lambda x: np.isclose(x[0], 1.0)).all("u^3")
    load = np.zeros(basis.N)
    load[end] = -1e-6 / len(end)
    write(directory, "cantilever", basis, stiffness, mass, load, held)
    free = np.setdiff1d(np.arange(basis.N), held)
    print("coordinate at the tip:", int(np.searchsorted(free, end[0])))


def plate(directory, cells):
    """Unit square in bending, stiffness D = 1, ν = 0.3, mass per area 1, simply supported; a load crosses it along y = 1/2.

    Nine patterns, each a bump around one of nine stations on the path; the scenario hands the load from one to the next.
    """
    mesh = MeshTri.init_symmetric().refined(int(np.log2(cells)))
    basis = Basis(mesh, ElementTriMorley(), intorder=4)
    nu = 0.3

    @BilinearForm
    def stiffness(u, v, _):
        curvature = dd(u)
        moment = (1 - nu) * curvature + nu * eye(trace(curvature), 2)
        return ddot(moment, dd(v))

    @BilinearForm
    def mass(u, v, _):
        return u * v

    held = basis.get_dofs().all("u")
    points = basis.doflocs
    stations = np.linspace(0.1, 0.9, 9)
    nodes = basis.nodal_dofs[0]
    loads = []
    for station in stations:
        load = np.zeros(basis.N)
        place = nodes[np.argmin(np.hypot(points[0, nodes] - station, points[1, nodes] - 0.5))]
        load[place] = 1.0
        loads.append(load)
    write(directory, "plate", basis, stiffness, mass, np.array(loads), held)
    free = np.setdiff1d(np.arange(basis.N), held)
    middle = nodes[np.argmin(np.hypot(points[0, nodes] - 0.5, points[1, nodes] - 0.5))]
    print("coordinate in the middle:", int(np.searchsorted(free, middle)))


def write(directory, name, basis, stiffness, mass, loads, held):
    free = np.setdiff1d(np.arange(basis.N), held)
    for letter, form in (("K", stiffness), ("M", mass)):
        matrix = sparse.csr_matrix(form.assemble(basis))[free][:, free]
        matrix.eliminate_zeros()
        sparse.save_npz(directory / f"{name}-{letter}.npz", matrix)
    loads = np.atleast_2d(loads)[:, free]
    for index, load in enumerate(loads):
        suffix = f"-{index}" if len(loads) > 1 else ""
        np.save(directory / f"{name}-load{suffix}.npy", load)
    print(f"{name}: {len(free)} coordinates, {matrix.nnz} entries")


def main():
    kinds = {"cantilever": (cantilever, 10), "plate": (plate, 8)}
    if len(sys.argv) not in (3, 4) or sys.argv[1] not in kinds:
        sys.exit(__doc__)
    make, cells = kinds[sys.argv[1]]
    directory = Path(sys.argv[2])
    directory.mkdir(parents=True, exist_ok=True)
    make(directory, int(sys.argv[3]) if len(sys.argv) == 4 else cells)


if __name__ == "__main__":
    main()
