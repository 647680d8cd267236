"""
Every example of the documents runs.

The blocks of a page marked ``python`` run in their order, in one namespace, in an empty folder. If
there are tests among them, pytest runs those of the page together, as a file of their own.
One that cannot run here says why after its language: ```` ```python no-run: needs a GPU ````.
"""

import ast
import contextlib
import io
import re
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import matplotlib as mpl
import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])

BLOCK = re.compile(r"^( *)(`{3,})([^\n`]*)\n(.*?)^\1\2 *$", re.MULTILINE | re.DOTALL)

MOST_NOT_RUN = 1
"""Blocks that may be marked as not to be run, in all documents together."""


def blocks_of(text):
    """Language, rest of the info string, code and line of each fenced block of a document."""
    found = []
    for match in BLOCK.finditer(text):
        indent, _, info, code = match.groups()
        language, _, rest = info.strip().partition(" ")
        code = "".join(line.removeprefix(indent) for line in code.splitlines(keepends=True))
        found.append((language, rest, code, text.count("\n", 0, match.start(4)) + 1))
    return found


def reason_not_to_run(rest):
    """What a block says after ``no-run:``, or None if it is to run."""
    if not rest.startswith("no-run"):
        return None
    _, colon, reason = rest.partition(":")
    assert colon, f"say why after no-run: {rest!r}"
    assert len(reason.split()) >= 3, f"say why in some words: {rest!r}"
    return reason.strip()


def examples_of(text):
    """Code and line of each block of a document that is to run."""
    return [
        (code, line)
        for language, rest, code, line in blocks_of(text)
        if language == "python" and reason_not_to_run(rest) is None
    ]


def run(name, text):
    """Run a document's examples; what they print is returned."""
    namespace = {"__name__": "__main__"}
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        for code, line in examples_of(text):
            tree = ast.parse(code, filename=name)
            # so that a traceback names the document's own line
            ast.increment_lineno(tree, line - 1)
            exec(compile(tree, name, "exec"), namespace)
    return printed.getvalue()


@pytest.fixture(autouse=True)
def _alone(tmp_path, monkeypatch):
    """An empty folder, figures that open no window, and none left open."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TREELOD_CACHE", str(tmp_path / "cache"))
    with mpl.rc_context({"backend": "agg"}):
        yield
    import matplotlib.pyplot as plt

    plt.close("all")


def run_tests(text):
    """Let pytest run the tests among a document's examples, with treelod's plugin."""
    Path("test_page.py").write_text("\n\n".join(code for code, _ in examples_of(text)), "utf-8")
    has_plugin = any(
        point.value == "pytest_treelod" for point in entry_points(group="pytest11", name="treelod")
    )
    plugin = [] if has_plugin else ["-p", "pytest_treelod"]
    result = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *plugin, "test_page.py"],
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    return result.returncode, result.stdout + result.stderr


WITH_EXAMPLES = [d for d in DOCUMENTS if examples_of(d.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("document", WITH_EXAMPLES, ids=lambda path: str(path.relative_to(ROOT)))
def test_examples_run(document):
    text = document.read_text(encoding="utf-8")
    run(str(document), text)
    if any(re.search(r"^def test_", code, re.MULTILINE) for code, _ in examples_of(text)):
        code, output = run_tests(text)
        assert code == 0, output


def test_blocks_that_do_not_run_are_few():
    reasons = {
        f"{document.relative_to(ROOT)}:{line}": reason_not_to_run(rest)
        for document in DOCUMENTS
        for language, rest, _, line in blocks_of(document.read_text(encoding="utf-8"))
        if language == "python" and reason_not_to_run(rest) is not None
    }
    assert len(reasons) <= MOST_NOT_RUN, reasons


def test_python_is_in_blocks_that_say_so():
    """A block without a language, or an indented one, would escape."""
    escaped = []
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        hidden = [code for language, _, code, _ in blocks_of(text) if language in {"", "py"}]
        plain = BLOCK.sub("", text)
        hidden += re.findall(r"(?:^    \S.*\n)+", plain, re.MULTILINE)
        escaped += [
            f"{document.relative_to(ROOT)}: {code[:60]!r}"
            for code in hidden
            if re.search(r"^\s*(import treelod|from treelod|\w+ = tl\.|tl\.)", code, re.MULTILINE)
        ]
    assert escaped == []


def test_examples_are_found_and_run_in_order():
    text = (
        "```python\na = 1\n```\nwords\n```sh\nexit 1\n```\n"
        "- in a list\n\n  ```python\n  if a:\n      print(a + 1)\n  ```\n"
        "````python\nprint('```')\n````\n"
        "```python no-run: needs another machine\nraise SystemExit\n```\n"
    )
    assert [line for _, line in examples_of(text)] == [2, 11, 15]
    assert run("made.md", text) == "2\n```\n"


def test_a_broken_example_is_found():
    with pytest.raises(ZeroDivisionError) as caught:
        run("made.md", "# Title\n\n```python\na = 1\na / 0\n```\n")
    assert caught.traceback[-1].lineno + 1 == 5, "the document's own line"


def test_a_failing_test_of_a_page_is_found():
    page = "```python\ndef test_it(treelod_plant):\n    assert treelod_plant is {}\n```\n"
    assert run_tests(page.format("not None"))[0] == 0
    code, output = run_tests(page.format("None"))
    assert code == 1, output


@pytest.mark.parametrize("rest", ["no-run", "no-run:", "no-run: slow", "no-run because slow"])
def test_a_block_that_is_not_run_says_why(rest):
    with pytest.raises(AssertionError, match="say why"):
        examples_of(f"```python {rest}\n1 / 0\n```\n")


def test_examples_run_in_an_empty_folder():
    assert [*Path().iterdir()] == []
