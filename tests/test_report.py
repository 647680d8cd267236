"""Is the report whole by itself, true to the numbers, and safe with names from outside?"""

import base64
import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from made_results import comparison
from treelod.report import images, write_report


class Page(HTMLParser):
    """Collects tags, attributes and text; checks that every tag is closed in order."""

    VOID = frozenset({"meta", "img", "br", "link", "input", "wbr"})

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.text = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)

    @property
    def words(self):
        return re.sub(r"\s+", " ", "".join(self.text))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "a" / "b"
    assert write_report(comparison(), folder) == folder / "report.html"
    return folder


def page_of(path):
    return Page(path.read_text(encoding="utf-8"))


def test_page_needs_nothing_else(folder):
    page = page_of(folder / "report.html")
    assert not {"script", "link", "iframe"} & {tag for tag, _ in page.tags}
    sources = [attributes["src"] for tag, attributes in page.tags if tag == "img"]
    assert len(sources) >= 2 + 3 + 6 * 3
    assert all(source.startswith("data:image/") for source in sources)
    style = "".join(page.text)
    assert "@import" not in style
    assert "url(" not in style
    # what can be followed is only read by those who click
    assert {tag for tag, attributes in page.tags if "href" in attributes} == {"a"}


def test_every_embedded_picture_opens(folder):
    page = page_of(folder / "report.html")
    for tag, attributes in page.tags:
        if tag != "img":
            continue
        kind, _, data = attributes["src"].partition(";base64,")
        raw = base64.b64decode(data, validate=True)
        if kind == "data:image/svg+xml":
            assert b"<svg" in raw
            continue
        picture = Image.open(io.BytesIO(raw))
        picture.load()
        assert int(attributes["width"]) <= images.COLUMN_PX
        assert attributes["alt"]


def test_page_states_the_numbers(folder):
    words = page_of(folder / "report.html").words
    for expected in (
        "oak: speed against error",
        "FLIP",
        "0.0200",  # mean over all views
        "4.00",  # ms at 2.5 radii
        "2.00\N{MULTIPLICATION SIGN}",  # the speed-up everywhere
        "∞",  # the full mesh's PSNR here
        "\N{MINUS SIGN}0.0050",  # coverage bias
        "slice_count=5",
        "correction=fit",
        "A Processor",
        "treelod1.2.3, release build",
        "numpy 2.4.6",
        "sha256",
        "64 samples a pixel",
        "after 2 frames of warm-up, 5 frames",
        "5.10 MB",
    ):
        assert expected in words, expected


def test_tables_hold_every_row_and_no_infinity(folder):
    parquet = pd.read_parquet(folder / "results.parquet")
    csv = pd.read_csv(folder / "results.csv")
    for table in (parquet, csv):
        assert len(table) == 2 * 16
        assert table["psnr"].isna().sum() == 16  # the full mesh's, which are infinite
        assert table["psnr_black"].isna().sum() == 16
        assert not np.isinf(table.select_dtypes("number").to_numpy(float, na_value=0.0)).any()
        slicings = table[table["label"] == "slicings"]
        assert slicings["psnr"].notna().all()
        np.testing.assert_allclose(slicings["speedup"], 2.0)
        assert set(slicings["params"]) == {'{"correction": "fit", "slice_count": 5}'}
        assert set(slicings["error_samples"]) == {64}
        assert set(table["azimuth_deg"]) == {0, 90, 180, 270}
        assert set(table["elevation_deg"]) == {0, 25}
        assert set(table["distance"]) == {2.5, 10}
    assert "inf" not in (folder / "results.csv").read_text().replace("infinite", "").split(",")
    assert parquet["plant_sha256"].tolist() == ["00ff" * 16] * 32
    for column in ("cpu", "treelod_version", "numpy_version", "date", "build_profile", "threads"):
        assert parquet[column].notna().all()


def test_columns_without_values_keep_their_type():
    table = comparison().table()
    assert str(table["seed"].dtype) == "Int64"
    assert str(table["git_commit"].dtype) == "string"
    assert str(table["yee"].dtype) == "float64"
    grown = replace(comparison(), source={"preset": "oak", "seed": 3}).table()
    assert grown["seed"].tolist() == [3] * len(grown)
    assert list(grown.dtypes) == list(table.dtypes)


def test_pictures_beside_the_page_have_every_pixel(folder):
    made = comparison()
    names = sorted(path.name for path in (folder / "pictures").iterdir())
    assert len(names) == 6 * 4 + 2
    (name,) = [n for n in names if n.endswith("_slicings_near_image.png")]
    np.testing.assert_array_equal(
        np.asarray(Image.open(folder / "pictures" / name)), made.pictures[0].image
    )
    assert {path.name for path in (folder / "plots").iterdir()} == {
        "speed_against_error.png",
        "error_by_azimuth.png",
        "error_by_distance.png",
    }


