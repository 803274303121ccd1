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
