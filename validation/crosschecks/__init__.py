"""Checks against MuJoCo: the terms of the model, and the equilibria of statics.

Which file holds what
---------------------
crosscheck
    `crosscheck`: every quantity at random states, with its tolerance.
mujoco_terms
    MuJoCo's own answer to each term of the dynamics.
rigged
    Winches, tensions, sensors and a trajectory of a robot with a rig.
trajectories
    Trajectories in both engines, and how they converge when the step is halved.
result
    The result of a cross-check, and its text.
rests
    Whether the twin stays at an equilibrium.
rest_report
    The equilibria of a robot, each held in the twin, and their text.
"""
