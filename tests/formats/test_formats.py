"""Files of each version that ever landed: today's code reads them, or one line names the version.

The files are as the code of their time wrote them: logs of a run of four steps of a cart on a
spring, tables as they stood in the documents. Whoever changes a format adds a file of the new
version and keeps the old ones; `python -m tests.support.newest_log` writes the log.
"""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn import InputError, UrdfError, design
from softdyn.controllers import Gains, PolicyNetwork
from softdyn.csv_table import CsvTable
from softdyn.description.annotations import VERSION
from softdyn.files import read_toml
from softdyn.formats import CSV, RECORD, TOML
from softdyn.identification.markers.points import read_points
from softdyn.safety import Surroundings
from softdyn.tasks.targets import read_paths
from softdyn.validation import Log, Rig
from softdyn.validation.bench.kept_zeros import KeptZeros
from softdyn.validation.loop.log_checks import FORMAT
from softdyn.validation.loop.recorded import RecordedRun
from softdyn.validation.studies.sweep_file import read_sweep
from tests.support import newest_log
from tests.support.refused import refused

HERE = Path(__file__).parent
NEWEST_LOG = int(FORMAT.rpartition("-")[2])
READ_LOGS = range(4, NEWEST_LOG + 1)  # versions of logs that are read
# each table, with a number in it and what today's code reads there
TABLES = {
    "arm_1.toml": lambda path: (len(design.make_arm(read_toml(path)).sections), 3),
    "gains_1.toml": lambda path: (Gains(500.0, **read_toml(path)).eps, 0.015),
    "markers_1.toml": lambda path: ([one.name for one in read_points(path)], ["a", "b", "c"]),
    "obstacles_1.toml": lambda path: (
        Surroundings.of(read_toml(path)).names, ("floor", "sphere_1", "box_1", "pairs_1"),
    ),
    "rig_1.toml": lambda path: (Rig.of(read_toml(path)).plant.payload, 0.05),
    "sweep_1.toml": lambda path: (len(read_sweep(path).expanded), 84),
    "paths_1.csv": lambda path: (read_paths(path)["tip"](1.0).y[0], 0.5),
}  # fmt: skip


def cart():
    return softdyn.load(HERE / "block_1.urdf")


def check_run(log):
    """The values of the cart's run, by the closed form of its first step."""
    assert log.steps == 4
    np.testing.assert_array_equal(log.t, [0, 0.01, 0.02, 0.03, 0.04])
    assert log.u[0, 0] == pytest.approx(0.5 * 25 * 0.5)  # m Kp e
    assert log.error[0].tolist() == pytest.approx([-0.5, 0, 0])


@pytest.mark.parametrize("number", range(1, NEWEST_LOG + 1))
def test_a_log_of_each_version_is_read_or_named(number):
    file = HERE / f"log_{number}.npz"
    if number in READ_LOGS:
        log = Log.load(file)
        check_run(log)
        assert log.source.model().joint_names == ("x",)
    else:
        with pytest.raises(InputError) as caught:
            Log.load(file)
        assert (caught.value.name, caught.value.expected) == (
            str(file),
            f"a log of format {FORMAT}",
        )
        assert f"softdyn-log-{number}," in caught.value.got
        assert "\n" not in str(caught.value)


def test_today_s_log_is_of_a_version_that_is_kept(tmp_path):
    """A new entry of the settings needs a new version, and a file of it in this folder."""
    newest_log.write(tmp_path)
    written, kept = Log.load(tmp_path / f"log_{NEWEST_LOG}.npz"), HERE / f"log_{NEWEST_LOG}.npz"
    with np.load(kept) as one, np.load(tmp_path / kept.name) as other:
        assert sorted(one) == sorted(other)
        entries = [set(json.loads(file["about"].item())) for file in (one, other)]
    assert entries[0] == entries[1]
    check_run(written)


@pytest.mark.parametrize("number", READ_LOGS)
def test_a_log_as_csv_is_read(number):
    check_run(Log.from_csv(HERE / f"log_{number}.csv"))


@pytest.mark.parametrize("beside", [True, False])
def test_a_record_of_another_version_is_one_line_that_names_it(beside, tmp_path):
    """The record stands beside a CSV, and in the JSON of a report and of a sweep's case."""
    record = json.loads((HERE / "log_5.csv.json").read_text("utf-8"))
    assert record["format"] == RECORD == "softdyn-record-1"
    record["format"] = "softdyn-record-7"
    path = tmp_path / ("log_5.csv.json" if beside else "case.json")
    path.write_text(json.dumps(record if beside else {"record": record}), "utf-8")
    shutil.copy(HERE / "log_5.csv", tmp_path)
    with pytest.raises(InputError) as caught:
        Log.from_csv(tmp_path / "log_5.csv") if beside else RecordedRun.read(path)
    assert (caught.value.name, "softdyn-record-7," in caught.value.got) == (str(path), True)


