"""Identification against another program.

- `second_opinion`: the same unknowns from the same data by MuJoCo's own identification.
- `decays`: how often intervals of a creeping spring's share and time hold the truth.
"""
