"""Many robots at once: the catalogue's rows and document, and a hundred random robots."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import pytest

from softdyn.description.library import example_files, example_robots
from tests.proof.crosschecks import batch as catalogue
from tests.proof.crosschecks import forced_robots
from tests.proof.crosschecks.batch import FIXED, BatchRow
from tests.support.random_robots import random_urdf


def test_every_file_of_the_package_is_a_job():
    files = example_files()
    assert len(files) == 69 > len(example_robots())
    jobs = catalogue.catalogue_jobs(3, 5, floating=False, repair_inertia=False)
    assert [job.path for job in jobs] == list(files)
    assert len({job.name for job in jobs}) == 69
    assert all((job.samples, job.seed) == (3, 5) for job in jobs)


def test_a_disagreement_is_a_failed_row():
    rows = [
        BatchRow("good", FIXED, True, 2, "M", 1e-15),
        BatchRow("bad", FIXED, False, 2, "qdd", 1e-3, 1e9, "qdd: too far"),
        BatchRow("odd", FIXED, None, reason="no joint"),
    ]
    survey = catalogue.BatchReport(tuple(rows))
    assert survey.counts == {FIXED: {"passed": 1, "failed": 1, "unsupported": 1}}
    assert not survey.passed
    assert "FAILED, qdd: too far" in str(survey)
    assert "unsupported: no joint" in str(survey)
    assert "good" not in survey.text_of(rows[1:])


@pytest.mark.parametrize("block", range(4))
def test_a_hundred_random_robots(block):
    for job in catalogue.random_jobs(25, 1, 200 + 25 * block, trajectories=False):
        row = catalogue.examine(job)
        assert row is not None
        assert row.passed is True, row


SPRING = "stiffness", "rest", "damping", "armature"


def test_random_robots_have_every_feature_of_the_format():
    """By the tags of a hundred: joints, tendons, massless links alone and in a row."""
    seen: set[str] = set()
    for seed in range(100):
        root = ElementTree.fromstring(random_urdf(seed))
        seen |= {f"{x.get('type')} joint" for x in root.iter("joint") if x.get("type")}
        for tag, fields in (("tendon", SPRING), ("joint", ("armature",))):
            seen |= {f"{tag} {name}" for x in root.iter(tag) for name in fields if x.get(name)}
        seen |= {f"{x.tag} in {y.tag}" for y in root.iter() for x in y}
        light = {x.get("name") for x in root.iter("link") if x.find("inertial") is None}
        parents = {x.find("child").get("link"): x.find("parent").get("link")
                   for x in root.findall("joint") if x.get("type") != "fixed"}  # fmt: skip
        light &= parents.keys()
        above = light & {parents[x] for x in light}
        seen |= {"massless links in a row"} if above else set()
        seen |= (
            {"a massless link alone"}
            if light - above - {x for x in light if parents[x] in light}
            else set()
        )
    kinds = ("revolute", "continuous", "prismatic", "fixed")
    assert seen >= {f"{kind} joint" for kind in kinds} | {
        "massless links in a row", "a massless link alone",
        "tendon stiffness", "tendon rest", "tendon damping", "tendon armature",
        "joint armature", "site in tendon",
        "joint in tendon", "actuator in softdyn", "task in softdyn", "springReference in gazebo",
    }  # fmt: skip


def test_a_robot_with_each_kind_of_force():
    """A row has an error of each quantity, of the slopes too; a fault of the judge is one."""
    for kind in forced_robots.KINDS:
        (job,) = catalogue.forced_jobs(kind, 1, 1, 3, trajectories=False)
        row = catalogue.examine(job)
        assert row.passed, row.verdict
        assert {"M", "K", "D", "qdd", "dqdd/dq", "dqdd/dv"} <= {*row.errors}
        assert ("F" in row.errors) == (kind not in ("joints", "tendons"))
    report = catalogue.BatchReport((row, replace(row, errors=row.errors | {"M": 0.5})))
    assert "M 5.0e-01" in str(report)


def test_the_command(tmp_path, monkeypatch, capsys):
    from tests.proof import robots as script

    out = tmp_path / "rows.json"
    arguments = ["--random", "3", "--samples", "1", "--seed", "7", "--jobs", "1"]
    assert script.main([*arguments, "--states-only", "--json", str(out)]) == 0
    report = json.loads(out.read_text())
    assert report["counts"] == {FIXED: {"passed": 3, "failed": 0, "unsupported": 0}}
    assert [row["name"] for row in report["rows"]] == ["random_7", "random_8", "random_9"]
    assert "3 passed, 0 failed" in capsys.readouterr().out

    files = [path for path in example_files() if path.stem in ("TwoDofs", "ur3")]
    monkeypatch.setattr(catalogue, "example_files", lambda: tuple(files))
    page = tmp_path / "page.md"
    common = ["--samples", "1", "--jobs", "1", "--states-only"]
    assert script.main([*common, "--markdown", str(page)]) == 0
    assert "1 of 2 pass, 0 fail, 1 are not supported" in page.read_text()
    assert "`python -m tests.proof robots`" in page.read_text()

    bad = BatchRow("bad", FIXED, False, 1, "M", 1.0)
    monkeypatch.setattr(catalogue, "examine", lambda _: bad)
    monkeypatch.setattr(
        catalogue, "random_jobs", lambda *_, **__: [catalogue.RobotJob("bad", None, 0, 1)]
    )
    capsys.readouterr()
    assert script.main(["--random", "1", "--jobs", "1"]) == 1
    assert "FAILED" in capsys.readouterr().out
