"""The parts of predictive control: `softdyn.controllers.mpc` joins them.

- `prediction`: the linear model over the horizon and its condensed QP
- `objective`: the weights of its objective, from the robot at rest
- `aim`: the error along the horizon, of the tip or of tasks
- `actuation`: delay and lag of the actuators
- `state_filter`: measured states and unmodelled forces
- `stops`: joint stops as stiff springs
- `pulls`: the pulls at the winches that make up for the friction of cables
- `compensated`: any controller behind delay, lag and friction
- `background`: long work in a process of its own
- `rest_target`: equilibria as targets of shape and input
- `buckling`: the input that buckles an arm, so that its tip can follow a path
- `plan`: bounded commands through a fold
- `ilqr`: paths of least cost under bounded commands, for any discrete step
- `supervisor`: what is followed, the reference, a rest or a plan, and why
"""
