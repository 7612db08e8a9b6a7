"""Rollouts: a robot moves under given inputs, without a controller.

- `inputs`: the inputs' forms, and CSV files of them
- `threads`: MuJoCo's own rollout of many runs on all cores
- `rollout`: `rollout` and `rollouts`, with the log of a closed loop
"""
