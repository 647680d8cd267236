"""
Every technique has a page with the same parts, and its table of parameters tells the truth.

A table is held to the signature (names, order, defaults), to the docstring (units), to the types
(names that may be given) and to what `build` refuses (ranges).
"""

import ast
import functools
import inspect
import math
import re
import textwrap
import typing
from pathlib import Path

import pytest

import treelod as tl
from treelod.techniques import REGISTRY

DOCS = Path(__file__).parents[1] / "docs"

PARTS = ["What it is", "Method", "Parameters", "Trade-offs", "Source"]

NOT_IN_TABLES = {"threads", "progress"}
"""They change no picture."""

HEADER = "| parameter | unit | range | default | effect |"

UNITS = {
    "-": "",
    "px": r"[Pp]ixels",
    "degrees": r"[Dd]egrees",
    "m": r"[Mm]etres",
    "m²": r"square metres",
    "R": r"crown radii",
    "R²": r"square of\s+the crown's radius",
    "texels": r"[Tt]exels",
    "texels / m": r"Texels",
    "triangles": r"triangles",
    "corners": r"[Cc]orners",
}
"""What the docstring of a parameter must say where its table names a unit."""

QUICK = {
    "slicings": {"slicing_count": 2, "slice_count": 2, "resolution": 8},
    "leaf_clusters": {"cluster_count": 2, "resolution": 8},
    "orthogonal_slices": {"slice_count": 2, "resolution": 8},
    "layered_billboards": {"layer_count": 2, "resolution": 8},
    "octahedral_impostor": {"frame_count": 3, "resolution": 8},
}
"""So that what is not refused is built at once."""

WHERE_IT_COUNTS = {
    "With indirect texturing": {"texturing": "indirect", "leaf_resolution": 8, "rotation_count": 2},
    "With 'attributes'": {"method": "attributes"},
    "With 'viewer'": {"turn": "viewer"},
}
"""What a docstring says of a parameter that is looked at only then."""

SAMPLES = "1, 4, 8, 16 or 17..65536"


def page_of(name):
    return (DOCS / f"{name}.md").read_text(encoding="utf-8")


def rows_of(text):
    """Cells of the table of parameters, by parameter."""
    _, found, rest = text.partition(HEADER)
    assert found, "a page has a table of parameters"
    rows = {}
    for line in rest.splitlines()[2:]:
        if not line.startswith("|"):
            break
        name, *cells = (cell.strip() for cell in line.strip().strip("|").split("|"))
        rows[name.strip("`")] = dict(
            zip(("unit", "range", "default", "effect"), cells, strict=True)
        )
    return rows


@functools.cache
def parameters_of(name):
    """A technique's own parameters, with the source of their defaults."""
    build = REGISTRY[name].build
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(build))).body
    defaults = {
        argument.arg: ast.unparse(default)
        for argument, default in zip(tree.args.kwonlyargs, tree.args.kw_defaults, strict=True)
    }
    return {key: value for key, value in defaults.items() if key not in NOT_IN_TABLES}


@functools.cache
def docs_of(name):
    """What the docstring says of each parameter."""
    doc = inspect.getdoc(REGISTRY[name].build)
    section = doc.partition("Parameters\n----------\n")[2].partition("\n\nReturns\n")[0]
    entries = re.split(r"^(\w+(?:, \w+)*) : ", section, flags=re.MULTILINE)[1:]
    return dict(zip(entries[::2], entries[1::2], strict=True))


def choices_of(name, parameter):
    """Names that the type of a parameter allows."""
    import treelod.techniques as package

    module = inspect.getmodule(REGISTRY[name])
    annotation = inspect.signature(REGISTRY[name].build).parameters[parameter].annotation
    names = {**vars(package), **vars(module), "Literal": typing.Literal, "Any": typing.Any}
    # an alias names its type, which more than one technique has
    found = [*typing.get_args(names.get(annotation))]
    for part in re.findall(r"Literal\[([^\]]*)\]", annotation):
        found += typing.get_args(eval(f"Literal[{part}]", names))
    return found


@functools.cache
def small_plant():
    return tl.grow_plant("chestnut", leaf_count=12)


def refusal(name, parameter, value):
    """What `build` says to a value, or None if it takes it."""
    settings = {**QUICK.get(name, {})}
    for words, needed in WHERE_IT_COUNTS.items():
        if words in docs_of(name)[parameter]:
            settings |= needed
    try:
        REGISTRY[name].build(small_plant(), **{**settings, parameter: value})
    except ValueError as error:
        return str(error)
    return None


EACH = [(name, parameter) for name in REGISTRY for parameter in parameters_of(name)]


