"""Coordinates without mass."""

import numpy as np
import pytest

import fvi

# A mass on a spring, beside it a Maxwell element: 2 ẍ + 3 x + 5 (x − z) = 0, 2.5 ż = 5 (x − z).
ELEMENT = dict(mass=[2.0, 0.0], stiffness=[[8.0, -5.0], [-5.0, 5.0]], damping=fvi.Damping(1.0, [0.0, 2.5]),
               position=[1.0, 1.0], velocity=[0.5, 0.0], end=2.0)  # fmt: skip


def exact(t):
    """x, p and z, by the eigenvectors of y' = A y."""
    matrix = np.array([[0.0, 0.5, 0.0], [-8.0, 0.0, 5.0], [2.0, 0.0, -2.0]])
    rates, vectors = np.linalg.eig(matrix)
    parts = np.linalg.solve(vectors, np.array([1.0, 1.0, 1.0], dtype=complex))
    return ((vectors * parts) @ np.exp(np.outer(rates, t))).real


@pytest.mark.parametrize(
    ("scheme", "order"),
    [(dict(order=2), 2), (dict(scheme="galerkin", degree=2, order=4), 4), (dict(scheme="collocation", stages=2), 3)],
)
def test_a_maxwell_element_has_the_order_of_the_scheme_at_all_rows(scheme, order):
    def error(steps):
        r = fvi.integrate(**ELEMENT, step=2.0 / steps, **scheme)
        x, p, z = exact(r.t)
        late = r.t > 1.0
        return max(np.abs(r.q[late, 0] - x[late]).max(), np.abs(r.q[late, 1] - z[late]).max(), np.abs(r.p[late, 0] - p[late]).max())

    assert np.log2(error(64) / error(128)) > order - 0.3


def test_momenta_are_zero_and_velocities_unknown():
    r = fvi.integrate(**ELEMENT, step=0.01)
    assert (r.p[:, 1] == 0.0).all() and np.isnan(r.v[:, 1]).all()
    np.testing.assert_allclose(r.v[:, 0], r.p[:, 0] / 2.0, rtol=1e-15)
    between = np.linspace(0.5, 1.5, 7) + 0.003
    np.testing.assert_allclose(r(between)[:, 1], exact(between)[2], atol=2e-4)


def test_a_function_may_hold_one_by_a_resistance():
    arguments = {name: value for name, value in ELEMENT.items() if name != "damping"}
    words = fvi.integrate(**arguments, step=0.02, force=["0", "-2.5*v1"])
    code = fvi.integrate(**arguments, step=0.02, force=lambda t, q, v: [0.0, -2.5 * v[1]])
    assert np.abs(code.q - words.q).max() < 1e-9
    assert np.abs(words.q[-1, 1] - exact(2.0)[2]) < 1e-3


def test_full_and_sparse_mass_matrices():
    sparse = pytest.importorskip("scipy.sparse")
    # A chain in which every second mass is missing.
    size = 301
    mass = np.where(np.arange(size) % 2 == 0, 1.0, 0.0)
    stiffness = sparse.diags([np.full(size - 1, -1.0), np.full(size, 2.0), np.full(size - 1, -1.0)], [-1, 0, 1], format="csr")
    load = fvi.Load({"coordinate": 151}, "sin(t)")
    common = dict(stiffness=stiffness, loads=load, position=0.0, step=0.05, steps=40)
    coupled = sparse.diags([mass, np.where(mass > 0.0, 0.1, 0.0)[:-2], np.where(mass > 0.0, 0.1, 0.0)[:-2]], [0, -2, 2], format="csr")
    kept = np.arange(0, size, 2)
    for given in (mass, coupled, coupled.toarray()):
        r = fvi.integrate(mass=given, **common)
        assert r.summary["solver"]["kind"] == "sparse"
        matrix = np.diag(given) if np.ndim(given) == 1 else sparse.csr_matrix(given).toarray()
        # Condensed: half the stiffness between neighbours with mass.
        reduced = stiffness.toarray()
        z = np.arange(1, size, 2)
        condensed = reduced[np.ix_(kept, kept)] - reduced[np.ix_(kept, z)] @ np.linalg.solve(reduced[np.ix_(z, z)], reduced[np.ix_(z, kept)])
        pattern = np.zeros(size)
        pattern[151] = 1.0
        pushed = pattern[kept] - reduced[np.ix_(kept, z)] @ np.linalg.solve(reduced[np.ix_(z, z)], pattern[z])
        other = fvi.integrate(
            mass=matrix[np.ix_(kept, kept)], stiffness=condensed, loads=fvi.Load(pushed, "sin(t)"), position=0.0, step=0.05, steps=40
        )
        np.testing.assert_allclose(r.q[:, kept], other.q, atol=1e-12)
        np.testing.assert_allclose(r.energy[0], other.energy[0], atol=1e-12)
        assert np.isnan(r.v[:, z]).all()
        np.testing.assert_allclose(r.v[:, kept], other.v, atol=1e-11)


def test_where_one_starts():
    # 4 (z − x) + 6 z = 1.
    common = dict(mass=[2.0, 0.0], potential="2*(q0 - q1)^2 + 3*q1^2", force=["0", "1"], step=0.05, steps=10)
    assert fvi.integrate(**common, position=[1.0, 0.0]).q[0, 1] == pytest.approx(0.5, abs=1e-15)
    with pytest.raises(fvi.InputError, match=r"coordinate 1 .* balance at 0\.[45]") as caught:
        fvi.integrate(**common, position=[1.0, 0.7])
    assert caught.value.key == "position"


def test_what_nothing_holds_is_refused():
    with pytest.raises(fvi.InputError, match="mass 0 at coordinate 1") as caught:
        fvi.integrate(mass=[1.0, 0.0], stiffness=[1.0, 0.0], position=[1.0, 0.0], step=0.1, steps=10)
    assert caught.value.key == "mass"
    with pytest.raises(fvi.InputError, match="coordinate 1"):
        fvi.integrate(mass=[1.0, 0.0], stiffness=[1.0, 1.0], position=[1.0, 0.0], velocity=[0.0, 1.0], step=0.1, steps=10)
