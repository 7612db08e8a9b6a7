"""Identification judged by MuJoCo.

- `trials`: data of twins whose parameters are known, identified;
- `excitations`: which of several tells the parameters best;
- `second_opinion`: the same fit by MuJoCo's own identification.
"""
