"""Models in programs of JAX. .ci/python runs this in a process of its own: one with JAX's threads cannot be forked."""

import jax
import numpy as np
import pytest
from test_gradient import MODEL

import fvi
import fvi.jax

jax.config.update("jax_enable_x64", True)


def test_jax_differentiates_models():
    model = fvi.Model(**MODEL)

    def loss(k, strengths):
        q, p = fvi.jax.integrate(model, {"k": k, "damping[1].kernel.strengths": strengths})
        return (q**2).sum() + (p**4).sum()

    strengths = np.array([0.8, 0.7])
    run = model.gradient({"k": 1.3, "damping[1].kernel.strengths": strengths}, lambda r: (2 * r.q, 4 * r.p**3))
    for differentiated in (jax.grad(loss, argnums=(0, 1)), jax.jit(jax.grad(loss, argnums=(0, 1)))):
        by_k, by_strengths = differentiated(1.3, strengths)
        assert float(by_k) == pytest.approx(run["k"], rel=1e-12)
        assert np.allclose(by_strengths, run["damping[1].kernel.strengths"], rtol=1e-12)
    ks = np.array([1.0, 1.3, 1.6])
    each = jax.vmap(jax.grad(loss), in_axes=(0, None))(ks, strengths)
    assert np.allclose(each, [jax.grad(loss)(k, strengths) for k in ks], rtol=1e-12)


def oscillator():
    return fvi.Model(mass=[1.0, 1.0], potential="0.5*kk*q0^2 + 0*sqrt(3 - q0)", parameters={"kk": 1.0}, position=[1.0, 2.0], step=0.05,
                     steps=80, damping=fvi.Damping(kernel=fvi.Kernel.prony([0.5], [1.0]), coefficient=0.3))  # fmt: skip


def test_names_and_shapes_are_told_before_jax_calls():
    model = oscillator()
    for given, said in (
        ({"k": 1.0}, "k: no number of the model.*did you mean kk"),
        ({"positon": np.ones(2)}, "did you mean position"),
        ({"damping[1].order": 0.5}, r"damping\[1\].order"),
        ({"position": np.ones(3)}, r"position: shape \(3,\), where \(2,\) is needed"),
        ({"kk": np.ones(2)}, r"kk: shape \(2,\), where \(\)"),
        ({"step": 0.1}, "step"),
    ):

        def first(values):
            return fvi.jax.integrate(model, values)[0][-1, 0]

        given = {name: np.asarray(value, dtype=float) for name, value in given.items()}
        for call in (first, jax.jit(first), jax.grad(first), jax.jit(jax.grad(first))):
            with pytest.raises(fvi.InputError, match=said):
                call(given)
    with pytest.raises(fvi.InputError, match="names"):
        fvi.jax.integrate(model, ["kk"])
    with pytest.raises(fvi.InputError, match="model"):
        fvi.jax.integrate({}, {"kk": 1.0})


def test_what_a_run_refuses_is_told_as_it_is_outside_of_jit():
    model = oscillator()
    with pytest.raises(fvi.InputError, match="kk = nan"):
        fvi.jax.integrate(model, {"kk": np.nan})
    with pytest.raises(fvi.StepError):
        jax.grad(lambda kk: fvi.jax.integrate(model, {"kk": kk})[0][-1, 0])(-9.0)
    with pytest.raises(jax.errors.JaxRuntimeError, match="kk = nan"):
        jax.block_until_ready(jax.jit(lambda kk: fvi.jax.integrate(model, {"kk": kk}))(np.nan))
    assert np.isfinite(fvi.jax.integrate(model, {"kk": 2.0})[0]).all()


def test_a_single_number_stands_for_a_vector_and_lists_of_one_are_taken():
    model = oscillator()
    by = jax.grad(lambda q: fvi.jax.integrate(model, {"position": q})[0].sum())(1.5)
    run = model.gradient({"position": [1.5, 1.5]}, lambda r: np.ones_like(r.q))
    assert float(by) == pytest.approx(run["position"].sum(), rel=1e-12)
    name = "damping[0].kernel.strengths"
    by = jax.grad(lambda s: fvi.jax.integrate(model, {name: s})[0].sum())(np.array([0.4]))
    assert np.allclose(by, model.gradient({name: [0.4]}, lambda r: np.ones_like(r.q))[name], rtol=1e-12)
