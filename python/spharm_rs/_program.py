"""Runs the program `spharm` as the console script of this package."""

from __future__ import annotations

import signal
import sys


def main() -> int:
    """Runs `spharm` with the arguments of this process and returns its exit code."""
    # Restore the system's handling of SIGINT, because the program installs its own handler. If SIGINT is ignored, it
    # stays so.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from . import _load  # noqa: F401
    from ._core import main as run

    return run(["spharm", *sys.argv[1:]])
