"""Step times against another version of softdyn, and against the size of a robot.

- `comparison`: two versions in alternating processes, and the ratio with its interval;
- `step_scaling`, `chains`, `growth`: a step on generated chains of n joints and m inputs;
- `checkout`: another checkout's softdyn, imported and timed in a process of its own.
"""
