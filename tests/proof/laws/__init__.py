"""The controllers against the paper's QPs, and the reference implementation recorded.

- `agreement`: every controller against the paper's QP as printed, at random states;
- `record_reference`: the reference implementation, recorded in an environment of its own.
"""
