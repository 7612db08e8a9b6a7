"""Markers: points and poses that a camera or a motion-capture system measures.

- `points`: the file that says where each marker is on the robot;
- `camera`: the rigid transform from the robot's base to the camera's frame;
- `labels`: which measured marker is which point of the robot;
- `mistakes`: errors in the data that the markers' distances reveal.
"""
