"""`softdyn.show`: displayed and saved page are equal, and bad arguments are refused."""

from __future__ import annotations

import pickle

import numpy as np

import softdyn
from tests.support.refused import refused


def test_a_view_shows_one_pose_in_a_notebook_and_in_a_file(tmp_path):
    model = softdyn.load("finger")
    view = softdyn.show(model)
    q, u = np.array([0.1, 0.2, 0.3, 0.4]), np.array([0.5, -1.0])
    assert view.display(q, u) is view
    copy = pickle.loads(pickle.dumps(view))
    for one in (view, copy):
        ((frame,),) = (track.frames for track in one.page.runs[0].tracks)
        np.testing.assert_allclose(frame[1:7], [*q, *u], rtol=1e-6)
    view.save(tmp_path / "arm.html")
    assert (tmp_path / "arm.html").read_text(encoding="utf-8") == view.page.html()
    assert "<iframe" in view._repr_html_()
    tip = model.state(q, np.zeros(4)).y
    assert f"tip at {tip[0]:.4f} " in repr(view)
    assert "save(" in repr(view)


def test_a_page_has_the_name_of_its_robot(tmp_path):
    own = (
        (softdyn.load("finger").robot.path).read_text().replace('name="finger"', 'name="thumb"', 1)
    )
    (tmp_path / "arm.urdf").write_text(own)
    for source, title in (("spirob48", "spirob48"), (tmp_path / "arm.urdf", "thumb")):
        assert softdyn.show(softdyn.load(source)).page.title == title


def test_what_cannot_be_shown_is_said():
    model = softdyn.load("finger")
    view = softdyn.show(model)
    for q, u, name in (([0, 0], None, "q"), ([np.nan] * 4, None, "q"), (None, [1], "u")):
        with refused(name):
            view.display(q, u)
    with refused("model"):
        softdyn.show("finger")
    with refused("/no/such/folder/arm.html"):
        view.save("/no/such/folder/arm.html")
