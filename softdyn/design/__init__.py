"""From a few parameters to a robot's file and meshes.

- `urdf_text`: annotated URDF as text, link by link;
- `shapes`: lattices, log-spiral blocks and bones as meshes.

Which numbers make which robot is data of the caller: `scripts/make_robots.py` for the bundled ones.
"""
