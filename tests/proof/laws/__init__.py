"""The controllers compared with the paper's QPs, and recordings of the reference implementation.

- `agreement`: every controller compared with the paper's printed QP, at random states;
- `record_reference`: records the reference implementation in a separate environment.
"""
