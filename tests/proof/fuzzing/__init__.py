"""Thousands of damaged files, messages and command lines, and verdicts on the reactions.

- `inputs`: a damaged file from a base file, a seed and a number;
- `verdict`: the input is refused in one line, accepted and read correctly, or a finding;
- `second_reading`: a robot's file, read by another parser;
- `data`: inputs and verdicts for logs, stores, summaries and TOML; `arm_table`: one of them;
- `messages`: damaged messages to a live robot;
- `arguments`: damaged command lines;
- `campaign`: many inputs in separate processes, and the report.

Another kind of input is a module with `kept` and `work`, as `data` has them.
"""