@pytest.mark.parametrize("name", REGISTRY)
def test_pages_have_the_same_parts(name):
    text = page_of(name)
    assert re.findall(r"^## (.+)$", text, re.MULTILINE) == PARTS
    what, method, _, trade_offs, source = re.split(r"^## .+$", text, flags=re.MULTILINE)[1:]
    assert re.search(r"!\[[^\]]+\]\(images/\w+\.png\)", what), "a picture"
    assert "```python\n" in what, "an example"
    assert re.search(r"^ *\$\$$", method, re.MULTILINE), "a formula"
    assert re.search(r"^\|[-|]+\|$", trade_offs, re.MULTILINE), "a measured table"
    assert source.strip(), "a source"


@pytest.mark.parametrize("name", REGISTRY)
def test_the_list_of_techniques_is_complete(name):
    text = (DOCS / "techniques.md").read_text(encoding="utf-8")
    assert f"]({name}.md)" in text, "the table has a row"
    assert re.search(rf"^{name}$", text, re.MULTILINE), "the pages have an order"


@pytest.mark.parametrize("name", REGISTRY)
def test_tables_have_every_parameter_and_default(name):
    rows = rows_of(page_of(name))
    assert [*rows] == [*parameters_of(name)]
    stated = {key: re.match(r"`([^`]*)`", row["default"])[1] for key, row in rows.items()}
    assert stated == parameters_of(name)
    assert all(row["effect"] for row in rows.values())


@pytest.mark.parametrize(("name", "parameter"), EACH)
def test_units_are_those_of_the_docstring(name, parameter):
    unit = rows_of(page_of(name))[parameter]["unit"]
    assert re.search(UNITS[unit], docs_of(name)[parameter]), unit
    suffix = parameter.rpartition("_")[2]
    if suffix == "px":
        assert unit == "px"


@pytest.mark.parametrize(("name", "parameter"), EACH)
def test_choices_are_those_of_the_type(name, parameter):
    stated = re.findall(r"`'(\w+)'`", rows_of(page_of(name))[parameter]["range"])
    assert stated == choices_of(name, parameter)
    if not stated:
        return
    for choice in stated:
        assert f"'{choice}'" in docs_of(name)[parameter], "the docstring has the same"


def ends_of(text):
    """Lower and upper end of a range, and whether it is of whole numbers; None where none is."""
    number = r"\d+(?:\.\d+)?(?:e-?\d+)?"
    if found := re.match(rf"[\[(]({number}), ({number})\]", text):
        return float(found[1]), float(found[2]), False
    if found := re.search(rf"({number})\.\.({number})", text):
        return int(found[1]), int(found[2]), True
    if found := re.match(rf"at least ({number})", text):
        return float(found[1]), math.inf, False
    return None


def outside(low, high, *, is_whole):
    """Values just outside of a range."""
    if is_whole:
        return low - 1, high + 1
    step = max(abs(low), 1.0)
    return (low - step if low else -1), (None if high == math.inf else high * 2)


RANGED = [
    (name, parameter)
    for name, parameter in EACH
    if ends_of(rows_of(page_of(name))[parameter]["range"]) is not None
]


@pytest.mark.parametrize(("name", "parameter"), RANGED)
def test_ranges_are_those_that_build_refuses_beyond(name, parameter):
    cell = rows_of(page_of(name))[parameter]["range"]
    low, high, is_whole = ends_of(cell)
    below, above = (5, high + 1) if cell == SAMPLES else outside(low, high, is_whole=is_whole)
    message = refusal(name, parameter, int(below) if float(below).is_integer() else below)
    assert message, f"{below} is refused"
    assert parameter in message, "by name"
    if above is not None:
        message = refusal(name, parameter, above)
        assert message, f"{above} is refused"
    # the core's messages state the range
    if stated := re.search(r"in ([\[(])([\d.e+-]+), ([\d.e+-]+)\]", message):
        assert (float(stated[2]), float(stated[3])) == (low, high), message
        assert (stated[1] == "(") == cell.startswith("("), message
    elif stated := re.search(r"at least (\d+)", message):
        assert float(stated[1]) == low, message


@pytest.mark.parametrize(
    ("cell", "ends"),
    [
        ("[0, 1e6], `'fit'`", (0.0, 1e6, False)),
        ("(0, 1]", (0.0, 1.0, False)),
        ("1..4096", (1, 4096, True)),
        ("1, 4, 8, 16 or 17..65536", (17, 65536, True)),
        ("at least 1", (1.0, math.inf, False)),
        ("`True`, `False`", None),
        ("cameras", None),
    ],
)
def test_ranges_are_read(cell, ends):
    assert ends_of(cell) == ends


def test_a_wrong_table_is_found():
    text = page_of("stochastic_pruning")
    assert rows_of(text)["shrink"]["range"] == "[0, 1]"
    assert refusal("stochastic_pruning", "shrink", 0.5) is None
    assert "shrink must be in [0, 1], got 2" in refusal("stochastic_pruning", "shrink", 2)
    renamed = text.replace("| `shrink` |", "| `shrunk` |").replace("| `0.2` |", "| `0.3` |")
    assert [*rows_of(renamed)] != [*parameters_of("stochastic_pruning")]
