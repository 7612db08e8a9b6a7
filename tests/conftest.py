"""The same suite however it was started."""

import signal
from collections.abc import Iterator
from unittest.mock import patch

import pytest

from softdyn import compiled


@pytest.fixture(scope="session", autouse=True)
def a_cold_cache_is_no_news() -> Iterator[None]:
    """Whichever test comes first compiles, and what it says is what it tests."""
    with patch.object(compiled, "say_once"):
        yield


def pytest_configure() -> None:
    """Hear Ctrl-C: a shell starts what it puts in the background with it ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
