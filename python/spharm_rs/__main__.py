"""`python -m spharm_rs` is the program `spharm`."""

import sys

from ._program import main

if __name__ == "__main__":
    sys.exit(main())
