"""The same suite however it was started."""

import signal


def pytest_configure() -> None:
    """Hear Ctrl-C: a shell starts what it puts in the background with it ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
