"""What `import treelod` gives, and what it must not cost."""

import subprocess
import sys

import treelod


def test_every_public_name_is_there():
    for name in treelod.__all__:
        assert getattr(treelod, name) is not None, name
    assert treelod.metrics is sys.modules["treelod.metrics"]


def test_import_is_light():
    code = """
import sys, treelod
heavy = {"OpenImageIO", "matplotlib", "pandas", "skimage", "trimesh"}
print(sorted(heavy & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
