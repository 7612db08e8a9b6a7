"""Pinocchio against MuJoCo, term by term and along trajectories."""
