"""Identification tested with MuJoCo's data and compared with MuJoCo's own.

- `trials`: identification of twins with known parameters;
- `excitations`: the excitation whose data identify the parameters best;
- `twin_report`: reports of them.
"""
