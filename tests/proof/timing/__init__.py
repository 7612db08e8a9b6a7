"""Step times of another version of softdyn against this one.

- `comparison`: two versions in alternating processes, and the ratio with its interval;
- `checkout`: another checkout's softdyn, imported and timed in a process of its own.
"""
