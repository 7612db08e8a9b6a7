"""An iLQR of your own, with bounds of the inputs, on the full model of a helix.

It plans 0.6 s from rest to the tip of another equilibrium, 36 joints and 9 inputs, and prints the
cost of each iteration, the steps that were divided, and the tip's last error.
"""

import numpy as np

import softdyn
from softdyn import statics
from softdyn.dynamics import discrete_step

PERIOD, STEPS, ITERATIONS = 0.02, 30, 10  # s
TIP, SHAPE, SPEED, INPUT, END = (
    1000.0,
    1e-2,
    1e-2,
    1e-5,
    10.0,
)  # weights; END is the last step's factor
model = softdyn.load("helix")
n, m = model.nv, model.nu
lower, upper = model.u_min, model.u_max
start = statics.settle(model, model.relaxed)
goal = statics.settle(model, np.clip([3, 0, 0, 0, 0, 0, 0, 0, 0], lower, upper))
divided = 0


def forward(u, gains=None, old=None):
    """States and steps under inputs, or under gains about an old path."""
    global divided
    q, v, steps, used = start.q, np.zeros(n), [], []
    for k in range(STEPS):
        now = u[k]
        if gains is not None:
            away = np.concatenate((q - old[k][0], v - old[k][1]))
            now = np.clip(u[k] + gains[k] @ away, lower, upper)
        step = discrete_step(model, q, v, now, PERIOD)
        steps.append((q, v, step))
        used.append(now)
        q, v, divided = step.q, step.v, divided + (step.substeps > 1)
    return np.array(used), steps


def cost_at(q, v, last):
    """The cost of a state, its gradient and its Gauss-Newton Hessian."""
    state, factor = model.state(q, v), END if last else 1.0
    tip, shape = state.y - goal.state.y, q - goal.q
    value = factor * (TIP * tip @ tip + SHAPE * shape @ shape + SPEED * v @ v)
    slope = factor * np.concatenate((TIP * state.J.T @ tip + SHAPE * shape, SPEED * v))
    bend = np.zeros((2 * n, 2 * n))
    bend[:n, :n] = factor * (TIP * state.J.T @ state.J + SHAPE * np.eye(n))
    bend[n:, n:] = factor * SPEED * np.eye(n)
    return value, 2 * slope, 2 * bend


def total(u, steps):
    """The cost of a path."""
    ends = [cost_at(step.q, step.v, k == STEPS - 1)[0] for k, (_, _, step) in enumerate(steps)]
    return sum(ends) + INPUT * np.sum((u - goal.u) ** 2)


def backward(u, steps, damping):
    """Changes of the inputs and gains; inputs that leave their bounds are kept there."""
    s, S = np.zeros(2 * n), np.zeros((2 * n, 2 * n))
    changes, gains = np.zeros((STEPS, m)), np.zeros((STEPS, m, 2 * n))
    for k in reversed(range(STEPS)):
        _, _, step = steps[k]
        _, slope, bend = cost_at(step.q, step.v, k == STEPS - 1)
        s, S = s + slope, S + bend
        by_u = step.B.T @ s + 2 * INPUT * (u[k] - goal.u)
        by_ux, by_uu = step.B.T @ S @ step.A, step.B.T @ S @ step.B
        by_uu += 2 * (INPUT + damping) * np.eye(m)
        free = ~((u[k] <= lower) & (by_u > 0) | (u[k] >= upper) & (by_u < 0))
        inverse = np.linalg.inv(by_uu[free][:, free])
        changes[k, free], gains[k, free] = -inverse @ by_u[free], -inverse @ by_ux[free]
        s = step.A.T @ s + gains[k].T @ (by_u + by_uu @ changes[k]) + by_ux.T @ changes[k]
        S = step.A.T @ S @ step.A + gains[k].T @ by_uu @ gains[k]
        S += gains[k].T @ by_ux + by_ux.T @ gains[k]
    return changes, gains


u, steps = forward(np.tile(start.u, (STEPS, 1)))
cost, damping = total(u, steps), 1e-2
for _ in range(ITERATIONS):
    changes, gains = backward(u, steps, damping)
    tried = forward(u + changes, gains, steps)
    better = total(*tried) < cost
    if better:
        (u, steps), cost = tried, total(*tried)
    damping *= 0.2 if better else 10.0
    print(f"cost {cost:.3f}")
error = np.linalg.norm(model.state(steps[-1][2].q, steps[-1][2].v).y - goal.state.y)
print(
    f"{divided} divided steps, tip {1e3 * error:.2f} mm from its target after {PERIOD * STEPS:g} s"
)
