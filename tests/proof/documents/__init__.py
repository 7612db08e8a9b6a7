"""The documents' tables.

- `tables`: those of measured figures, which stand beside the code
- `measured_rows`: the measured figures of a table, replaced in parts
- `settings`: those that repeat settings of the code
- `reports`: public reports about other tools, which a test runs
"""
