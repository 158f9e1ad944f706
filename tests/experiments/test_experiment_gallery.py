"""The page of results: complete, well-formed, escaped, and the same bytes for the same results."""

import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import PIL.Image
import pytest

from jaxlens.experiments import Experiment, ExperimentError, config, paper
from jaxlens.experiments.folders import MARKER, read_manifest
from jaxlens.experiments.gallery import Section, write_page
from jaxlens.experiments.gallery.sections import MEDIA
from jaxlens.experiments.gallery.tables import heading
from jaxlens.experiments.schema import Image, Lenses
from jaxlens.experiments.sweep import SweepExperiment

ROOT = Path(__file__).parents[2]
EMPTY = {"br", "img", "link", "meta"}
NASTY = """<script>alert("x")</script> & 'y'"""
SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="504pt" height="252pt">'
SVG += '<path id="p" style="fill:#fff" d="M0 0 &gt;"/></svg>'


class Page(HTMLParser):
    """Reads a page and complains of what is not well-formed."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        assert len(dict(attrs)) == len(attrs)
        self.elements.append((tag, dict(attrs)))
        if tag not in EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.text += data

    def all(self, tag: str, attribute: str) -> list[str]:
        return [
            str(attributes[attribute]) for name, attributes in self.elements if name == tag and attribute in attributes
        ]


def make(folder: Path, content: dict[str, str | bytes], experiment=None, note: str = "", **facts: object) -> Section:
    """A section with results of any files."""
    experiment = experiment or Experiment(kind="grids", name=folder.name)
    folder.mkdir(parents=True, exist_ok=True)
    for name, inside in content.items():
        (folder / name).write_bytes(inside.encode() if isinstance(inside, str) else inside)
    manifest = {"tool": MARKER, "experiment": folder.name, "files": {name: "0" * 64 for name in content}} | facts
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return Section(experiment, f"{folder.name}.toml", folder, manifest, note)


def page_of(folder: Path, *sections: Section, embed: bool = False) -> Page:
    write_page(folder / "index.html", sections, embed=embed)
    return Page((folder / "index.html").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def png(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("png") / "small.png"
    PIL.Image.fromarray(np.zeros((30, 40), np.uint8)).save(path)
    return path.read_bytes()


@pytest.mark.parametrize("embed", [False, True])
def test_every_figure_and_table_is_on_the_page(tmp_path: Path, png: bytes, embed: bool):
    files = {
        "line.svg": SVG,
        "line.png": png,
        "photo.png": png,
        "table.csv": "x\n1\n",
        "more.csv": "x\n",
        "mesh.obj": "v",
    }
    facts = {
        "configuration": {"image": {"peak": 193.0}},
        "results": {"lenses": 17},
    }
    section = make(tmp_path / "é.f", files, **facts)
    page = page_of(tmp_path, section, make(tmp_path / "other", {"line.svg": SVG}), embed=embed)
    linked = {unquote(reference) for reference in page.all("a", "href") if not reference.startswith("#")}
    assert linked == {f"é.f/{name}" for name in (*files, "manifest.json")} | {"other/line.svg", "other/manifest.json"}
    shown = ["é.f/line.svg", "é.f/photo.png", "other/line.svg"]
    for source, name in zip(page.all("img", "src"), shown, strict=True):
        if embed:
            kind, _, content = source.partition(";base64,")
            assert kind == f"data:{MEDIA[Path(name).suffix]}"
            assert base64.b64decode(content) == (tmp_path / name).read_bytes()
        else:
            assert (tmp_path / unquote(source)).is_file()
            assert unquote(source) == name
    assert not {"script", "link", "iframe", "object"} & {tag for tag, _ in page.elements}
    for said in ("0" * 64, "image.peak", "193", "results.lenses", "17"):
        assert said in page.text
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(set(ids)) == len(ids)
    assert {f"#{one}" for one in ids} >= {one for one in page.all("a", "href") if one.startswith("#")}


def test_the_papers_numbers_stand_beside_ours(tmp_path: Path):
    rows = "".join(f"{a:g},{b:g},1,2,3,4\n" for a, b in [(0.5, 0.5), *(row.kappa for row in paper.TABLE_1)])
    table = {"table.csv": "kappa1,kappa2,snr,psnr,rmse,mae\n" + rows}
    sweep = SweepExperiment(
        kind="sweep", name="s", image=Image(source="portrait"), lenses=Lenses(kappa=[[0.0, 1.0]]), compare="table1"
    )
    text = (page := page_of(tmp_path, make(tmp_path / "s", table, sweep))).text
    assert ("table", {"class": "compared"}) in page.elements
    for row in paper.TABLE_1:
        assert f"{row.psnr:.3f}" in text
        assert f"{2 - row.psnr:+.3f}".replace("-", "−") in text
    assert text.count("54.572") == 2
    assert "54.572*" in text
    assert "implies an RMSE of 61.742" in text
    plain = sweep.model_copy(update={"compare": None})
    assert "16.314" not in page_of(tmp_path, make(tmp_path / "s", table, plain)).text
    # Without the columns, or without a lens of the paper, there is nothing to compare.
    for other in ("kappa1,kappa2\n0,1\n", "kappa1,kappa2,snr,psnr,rmse,mae\n9,9,1,2,3,4\n", "\n", ""):
        page = page_of(tmp_path, make(tmp_path / "s", {"table.csv": other}, sweep))
        assert ("table", {"class": "compared"}) not in page.elements


def test_text_is_escaped_wherever_it_comes_from(tmp_path: Path, png: bytes):
    experiment = Experiment(
        kind="grids", name="e", title=NASTY, caption=NASTY, captions={"chart": NASTY, "table": NASTY}
    )
    files = {"chart.png": png, "table.csv": f'"{NASTY.replace(chr(34), chr(34) * 2)}",b\n1,<i>\n', '<i>".csv': "a\n1\n"}
    page = page_of(tmp_path, make(tmp_path / "e", files, experiment, NASTY, configuration={"<u>": [NASTY, {"<s>": 1}]}))
    assert not {"script", "i", "u", "s"} & {tag for tag, _ in page.elements}
    assert page.text.count(NASTY) >= 7
    assert "e/%3Ci%3E%22.csv" in page.all("a", "href")
    assert page.all("img", "alt") == [NASTY]


def test_captions_say_the_order_and_svg_is_taken_first(tmp_path: Path, png: bytes):
    files = {"b.png": png, "a.png": png, "c.svg": SVG, "c.png": png, "z.csv": "x\n1\n", "table.csv": "x\n1\n"}
    experiment = Experiment(kind="grids", name="o", captions={"c": "Lines. Then more.", "b": "Noise, as in Eq. 5."})
    page = page_of(tmp_path, make(tmp_path / "o", files, experiment))
    assert page.all("figure", "id") == ["o.c", "o.b", "o.a"]
    assert page.all("img", "alt") == ["Lines.", "Noise, as in Eq. 5.", "o: a"]
    assert page.all("img", "src") == ["o/c.svg", "o/b.png", "o/a.png"]
    assert page.text.index("table.csv") < page.text.index("z.csv")


def test_letters_are_of_one_size_in_all_figures(tmp_path: Path, png: bytes):
    for name, dpi in (("fine.png", 320), ("coarse.jpg", 80)):
        PIL.Image.new("L", (7 * dpi, 3 * dpi)).save(tmp_path / name, dpi=(dpi, dpi))
    files = {name: (tmp_path / name).read_bytes() for name in ("fine.png", "coarse.jpg")}
    page = page_of(tmp_path, make(tmp_path / "s", files | {"line.svg": SVG, "other.svg": "<svg/>", "raw.png": png}))
    assert page.all("img", "src") == ["s/coarse.jpg", "s/fine.png", "s/line.svg", "s/other.svg", "s/raw.png"]
    assert page.all("img", "width") == ["800", "800", "800", "40"]
    assert page.all("img", "height") == ["343", "343", "400", "30"]


@pytest.mark.parametrize("embed", [False, True])
def test_a_figure_that_cannot_be_read_is_named(tmp_path: Path, embed: bool):
    with pytest.raises(ExperimentError, match=r"cannot read the figure '.*broken\.png'"):
        page_of(tmp_path, make(tmp_path / "x", {"broken.png": b"none"}), embed=embed)
    assert not (tmp_path / "index.html").exists()


def test_long_tables_are_folded_and_very_long_ones_cut(tmp_path: Path):
    files = {f"t{rows}.csv": "v\n" + "".join(f"{index}\n" for index in range(rows)) for rows in (3, 30, 300)}
    page = page_of(tmp_path, make(tmp_path / "t", files))
    assert sum(tag == "details" for tag, _ in page.elements) == 4  # and parameters, manifest
    assert "(3 rows)" in page.text
    assert "(30 rows)" in page.text
    assert "the first 12 of 300 rows" in page.text


def test_cells_are_numbers_where_all_of_a_column_are(tmp_path: Path):
    table = "kappa1,held_out_rms,name\n-1,0.123456789,-a\n3,nan,2\n10,1e-16,\n"
    page = page_of(tmp_path, make(tmp_path / "n", {"table.csv": table}))
    for said in ("κ₁", "held out RMS", "−1", "0.123457", "–", "1e−16", "-a"):
        assert said in page.text
    assert heading("kappa12") == ("κ₁₂", "")
    assert heading("range_snr") == ("range SNR", "dB")
    assert heading("psnr_distance") == ("PSNR distance", "")
    assert heading("px") == ("px", "")


def test_the_same_results_are_the_same_page_wherever_they_lie(tmp_path: Path, png: bytes):
    files = {"a.png": png, "table.csv": "x\n1\n"}
    pages = []
    for place in ("one", "two"):
        page_of(tmp_path / place, make(tmp_path / place / "e", files))
        pages.append((tmp_path / place / "index.html").read_bytes())
    assert pages[0] == pages[1]
    assert str(tmp_path).encode() not in pages[0]
    page_of(tmp_path / "two", make(tmp_path / "two" / "e", files | {"table.csv": "x\n2\n"}))
    assert (tmp_path / "two" / "index.html").read_bytes() != pages[0]


def test_the_page_is_written_when_it_differs_and_replaces_only_itself(tmp_path: Path):
    section = make(tmp_path / "e", {"table.csv": "x\n1\n"})
    page = tmp_path / "index.html"
    write_page(page, [section])
    first = page.read_bytes()
    inode = page.stat().st_ino
    write_page(page, [section])
    assert page.stat().st_ino == inode
    page.write_bytes(first.replace(b"Lens distortion", b"Lens deception"))
    write_page(page, [section])
    assert page.read_bytes() == first
    for foreign in (b"", b"<!DOCTYPE html>\nmine", b"\xff", first[20:]):
        page.write_bytes(foreign)
        with pytest.raises(ExperimentError, match=r"index\.html' is no page that jaxlens wrote"):
            write_page(page, [section])
        assert page.read_bytes() == foreign
    assert sorted(path.name for path in tmp_path.iterdir()) == ["e", "index.html"]


@pytest.mark.parametrize("files", [None, [], {"../x.csv": "", "gone.csv": "", "": ""}, {"sub": ""}])
def test_a_manifest_may_list_what_is_not_there(tmp_path: Path, files: object):
    (tmp_path / "x.csv").write_text("secret\n1\n")
    section = make(tmp_path / "e", {}, files=files)
    (tmp_path / "e" / "sub").mkdir()
    page = page_of(tmp_path, section)
    assert "secret" not in page.text
    assert "figure" not in {tag for tag, _ in page.elements}


def test_a_section_without_results(tmp_path: Path):
    experiment = Experiment(kind="grids", name="e", title="Soon")
    page = page_of(tmp_path, Section(experiment, "e.toml", tmp_path / "e", None, "Not run: there are no results yet."))
    assert "Not run: there are no results yet." in page.text
    assert "Manifest" not in page.text


def configurations() -> list[Path]:
    return sorted((ROOT / "experiments").glob("*.toml"))


@pytest.mark.parametrize("path", configurations(), ids=lambda path: path.stem)
def test_every_experiment_of_this_repository_says_what_is_seen(path: Path):
    experiment = config.load(path, inputs=False).experiment
    assert experiment.caption
    assert experiment.order < 1000
    manifest = read_manifest(ROOT / "results" / experiment.name)
    if manifest is None:
        pytest.skip("there are no results of it")
    files = manifest["files"]
    assert isinstance(files, dict)
    stems = {Path(name).stem for name in files if Path(name).suffix in (*MEDIA, ".csv")}
    assert set(experiment.captions) == stems
    for caption in experiment.captions.values():
        assert re.search(r"[.]$", caption)
