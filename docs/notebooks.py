"""Executes the notebooks of the gallery, which the site offers for download.

    python docs/notebooks.py [--output DIR] [EXAMPLE ...]

Converts `examples/python/[0-9]_*.py`, or the given ones, as the site does, and executes each in an empty folder of its
own. The first cell that fails ends the run with status 1. Needs sphinx-gallery, nbclient and ipykernel. With --output
the executed notebooks are written there.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from sphinx_gallery.gen_gallery import DEFAULT_GALLERY_CONF
from sphinx_gallery.notebook import jupyter_notebook
from sphinx_gallery.py_source_parser import remove_config_comments, split_code_and_text_blocks

HERE = Path(__file__).resolve().parent
EXAMPLES = HERE.parent / "examples" / "python"
sys.path.insert(0, str(HERE / "_extensions"))

from standalone_notebooks import finish, first_cell  # noqa: E402


def convert(example):
    """Returns the notebook of an example, as the site offers it."""
    _, blocks = split_code_and_text_blocks(str(example))
    blocks = [block._replace(content=remove_config_comments(block.content)) for block in blocks]
    settings = {**DEFAULT_GALLERY_CONF, "first_notebook_cell": first_cell()}
    return nbformat.from_dict(finish(jupyter_notebook(blocks, settings, str(example.parent))))


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("examples", nargs="*", type=Path, metavar="EXAMPLE")
    parser.add_argument("--output", type=Path, metavar="DIR")
    arguments = parser.parse_args()
    for example in arguments.examples or sorted(EXAMPLES.glob("[0-9]_*.py")):
        notebook = convert(example)
        nbformat.validate(notebook)
        with tempfile.TemporaryDirectory() as folder:
            settings = {"timeout": 600, "kernel_name": "python3", "resources": {"metadata": {"path": folder}}}
            client = NotebookClient(notebook, extra_arguments=["--Application.log_level=ERROR"], **settings)
            try:
                client.execute()
            except CellExecutionError as error:
                sys.exit(f"{example.name}: {error}")
        outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
        pictures = sum("image/png" in output.get("data", {}) for output in outputs)
        print(f"{example.name}: {len(notebook.cells)} cells, {pictures} pictures")
        if arguments.output:
            arguments.output.mkdir(parents=True, exist_ok=True)
            nbformat.write(notebook, arguments.output / f"{example.stem}.ipynb")


if __name__ == "__main__":
    main()