def test_a_record_is_read_from_beside_a_csv():
    log = Log.from_csv(HERE / "log_5.csv")
    assert log.record["settings"]["period"] == 0.01
    assert RecordedRun.read(HERE / "log_5.csv").record == log.record


def test_a_csv_of_the_third_version_has_no_settings_and_is_read_as_a_recording():
    log = Log.from_csv(HERE / "recording_1.csv", cart())
    assert log.error[0].tolist() == pytest.approx([-0.5, 0, 0])
    assert log.t[-1] == 0.04


def test_the_block_of_each_version_is_read():
    assert VERSION == "1"
    model = cart()
    assert (model.nu, model.u_max.tolist()) == (1, [20.0])


@pytest.mark.parametrize("file", TABLES)
def test_a_table_of_each_version_is_read(file):
    found, expected = TABLES[file](HERE / file)
    assert found == expected


def test_a_policy_of_the_first_version_is_read():
    network = PolicyNetwork.load(HERE / "policy_1.npz")
    assert network.observation == ("error", "input")
    np.testing.assert_array_equal(network(np.array([2.0, 0.0, 1.0, 0.5])), [4.5])


def test_kept_zeros_of_each_version_are_read_or_named(tmp_path):
    """They belong to one robot: the digest is put in as the cart's."""
    table = json.loads((HERE / "zeros_1.json").read_text("utf-8")) | {"digest": cart().robot.digest}
    path = tmp_path / "zeros.json"
    path.write_text(json.dumps(table), "utf-8")
    (zero,) = KeptZeros(path, cart()).read()
    assert (zero.actuator, zero.offset, zero.biases) == ("u", 0.02, {"wire": -0.0166})
    path.write_text(json.dumps(table | {"format": "softdyn-zeros-7"}), "utf-8")
    with pytest.raises(InputError) as caught:
        KeptZeros(path, cart()).read()
    assert (caught.value.name, "softdyn-zeros-7," in caught.value.got) == (str(path), True)


def with_format(file: str, said: str, folder: Path) -> Path:
    """A copy of a table that states a format."""
    text, path = (HERE / file).read_text("utf-8"), folder / file
    if path.suffix == ".toml":
        path.write_text(f'format = "{said}"\n{text}', "utf-8")
    else:
        first, second, *rest = text.splitlines()
        rows = [f"{first},format", f"{second},{said}", *(f"{row}," for row in rest)]
        path.write_text("\n".join(rows), "utf-8")
    return path


@pytest.mark.parametrize("file", TABLES)
def test_a_table_may_state_its_version(file, tmp_path):
    said = CSV if file.endswith(".csv") else TOML
    found, expected = TABLES[file](with_format(file, said, tmp_path))
    assert found == expected


@pytest.mark.parametrize("file", TABLES)
def test_a_table_of_another_version_is_one_line_that_names_it(file, tmp_path):
    kind = "csv" if file.endswith(".csv") else "toml"
    path = with_format(file, f"softdyn-{kind}-7", tmp_path)
    with pytest.raises(InputError) as caught:
        TABLES[file](path)
    assert str(path) in caught.value.name
    assert f"softdyn-{kind}-1" in caught.value.expected
    assert f"softdyn-{kind}-7," in caught.value.got
    assert "\n" not in str(caught.value)


def test_a_block_of_another_version_is_one_line_that_names_it(tmp_path):
    text = (HERE / "block_1.urdf").read_text("utf-8").replace('version="1"', 'version="7"')
    (tmp_path / "robot.urdf").write_text(text, "utf-8")
    with pytest.raises(UrdfError) as caught:
        softdyn.load(tmp_path / "robot.urdf")
    assert (caught.value.expected, caught.value.got) == ('version="1"', "'7'")


def test_tables_read_by_other_means_state_it_too():
    table = {"format": TOML} | tomllib.loads((HERE / "arm_1.toml").read_text("utf-8"))
    assert len(design.make_arm(table).sections) == 3
    with refused("table", "softdyn-toml-2, of another version of softdyn"):
        design.make_arm(table | {"format": "softdyn-toml-2"})


def test_a_key_and_a_column_of_this_name_that_mean_something_else_stay(tmp_path):
    (tmp_path / "own.toml").write_text('format = "wide"\n')
    assert read_toml(tmp_path / "own.toml") == {"format": "wide"}
    (tmp_path / "own.csv").write_text("t,format\n0,3\n1,4\n")
    assert CsvTable(tmp_path / "own.csv").numbers(["format"]).ravel().tolist() == [3.0, 4.0]
