"""Do the documents say what is there? Links, commands, names, versions, dependencies."""

import functools
import importlib.metadata
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from treelod.techniques import REGISTRY

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])

FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


def links_of(text):
    """Targets of a document's links and images; code blocks hold none."""
    return LINK.findall(FENCE.sub("", text))


def anchors_of(text):
    """What `#...` may follow a link to a document: one for each heading."""
    headings = re.findall(r"^#+ +(.+)$", FENCE.sub("", text), re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.strip().replace(" ", "-") for heading in plain}


def broken_links(document, text):
    """Links that lead to no file, or to no heading of the file."""
    broken = []
    for target in links_of(text):
        url = urlsplit(target)
        if url.scheme in {"http", "https"}:
            continue
        file = document.parent / url.path if url.path else document
        if not file.exists() or (
            url.fragment and url.fragment not in anchors_of(file.read_text(encoding="utf-8"))
        ):
            broken.append(target)
    return broken


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_resolve(document):
    assert broken_links(document, document.read_text(encoding="utf-8")) == []


def test_broken_links_are_found(tmp_path):
    here = tmp_path / "a.md"
    (tmp_path / "b.md").write_text("# One *two*\n", encoding="utf-8")
    here.write_text("# Top\n", encoding="utf-8")
    text = "[x](b.md) [x](b.md#one-two) [x](#top) ![x](no.png) [x](b.md#no) [x](#no)"
    assert broken_links(here, text) == ["no.png", "b.md#no", "#no"]
    assert broken_links(here, "```\n[x](no.md)\n```\n") == []


# Commands


@functools.cache
def help_of(*command):
    """What `treelod COMMAND --help` prints, wide enough to cut no word."""
    result = subprocess.run(
        [sys.executable, "-c", "from treelod.cli import main; main()", *command, "--help"],
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
        env={**os.environ, "COLUMNS": "200", "TERM": "dumb", "NO_COLOR": "1"},
    )
    assert result.returncode == 0, f"treelod {' '.join(command)} --help: {result.stderr}"
    return result.stdout


def commands_of(text):
    """Pairs of a command and an option (or None) that a document tells people to type."""
    pairs = set()
    fenced = [block for block in FENCE.findall(text) if not block.startswith("```python")]
    code = [*fenced, *re.findall(r"`([^`\n]+)`", FENCE.sub("", text))]
    for line in "\n".join(code).splitlines():
        for command, rest in re.findall(r"\btreelod ([a-z]+)((?: [^#&|]*)?)", line):
            pairs.add((command, None))
            pairs.update((command, option) for option in re.findall(r"(?<!\S)--?[a-z][\w-]*", rest))
    return pairs


def test_commands_exist():
    text = "\n".join(document.read_text(encoding="utf-8") for document in DOCUMENTS)
    commands = commands_of(text)
    assert {("demo", None), ("compare", "-o")} <= commands, "README names the two main commands"
    for command, option in sorted(commands, key=str):
        assert re.search(rf"\b{command}\b", help_of()), f"treelod has no command {command}"
        if option not in {None, "--help"}:
            known = re.search(rf"(?<![\w-]){option}(?![\w-])", help_of(command))
            assert known, f"treelod {command} has no option {option}"


def test_commands_are_found():
    text = "```sh\nuv run treelod demo -o x --seed 1  # grows --not\n```\n and `treelod grow` too"
    text += "\n```python\nfrom treelod import plots\n```\n"
    assert commands_of(text) == {
        ("demo", None),
        ("demo", "-o"),
        ("demo", "--seed"),
        ("grow", None),
    }


