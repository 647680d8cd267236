"""
The role of a name between single backticks in a docstring: a link where the name is in the API.

A name is looked for in its class, in its module, and in all of the API. Names of parameters are in
none of them and stay code. A name with a dot or a capital is meant to be in the API: it must be
found.
"""

import pydoc
import re
from typing import TYPE_CHECKING, Any

from docutils import nodes
from sphinx import addnodes
from sphinx.util.docutils import SphinxRole

if TYPE_CHECKING:
    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment


class Name(SphinxRole):
    """A name, linked if it can be."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Leave the link to be found when all pages are read."""
        context = self.env.ref_context
        link = addnodes.pending_xref(
            self.rawtext,
            nodes.literal(self.rawtext, self.text, classes=["xref", "py", "py-obj"]),
            refdomain="py",
            reftype="obj",
            reftarget=self.text,
            refdoc=self.env.docname,
            refexplicit=False,
            refwarn=True,
            **{"py:module": context.get("py:module"), "py:class": context.get("py:class")},
        )
        link["is_name"] = True
        self.set_source_info(link)
        return [link], []


def place_of(env: "BuildEnvironment", name: str) -> str | None:
    """Return the full name of the one thing in the API that is called so."""
    known = env.get_domain("py").objects  # type: ignore[attr-defined]
    places = [f"treelod.{name}"] if f"treelod.{name}" in known else []
    places = places or [place for place in known if place.endswith(f".{name}")]
    return places[0] if len(places) == 1 else None


def holder_of(env: "BuildEnvironment", name: str) -> str | None:
    """Return the class whose docstring describes an attribute, as `Frame.ids`."""
    owner, _, attribute = name.rpartition(".")
    place = place_of(env, owner) if owner else None
    doc = getattr(pydoc.locate(place), "__doc__", None) if place else None
    return place if re.search(rf"\b{re.escape(attribute)}\b", doc or "") else None


def resolve(
    app: "Sphinx", env: "BuildEnvironment", node: nodes.Element, content: nodes.TextElement
) -> nodes.Node | None:
    """Look further than Python's rules do, and leave what may be a parameter as code."""
    if not node.get("is_name"):
        return None
    target = node["reftarget"]
    if target.islower() and "." not in target:
        place = f"treelod.{target}"
    else:
        place = place_of(env, target) or holder_of(env, target)
    found = place and env.get_domain("py").resolve_xref(
        env, node["refdoc"], app.builder, "obj", place, node, content
    )
    is_plain = target.islower() and "." not in target
    # of another library: not linked, but it has to be there
    is_foreign = "." in target and not target.startswith("treelod.") and pydoc.locate(target)
    if found is None and (is_plain or is_foreign):
        content["classes"] = []
        return content
    return found


def escape_initials(
    _app: "Sphinx", _what: str, _name: str, _object: object, _options: object, lines: list[str]
) -> None:
    """Keep the first letter of ``.. [1] H. Yee`` from being taken for an item of a list."""
    lines[:] = [re.sub(r"^(\.\. \[\w+\] )([A-Z]\. )", r"\1\\\2", line) for line in lines]


def shorten_citations(_app: "Sphinx", document: nodes.document, _name: str) -> None:
    """Show ``[1]`` where numpydoc has put a label that is unique on the page."""
    for text in [*document.findall(nodes.Text)]:
        if found := re.fullmatch(r"\[?R[0-9a-f]{8,}-(\d+)\]?", text.astext()):
            text.parent.replace(text, nodes.Text(f"[{found[1]}]"))


def setup(app: "Sphinx") -> dict[str, Any]:
    """Register the role."""
    app.setup_extension("sphinx.ext.autodoc")
    app.add_role("name", Name())
    app.connect("missing-reference", resolve)
    # before numpydoc reads the docstring
    app.connect("autodoc-process-docstring", escape_initials, priority=400)
    app.connect("doctree-resolved", shorten_citations)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
