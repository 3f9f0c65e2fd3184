"""Runs the tutorials of `docs/start`: the blocks of Python and of commands of a page, in order, in a folder of its own.

    python docs/tutorials.py [PAGE ...]

Without pages it runs those that take less than a minute, `cells` and `sphere`; `group` takes four minutes, `freesurfer`
three and nilearn. A complete study file among the blocks is written to study.toml. Blocks marked `py` in place of
`python` need a program with a window, such as napari, and aren't run. The first block that fails ends the run with
status 1. `spharm` must be in the path.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
QUICK = ["cells", "sphere"]


def run(page, folder):
    text = (HERE / "start" / f"{page}.md").read_text(encoding="utf-8")
    python = ""
    for language, block in re.findall(r"^```(python|bash|toml)\n(.*?)^```", text, re.M | re.S):
        if language == "toml":
            if "table = " in block:
                (folder / "study.toml").write_text(block, encoding="utf-8")
            continue
        if language == "python":
            # Blocks use names of earlier ones.
            python += block + "\n"
            command = [sys.executable, "-c", python]
        else:
            command = ["bash", "-euo", "pipefail", "-c", block]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode != 0:
            sys.exit(f"{page}.md: status {done.returncode} of\n{block}\n{done.stdout}{done.stderr}")
    print(f"{page}: done")


def main():
    for page in sys.argv[1:] or QUICK:
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "examples").symlink_to(HERE.parent / "examples")
            run(page, Path(folder))


if __name__ == "__main__":
    main()