def make_targets():
    """Targets of the Makefile."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    return set(re.findall(r"^([a-z][a-z-]*):(?!=)", makefile, re.MULTILINE))


def test_make_targets_exist():
    users = [*DOCUMENTS, ROOT / ".ci/run", ROOT / ".pre-commit-config.yaml"]
    text = "\n".join(user.read_text(encoding="utf-8") for user in users)
    used = set(re.findall(r"(?:`|entry: |stage \w+ |^ +)make ([a-z-]+)", text, re.MULTILINE))
    assert "lint" in used, "CI lints"
    assert used <= make_targets()


# Names and numbers


def test_versions_agree():
    cargo = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))
    version = cargo["package"]["version"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^version: (\S+)$", citation, re.MULTILINE) == [version]
    assert re.findall(r"^## \[(\d\S*)\]", changelog, re.MULTILINE)[0] == version
    assert importlib.metadata.version("treelod") == version


def test_changelog_lines_name_their_part():
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    lines = re.findall(r"^- (.*)$", changelog, re.MULTILINE)
    assert lines, "the changelog says what changed"
    assert [line for line in lines if not re.match(r"(core|py|gpu|bench): ", line)] == []


def table_after(text, header):
    """First cells of the rows below a table's header line."""
    _, _, rest = text.partition(header)
    rows = []
    for line in rest.splitlines()[2:]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_dependencies_have_their_reason():
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    cargo = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    groups = project["dependency-groups"] | project["project"]["optional-dependencies"]
    expected = {
        "| Rust | why |": [*cargo["dependencies"], *cargo["dev-dependencies"]],
        "| Python | why |": project["project"]["dependencies"],
        "| tools | why |": [
            entry for group in groups.values() for entry in group if isinstance(entry, str)
        ],
    }
    for header, names in expected.items():
        rows = table_after(contributing, header)
        stated = {row[0].strip("`") for row in rows}
        assert stated == {re.split(r"[<>=\[; ]", name)[0] for name in names}, header
        assert all(row[1] for row in rows), header


def test_techniques_table_is_the_registry():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = table_after(readme, "| technique | name | status | after |")
    status = {row[1].strip("`"): row[2] for row in rows}
    assert set(status.values()) <= {"now", "planned"}
    assert {name for name, when in status.items() if when == "now"} == set(REGISTRY)


def test_environment_variables_table_is_complete():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = table_after(readme, "| variable | effect | default |")
    stated = {row[0].strip("`") for row in rows}
    sources = [*ROOT.glob("src/**/*.rs"), *ROOT.glob("python/**/*.py"), *ROOT.glob("tests/*.py")]
    used = set()
    for source in sources:
        used.update(re.findall(r"[\"'](TREELOD_[A-Z_]+)[\"']", source.read_text(encoding="utf-8")))
    assert stated == used


# Layout of the core


def module_order():
    """Rank of each module of the core, from the one line of the documents that states it."""
    text = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"^    (\w[\w, ]* < [\w, <]*)$", text, re.MULTILINE)
    ranks = line.split(" < ")
    return {name: rank for rank, names in enumerate(ranks) for name in names.split(", ")}


def wrong_imports(module, source, order):
    """Modules that `module` names although they do not come before it."""
    named = set(re.findall(r"\bcrate::(\w+)", source)) & set(order)
    return sorted(name for name in named if name != module and order[name] >= order[module])


def core_sources():
    """Each file of the core with the module at the top of its path."""
    src = ROOT / "src"
    for file in sorted(src.glob("**/*.rs")):
        module = file.relative_to(src).parts[0].removesuffix(".rs")
        if module != "lib":
            yield file, module


def test_imports_go_one_way():
    order = module_order()
    for file, module in core_sources():
        assert module in order, f"docs/architecture.md does not say where {module} stands"
        assert wrong_imports(module, file.read_text(encoding="utf-8"), order) == [], file


def test_wrong_imports_are_found():
    order = {"error": 0, "view": 1, "raster": 2}
    assert wrong_imports("view", "use crate::error::LodError;\nuse crate::view::View;", order) == []
    assert wrong_imports("view", "use crate::raster::Frame;", order) == ["raster"]


def test_no_technique_knows_another():
    for name in REGISTRY:
        source = (ROOT / f"src/lod/{name}.rs").read_text(encoding="utf-8")
        others = "|".join(other for other in REGISTRY if other != name)
        assert re.findall(rf"\b(?:lod|super)::(?:{others})\b", source) == [], name


def test_the_core_knows_neither_python_nor_files():
    for file, module in core_sources():
        if module != "py" and file.name != "tests.rs":
            source = file.read_text(encoding="utf-8")
            assert re.findall(r"\b(?:pyo3|numpy::|std::fs)\b", source) == [], file
