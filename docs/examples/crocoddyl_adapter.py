"""The exact step as a model of Crocoddyl: FDDP plans the finger's motion to a target.

It prints the tip's last error, and the largest difference to Crocoddyl's numerical derivatives.
It needs the package crocoddyl.
"""

import crocoddyl
import numpy as np

import softdyn
from softdyn import statics
from softdyn.dynamics import discrete_step


class Step(crocoddyl.ActionModelAbstract):
    """A period of a robot without continuous joints and floating base, towards an equilibrium."""

    def __init__(self, model, goal, period, weights=(1.0, 1e-4, 1e-2)):
        super().__init__(crocoddyl.StateVector(2 * model.nv), model.nu)
        self.robot, self.period, self.weights = model, period, weights
        self.x_goal, self.u_goal = np.concatenate((goal.q, np.zeros(model.nv))), goal.u
        self.W = np.repeat(weights[:2], model.nv)  # of positions and speeds

    def calc(self, data, x, u=None):
        given, n = u is not None, self.robot.nv
        u = u if given else self.u_goal
        self.step = discrete_step(self.robot, x[:n], x[n:], u, self.period)
        data.xnext = np.concatenate((self.step.q, self.step.v)) if given else x
        away, force = x - self.x_goal, u - self.u_goal
        data.cost = 0.5 * (self.W @ away**2 + self.weights[2] * force @ force)

    def calcDiff(self, data, x, u=None):
        self.calc(data, x, u)
        data.Lx, data.Lxx = self.W * (x - self.x_goal), np.diag(self.W)
        if u is not None:
            data.Fx, data.Fu = self.step.A, self.step.B
            data.Lu = self.weights[2] * (u - self.u_goal)
            data.Luu = self.weights[2] * np.eye(self.nu)


model = softdyn.load("finger")
goal = statics.inputs_for_tip(model, np.array([0.127, 0.0, -0.127])).nearest
run, end = Step(model, goal, 0.01), Step(model, goal, 0.01, (1e4, 1.0, 1e-2))
x0 = np.zeros(2 * model.nv)
solver = crocoddyl.SolverFDDP(crocoddyl.ShootingProblem(x0, [run] * 100, end))
solver.solve([x0] * 101, [goal.u] * 100, 50)
tip = model.state(solver.xs[-1][: model.nv], solver.xs[-1][model.nv :]).y
print(f"tip {1e3 * np.linalg.norm(tip - goal.state.y):.3f} mm from its target after 1 s")

numeric = crocoddyl.ActionModelNumDiff(run, True)
data, other = run.createData(), numeric.createData()
x, u = np.array(solver.xs[30]), np.array(solver.us[30])
run.calc(data, x, u)
run.calcDiff(data, x, u)
numeric.calc(other, x, u)
numeric.calcDiff(other, x, u)
print(f"Fx {np.abs(data.Fx - other.Fx).max():.1e}, Fu {np.abs(data.Fu - other.Fu).max():.1e}")
