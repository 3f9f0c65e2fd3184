"""Runs the program `spharm` for `python -m spharm_rs`."""

import sys

from ._program import main

if __name__ == "__main__":
    sys.exit(main())
