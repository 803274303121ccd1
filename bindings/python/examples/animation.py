"""The motion of a membrane as a series of VTK files, one for each row of the result, for ParaView; meshio writes them.

ParaView opens `membrane.vtu.series`; its filter Warp By Scalar shows the deflection.
"""

import json
import sys
import tempfile
from pathlib import Path

import meshio
import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

import fvi

SIDE = 20
one = sp.identity(SIDE)
line = 2 * one - sp.eye(SIDE, k=1) - sp.eye(SIDE, k=-1)
stiffness = ((sp.kron(line, one) + sp.kron(one, line)) * (SIDE + 1) ** 2).tocsr()
x, y = np.meshgrid(*2 * [np.arange(1, SIDE + 1) / (SIDE + 1)], indexing="ij")
struck = np.exp(-60.0 * ((x - 0.3) ** 2 + (y - 0.4) ** 2)).ravel()
membrane = fvi.System(mass=np.ones(SIDE**2), stiffness=stiffness, damping=fvi.Damping(0.5, 0.01 * stiffness))
r = fvi.integrate(membrane, position=struck, step=0.01, steps=200, every=5, coordinates=range(SIDE**2))

places = np.arange(SIDE**2).reshape(SIDE, SIDE)
corners = [places[:-1, :-1], places[1:, :-1], places[1:, 1:], places[:-1, 1:]]
cells: dict[str, ArrayLike] = {"quad": np.stack([corner.ravel() for corner in corners], axis=1)}
points = np.stack([x.ravel(), y.ravel(), np.zeros(SIDE**2)], axis=1)

directory = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
directory.mkdir(parents=True, exist_ok=True)
names = [f"membrane_{row:04d}.vtu" for row in range(len(r.t))]
for name, q, v in zip(names, r.q, r.v):
    meshio.Mesh(points, cells, point_data={"deflection": q, "velocity": v}).write(directory / name)
moments = [{"name": name, "time": float(t)} for name, t in zip(names, r.t)]
(directory / "membrane.vtu.series").write_text(json.dumps({"file-series-version": "1.0", "files": moments}), encoding="utf-8")
print(f"{len(moments)} moments in {directory}")
last = meshio.read(directory / names[-1])
assert (last.point_data["deflection"] == r.q[-1]).all()
