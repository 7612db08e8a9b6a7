"""The time of a control step, and its measurement.

- `step_time`: one step, its parts, the floor below it, the paper's stack; rounds
- `recording`: closed-loop states on which steps are timed
- `step_report`, `step_figures`: tables, the machine, and the figure of the parts
- `comparison`, `checkout`: this checkout against another, in alternating processes
- `step_scaling`, `growth`: the step by the size of a robot
"""
