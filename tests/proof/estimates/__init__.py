"""Estimates of the observer, judged by MuJoCo's truth.

- `forces`: force and payload at the tip.
"""
