"""The server of a live robot: access, the page in command, and no delay of the loop."""

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
from softdyn.validation.live.menu import menu_of
from softdyn.validation.live.playing import drive, open_play_page
from softdyn.validation.live.session import Session
from softdyn.view.live.messages import OPEN_LOOP
from softdyn.view.live.pacing import Clock
from tests.support import PATIENCE
from tests.support.refused import refused


@pytest.fixture(scope="module")
def session():
    model = softdyn.load("finger")
    return Session(model, menu_of(model), OPEN_LOOP)


@pytest.fixture(scope="module")
def channel(session):
    with open_play_page(session) as found:
        found.state(asdict(session.shown))
        yield found


def address(channel, path="live"):
    return channel.url.replace("/?", f"/{path}?")


def join(channel, url=None, origin=None):
    url = (url or address(channel)).replace("http:", "ws:")
    headers = {"Origin": origin} if origin else {}
    return websocket_connect(HTTPRequest(url, headers=headers))


async def news(link, key):
    """The next text message with this key."""
    while True:
        got = await asyncio.wait_for(link.read_message(), PATIENCE)
        assert got is not None, "the server has ended"
        if isinstance(got, str) and key in json.loads(got):
            return json.loads(got)


async def leading(channel):
    """A page in command; pages of earlier tests may still be connected."""
    link = await join(channel)
    await told(link, "leads", True)
    return link


async def alone(channel):
    """A page that commands when all others have left."""
    link = await join(channel)
    while (got := await news(link, "leads"))["pages"] > 1 or not got["leads"]:
        pass
    return link


async def told(link, key, value):
    """Wait until the page has received this message."""
    while (await news(link, key))[key] != value:
        pass


def heard(channel, last):
    """The messages that the loop reads until one of this kind arrives."""
    end, found = time.monotonic() + PATIENCE, []
    while last not in (type(message).__name__ for message in found):
        assert time.monotonic() < end, found
        found += channel.messages()
        time.sleep(0.001)
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


def test_a_body_is_refused_before_it_is_read(channel):
    host, port = "127.0.0.1", int(channel.url.split(":")[2].split("/")[0])
    with socket.create_connection((host, port), timeout=PATIENCE) as link:
        link.sendall(
            f"POST / HTTP/1.1\r\nHost: {host}\r\nContent-Length: 95000000\r\n\r\n".encode()
        )
        answer = link.recv(4096)  # none of the body was sent
    assert answer.startswith(b"HTTP/1.1 400") or answer == b""


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
        first = await leading(channel)
        second = await join(channel)
        assert not (await news(second, "leads"))["leads"]
        await second.write_message('{"do": "reset"}')
        assert "another page commands" in (await news(second, "error"))["error"]
        for bad in ('{"do": "law", "name": "x"}', "{}", b"\xff", '{"do": "target", "y": [1e999]}'):
            await first.write_message(bad, isinstance(bad, bytes))
            assert "expected" in (await news(first, "error"))["error"]
        await first.write_message(
            '{"do": "push", "link": "link4", "at": [0, 0, 0], "to": [0, 0, 0]}'
        )
        await second.write_message('{"do": "lead"}')
        await told(second, "leads", True)
        await second.write_message('{"do": "speed", "factor": 0.5}')
        second.close()
        await told(first, "leads", True)
        first.close()

    asyncio.run(play())
    kinds = [type(message).__name__ for message in heard(channel, "SetSpeed")]
    # the next page in command finds no drag on the robot
    assert [kind for kind in kinds if kind != "Release"] == ["Push", "SetSpeed"]
    assert kinds[kinds.index("SetSpeed") - 1] == "Release"


def test_a_loop_that_is_busy_for_long_loses_nothing_of_what_is_said(channel):
    """It may build a controller, for example. Only the last place of a drag in that time counts."""

    async def play():
        link = await leading(channel)
        for i in range(4000):
            await link.write_message(f'{{"do": "target", "y": [0.1, 0, {-i / 40000}]}}')
        await link.write_message('{"do": "reset"}')
        await link.write_message('{"do": "speed", "factor": 0.5}')
        await link.write_message("{}")  # its answer comes after all these messages
        assert "expected one of" in (await news(link, "error"))["error"]
        found = await asyncio.to_thread(heard, channel, "SetSpeed")
        link.close()
        return found

    found = [m for m in asyncio.run(play()) if type(m).__name__ != "Release"]
    kinds = [type(message).__name__ for message in found]
    assert kinds == ["SetTarget"] * (len(kinds) - 2) + ["Reset", "SetSpeed"]
    assert len(kinds) < 2000  # the socket itself holds some hundred
    assert found[-3].y[2] == -3999 / 40000


def test_an_old_state_does_not_overtake_a_new_one(session):
    """A state that did not fit into the socket is not sent after later messages."""

    async def watch(channel):
        link = await leading(channel)
        channel._process.send_signal(19)  # the server is blocked
        while channel.dropped == 0:
            channel.frame(session.frame())
        channel.state({"notice": "old"})
        channel._process.send_signal(18)
        while not channel._send(b"?", b""):  # until it takes something again
            await asyncio.sleep(0.001)
        channel.state({"notice": "new"})
        channel.frame(session.frame())
        seen: list[object] = []
        while "new" not in seen or not isinstance(seen[-1], bytes):  # frames come last
            got = await asyncio.wait_for(link.read_message(), PATIENCE)
            seen.append(got if isinstance(got, bytes) else json.loads(got)["state"].get("notice"))
        link.close()
        return seen

    with open_play_page(session) as channel:
        assert "old" not in asyncio.run(watch(channel))


