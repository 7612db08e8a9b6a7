"""The number of joints that a designed arm needs: convergence to its limit.

- `ladder`: a figure at several numbers of joints: errors, order, joints for a tolerance;
- `convergence`: the measurements of `softdyn new FILE --converge`;
- `arms`: a model built from an arm's numbers, and its figures.
"""
