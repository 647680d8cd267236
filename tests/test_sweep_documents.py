"""Do the examples of sweeps in the documents run, and give what they say?"""

import re
from pathlib import Path

import treelod as tl
from made_sweeps import PLANT
from treelod.sweeps.config import read_config
from treelod.sweeps.grid import expand

ROOT = Path(__file__).parents[1]


def fences(document, language):
    text = (ROOT / document).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


SMALL = (
    ("(256, 192)", "(48, 40)"),
    ("reference_samples=16", "reference_samples=16, repeats=1, warmup=0"),
)
"""What makes an example quick; it stays the same in all else."""


def test_the_first_example_runs(tmp_path, monkeypatch, capsys):
    (code, *_) = fences("docs/sweeps.md", "python")
    small = code
    for text, other in (("chestnut", "grass"), ("leaf_count=500", "leaf_count=60"), SMALL[1]):
        assert text in small
        small = small.replace(text, other)
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(small, "docs/sweeps.md", "exec"), names)
    assert names["again"].equals(names["table"])
    assert names["data"].sizes == {"plant": 1, "slice_count": 3, "resolution": 2, "view": 2}
    assert "slicings:slice_count=7,resolution=32" in capsys.readouterr().out


def test_the_readmes_example_runs(tmp_path, monkeypatch):
    (code,) = [code for code in fences("README.md", "python") if "tl.sweep" in code]
    monkeypatch.chdir(tmp_path)
    names = {"tl": tl, "plant": PLANT}
    for text, other in SMALL:
        code = code.replace(text, other)
    exec(compile(code, "README.md", "exec"), names)
    assert len(names["table"]) == 8 * 8


def test_the_file_that_is_shown_is_one(tmp_path):
    (text,) = fences("docs/sweeps.md", "toml")
    (tmp_path / "grid.toml").write_text(text, encoding="utf-8")
    config = read_config(tmp_path / "grid.toml")
    assert [*config.plants] == ["chestnut", "oak", "ash"]
    # the full mesh; 3 x 3 x 2 slicings; 2 and 1 clusters
    assert len(expand(config.grid)) == 1 + 18 + 3
    assert config.settings["timing"] == "exclusive"
