"""A comparison opens each file only once."""

import json
import subprocess
import sys

from softdyn.validation.mjcf.comparison.side import Side
from tests.support import pair_robots, robots

COUNTED = """
import json, os, sys
opened = []
sys.addaudithook(lambda event, words: event == "open" and opened.append(words[0]))
from softdyn.commands import compare
code = compare.main([*sys.argv[1:], "--samples", "1"])
print(json.dumps([code, [os.path.realpath(x) for x in opened if isinstance(x, (str, bytes))]]))
"""


def opened(folder, *words):
    """The command's exit code, and how often it opened each file of the folder."""
    run = subprocess.run(
        [sys.executable, "-P", "-c", COUNTED, *map(str, words)],
        capture_output=True, text=True, cwd=folder,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    code, files = json.loads(run.stdout.splitlines()[-1])
    names = [path.rpartition("/")[2] for path in files if path.startswith(str(folder.resolve()))]
    return code, {name: names.count(name) for name in names}


def test_the_command_opens_each_file_once(tmp_path):
    """The page, both engines, Pinocchio's reader and the comparison share one content."""
    include = '<mujocoinclude><default><geom rgba="1 0 0 1"/></default></mujocoinclude>'
    (tmp_path / "look.xml").write_text(include)
    (tmp_path / "a.urdf").write_text(pair_robots.URDF)
    mjcf = pair_robots.MJCF.replace("<worldbody>", '<include file="look.xml"/><worldbody>', 1)
    (tmp_path / "b.xml").write_text(mjcf)
    code, counts = opened(tmp_path, "a.urdf", "b.xml", "--html", "out.html", "--engines")
    assert code == 0
    assert {name: counts[name] for name in ("a.urdf", "b.xml", "look.xml")} == {
        "a.urdf": 1, "b.xml": 1, "look.xml": 1,
    }  # fmt: skip


def test_a_floating_urdf_is_opened_once_too(tmp_path):
    (tmp_path / "a.urdf").write_text(robots.WALKER)
    root = Side(tmp_path / "a.urdf", floating=True)
    free = Side(tmp_path / "b.xml")
    free.path.write_text(
        '<mujoco><worldbody><body name="base"><freejoint/><geom size="0.1"/><body name="arm">'
        '<joint axis="0 1 0"/><geom size="0.1"/></body></body></worldbody></mujoco>'
    )
    fixed = Side(root.path)
    assert fixed.beside(free).neutral.parts[0].kind == "free"
    assert fixed.beside(free).contents is fixed.contents
    assert free.beside(fixed) is free
    assert fixed.beside(fixed) is fixed
    _, counts = opened(tmp_path, "a.urdf", "b.xml", "--html", "out.html", "--engines")
    assert (counts["a.urdf"], counts["b.xml"]) == (1, 1)


def test_what_is_made_of_a_file_is_its_content_as_it_was(tmp_path):
    side = Side(tmp_path / "a.xml")
    side.path.write_text(pair_robots.MJCF)
    names = [part.name for part in side.neutral.parts]
    side.path.write_text("<mujoco/>")
    assert side.scene.njnt == len(names) == 3
    assert Side.of(side) is side
