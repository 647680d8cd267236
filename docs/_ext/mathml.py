"""
Formulas as MathML: drawn by the browser itself, without a script and without a network.

Docutils brings the converter. A formula that it cannot read is a warning, so it fails the build.
"""

import re
from typing import TYPE_CHECKING, Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging

if TYPE_CHECKING:
    from docutils.nodes import Element
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

logger = logging.getLogger(__name__)


def converted(node: "Element", *, as_block: bool) -> str:
    """Return a formula's MathML; a warning and the source where it cannot be read."""
    source = node.astext()
    # a bar that opens and one that closes are spaced alike only if they say which they are
    barred = re.sub(r"\|([^|]+)\|", r"\\lvert \1 \\rvert ", source)
    try:
        return tex2mathml(barred, as_block=as_block)
    except MathError as error:
        logger.warning("no formula: %s: %s", error, source, location=node, type="mathml")
        return source


def visit_inline(writer: "HTML5Translator", node: "Element") -> None:
    """Write a formula within a line."""
    writer.body.append(converted(node, as_block=False))
    raise nodes.SkipNode


def visit_block(writer: "HTML5Translator", node: "Element") -> None:
    """Write a formula on lines of its own; a wide one is scrolled, not cut."""
    writer.body.append(f'<div class="formula">{converted(node, as_block=True)}</div>')
    raise nodes.SkipNode


def setup(app: "Sphinx") -> dict[str, Any]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    app.config.html_math_renderer = "mathml"
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
