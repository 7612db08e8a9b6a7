"""Pinocchio against MuJoCo, and what statics says against MuJoCo.

Which file holds what
---------------------
crosscheck
    `crosscheck`: every quantity at random states, with its tolerance.
mujoco_terms
    MuJoCo's own answer to each term of the dynamics.
trajectories
    Both engines along time, and their ladders of steps.
result
    What a cross-check found, and its text.
rests
    Whether the twin stays at an equilibrium.
rest_report
    Where a robot can rest, judged by the twin, and its text.
"""
