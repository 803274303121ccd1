"""Learns the damper of a swinging mass from its motion: the strengths of a Prony series, by JAX.

The data are made with a damper of order 1/2, which is no Prony series: four relaxations stand for it as far as the motion
tells. All four derivatives of a loss cost as much as two runs or three, whatever their number.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import fvi
import fvi.jax

jax.config.update("jax_enable_x64", True)

motion: dict[str, Any] = dict(mass=[1.0], stiffness=[4.0], position=[1.0], step=0.05, steps=300)
data = fvi.integrate(**motion, damping=fvi.Damping(0.5, 0.4)).q
times = [0.03, 0.2, 1.0, 6.0]
model = fvi.Model(**motion, damping=fvi.Damping(kernel=fvi.Kernel.prony([0.5] * 4, times), coefficient=1.0))


def loss(logarithms):
    q, _ = fvi.jax.integrate(model, {"damping[0].kernel.strengths": jnp.exp(logarithms)})
    return jnp.mean((q - data) ** 2)


slope = jax.jit(jax.value_and_grad(loss))
logarithms, velocity = jnp.log(jnp.full(4, 0.5)), jnp.zeros(4)
mean_square = jnp.zeros(4)
first = value = float(loss(logarithms))
for step in range(1, 201):
    value, by = slope(logarithms)
    # Adam, with steps of 0.05.
    velocity, mean_square = 0.9 * velocity + 0.1 * by, 0.99 * mean_square + 0.01 * by**2
    logarithms -= 0.05 * velocity / (1 - 0.9**step) / (jnp.sqrt(mean_square / (1 - 0.99**step)) + 1e-12)

print("strengths", np.round(np.exp(logarithms), 3), "at the times", times)
print(f"mean square error {float(value):.2e}, at first {first:.2e}")
assert value < 1e-2 * first
