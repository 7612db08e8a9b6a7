"""The exact step as a function of CasADi, with its Jacobians.

It prints the gradient of a cost over 20 periods by the inputs, and its largest difference to the
chain rule in NumPy. It needs the package casadi.
"""

import casadi
import numpy as np

import softdyn
from softdyn.dynamics import discrete_step


class Step(casadi.Callback):
    """(x, u) → x⁺ with x = (q, v), of a robot without continuous joints and floating base."""

    def __init__(self, model, period, jacobians=False):
        super().__init__()
        self.model, self.period, self.jacobians, self.kept = model, period, jacobians, []
        self.construct("jac_step" if jacobians else "step", {})

    def get_n_in(self):
        return 3 if self.jacobians else 2

    def get_n_out(self):
        return 2 if self.jacobians else 1

    def get_sparsity_in(self, i):
        return casadi.Sparsity.dense((2 * self.model.nv, self.model.nu, 2 * self.model.nv)[i], 1)

    def get_sparsity_out(self, i):
        n = 2 * self.model.nv
        return casadi.Sparsity.dense(n, (n, self.model.nu)[i] if self.jacobians else 1)

    def eval(self, given):
        x, u = (np.array(one).ravel() for one in given[:2])
        q, v = np.split(x, 2)
        step = discrete_step(self.model, q, v, u, self.period)
        return [step.A, step.B] if self.jacobians else [np.concatenate((step.q, step.v))]

    def has_jacobian(self):
        return not self.jacobians

    def get_jacobian(self, *_):
        self.kept.append(Step(self.model, self.period, True))
        return self.kept[-1]


model, T, N = softdyn.load("finger"), 0.01, 20
step, U = Step(model, T), casadi.MX.sym("U", model.nu, N)
x = casadi.DM.zeros(2 * model.nv)
for k in range(N):
    x = step(x, U[:, k])
cost = casadi.sumsqr(x - 0.1)
gradient = casadi.Function("gradient", [U], [casadi.gradient(cost, U)])
inputs = np.random.default_rng(0).uniform(model.u_min, model.u_max, (N, model.nu))
found = np.array(gradient(inputs.T)).T

q, v, steps = model.q0, np.zeros(model.nv), []
for u in inputs:
    steps.append(discrete_step(model, q, v, u, T))
    q, v = steps[-1].q, steps[-1].v
s, expected = 2 * (np.concatenate((q, v)) - 0.1), []
for one in reversed(steps):
    expected.append(one.B.T @ s)
    s = one.A.T @ s
error = np.abs(found - expected[::-1]).max() / np.abs(found).max()
print(f"gradient by the first input {found[0]}, relative difference {error:.1e}")
