"""How many joints an arm of the generator needs: convergence against its own limit.

- `ladder`: a figure at several numbers of joints: errors, order, joints for a tolerance;
- `convergence`: what `softdyn converge FILE` measures of any arm;
- `arms`: a model straight from an arm's numbers, forces at its tip.
"""
