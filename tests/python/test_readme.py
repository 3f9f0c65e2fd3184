"""The README's Python code runs as printed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import spharm_rs as sp

README = Path(__file__).resolve().parents[2] / "README.md"


def test_the_readmes_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.S)
    assert blocks
    monkeypatch.chdir(tmp_path)
    sp.example_surface(4)[0].save("folded.ply")
    for block in blocks:
        # Use a lower degree, to save time.
        exec(compile(block.replace("max_degree=60", "max_degree=20"), "README.md", "exec"), {})
    assert {path.name for path in tmp_path.iterdir()} == {"folded.ply", "python.spharm.npz", "folded20.ply", "folded20.png"}