def test_what_is_shown_last_arrives_and_so_does_a_page_to_keep(session):
    """When the robot stops or the run ends, no later frame repeats the content of the last one."""

    async def watch(channel):
        link = await leading(channel)
        channel.state({"notice": "moving"})
        channel.frame(session.frame())
        await told_state(link, "moving")
        frame = None
        while not isinstance(frame, bytes):
            frame = await asyncio.wait_for(link.read_message(), PATIENCE)
        channel.state({"notice": "done"})
        channel.leave("<p>the run</p>" + " " * 2_000_000)
        closing = asyncio.create_task(asyncio.to_thread(channel.close))
        await told_state(link, "done")
        kept = (await news(link, "replay"))["replay"]
        assert await asyncio.wait_for(link.read_message(), PATIENCE) is None
        await closing
        return np.frombuffer(frame, "<f4"), kept

    async def told_state(link, notice):
        while (await news(link, "state"))["state"].get("notice") != notice:
            pass

    channel = open_play_page(session)
    frame, kept = asyncio.run(watch(channel))
    np.testing.assert_array_equal(frame, session.frame())
    assert kept.startswith("<p>the run</p>")
    assert channel._process.returncode == 0


def test_a_loop_whose_server_is_gone_says_so(session):
    with open_play_page(session) as channel:
        channel._process.kill()
        channel._process.wait()
        with pytest.raises(softdyn.SoftdynError, match="server of the pages has ended"):
            drive(session, channel, Clock(session.period))


def test_what_is_said_at_once_all_arrives_without_a_frame(channel):
    """A paused robot sends no frames, so no message may wait for a frame."""

    async def play():
        link = await leading(channel)
        for _ in range(15):
            link.write_message("{}")  # not awaited: they arrive together
        for _ in range(15):
            assert "expected" in (await news(link, "error"))["error"]
        link.close()

    asyncio.run(play())


def test_a_page_that_does_not_read_delays_nothing_and_others_see_frames(channel, session):
    """The messages exceed the sockets' buffers, so those for the deaf page must wait."""
    frame = session.frame()
    host, port = channel.url.partition("//")[2].partition("/")[0].split(":")
    with socket.socket() as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.connect((host, int(port)))
        deaf.sendall(
            f"GET {address(channel).partition(port)[2]} HTTP/1.1\r\nHost: {host}:{port}\r\n"
            "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )

        async def watch():
            link = await join(channel)
            for i in range(60):
                channel.state({"notice": f"{i}", "long": "." * 150_000})
                while (await news(link, "state"))["state"].get("notice") != f"{i}":
                    channel.state({"notice": f"{i}", "long": "." * 150_000})
            channel.frame(frame)
            got: str | bytes = ""
            while not isinstance(got, bytes):
                got = await asyncio.wait_for(link.read_message(), PATIENCE)
            link.close()
            return got

        got = asyncio.run(watch())
    channel.state(asdict(session.shown))
    np.testing.assert_array_equal(np.frombuffer(got, "<f4"), frame)


def test_a_frame_that_nobody_takes_is_dropped(session):
    channel = open_play_page(session)
    # the server is blocked, so that waiting for it would never end
    channel._process.send_signal(19)
    for _ in range(2000):
        channel.frame(session.frame())
    assert channel.dropped > 100
    channel._process.send_signal(18)
    channel.close()
    assert channel._process.returncode is not None


def test_what_is_recorded_is_a_replay_page(channel, session):
    async def record():
        link = await leading(channel)
        await link.write_message('{"do": "record", "on": true}')
        await told(link, "recording", True)
        for _ in range(30):
            session.step()
            dropped = channel.dropped
            channel.frame(session.frame())
            while channel.dropped > dropped:  # a slower server
                await asyncio.sleep(0.001)
                dropped = channel.dropped
                channel.frame(session.frame())
        await link.write_message('{"do": "record", "on": false}')
        page = (await news(link, "recorded"))["recorded"]
        link.close()
        return page

    text = urllib.request.urlopen(address(channel, asyncio.run(record()))).read().decode()
    assert "new Player(" in text
    scene = json.loads(text.partition('id="scene">')[2].partition("</script>")[0])
    assert len(scene["runs"][0]["tracks"][0]["frames"]) > 30 * 13 * 4  # base64


def test_a_taken_port_is_one_line(session):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with refused("--port"):
            open_play_page(session, taken.getsockname()[1])


def test_a_page_that_leaves_lets_go_of_the_robot(channel):
    """A page that only watched leaves too: it held nothing."""

    async def play():
        first = await alone(channel)
        await first.write_message('{"do": "speed", "factor": 0.5}')
        await asyncio.to_thread(heard, channel, "SetSpeed")
        second = await join(channel)
        await told(first, "pages", 2)
        second.close()
        await told(first, "pages", 1)
        third = await join(channel)
        await told(third, "leads", False)
        await first.write_message(
            '{"do": "push", "link": "link4", "at": [0, 0, 0], "to": [0, 0, 0]}'
        )
        first.close()
        await told(third, "leads", True)
        await third.write_message('{"do": "speed", "factor": 1}')
        found = await asyncio.to_thread(heard, channel, "SetSpeed")
        third.close()
        return [type(message).__name__ for message in found]

    assert asyncio.run(play()) == ["Push", "Release", "SetSpeed"]


def test_there_is_room_for_sixteen_pages(channel):
    async def crowd():
        first = await alone(channel)
        others = [await join(channel) for _ in range(15)]
        await told(first, "pages", 16)
        last = await join(channel)
        assert await asyncio.wait_for(last.read_message(), PATIENCE) is None
        assert (last.close_code, last.close_reason) == (1013, "too many pages")
        others.pop().close()
        await told(first, "pages", 15)
        others.append(await join(channel))
        await told(first, "pages", 16)
        for link in (first, *others):
            link.close()

    asyncio.run(crowd())
