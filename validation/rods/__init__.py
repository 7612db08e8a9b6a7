"""How well a chain of joints stands for a rod: against itself, closed forms and another code.

- `ladder`: a figure at several numbers of joints: errors, order, joints for a tolerance;
- `convergence`: what `softdyn converge FILE` measures of any arm;
- `closed_forms`: Euler–Bernoulli, Rayleigh, Timoshenko, the elastica, constant curvature;
- `proof`: the generator against each of these, as the tables of docs/design.md;
- `peer`: the same arm in SoRoMoX;
- `arms`: a model straight from an arm's numbers, forces at its tip.
"""
