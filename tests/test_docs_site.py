"""The site is whole: every public name is in the API, and every command line is understood."""

import importlib
import pkgutil
import pydoc
import re
import shlex
from pathlib import Path

import pytest
import typer.main

import treelod
from treelod.cli import app
from treelod.cli.options import technique_of

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
API = sorted(DOCS.glob("api/*.md"))
DOCUMENTS = sorted([*ROOT.glob("*.md"), *DOCS.glob("**/*.md")])

USAGE_ERROR = typer.BadParameter.__base__
"""What click raises for all that a user can mistype."""

# The API


def modules_on(heading):
    """Modules that the first page of the API names before or after where it draws the line."""
    text = (DOCS / "api/README.md").read_text(encoding="utf-8")
    inside, line, outside = text.partition("Modules without a page")
    assert line, "the page says what is no part of the API"
    text = inside if heading == "inside" else outside.partition("```")[0]
    return set(re.findall(r"`(treelod\.\w+)`", text))


def documented():
    """Kind and full name of everything that the pages describe."""
    text = "\n".join(page.read_text(encoding="utf-8") for page in API)
    return re.findall(r"^\.\. auto(function|class|data|exception):: (\S+)$", text, re.MULTILINE)


def object_of(name):
    """The object with a full name; modules are imported as far as they go."""
    module, _, attribute = name.rpartition(".")
    return getattr(importlib.import_module(module), attribute)


def public_names():
    """Module and name of everything in the `__all__` of the package and of the API's modules."""
    for module in ["treelod", *sorted(modules_on("inside"))]:
        for name in importlib.import_module(module).__all__:
            yield module, name


def missing(module, name, described):
    """Whether a public name is described nowhere, under any of its names."""
    if f"{module}.{name}" in described:
        return False
    value = getattr(importlib.import_module(module), name)
    if isinstance(value, type(pydoc)):
        return value.__name__ not in modules_on("inside")
    # a constant has no name of its own by which to find it elsewhere
    return not callable(value) or not any(object_of(place) is value for place in described)


def test_every_module_is_inside_or_outside():
    found = {
        f"treelod.{module.name}"
        for module in pkgutil.iter_modules(treelod.__path__)
        if not module.name.startswith("_")
    }
    inside, outside = modules_on("inside"), modules_on("outside")
    assert inside | outside == found
    assert inside & outside == set()


def test_every_public_name_is_in_the_api():
    described = {name for _, name in documented()}
    lost = [
        f"{module}.{name}"
        for module, name in public_names()
        if name != "__version__" and missing(module, name, described)
    ]
    assert lost == []


def test_a_lost_name_is_found():
    described = {name for _, name in documented()}
    assert missing("treelod", "render", described - {"treelod.render"})
    assert missing("treelod.render", "OUTPUTS", described - {"treelod.render.OUTPUTS"})
    assert not missing("treelod.plants", "Plant", described), "described as treelod.Plant"


def test_the_api_describes_each_thing_once_and_as_what_it_is():
    names = [name for _, name in documented()]
    assert len(names) == len(set(names))
    for kind, name in documented():
        value = object_of(name)
        is_class = isinstance(value, type)
        is_error = is_class and issubclass(value, BaseException)
        expected = {
            "class": is_class and not is_error,
            "exception": is_error,
            "function": callable(value) and not is_class,
            "data": not is_class,
        }
        assert expected[kind], f"{name} is no {kind}"


# Notebooks


def test_the_gallery_shows_all_notebooks():
    text = (DOCS / "notebooks.md").read_text(encoding="utf-8")
    assert "{gallery} ../notebooks/*.ipynb" in text
    nested = [path for path in ROOT.glob("notebooks/*/**/*.ipynb") if ".ipynb_c" not in str(path)]
    assert nested == [], "the gallery looks in one folder"


# Commands


def command_lines(text):
    """Arguments of each `treelod` in a document's shell blocks."""
    lines = []
    for block in re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            while "treelod" in words:
                words = words[words.index("treelod") + 1 :]
                ends = [i for i, word in enumerate(words) if word in {"&&", "||", ";", "|", "&"}]
                lines.append(words[: ends[0]] if ends else words)
    return lines


def parse(words):
    """Read arguments as the program would, techniques and their parameters too, and run nothing."""
    group = typer.main.get_command(app)
    context = group.make_context("treelod", [*words], resilient_parsing="--version" in words)
    if "--version" in words:
        return
    name, command, rest = group.resolve_command(context, [*words])
    parsed = command.make_context(name, rest, parent=context).params
    for spec in parsed.get("technique") or ():
        technique_of(spec)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_command_lines_are_understood(document):
    for words in command_lines(document.read_text(encoding="utf-8")):
        parse(words)


@pytest.mark.parametrize(
    "line",
    [
        "treelod compare chestnut",
        "treelod compare chestnut -o report --sample 4",
        "treelod compare chestnut -o report -t slicing",
        "treelod compare chestnut -o report -t slicings:slices=3",
        "treelod walk chestnut -o report --frames many",
        "treelod draw chestnut",
    ],
)
def test_a_command_line_that_is_not_understood_is_found(line):
    (words,) = command_lines(f"```sh\nuv run {line}  # a comment\n```\n")
    with pytest.raises(USAGE_ERROR):
        parse(words)


def test_command_lines_are_found():
    text = "```sh\npip install uv && uv run treelod demo  # once\n```\n"
    text += "```sh\ntreelod grow pine \\\n  -o a.glb\n```\n"
    assert command_lines(text) == [["demo"], ["grow", "pine", "-o", "a.glb"]]
