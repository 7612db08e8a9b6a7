"""Forces that a fitted model lacks.

- `discrepancy`: a small smooth model of missing joint forces, and rows left out of a fit.
"""
