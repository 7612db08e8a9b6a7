"""A controller of your own: a virtual spring and damper pull the tip to its target.

It prints whether the finger's tip arrives, its last error, and writes own_controller.png.
"""

import softdyn
from softdyn.controllers import Command, allocate
from softdyn.validation import paper, simulate


class SpringPull:
    """Pulls the tip by a spring; gravity and the joints' springs are compensated."""

    def __init__(self, model, stiffness=20.0, damping=2.0):
        self.model, self.stiffness, self.damping = model, stiffness, damping  # N/m, N s/m

    def __call__(self, state, reference):
        force = self.stiffness * (reference.y - state.y) - self.damping * state.ydot
        torque = state.J.T @ force + state.g + state.K
        return Command(allocate(self.model, state, torque))


model = softdyn.load("finger")
log = simulate(model, SpringPull(model), paper.set_point("finger", theta=0.5), duration=2.0)
print(f"reached: {log.verdict().reached}, final error {log.final_error_cm:.3f} cm")
log.plot("own_controller.png")
