"""Rods whose behaviour theory knows, and the same arm in another code.

- `closed_forms`: Euler–Bernoulli, Rayleigh, Timoshenko, the elastica, constant curvature;
- `tables`: the generator against each of these, as the tables of docs/design.md;
- `peer`: the same arm in SoRoMoX.
"""
