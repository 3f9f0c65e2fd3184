"""Pages of the repository keep the links that they have there: those to files outside of this folder lead to their copies
in the site.
"""

import re

COPIES = {"../store-format.md": "store-format", "../README.md": "/index", "../CONTRIBUTING.md": "contributing"}


def links(app, name, source):
    for file, page in COPIES.items():
        target = page.lstrip("/") if page.startswith("/") else f"reference/{page}"
        source[0] = re.sub(rf"\]\({re.escape(file)}([)#])", rf"]({target}.md\1", source[0])


def included(app, relative, parent, source):
    """The same for files that a page of `reference` includes, whose links are relative to the root."""
    source[0] = re.sub(r"\]\(docs/([\w/-]+)\.md", r"](../\1.md", source[0])
    source[0] = source[0].replace("](store-format.md)", "](../reference/store-format.md)")


def setup(app):
    app.connect("source-read", links)
    app.connect("include-read", included)
    return {"parallel_read_safe": True}
