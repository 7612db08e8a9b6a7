"""Robots written in the other format.

`to_mjcf` writes for MuJoCo, `to_urdf` an annotated URDF, both with `xml_text`; `export` reads back
what they wrote and compares.
"""
