"""Robots written in the other format: `to_mjcf` for MuJoCo, `to_urdf` as an annotated URDF."""
