"""A linear MPC of your own: one linearisation, one QP in each period, solved by ProxQP.

It prints the error of the finger's tip after 0.5 s, 1 s and 2 s.
"""

import numpy as np
from proxsuite import proxqp

import softdyn
from softdyn import statics
from softdyn.dynamics import discrete_step
from softdyn.validation import paper, simulate

PERIOD, STEPS = 0.01, 20  # s
model, target = softdyn.load("finger"), paper.set_point("finger", theta=0.5)
goal = statics.inputs_for_tip(model, target.reference(0.0).y).nearest  # an equilibrium there
n, m, J = model.nv, model.nu, goal.state.J
step = discrete_step(model, goal.q, np.zeros(n), goal.u, PERIOD, stops=False)

# deviations from the equilibrium over the horizon: x = F x_0 + G u
powers = [np.eye(2 * n)]
for _ in range(STEPS):
    powers.append(step.A @ powers[-1])
blocks = [power @ step.B for power in powers[:-1]]
rows = [blocks[k::-1] + [np.zeros((2 * n, m))] * (STEPS - 1 - k) for k in range(STEPS)]
F, G = np.vstack(powers[1:]), np.block(rows)
Q = np.zeros((2 * n, 2 * n))  # the tip's place, the joints' angles, their speeds
Q[:n, :n], Q[n:, n:] = 30 * J.T @ J + 1e-2 * np.eye(n), 1e-4 * np.eye(n)
W = G.T @ np.kron(np.eye(STEPS), Q)
bounds = np.tile(model.u_min - goal.u, STEPS), np.tile(model.u_max - goal.u, STEPS)
qp = proxqp.dense.QP(STEPS * m, 0, 0, True)
qp.init(W @ G + 1e-2 * np.eye(STEPS * m), np.zeros(STEPS * m), *[None] * 5, *bounds)


def controller(state, reference):
    """The first input of the QP's solution."""
    qp.update(g=W @ F @ np.concatenate((state.q - goal.q, state.v)))
    qp.solve()
    return goal.u + qp.results.x[:m]


log = simulate(model, controller, target, duration=2.0, period=PERIOD)
error = 100 * np.linalg.norm(log.error, axis=1)
print(f"error after 0.5, 1 and 2 s: {error[50]:.3f}, {error[100]:.3f}, {error[200]:.3f} cm")
