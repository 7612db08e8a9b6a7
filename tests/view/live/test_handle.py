"""The handle of a target in a browser: moved and turned as the pointer says, from any side."""

from __future__ import annotations

from string import Template

import numpy as np
import pytest

from softdyn.view.page import asset, scene_page
from tests.support.browser import Browser, required

pytestmark = required()
PAGE = """$head<body><div id="pane"></div>$library
<script>$script</script>
<script type="application/json" id="scene">$scene</script></body></html>"""
# a target of a robot of one metre; `look` places the camera in the robot's axes
SCRIPT = """
const [viewer, stage] = openViewer(document.getElementById("pane"));
const target = new T.Mesh(new T.SphereGeometry(0.02), new T.MeshBasicMaterial());
stage.add(target);
const handle = new Handle(viewer, target, 1);
handle.enable(true);
function look(from, place, axis, angle, turns) {
  target.position.set(...place);
  target.quaternion.setFromAxisAngle(new T.Vector3(...axis), angle);
  viewer.scene.updateMatrixWorld(true);
  viewer.camera.position.copy(stage.localToWorld(new T.Vector3(...from)));
  viewer.controls.target.copy(stage.localToWorld(target.position.clone()));
  viewer.controls.update();
  viewer.camera.updateMatrixWorld(true);
  handle.turns = turns;
}
function seen(place) {
  const p = stage.localToWorld(new T.Vector3(...place)).project(viewer.camera);
  return [(p.x + 1) / 2 * innerWidth, (1 - p.y) / 2 * innerHeight];
}
const at = ([x, y], shiftKey = false, pointerType = "mouse") =>
  ({clientX: x, clientY: y, shiftKey, pointerType, buttons: 1});
function drag(from, to, shift = false) {
  if (!handle.press(at(from, shift))) return null;
  for (const s of [0.3, 0.7, 1])
    handle.move(at(from.map((a, k) => a + s * (to[k] - a)), shift));
  handle.release();
  return [...target.position.toArray(), ...target.quaternion.toArray()];
}
"""
SIDES = {  # from where the camera looks, and the axis of depth
    "front": ([0.4, -2.0, 0.5], 1), "back": ([-0.5, 2.0, -0.4], 1), "side": ([2.0, 0.6, -0.7], 0),
    "above": ([0.3, -0.8, 2.0], 2), "straight": ([0.1, -2.0, 0.2], 1),
    "corner": ([1.5, -1.6, 1.2], 1),
}  # fmt: skip
PLACE = [0.1, 0.0, 0.2]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory):
    parts = asset("figure.js"), asset("handle.js", "softdyn.view.live"), SCRIPT
    file = tmp_path_factory.mktemp("handle") / "handle.html"
    text = scene_page(PAGE, asset("style.css"), "\n".join(parts), {"title": "handle"})
    file.write_text(text, encoding="utf-8")
    with Browser() as found:
        found.open(file.as_uri(), 800, 600)
        yield found
        assert found.console == []


def js(template: str, **values: object) -> str:
    text = {name: np.asarray(value).tolist() for name, value in values.items()}
    return Template(template).substitute({name: str(value) for name, value in text.items()})


def look(browser: Browser, side: str, turns: bool = False, axis=(0, 0, 1), angle=0.0) -> int:
    """Place camera and target; the axis of depth."""
    place, depth = SIDES[side]
    values = {"from_": place, "place": PLACE, "axis": axis, "angle": angle}
    turned = "true" if turns else "false"
    browser.run(js(f"(look($from_, $place, $axis, $angle, {turned}), 1)", **values))
    return depth


def seen(browser: Browser, place: object) -> np.ndarray:
    return np.array(browser.run(js("seen($place)", place=place)))


def drag(browser: Browser, start: object, end: object, shift: bool = False) -> np.ndarray:
    word = "true" if shift else "false"
    return np.array(browser.run(js(f"drag($start, $end, {word})", start=start, end=end)))


@pytest.mark.parametrize("side", SIDES)
def test_the_ball_follows_the_pointer_in_the_plane_that_faces_the_camera(browser, side):
    depth = look(browser, side)
    beside = np.array([3, 2])  # the centre, which does not jump
    start = seen(browser, PLACE) + beside
    end = start + np.array([70, -40])
    moved = drag(browser, start, end)
    assert moved[depth] == pytest.approx(PLACE[depth], abs=1e-12)
    np.testing.assert_allclose(seen(browser, moved[:3]), end - beside, atol=1.5)
    np.testing.assert_allclose(moved[3:], [0, 0, 0, 1])


