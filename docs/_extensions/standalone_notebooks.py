"""Makes the gallery's notebooks work on their own: each begins with the module `draw`, and its text is Markdown.

`docs/notebooks.py` executes them.
"""

import json
import re
from pathlib import Path

DRAW = Path(__file__).resolve().parents[2] / "examples" / "python" / "draw.py"
INTRODUCTION = (
    "*To run this notebook: `pip install matplotlib scipy scikit-learn` and spharm-rs itself. The first cell writes "
    "`draw.py`, with which the examples draw, beside the notebook.*"
)


def first_cell():
    """Returns the cell that writes `draw.py`."""
    return "%%writefile draw.py\n" + DRAW.read_text(encoding="utf-8")


def markdown(text):
    """Replaces the roles of reStructuredText that sphinx-gallery leaves in a notebook's text."""
    text = re.sub(r"\\ :sup:`([^`]+)`", r"<sup>\1</sup>", text)
    text = re.sub(r":sup:`([^`]+)`", r"<sup>\1</sup>", text)
    return re.sub(r"\[([^\]]+)\]\(\.\./[^)]+\.html\)", r"\1", text).replace("\\\n", "")


def finish(notebook):
    """Changes a notebook, as sphinx-gallery makes it, in place."""
    for cell in notebook["cells"]:
        # Without this, Jupyter of today refuses the format that the notebook states.
        cell["metadata"].pop("collapsed", None)
        text = "".join(cell["source"])
        cell["source"] = markdown(text) if cell["cell_type"] == "markdown" else text
    if notebook["cells"][0]["source"] != INTRODUCTION:
        notebook["cells"].insert(0, {"cell_type": "markdown", "metadata": {}, "source": INTRODUCTION})
    return notebook


def finish_all(app):
    for file in sorted(Path(app.srcdir, "gallery").glob("*.ipynb")):
        notebook = finish(json.loads(file.read_text(encoding="utf-8")))
        file.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def setup(app):
    # After sphinx-gallery, which writes the notebooks at this event.
    app.connect("builder-inited", finish_all, priority=900)
    return {"parallel_read_safe": True}
