"""The directive `spharm-help`: the help of `spharm` and of each of its verbs, a section each, as the program prints them."""

import os
import re
import subprocess
import sys

from docutils import nodes
from sphinx.util.docutils import SphinxDirective


def help_of(*arguments):
    command = [sys.executable, "-m", "spharm_rs", *arguments, "--help"]
    # Without COLUMNS it is as wide as the terminal.
    environment = {**os.environ, "COLUMNS": "96", "NO_COLOR": "1"}
    return subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout.rstrip()


def verbs(text):
    """Names of the verbs in the help of the program or of a verb, but for `help` itself."""
    listed = re.search(r"^Commands:\n((?:  .*\n)+)", text, re.M)
    return [name for name in re.findall(r"^  (\S+)", listed[1], re.M) if name != "help"] if listed else []


class Program(SphinxDirective):
    def run(self):
        return [section for verb in verbs(help_of()) for section in self.of(verb)]

    def of(self, *arguments):
        title = " ".join(("spharm", *arguments))
        section = nodes.section("", nodes.title(text=title), ids=[nodes.make_id(title)], names=[title])
        self.state.document.note_explicit_target(section, section)
        text = help_of(*arguments)
        first, _, rest = text.partition("\n")
        section += [nodes.paragraph(text=first + "."), nodes.literal_block(rest.strip(), rest.strip(), language="text")]
        for verb in verbs(text):
            section += self.of(*arguments, verb)
        return [section]


def setup(app):
    app.add_directive("spharm-help", Program)
    return {"parallel_read_safe": True}
