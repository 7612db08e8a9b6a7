"""The QPs of the controllers and their parts; numbers in brackets are the paper's equations.

- `clf`: the Lyapunov function V (8), its P from the Riccati equation (9), the decrease of V (10);
- `stacked_error`: the errors of several tasks as one;
- `tip_error`: the tip's error η (6, 7), μ_ref, and V's condition on μ, for every controller;
- `soft_inverse_dynamics`: the objective of (13) and (22) on the actuated rows (12), condensed;
- `horizon`: M and h of the dynamics (1) at the end of a horizon instead of now;
- `task_qp`: an objective in few unknowns, input bounds and the decrease row as one QP;
- `stopped_step`: a step of the dynamics in which joints have stops, and the joints that these hold;
- `lexicographic_qp`: a QP on the inputs of such a step: bounds and stops, then conditions on the
  motion with the least slack, then the objective;
- `level_qp`: tasks in strict levels of priority, a QP for each level;
- `least_norm`: bounded least squares, the minimiser of least norm, for CLF-QP and `allocate`;
- `qp`: the solvers, with residuals of their answers and a clock; no other file imports DAQP and
  ProxSuite;
- `linear_algebra`: ranks, bases and small systems, in compiled loops.
"""
