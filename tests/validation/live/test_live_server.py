"""The server of a live robot: whom it serves, who commands, and that no page delays the loop."""

from __future__ import annotations

import asyncio
import json
import socket
import time
import urllib.error
import urllib.request
from dataclasses import asdict

import numpy as np
import psutil
import pytest
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

import softdyn
from softdyn.validation.live.messages import OPEN_LOOP
from softdyn.validation.live.playing import stage
from softdyn.validation.live.session import Session, menu_of


@pytest.fixture(scope="module")
def session():
    model = softdyn.load("finger")
    return Session(model, menu_of(model), OPEN_LOOP)


@pytest.fixture(scope="module")
def channel(session):
    with stage(session) as found:
        found.state(asdict(session.shown))
        yield found


def address(channel, path="live"):
    return channel.url.replace("/?", f"/{path}?")


def join(channel, url=None, origin=None):
    url = (url or address(channel)).replace("http:", "ws:")
    headers = {"Origin": origin} if origin else {}
    return websocket_connect(HTTPRequest(url, headers=headers))


async def news(link, key):
    """The next text with this member."""
    while True:
        got = await asyncio.wait_for(link.read_message(), 5)
        if isinstance(got, str) and key in json.loads(got):
            return json.loads(got)


def heard(channel, seconds=0.3):
    end, found = time.monotonic() + seconds, []
    while time.monotonic() < end:
        found += [type(message).__name__ for message in channel.messages()]
        time.sleep(0.01)
    return found


def test_it_is_on_loopback_and_wants_its_token(channel):
    process = psutil.Process(channel._process.pid)
    listening = {c.laddr.ip for c in process.net_connections() if c.status == psutil.CONN_LISTEN}
    assert listening == {"127.0.0.1"}
    assert "<title>finger</title>" in urllib.request.urlopen(channel.url).read().decode()
    bare = channel.url.partition("?")[0]
    for url in (bare, bare + "?token=", bare + "?token=wrong", bare + "record.html"):
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(url)
    request = urllib.request.Request(channel.url, headers={"Host": "example.org"})
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(request)
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(address(channel, "record.html"))  # there is none yet


def test_a_foreign_page_or_a_wrong_token_gets_no_websocket(channel):
    async def refused(**how):
        with pytest.raises(HTTPClientError, match="403"):
            await join(channel, **how)

    async def check():
        host = channel.url.partition("//")[2].partition("/")[0]
        await refused(origin="http://example.org")
        await refused(origin="null")
        await refused(origin=f"http://localhost:{host.partition(':')[2]}")  # the Host is 127.0.0.1
        await refused(url=address(channel).partition("?")[0])
        await refused(url=address(channel)[:-1] + "_")
        (await join(channel, origin=f"http://{host}")).close()

    asyncio.run(check())


def test_one_commands_several_watch_and_bad_messages_change_nothing(channel):
    async def play():
        first, second = await join(channel), await join(channel)
        assert (await news(first, "leads"))["leads"]
        assert not (await news(second, "leads"))["leads"]
        await second.write_message('{"do": "reset"}')
        assert "another page commands" in (await news(second, "error"))["error"]
        for bad in ('{"do": "law", "name": "x"}', "{}", b"\xff", '{"do": "target", "y": [1e999]}'):
            await first.write_message(bad, isinstance(bad, bytes))
            assert "expected" in (await news(first, "error"))["error"]
        await second.write_message('{"do": "lead"}')
        while not (await news(second, "leads"))["leads"]:
            pass
        await second.write_message('{"do": "speed", "factor": 0.5}')
        await asyncio.sleep(0.1)
        second.close()
        while not (await news(first, "leads"))["leads"]:
            pass
        first.close()

    list(channel.messages())
    asyncio.run(play())
    assert [name for name in heard(channel) if name != "Release"] == ["Speed"]


def test_what_is_said_at_once_all_arrives_without_a_frame(channel):
    """A paused robot sends no frames: nothing that a page is told may wait for one."""

    async def play():
        link = await join(channel)
        await news(link, "leads")
        for _ in range(15):
            link.write_message("{}")  # not awaited: they arrive together
        for _ in range(15):
            assert "expected" in (await news(link, "error"))["error"]
        link.close()

    asyncio.run(play())


def test_a_page_that_does_not_read_delays_nothing_and_others_see_frames(channel, session):
    """40 s worth of frames, all at once."""
    frame = session.frame()
    host, port = channel.url.partition("//")[2].partition("/")[0].split(":")
    with socket.create_connection((host, int(port))) as deaf:
        deaf.sendall(
            f"GET {address(channel).partition(port)[2]} HTTP/1.1\r\nHost: {host}:{port}\r\n"
            "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )

        async def watch():
            link = await join(channel)
            await news(link, "leads")
            slowest, got = 0.0, []
            for _ in range(1600):
                began = time.perf_counter()
                channel.frame(frame)
                slowest = max(slowest, time.perf_counter() - began)
                await asyncio.sleep(0.0005)
            while not isinstance(got, bytes):
                got = await asyncio.wait_for(link.read_message(), 5)
            link.close()
            return slowest, got

        slowest, got = asyncio.run(watch())
    np.testing.assert_array_equal(np.frombuffer(got, "<f4"), frame)
    assert slowest < 0.2  # it never waits for anybody: a blocked page would take for ever


def test_a_frame_that_nobody_takes_is_dropped(session):
    channel = stage(session)
    channel._process.send_signal(19)  # the server stands still
    began = time.perf_counter()
    for _ in range(2000):
        channel.frame(session.frame())
    assert channel.dropped > 100
    assert time.perf_counter() - began < 5
    channel._process.send_signal(18)
    channel.close()
    assert channel._process.returncode is not None


def test_what_is_recorded_is_a_replay_page(channel, session):
    async def record():
        link = await join(channel)
        await news(link, "leads")
        await link.write_message('{"do": "record", "on": true}')
        while not (await news(link, "recording"))["recording"]:
            pass
        for _ in range(30):
            session.step()
            channel.frame(session.frame())
            await asyncio.sleep(0.005)
        await link.write_message('{"do": "record", "on": false}')
        told = await news(link, "recorded")
        link.close()
        return told["recorded"]

    text = urllib.request.urlopen(address(channel, asyncio.run(record()))).read().decode()
    assert "new Player(" in text
    scene = json.loads(text.partition('id="scene">')[2].partition("</script>")[0])
    assert len(scene["runs"][0]["tracks"][0]["frames"]) > 30 * 13 * 4  # base64


def test_a_taken_port_is_one_line(session):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(softdyn.InputError, match="--port: expected a free port"):
            stage(session, taken.getsockname()[1])
