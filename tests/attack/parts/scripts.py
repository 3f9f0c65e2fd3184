"""Runs the standalone scripts of `tests/attack`: each gets the program, and prints a JSON object as its last line.

In the object, `cases` describes the checks, `failures` is the number or the list of failures, and `skipped`, if
present, lists the checks that couldn't be run.
"""

import json
import os
import sys
from pathlib import Path

from common import ROOT, Row, run


def run_script(site, name, file, seconds):
    row = Row(name)
    script = ROOT / "tests/attack" / file
    if not script.is_file():
        site.skip(row, f"there is no {script.relative_to(ROOT)}")
        return row
    # `./run` has made an environment for scripts that need NumPy or the Python package.
    python = ROOT / "target/python/bin/python" if name == "statistics" else os.environ.get("SPHARM_PYTHON", sys.executable)
    if not Path(python).is_file():
        site.skip(row, f"there is no {python}: ./run attack makes it")
        return row
    # A script limits its own time; it is ended here only if it far exceeds that time.
    ended = run([python, script, site.program], limit=max(900, 4 * seconds), env={"SPHARM_ATTACK_SECONDS": f"{seconds:.0f}"})
    text = ended.out.decode(errors="replace")
    site.log(text + ended.err.decode(errors="replace"))
    try:
        found = json.loads(text.strip().splitlines()[-1])
    except (ValueError, IndexError):
        site.find(row, "hangs" if ended.hung else "crashes", f"ends with {ended.code} without its row: {ended.last()}")
        return row
    counts = {key: value for key, value in found.items() if key not in ("name", "failures", "skipped")}
    row.part = found.get("name", name)
    row.done = ", ".join(f"{value} {key}" if isinstance(value, int) else f"{key} {value}" for key, value in counts.items())
    skipped = found.get("skipped") or []
    for text in [skipped] if isinstance(skipped, str) else skipped:
        site.skip(row, text)
    failures = found.get("failures") or []
    failures = [f"{failures} failures"] if isinstance(failures, int) else failures
    for failure in [failures] if isinstance(failures, str) else failures:
        site.find(row, "wrong", str(failure))
    if ended.code != 0 and not failures:
        site.find(row, "wrong", f"ends with {ended.code} and names no failure: {ended.last()}")
    return row
