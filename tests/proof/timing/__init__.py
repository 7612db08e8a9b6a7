"""Step times compared with another version of softdyn, and by the size of a robot.

- `comparison`: two versions in alternating processes, and the ratio with its interval;
- `step_scaling`, `chains`, `growth`: a step on generated chains of n joints and m inputs;
- `checkout`: another checkout's softdyn, imported and timed in a separate process.
"""
