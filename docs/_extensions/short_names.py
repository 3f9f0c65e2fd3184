"""Resolves names in docstrings that are given without their module, such as `Model` or `Member.report`.

A name that one object of the reference ends with is linked to it. Names of parameters and attributes, which have no
entry of their own, are printed as code. All others stay errors.
"""

import functools
import inspect

from docutils import nodes

import spharm_rs

PACKAGE = "spharm_rs"


@functools.cache
def owned_names():
    """Names of all parameters and attributes of the package's public functions and classes."""
    names = set()
    modules = [spharm_rs, *(value for value in vars(spharm_rs).values() if inspect.ismodule(value))]
    for module in modules:
        if not module.__name__.startswith(PACKAGE):
            continue
        for name in getattr(module, "__all__", ()):
            value = getattr(module, name)
            names |= parameters(value)
            if inspect.isclass(value):
                names |= set(getattr(value, "__annotations__", {}))
                for method in vars(value).values():
                    names |= parameters(method)
    return names


def parameters(value):
    """Names of a function's parameters; none if it has no signature."""
    if not callable(value):
        return set()
    try:
        return set(inspect.signature(value).parameters)
    except (TypeError, ValueError):
        return set()


def resolve(app, env, node, contnode):
    if node.get("refdomain") != "py" or node.get("reftype") not in ("obj", "class", "func", "meth", "attr"):
        return None
    target = node["reftarget"]
    objects = env.get_domain("py").objects
    found = {name: entry for name, entry in objects.items() if name.endswith(f".{target}") and not entry.aliased}
    if len({entry.docname for entry in found.values()}) == 1:
        name, entry = min(found.items(), key=lambda item: len(item[0]))
        uri = app.builder.get_relative_uri(node.get("refdoc", env.docname), entry.docname)
        reference = nodes.reference("", "", internal=True, refuri=f"{uri}#{entry.node_id}", reftitle=name)
        reference += contnode
        return reference
    owner, _, name = target.rpartition(".")
    known = not owner or any(f".{owner}" == entry[-len(owner) - 1 :] for entry in objects)
    return contnode if known and name in owned_names() else None


def setup(app):
    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True}
