"""Identification against another program.

- `second_opinion`: the same unknowns from the same data by MuJoCo's own identification.
"""
