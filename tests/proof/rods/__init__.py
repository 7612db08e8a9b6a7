"""Designed arms compared with theory, and with another code.

- `closed_forms`: Euler–Bernoulli, Rayleigh, Timoshenko, the elastica, constant curvature;
- `tables`: designed arms compared with each of these, as the tables of docs/rods.md;
- `peer`: the same arm in SoRoMoX.
"""