@pytest.mark.parametrize("side", SIDES)
def test_with_shift_it_moves_in_depth(browser, side):
    depth = look(browser, side)
    way = np.eye(3)[depth]
    goal = PLACE + 0.15 * way
    start, end = seen(browser, PLACE), seen(browser, goal)
    # along a line that points at the camera the pointer moves up or down
    straight = np.hypot(*(end - start)) < 10
    end = start - [0, 50] if straight else end
    moved = drag(browser, start, end, shift=True)
    np.testing.assert_allclose(np.delete(moved[:3], depth), np.delete(PLACE, depth), atol=1e-12)
    if not straight:
        assert moved[depth] == pytest.approx(goal[depth], abs=2e-3)
    else:
        away = -np.sign(SIDES[side][0][depth])  # up is away from the camera
        assert 0.05 < away * (moved[depth] - PLACE[depth]) < 0.5


@pytest.mark.parametrize("axis", range(3))
def test_an_arrow_moves_it_along_itself(browser, axis):
    look(browser, "corner")
    way = np.eye(3)[axis]
    start, end = (seen(browser, PLACE + x * way) for x in (0.19, 0.35))
    across = (end - start)[::-1] * [1, -1]  # what is not along the arrow does not count
    moved = drag(browser, start, end + 0.2 * across)
    others = [k for k in range(3) if k != axis]
    np.testing.assert_allclose(moved[others], np.array(PLACE)[others], atol=1e-12)
    assert moved[axis] == pytest.approx(PLACE[axis] + 0.16, abs=5e-3)


def turned(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A vector after a rotation by a quaternion (x, y, z, w)."""
    u, w = quaternion[:3], quaternion[3]
    return vector + 2 * np.cross(u, np.cross(u, vector) + w * vector)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", ["front", "above", "straight"])
def test_a_ring_turns_it_about_its_own_axis(browser, side, axis):
    """By the angle of the pointer about the centre; from the ring's edge along its near side."""
    about, angle = np.array([0.6, 0.0, 0.8]), 0.4
    look(browser, side, True, about, angle)
    before = np.array([*np.sin(angle / 2) * about, np.cos(angle / 2)])
    own = turned(before, np.eye(3)[axis])
    view = np.subtract(PLACE, SIDES[side][0])
    near = -view + (view @ own) * own  # a place of the ring that the pointer sees well
    near *= 0.17 / np.linalg.norm(near)
    wanted = 0.6
    far = near * np.cos(wanted) + np.cross(own, near) * np.sin(wanted)
    flat = abs(own @ view) / np.linalg.norm(view) < 0.3
    end = PLACE + (near + wanted * np.cross(own, near) if flat else far)
    after = drag(browser, seen(browser, np.add(PLACE, near)), seen(browser, end))
    np.testing.assert_allclose(after[:3], PLACE, atol=1e-12)
    np.testing.assert_allclose(turned(after[3:], np.eye(3)[axis]), own, atol=1e-9)
    across = np.cross(own, near) / 0.17
    start = near / 0.17
    local = turned(before * [-1, -1, -1, 1], start)
    now = turned(after[3:], local)
    assert np.arctan2(now @ across, now @ start) == pytest.approx(
        wanted, abs=0.12 if flat else 0.03
    )


def test_a_finger_grasps_what_is_further_away_than_a_mouse(browser):
    look(browser, "front")
    x, y = seen(browser, PLACE)
    place = f"[{x - 15}, {y}]"
    assert browser.run(f"handle.at(at({place}))") is None
    assert browser.run(f"handle.at(at({place}, false, 'touch')).name") == "ball"


def test_a_handle_that_is_not_enabled_is_not_grasped_and_not_shown(browser):
    look(browser, "front")
    start = seen(browser, PLACE)
    browser.run("(handle.enable(false), 1)")
    assert browser.run(js("drag($start, $start)", start=start)) is None
    assert not browser.run("target.children.some(shape => shape.visible)")
    browser.run("(handle.enable(true), 1)")
    assert browser.run("target.children.filter(shape => shape.visible).length") == 6


def test_shift_during_a_drag_changes_its_way_without_a_jump(browser):
    look(browser, "front")
    start = seen(browser, PLACE)
    found = browser.run(js("""(() => {
      const place = () => target.position.toArray(), [x, y] = $start;
      handle.press(at([x, y]));
      handle.move(at([x + 40, y]));
      const first = place();
      handle.move(at([x + 40, y], true));
      const second = place();
      handle.move(at([x + 40, y - 30], true));
      handle.release();
      return [first, second, place()]; })()""", start=start))  # fmt: skip
    first, second, last = np.array(found)
    assert first[0] > PLACE[0] + 0.02
    np.testing.assert_allclose(second, first, atol=1e-12)
    np.testing.assert_allclose(last[[0, 2]], first[[0, 2]], atol=1e-12)
    assert abs(last[1] - first[1]) > 0.02