def test_names_from_outside_cannot_become_markup_or_paths(tmp_path):
    evil = "</style><script>alert(1)</script>"
    made = comparison(labels=("full_mesh", f"slicings:{evil}/../x"), picture_size=(30, 20))
    made = replace(
        made,
        plant=made.plant | {"name": evil, "summary": evil},
        source={evil: evil},
        provenance=replace(made.provenance, cpu=evil),
    )
    write_report(made, tmp_path / "out")
    page = page_of(tmp_path / "out" / "report.html")
    assert "script" not in {tag for tag, _ in page.tags}
    assert evil in "".join(page.text)
    for path in (tmp_path / "out" / "pictures").iterdir():
        assert re.fullmatch(r"[A-Za-z0-9._=-]+", path.name)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out"]


def test_labels_that_look_alike_in_file_names_keep_their_pictures(tmp_path):
    made = comparison(labels=("full_mesh", "slicings:a/b", "slicings:a b"), picture_size=(30, 20))
    write_report(made, tmp_path)
    assert len(list((tmp_path / "pictures").iterdir())) == 9 * 4 + 2


def test_refuses_a_file_as_folder_and_writes_nothing(tmp_path):
    file = tmp_path / "taken"
    file.write_text("mine")
    for target in (file, file / "deeper"):
        with pytest.raises(NotADirectoryError, match="taken is a file"):
            write_report(comparison(), target)
    assert file.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [file]


def test_a_second_report_replaces_the_first(tmp_path):
    write_report(comparison(("full_mesh", "slicings", "other"), picture_size=(30, 20)), tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "pictures" / "00_mine.png").write_text("mine")
    pictures = {path.name for path in (tmp_path / "pictures").iterdir()}
    assert any("other" in name for name in pictures)
    made = comparison(picture_size=(30, 20))
    write_report(replace(made, plant=made.plant | {"name": "elm"}), tmp_path)
    assert "elm: speed against error" in page_of(tmp_path / "report.html").words
    assert (tmp_path / "notes.txt").read_text() == "mine"
    left = {path.name for path in (tmp_path / "pictures").iterdir()}
    assert len(left) == 6 * 4 + 3, "three views of two techniques, the plant twice, and mine"
    assert "00_mine.png" in left
    assert not any("other" in name for name in left)
    assert not list(tmp_path.rglob("*.tmp"))


def test_magma_runs_from_black_to_pale():
    colors = images.magma(np.array([[0.0, 1.0, 2.0]], np.float32))
    np.testing.assert_array_equal(colors[0, 0], [0, 0, 4])
    np.testing.assert_array_equal(colors[0, 1], [252, 253, 191])
    np.testing.assert_array_equal(colors[0, 1], colors[0, 2])


def opened(uri):
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))))


def test_small_pictures_are_enlarged_by_a_whole_factor_without_filtering():
    picture = np.random.default_rng(1).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    uri, width = images.overview(picture)
    assert width == 300  # 336 // 50 = 6
    np.testing.assert_array_equal(opened(uri), picture.repeat(6, axis=0).repeat(6, axis=1))


def test_strips_are_side_by_side():
    pictures = [np.full((100, 150, 3), shade, np.uint8) for shade in (10, 20, 30)]
    row = images.strip(pictures)
    assert row.shape == (200, 3 * 300 + 2 * 8, 3)  # 336 // 150 = 2
    for left, shade in ((0, 10), (300, 255), (308, 20), (608, 255), (616, 30)):
        width = 8 if shade == 255 else 300
        assert (row[:, left : left + width] == shade).all()


def test_middle_sized_pictures_are_kept_and_large_ones_are_reduced():
    middle = np.random.default_rng(1).integers(0, 256, (400, 500, 3), dtype=np.uint8)
    uri, width = images.overview(middle)
    assert width == images.COLUMN_PX
    np.testing.assert_array_equal(opened(uri), middle)
    uri, width = images.overview(np.full((1200, 600, 3), 77, np.uint8))
    assert width == images.COLUMN_PX // 2  # a tall picture is bound by its height
    assert opened(uri).shape == (512, 256, 3)


def test_detail_is_where_the_error_is():
    difference = np.zeros((300, 400), np.float32)
    difference[150:250, 260:360] = 1.0
    left, top, right, bottom = images.detail_window(difference)
    assert (right - left, bottom - top) == (112, 112)
    assert left <= 260
    assert right >= 360
    assert top <= 150
    assert bottom >= 250
    # of equal ones the first
    assert images.detail_window(np.zeros((300, 400), np.float32)) == (0, 0, 112, 112)
    assert images.detail_window(np.zeros((200, 100), np.float32)) is None
    # narrower than the window
    assert images.detail_window(np.zeros((300, 60), np.float32)) == (0, 0, 60, 112)
