"""The server of a page: loopback only, a free port, a clean end, the latest pose."""

from __future__ import annotations

import asyncio
import importlib
import json
import re
import signal
import socket
import subprocess
import sys
import threading
import urllib.error
import urllib.request

import numpy as np
import psutil
import pytest
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

import softdyn
from softdyn import InputError
from softdyn.view.live.channel import Channel
from softdyn.view.loopback import listener, read_origin
from softdyn.view.page import Page
from tests.support import PATIENCE
from tests.support.command import of_itself
from tests.support.forked import forked


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
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = forked("view", *arguments, "--no-open", **pipes)
    return process, process.stdout.readline().strip()


def test_view_listens_on_loopback_only_and_ends_cleanly():
    """It ends by Ctrl-C; test_browser.py ends it by SIGTERM."""
    process, url = started("finger")
    try:
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?token=\S+", url), (
            url,
            process.stderr.read(),
        )
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
    monkeypatch.setattr("softdyn.view.rest_sweep.rest_page", lambda model: Page("", (), ()))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert view.main(["finger", "--no-open", "--port", str(taken.getsockname()[1])]) == 2
    assert re.fullmatch(
        r"error: --port: expected a free port, got \d+: .+\n", capsys.readouterr().err
    )


def test_a_proxy_of_the_named_origin_passes_and_no_other():
    host, origin = "lab.example", "https://lab.example"
    for wrong in (
        "lab.example",
        "ftp://lab.example",
        f"{origin}/path",
        "https://a@lab.example",
        "",
    ):
        with pytest.raises(InputError):
            read_origin(wrong)

    def code(url: str, **headers: str) -> int:
        try:
            request = urllib.request.Request(url, headers=headers)
            return urllib.request.urlopen(request).status
        except urllib.error.HTTPError as error:
            return error.code

    with Channel("page", origin=f"{origin}/") as channel:
        live = channel.url.replace("/?", "/live?")
        assert code(channel.url, Host=host) == 200
        assert code(channel.url) == 200
        assert code(channel.url, Host="other.example") == 403
        assert code(channel.url.partition("token=")[0], Host=host) == 403

        async def answer(**headers: str) -> int:
            request = HTTPRequest(live.replace("http", "ws", 1), headers=headers)
            try:
                (await websocket_connect(request)).close()
            except HTTPClientError as error:
                return error.code
            return 101

        assert asyncio.run(answer(Host=host, Origin=origin)) == 101
        assert asyncio.run(answer(Origin=origin)) == 101  # a proxy that replaces the Host
        for other in ("http://lab.example", "https://other.example", "null"):
            assert asyncio.run(answer(Host=host, Origin=other)) == 403
    with Channel("page") as channel:
        assert code(channel.url, Host=host) == 403


def test_two_pages_find_different_ports():
    with listener(None) as held, listener(None) as other:  # from the moment when one is found
        assert held.getsockname() != other.getsockname()
    with Channel("one") as one, Channel("two") as two:
        for channel, text in ((one, b"one"), (two, b"two")):
            assert urllib.request.urlopen(channel.url).read() == text


def test_a_view_shows_its_latest_pose_to_a_page_that_comes_late_and_to_one_that_is_open():
    """The test uses websockets, as browsers do."""
    model = softdyn.load("finger")
    view = softdyn.show(model).open(browser=False)
    server = view._server._process

    async def poses():
        address = view.url.replace("http", "ws").replace("/?", "/live?")
        found, links = [], [await websocket_connect(address)]
        for q in (None, [0.1, 0.2, 0.3, 0.4]):
            if q is not None:
                server.send_signal(signal.SIGSTOP)  # it reads nothing for a while
                while view._server.dropped == 0:
                    view._server.frame(np.zeros(13))
                threading.Timer(0.2, server.send_signal, (signal.SIGCONT,)).start()
                view.display(q, [0.5, -1])
                links.append(await websocket_connect(address))
            for link in links:
                found.append(await pose(link, *view.q, *view.u))
        return found

    async def pose(link, *expected):
        row = None
        while row is None or not np.allclose(row[1:7], expected):
            got = await asyncio.wait_for(link.read_message(), PATIENCE)
            row = np.frombuffer(got, "<f4") if isinstance(got, bytes) else None
        return row

    try:
        first, open_page, late = asyncio.run(poses())
    finally:
        view.close()
    np.testing.assert_allclose(first[-6:-3], model.state(model.q0, np.zeros(4)).y, atol=1e-6)
    np.testing.assert_array_equal(open_page, late)
    assert view.url is None


def test_a_server_that_ends_ends_the_command(monkeypatch, capsys):
    view = importlib.import_module("softdyn.commands.view")
    monkeypatch.setattr("softdyn.view.rest_sweep.rest_page", lambda model: Page("", (), ()))
    monkeypatch.setattr(Channel, "open", lambda channel: channel._process.kill())
    assert view.main(["finger"]) == 1
    assert capsys.readouterr().err == "error: the server of the pages has ended\n"


def test_closing_is_final():
    channel = Channel("a page")
    channel.close()
    channel.close()
    channel.frame(np.zeros(13), patience=PATIENCE)
    assert channel.dropped == 1
    with pytest.raises(softdyn.SoftdynError, match="has ended"):
        channel.check()
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", int(channel.url.split(":")[2].split("/")[0])))


def test_importing_softdyn_imports_no_viewer():
    code = "import softdyn, sys, json; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules = json.loads(done.stdout)
    assert not {"meshcat", "tornado", "zmq", "IPython", "trimesh"} & set(modules)
