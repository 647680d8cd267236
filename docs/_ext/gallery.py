"""
The directive `gallery`: a card for each notebook, with its title, first words and first picture.

Its one argument is a pattern of files, relative to the page. Cards are made from the notebooks as
they lie there, so the page cannot fall behind them.
"""

import html
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import nbformat
from docutils import nodes
from sphinx import addnodes
from sphinx.util.docutils import SphinxDirective

if TYPE_CHECKING:
    from sphinx.application import Sphinx


def facts_of(notebook: Any) -> tuple[str, str, str | None]:
    """Return a notebook's title, its first paragraph without markup, and its first PNG, base64."""
    text = "\n\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    title = re.search(r"^# +(.+)$", text, re.MULTILINE)
    plain = (part.strip() for part in text.split("\n\n"))
    words = next((part for part in plain if part and part[0] not in "#!|`<$-*"), "")
    words = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", words).replace("`", "").replace("*", "")
    outputs = (
        output.get("data", {})
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
    )
    picture = next((data["image/png"] for data in outputs if "image/png" in data), None)
    return (
        title[1] if title else "",
        " ".join(words.split()),
        None if picture is None else "".join(picture.split()),
    )


class Gallery(SphinxDirective):
    """Cards of the notebooks that match a pattern, in the order of their names."""

    required_arguments = 1
    final_argument_whitespace = True
    has_content = False
    option_spec: ClassVar[dict[str, Any]] = {}

    def run(self) -> list[nodes.Node]:
        """Make the cards, and a hidden table of contents that gives the pages their place."""
        page = Path(self.env.doc2path(self.env.docname))
        files = sorted(page.parent.glob(self.arguments[0]))
        source = Path(self.env.srcdir)
        cards = nodes.container(classes=["gallery"])
        documents = []
        for file in files:
            self.env.note_dependency(str(file))
            title, words, picture = facts_of(nbformat.read(file, as_version=4))
            document = file.resolve().relative_to(source).with_suffix("").as_posix()
            documents.append(document)
            cards += self.card(document, title or file.stem, words, picture)
        if not files:
            cards += nodes.paragraph("", "There are no notebooks in this build.")
        toctree = addnodes.toctree(
            parent=self.env.docname,
            entries=[(None, document) for document in documents],
            includefiles=documents,
            maxdepth=1,
            caption=None,
            glob=False,
            hidden=True,
            includehidden=False,
            numbered=0,
            titlesonly=True,
        )
        return [cards, nodes.compound("", toctree, classes=["toctree-wrapper"])]

    def card(self, document: str, title: str, words: str, picture: str | None) -> nodes.container:
        """Make one card."""
        card = nodes.container(classes=["gallery-card"])
        if picture is not None:
            image = f'<img src="data:image/png;base64,{picture}" alt="{html.escape(title)}">'
            card += nodes.raw("", image, format="html")
        link = addnodes.pending_xref(
            "",
            nodes.strong(title, title),
            refdomain="std",
            reftype="doc",
            reftarget=f"/{document}",
            refexplicit=True,
            refdoc=self.env.docname,
            refwarn=True,
        )
        card += nodes.paragraph("", "", link)
        card += nodes.paragraph(words, words)
        return card


def setup(app: "Sphinx") -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("gallery", Gallery)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
