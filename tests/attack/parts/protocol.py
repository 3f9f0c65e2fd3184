"""Checks all states of the model in `tests/attack/protocol`, which describes how a store's files are published."""

import json

from common import KEPT, ROOT, Row, run


def run_part(site, _seconds):
    row = Row("publishing, all interleavings")
    folder = ROOT / "tests/attack/protocol"
    env = {"CARGO_TARGET_DIR": str(KEPT / "protocol")}
    built = run(["cargo", "build", "-q", "--locked"], cwd=folder, limit=1200, env=env)
    if built.code != 0:
        site.skip(row, f"the model can't be built: {built.last()}")
        return row
    ended = run([KEPT / "protocol/debug/spharm-protocol"], limit=600)
    text = ended.out.decode(errors="replace")
    site.log(text)
    try:
        found = json.loads(text.splitlines()[-1])
    except (ValueError, IndexError):
        site.find(row, "crashes", f"the model ends with {ended.code}: {ended.last()}")
        return row
    row.done = found["done"]
    for failure in found["failures"]:
        site.find(row, "wrong", failure)
    return row
