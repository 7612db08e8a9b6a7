"""Damaged files, messages and command lines by the thousand, and what may come of them.

- `inputs`: a base file, a seed and a number in, a damaged file out;
- `verdict`: refused in one line, accepted and read alike, or a finding;
- `second_reading`: a robot's file read once more, by another parser;
- `data`: the same of logs, stores, summaries and TOML: inputs and verdicts;
- `messages`: damaged messages to a live robot;
- `arguments`: damaged command lines;
- `campaign`: many of them, each in a process that may die of it; the report;

Another kind of input is a module with `kept` and `work`, as `data` has them.
"""
