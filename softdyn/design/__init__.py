"""Design a robot: from material and sizes to its URDF file and meshes.

    from softdyn import design

    rubber = design.Material(youngs_modulus=0.25e6, density=1070)
    arm = design.Arm((design.Section(0.2, (0.012, 0.008), rubber),), name="rod")
    text = design.urdf(arm)                      # annotated URDF
    made = design.read(tomllib.load(file))       # the same from a table, as `softdyn new` does

- `cables`: cables, their motors and sensors, as frozen data;
- `rods`: material, sections, plates, mount, as frozen data;
- `quadrature`: places of the joints in a section;
- `layout`: bodies and springs of the straight arm, its mass matrix and frequencies;
- `plausible`: refuses numbers that no soft arm has;
- `arm_file`: the annotated URDF of an arm, its looks included;
- `strains`: piecewise constant or polynomial strains, for `softdyn.reduce`;
- `log_spiral`, `finger`: presets;
- `attachment`: joins two robots, such as an arm and the robot that carries it;
- `arm_table`, `preset_tables`, `source`: read a table whose keys name their units;
- `chain`: builds a serial robot link by link, and the looks of its links;
- `shapes`: lattices, log-spiral blocks and bones as meshes.

The public names are imported when they are used, as `__init__.pyi` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
