"""A figure of cables that touch and leave a pulley, a pin and a ring."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.patches import Circle

from softdyn.loading import load_text
from softdyn.validation.loop.pictures import plot_style as look
from softdyn.view.scene import Figure

# a cable from the world to a slide, around one body; the slide moves along z
SLIDE = """\
<robot name="slide"><link name="world"/><link name="slide">
    <inertial><mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="lift" type="prismatic"><parent link="world"/><child link="slide"/>
    <axis xyz="0 0 1"/><limit lower="-0.2" upper="0.2" effort="1" velocity="1"/></joint>
  <softdyn version="1"><tendon name="cable"><site link="world" xyz="-0.15 0 {start}"/>
      <cylinder link="world" xyz="0 0 0" axis="0 1 0" radius="{radius}" side="0 0 {side}"/>
      <site link="slide" xyz="0.15 0 0"/></tendon></softdyn>
</robot>"""
BODIES = {  # radius, height of the side point, height of the site in the world (m)
    "a pulley": (0.05, 0.1, -0.02),
    "a pin": (0.006, 0.012, 0.0),
    "a ring": (0.03, 0.0, 0.0),
}
SHOWN = (-0.15, 0.0, 0.19)  # m, the places of the slide that are drawn


def draw(path: Path) -> None:
    """Write the figure: the cables, dℓ/dq and d²ℓ/dq² over the place of the slide."""
    places = np.linspace(-0.2, 0.2, 801)
    with look.style():
        figure, (above, middle, below) = look.panels(3, len(BODIES), 5.4, 4.4)
        for k, (name, (radius, side, start)) in enumerate(BODIES.items()):
            text = SLIDE.format(radius=radius, side=side, start=start)
            model = load_text(text, path=Path("slide.urdf"))
            drawn = Figure.of(model)
            look.letter(above[k], k, name)
            above[k].add_patch(Circle((0, 0), 100 * radius, facecolor="#E4E4E4", edgecolor="grey"))
            for place, (colour, dashes) in zip(SHOWN, look.INPUTS, strict=False):
                points = 100 * drawn.cables[0].points(drawn.link_poses(np.array([place])))
                above[k].plot(points[:, 0], points[:, 2], color=colour, linestyle=dashes)
                middle[k].axvline(100 * place, color=colour, linestyle=dashes, linewidth=0.6)
                below[k].axvline(100 * place, color=colour, linestyle=dashes, linewidth=0.6)
            above[k].set_aspect("equal")
            arms = [model.tendon_moment_arms(np.array([q]))[0, 0] for q in places]
            bends = [model.tendon_hessians(np.array([q]))[0, 0, 0] for q in places]
            middle[k].plot(100 * places, arms, color=look.BLACK)
            below[k].plot(100 * places, bends, color=look.BLACK)
            below[k].set_xlabel("height q (cm)")
        for axes, label in (
            (above[0], "z (cm)"), (middle[0], "dℓ/dq"), (below[0], "d²ℓ/dq² (1/m)"),
        ):  # fmt: skip
            axes.set_ylabel(label)
        look.write_figure(figure, path)
