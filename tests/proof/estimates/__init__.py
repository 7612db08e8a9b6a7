"""Estimates of the observer, judged by MuJoCo's truth.

- `forces`: force and payload at the tip;
- `creep`: controllers of springs that creep, with and without an observer of their branches.
"""
