#!/usr/bin/env python3
"""`./run attack [MINUTES] [PART ...]`: attacks files, programs and disks in many ways, for the given number of minutes.

Each part gets a share of the time, and one line of the table at the end, with its counts and failures. The log and the
files of failures are in `target/attack`. The exit status is 1 if a part failed.
"""

import argparse
import importlib
import sys
import time
from pathlib import Path

from common import KEPT, KINDS, ROOT, Row, Site
from scripts import run_script

#: Parts in order, each with its share of the time in units of 1/30.
PARTS = {
    "fuzz": 8, "inputs": 1, "faults": 5, "full": 2, "power": 3, "races": 2, "media": 1, "clock": 0.5, "protocol": 0.5, "mutants": 3,
    "memory": 2, "numbers": 1, "statistics": 1,
}
#: Parts that are separate scripts, in the parent folder.
SCRIPTS = {"memory": "memory.py", "numbers": "numerics.py", "statistics": "designs.py"}


def arguments():
    parser = argparse.ArgumentParser(prog="./run attack", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", nargs="*", metavar="MINUTES | PART",
                        help="minutes to share out [default: 30], and parts [default: all]: " + ", ".join(PARTS))
    parser.add_argument("--executions", type=float, help="executions of each reader by the fuzzer, in place of its time")
    parser.add_argument("--program", default=ROOT / "target/release/spharm", help="the program [default: the release]")
    parser.add_argument("--seed", type=int, help="of what is random [default: the time]; the log has it")
    args = parser.parse_args()
    args.minutes, args.parts = 30.0, []
    for word in args.what:
        if word in PARTS:
            args.parts.append(word)
        else:
            try:
                args.minutes = float(word)
            except ValueError:
                parser.error(f"{word} is neither a number of minutes nor a part: {', '.join(PARTS)}")
    if not args.minutes > 0:
        parser.error("minutes must be positive")
    if not Path(args.program).is_file():
        parser.error(f"there is no program {args.program}: ./run attack builds it")
    args.parts = args.parts or list(PARTS)
    args.seed = int(time.time()) if args.seed is None else args.seed
    return args


def table(rows):
    heads = ["part", "crashes", "hangs", "half-written", "wrong", "seconds", "done"]
    lines = [[row.part, *(str(getattr(row, kind)) for kind in KINDS), f"{row.seconds:.0f}", row.done or "-"] for row in rows]
    widths = [max(len(line[i]) for line in [heads, *lines]) for i in range(len(heads) - 1)]
    for line in [heads, *lines]:
        yield "  ".join([line[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(line[1:-1], widths[1:])), line[-1]])
    for row in rows:
        for text in row.skipped:
            yield f"skipped: {row.part}: {text}"


def main():
    args = arguments()
    KEPT.mkdir(parents=True, exist_ok=True)
    started = time.strftime("%Y%m%d-%H%M%S")
    with open(KEPT / f"{started}.log", "w") as log:
        site = Site(args.program, args.seed, log, args.executions)
        site.say(f"attack for {args.minutes:g} minutes, seed {args.seed}, log {Path(log.name).relative_to(ROOT)}")
        whole = sum(PARTS[part] for part in args.parts)
        rows = []
        for part in args.parts:
            seconds = 60 * args.minutes * PARTS[part] / whole
            site.say(f"== {part}, {seconds:.0f} s")
            begun = time.monotonic()
            try:
                if part in SCRIPTS:
                    row = run_script(site, part, SCRIPTS[part], seconds)
                else:
                    row = importlib.import_module(part).run_part(site, seconds)
            except Exception as error:
                row = Row(part, done="broke off")
                site.find(row, "wrong", f"the part broke off: {type(error).__name__}: {error}")
            row.seconds = time.monotonic() - begun
            rows.append(row)
        lines = list(table(rows))
        for line in lines:
            site.log(line)
        print("\n".join(lines), flush=True)
        bad = [row.part for row in rows if row.failed()]
        site.say(f"failed: {', '.join(bad)}" if bad else "nothing failed")
        return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
