"""Loads the extension module with the kernels that fit this processor.

OpenBLAS chooses its kernels once, while it is loaded, and an environment variable can set them. By itself, it treats
processors that are newer than OpenBLAS as processors of 2004. So this module sets the environment variable while the
extension module is loaded, as the program `spharm` does for itself.
"""

from __future__ import annotations

import os
import platform
import sys

_VARIABLE = "OPENBLAS_CORETYPE"


def _kernels() -> str | None:
    """Returns the name of the kernels, or None to let OpenBLAS choose."""
    if not sys.platform.startswith("linux") or platform.machine() != "x86_64":
        return None
    try:
        with open("/proc/cpuinfo", encoding="ascii", errors="replace") as file:
            flags = next((set(line.split()) for line in file if line.startswith("flags")), set())
    except OSError:
        return None
    if flags >= {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"}:
        return "SkylakeX"
    return "Haswell" if flags >= {"avx2", "fma"} else None


def _load() -> None:
    kernels = None if _VARIABLE in os.environ else _kernels()
    if kernels is None:
        from . import _core  # noqa: F401
        return
    os.environ[_VARIABLE] = kernels
    try:
        from . import _core  # noqa: F401
    finally:
        del os.environ[_VARIABLE]


_load()
