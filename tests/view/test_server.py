"""The viewer's server: loopback only, a free port, a clean end, Meshcat's own protocol."""

from __future__ import annotations

import importlib
import json
import re
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request

import numpy as np
import psutil
import pytest

import softdyn
from softdyn.view.loopback import listener
from softdyn.view.page import Page, PlayedRun, Track
from softdyn.view.scene import Figure
from softdyn.view.server import Viewer
from tests.support import PATIENCE, ROOT
from tests.support.command import of_itself


def blank(model) -> Page:
    width = 1 + model.nv + model.nu + 6
    track = Track(0, np.zeros((0, width)), "live")
    return Page(model.name, (Figure.of(model),), (PlayedRun("", (track,)),), live=True)


@pytest.fixture(scope="module")
def model():
    return softdyn.load("finger")


def listening(pid: int) -> set[str]:
    """Addresses on which a process and its children accept connections, as `ss -ltn` shows."""
    processes = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
    return {
        connection.laddr.ip
        for process in processes
        for connection in process.net_connections("all")
        if connection.status == psutil.CONN_LISTEN
    }


def started(*arguments: str) -> tuple[subprocess.Popen, str]:
    process = subprocess.Popen(
        [sys.executable, ROOT / "scripts/view.py", *arguments, "--no-open"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    return process, process.stdout.readline().strip()


def test_view_listens_on_loopback_only_and_ends_cleanly():
    """It ends by Ctrl-C; test_browser.py ends it by SIGTERM."""
    process, url = started("finger")
    try:
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", url), (url, process.stderr.read())
        assert listening(process.pid) == {"127.0.0.1"}
        children = psutil.Process(process.pid).children(recursive=True)
        page = urllib.request.urlopen(url).read().decode()
        assert "<title>finger</title>" in page
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 0
    assert of_itself(err) == ""
    assert not [child for child in children if child.is_running()]


def test_a_taken_port_is_one_line(monkeypatch, capsys):
    view = importlib.import_module("softdyn.commands.view")
    monkeypatch.setattr("softdyn.view.rest_sweep.rest_page", blank)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert view.main(["finger", "--no-open", "--port", str(taken.getsockname()[1])]) == 2
    assert re.fullmatch(
        r"error: --port: expected a free port, got \d+: .+\n", capsys.readouterr().err
    )


def test_two_viewers_find_different_ports(model):
    with listener(None) as held, listener(None) as other:  # from the moment when one is found
        assert held.getsockname() != other.getsockname()
    with Viewer(blank(model)) as one, Viewer(blank(model)) as two:
        assert one.url != two.url
        assert one.zmq_url != two.zmq_url


def test_another_host_s_name_is_refused(model):
    with Viewer(blank(model)) as viewer:
        request = urllib.request.Request(viewer.url, headers={"Host": "example.org"})
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(request)
        for path in ("static/main.min.js", "static/"):
            assert urllib.request.urlopen(viewer.url + path).status == 200


def test_a_late_browser_gets_every_frame_and_meshcat_s_objects(model):
    """The test uses a websocket, as a browser does."""
    import asyncio

    import meshcat
    import umsgpack
    from tornado.websocket import websocket_connect

    rows = np.arange(3 * (1 + 4 + 2 + 6), dtype=np.float32).reshape(3, -1)
    with Viewer(blank(model)) as viewer:
        viewer.push(rows[:2])
        viewer.say("halfway")
        meshcat.Visualizer(viewer.zmq_url)["mine"].set_object(meshcat.geometry.Box([1, 1, 1]))

        async def received():
            link = await websocket_connect(viewer.url.replace("http", "ws"))
            found = [umsgpack.unpackb(await link.read_message()) for _ in range(3)]
            viewer.push(rows[2:])
            found.append(umsgpack.unpackb(await link.read_message()))
            link.close()
            return found

        box, first, text, last = asyncio.run(received())
        assert viewer.wait(60)
    assert box["path"] == "/meshcat/mine"
    assert text["value"] == "halfway"
    got = [np.frombuffer(m["value"].data, "<f4").reshape(-1, rows.shape[1]) for m in (first, last)]
    np.testing.assert_array_equal(np.concatenate(got), rows)
    # the kind by which Meshcat sends its own
    assert first["value"].type == meshcat.geometry.pack_numpy_array(rows)["array"].type


def test_closing_is_final(model):
    before = psutil.Process().num_threads()
    viewer = Viewer(blank(model))
    viewer.close()
    viewer.close()
    viewer.push(np.zeros(13))
    assert psutil.Process().num_threads() <= before + 3  # ZMQ keeps its own two
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", int(viewer.url.rstrip("/").rpartition(":")[2])))


def test_importing_softdyn_imports_no_viewer():
    code = "import softdyn, sys, json; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules = json.loads(done.stdout)
    assert not {"meshcat", "tornado", "zmq", "IPython", "trimesh"} & set(modules)
