"""A twin with the collision geometry of another MJCF file."""

import mujoco
import numpy as np

from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.fingerprint import fingerprint
from softdyn.validation.twin.plant_errors import PlantErrors
from tests.proof.paper.borrowed import BorrowedPlant, BorrowedShapes
from tests.support.refused import refused

LINK = """<body name="b{k}" pos="{x} 0 0"><joint axis="0 1 0"/>
<inertial pos="0.03 0 0" mass="0.01" diaginertia="1e-5 1e-5 1e-5"/>
<geom type="capsule" fromto="0.02 0 0 0.04 0 0" size="0.{size}" friction="0.7" condim="1"/>
<geom type="sphere" size="0.05" contype="0" conaffinity="0"/>{inner}</body>"""


def chain(path, size="004", joints=4):
    """The finger's links 0.5 m up, each with a capsule and a purely visual sphere."""
    inner = ""
    for k in range(joints, 0, -1):
        inner = LINK.format(k=k, x=0.06 if k > 1 else 0.0, size=size, inner=inner)
    path.write_text(
        f'<mujoco><option cone="pyramidal" tolerance="1e-7"/><worldbody><body pos="0 0 0.5">'
        f'<geom type="box" size="0.01 0.01 0.01"/>{inner}</body></worldbody></mujoco>'
    )
    return path


def test_the_file_s_geoms_stand_where_it_has_them(tmp_path):
    path = chain(tmp_path / "chain.xml")
    twin = BorrowedShapes(path, "finger", contacts=True)
    source = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(source)
    q = np.array([0.3, -0.2, 0.5, 0.1])
    twin.set_state(q, np.zeros(4))
    data.qpos[:] = q
    mujoco.mj_forward(source, data)
    touching = source.geom_contype > 0
    assert twin.model.ngeom == touching.sum() == 5
    np.testing.assert_allclose(
        twin.data.geom_xpos, data.geom_xpos[touching] - [0, 0, 0.5], atol=1e-12
    )
    np.testing.assert_array_equal(twin.model.geom_size, source.geom_size[touching])
    assert (twin.model.geom_friction[1:, 0] == 0.7).all()
    assert twin.model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    assert twin.model.opt.tolerance == 1e-7
    assert twin.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_MULTICCD


def test_a_run_is_known_by_the_content_of_the_shapes(tmp_path):
    """The content counts, not the name: that of the MJCF, its includes and its meshes."""
    text = chain(tmp_path / "chain.xml").read_text()

    def mark(name="chain.xml"):
        plant = BorrowedPlant.of(PlantErrors(mass=1.1), tmp_path / name)
        assert plant.mass == 1.1
        return fingerprint(Case("finger", "ic", "set_point", 0.5, options={"plant": plant}))

    marks = [mark()]

    def write(size="004", mesh=1.0, included="0.7"):
        corners = [(x, y, z) for x in (0, mesh) for y in (0, mesh) for z in (0, mesh)]
        (tmp_path / "cube.obj").write_text("".join("v {} {} {}\n".format(*c) for c in corners))
        (tmp_path / "more.xml").write_text(
            f'<mujoco><asset><mesh name="cube" file="cube.obj" scale=".01 .01 .01"/></asset>'
            f'<default><geom friction="{included}"/></default></mujoco>'
        )
        changed = text.replace("<worldbody>", '<include file="more.xml"/><worldbody>')
        (tmp_path / "chain.xml").write_text(changed.replace('"0.004"', f'"0.{size}"'))
        marks.append(mark())

    write()
    write(size="005")
    write(mesh=1.5)
    write(included="0.8")
    assert len(set(marks)) == len(marks) == 5
    write()
    assert marks[-1] == marks[1]
    with refused("none.xml"):
        mark("none.xml")
