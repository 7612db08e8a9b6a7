"""The exact step as a function of JAX that `grad` differentiates.

It prints the gradient of a cost over 20 periods by the inputs, and its largest difference to
central differences. It needs the package jax.
"""

import jax
import jax.numpy as jnp
import numpy as np

import softdyn
from softdyn.dynamics import discrete_step

jax.config.update("jax_enable_x64", True)
model, T, N = softdyn.load("finger"), 0.01, 20
n, m = 2 * model.nv, model.nu


def solved(x, u):
    """x⁺, A and B of one period in NumPy."""
    q, v = np.split(np.asarray(x), 2)
    step = discrete_step(model, q, v, np.asarray(u), T)
    return np.concatenate((step.q, step.v)), step.A, step.B


def called(x, u):
    """The same in JAX."""
    shapes = [jax.ShapeDtypeStruct(shape, float) for shape in ((n,), (n, n), (n, m))]
    return jax.pure_callback(solved, shapes, x, u, vmap_method="sequential")


@jax.custom_vjp
def step(x, u):
    """x⁺ (2n,) of x = (q, v) and u."""
    return called(x, u)[0]


def forwards(x, u):
    """x⁺, and A and B for the way back."""
    after, A, B = called(x, u)
    return after, (A, B)


step.defvjp(forwards, lambda kept, s: (kept[0].T @ s, kept[1].T @ s))


def cost(inputs):
    """The distance of the last state from 0.1."""
    end, _ = jax.lax.scan(lambda x, u: (step(x, u), None), jnp.zeros(n), inputs)
    return jnp.sum((end - 0.1) ** 2)


inputs = np.random.default_rng(0).uniform(model.u_min, model.u_max, (N, m))
found, way = jax.grad(cost)(inputs), np.random.default_rng(1).normal(size=(N, m))
slope = (cost(inputs + 1e-5 * way) - cost(inputs - 1e-5 * way)) / 2e-5
error = abs(slope - np.sum(found * way)) / abs(slope)
print(f"gradient by the first input {found[0]}, relative difference {error:.1e}")
