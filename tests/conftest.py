"""Settings that make the suite independent of how it is started."""

import os
import signal
import sys
from collections.abc import Iterator
from unittest.mock import patch

import pytest

from softdyn import compiled


@pytest.fixture(scope="session", autouse=True)
def a_cold_cache_is_no_news() -> Iterator[None]:
    """Hide the notice of a cold cache, because any test may be the first that compiles."""
    with patch.object(compiled, "say_once"):
        yield


# A command that takes all cores would start a worker for each, which imports for seconds. Tests of
# workers say how many they want.
os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")
# Otherwise every process that a test starts would compile all sources that it imports.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


def pytest_configure() -> None:
    """Enable Ctrl-C, because a shell starts background jobs with SIGINT ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
