"""A user's script runs, and type checkers accept it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).with_name("user_script.py")


def test_a_users_script_runs() -> None:
    done = subprocess.run([sys.executable, "-W", "error", str(SCRIPT)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("Surface(642 vertices, 1280 faces)") and lines[-1] == "True", done.stdout
    assert "call spharm_rs.repair(surface)" in lines[-2], lines[-2]


def test_pyright_accepts_a_users_script(tmp_path: Path) -> None:
    """In the mode of editors; mypy checks the script with the tests."""
    (tmp_path / "user_script.py").write_bytes(SCRIPT.read_bytes())
    (tmp_path / "pyrightconfig.json").write_text('{"typeCheckingMode": "standard"}')
    command = [sys.executable, "-m", "basedpyright", "--pythonpath", sys.executable, "user_script.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "0 errors" in done.stdout, done.stdout + done.stderr
