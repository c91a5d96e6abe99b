"""The page stands alone, escapes what users write, and shows numbers as a reader wants them."""

import base64
import dataclasses
import json
import re
import shutil
import subprocess
import tomllib
import warnings
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from PIL import Image

from fynjax.app.report import pages
from fynjax.app.report.figures import composites, save_figure, stacked_panels, typeset
from fynjax.app.report.pages import Page, Picture, Section, Table, Views, format_number, write_page


class Checker(HTMLParser):
    """Tags that open and close in order, and everything that points outside."""

    VOID = frozenset({"meta", "img", "br"})

    def __init__(self, text):
        super().__init__()
        self.stack, self.tags, self.sources, self.text = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [value for name, value in attrs if name in ("src", "href", "srcset")]
        if tag not in self.VOID:
            self.stack.append(tag)

    def handle_endtag(self, tag):
        assert self.stack.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture
def page():
    figure = Figure(figsize=(2, 1))
    figure.subplots().plot([1, 2])
    table = pd.DataFrame(
        {"name": ["<b>x</b>", "y"], "cover": [0.123456, np.nan], "n": [3, -4], "ok": [True, False]}
    )
    return Page(
        "build",
        "Plot <1>",
        "A & B",
        [
            Section(
                "Images <i>",
                [
                    "see http://nowhere.example & <script>alert(1)</script>",
                    Picture("figure.png", figure, "a line", 'Caption "quoted"'),
                    Table(table, "All", units={"cover": "m2 m-2"}, headers={"n": "Count"}),
                    Table(table, "Folded", folded=True),
                ],
            )
        ],
        {"NDVI": "0.746", "renders": "41"},
        {"command": "fynjax demo"},
    )


def test_page_is_well_formed_and_needs_no_network(page, tmp_path):
    files = write_page(page, tmp_path)
    assert files == {"report.html": "all of it on one page", "figure.png": "a line"}
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(files)
    text = (tmp_path / "report.html").read_text("utf-8")
    checker = Checker(text)
    assert checker.stack == []
    assert checker.sources
    assert all(re.match("data:image/(png|webp);base64,", source) for source in checker.sources)
    assert not {"link", "iframe", "object", "b" * 2} & set(checker.tags)
    assert checker.tags.count("script") == 1  # the page's own, which asks for nothing
    script = re.search(r"<script>(.*?)</script>", text, re.S)[1]
    assert not re.search(r"http|fetch|import|XMLHttp|eval|innerHTML|src", script)
    assert text.count('<tr data-name="&lt;b&gt;x&lt;/b&gt;">') == 2  # marked in both tables
    style = re.search(r"<style>(.*?)</style>", text, re.S)[1]
    assert "url(" not in style
    assert "@import" not in style
    shown, written = (
        np.asarray(Image.open(one).convert("RGB"), float)
        for one in (
            BytesIO(base64.b64decode(checker.sources[0].split(",")[1])),
            tmp_path / "figure.png",
        )
    )
    assert np.abs(shown - written).mean() < 2.0  # of 255


def html(page, folder):
    write_page(page, folder)
    return (folder / "report.html").read_text("utf-8")


def test_views_are_all_on_the_page_each_with_its_label(tmp_path):
    def picture(file):
        return Picture(file, Figure(figsize=(1, 1)), "a band")

    views = Views({"Red": picture("red.png"), "NDVI <1>": picture("ndvi.png")})
    files = write_page(Page("build", "Plot", "", [Section("", [views])]), tmp_path)
    assert files == {
        "report.html": "all of it on one page",
        "red.png": "a band",
        "ndvi.png": "a band",
    }
    assert (tmp_path / "ndvi.png").read_bytes()[:4] == b"\x89PNG"
    text = (tmp_path / "report.html").read_text("utf-8")
    inside = re.search(r'<div class="views">(.*?</figure></div>)', text, re.S)[1]
    assert re.findall(r'data-label="(.*?)"', inside) == ["Red", "NDVI &lt;1&gt;"]
    assert inside.count("<figure") == 2
    assert "display: none" not in inside  # without JavaScript all are seen
    assert Checker(text).stack == []


@pytest.mark.parametrize("by_place", [True, False])
def test_rows_of_a_figure_are_marked_with_those_of_tables(tmp_path, by_place):
    """Where a row lies on the page, against the coloured bar in the picture itself."""
    figure = Figure(figsize=(4, 2), layout="constrained")
    axes = figure.subplots()
    names, colours = ["Erica <1>", "Restio"], ["#ff0000", "#0000ff"]
    if by_place:
        axes.barh([0, 1], [1.0, 1.0], height=0.5, color=colours)
        axes.set_yticks([0, 1], names)
    else:
        axes.barh(names, [1.0, 1.0], height=0.5, color=colours)
    axes.set_xlim(0, 1)
    table = Table(pd.DataFrame({"species": ["Erica <1>"], "cover": [0.2]}))
    parts = [Picture("bars.png", figure, "bars"), table]
    text = html(Page("build", "Plot", "", [Section("", parts)]), tmp_path)
    assert text.count('data-name="Erica &lt;1&gt;"') == 2
    assert Checker(text).stack == []
    image = plt.imread(tmp_path / "bars.png")
    for name, channel in (("Erica &lt;1&gt;", 0), ("Restio", 2)):
        left, top, wide, high = map(
            float,
            re.search(
                rf'<i data-name="{name}" style="left: (.*?)%; top: (.*?)%; width: (.*?)%; '
                r'height: (.*?)%"',
                text,
            ).groups(),
        )
        coloured = (image[..., channel] > 0.9) & (image[..., :3].sum(axis=-1) < 1.3)
        rows, columns = np.nonzero(coloured)
        shares = 100 * rows / image.shape[0]
        assert abs(top + high / 2 - shares.mean()) < 1.0
        assert high == pytest.approx(2 * np.ptp(shares), rel=0.05)  # bars fill half of a row
        # It begins with the longer name, which lies left of the bar.
        names_at = np.nonzero(image[:, : columns.min() - 20, :3].min(axis=(0, 2)) < 0.5)[0]
        assert left == pytest.approx(100 * names_at.min() / image.shape[1], abs=1.5)
        assert left + wide == pytest.approx(100 * columns.max() / image.shape[1], abs=1.0)


def test_views_of_the_ground_are_marked_where_the_picture_has_them(tmp_path):
    """Three of them, by the colour of each; no other part of a picture is one."""
    colours = {"a": 0, "b": 1, "c": 2}
    images = {name: np.zeros((4, 6, 9)) for name in colours}
    for name, channel in colours.items():
        images[name][(3, 1, 0)[channel]] = 1.0  # near infrared, red, green
    figure = composites(images, ("green", "red", "red_edge", "nir"), pixel_m=0.1)
    plain = Figure(figsize=(1, 1))
    plain.subplots()
    parts = [Picture("images.png", figure, "x"), Picture("plain.png", plain, "x")]
    text = html(Page("build", "Plot", "", [Section("", parts)]), tmp_path)
    found = re.findall(
        r'<b class="ground" style="left: (.*?)%; top: (.*?)%; width: (.*?)%; height: (.*?)%"', text
    )
    assert len(found) == 3
    picture = plt.imread(tmp_path / "images.png")[..., :3]
    for channel, edges in zip(colours.values(), found, strict=True):
        left, top, wide, high = map(float, edges)
        pure = (picture[..., channel] > 0.9) & (np.delete(picture, channel, -1).max(axis=-1) < 0.2)
        rows, columns = np.nonzero(pure)
        for share, count, inside in ((left, 1, columns), (top, 0, rows)):
            edge = 100 * inside.min() / picture.shape[count]
            assert share == pytest.approx(edge, abs=0.4)
        assert left + wide == pytest.approx(100 * columns.max() / picture.shape[1], abs=0.4)
        assert top + high == pytest.approx(100 * rows.max() / picture.shape[0], abs=0.4)


_BROWSER = """
class Element {
  constructor(found = {}) {
    Object.assign(this, {found, style: {}, dataset: {}, on: {}, parts: [], seen: new Set()});
    this.offsetWidth = 200; this.offsetHeight = 100; this.firstElementChild = this;
    this.classList = {add: c => this.seen.add(c), toggle: (c, on) => on && this.seen.add(c)};
  }
  addEventListener(name, act) { this.on[name] = act; }
  append(one) { this.parts.push(one); }
  before() {} replaceWith() {} setPointerCapture() {}
  cloneNode() { return new Element(); }
  closest(what) { return what === "figure" ? new Element() : null; }
  getBoundingClientRect() { return {left: 10, top: 20}; }
  querySelectorAll(what) { return this.found[what] ?? []; }
  querySelector(what) { return this.found[what][0]; }
}
const pane = () => Object.assign(new Element(), {style: {left: "10%", top: "20%", width: "25%",
  height: "50%"}});
const panes = [pane(), pane(), pane()], other = pane(), plain = new Element();
const section = pictures => new Element({".picture": pictures,
  ".ground": pictures.flatMap(picture => picture.found[".ground"] ?? [])});
const picture = grounds => new Element({".ground": grounds});
const sections = [section([picture(panes.slice(0, 2)), picture(panes.slice(2)), plain]),
  section([picture([other])])];
const document = {createElement: () => new Element(),
  querySelectorAll: what => what === "section" ? sections : []};
SCRIPT
const shown = () => [...panes, other].map(p => p.parts[0].style.transform ?? "");
const before = shown(), part = panes[0].parts[0].parts[0].style;
panes[1].on.dblclick({clientX: 10 + 50, clientY: 20 + 50});
const zoomed = shown();
panes[2].on.pointerdown({clientX: 110, clientY: 70});
panes[2].on.pointermove({clientX: 135, clientY: 57.5});
panes[2].on.pointerup({});
const moved = shown();
panes[2].on.pointermove({clientX: 0, clientY: 0});
console.log(JSON.stringify([before, zoomed, moved, shown(), part, plain.style]));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="no JavaScript outside a browser")
def test_views_of_the_ground_in_a_section_zoom_and_move_together():
    """Those of one picture and of the next; not those of another section."""
    script = (Path(pages.__file__).parent / "page.js").read_text("utf-8")
    asked = ["node", "-e", _BROWSER.replace("SCRIPT", script)]
    answer = subprocess.run(asked, capture_output=True, text=True, timeout=60, check=True).stdout
    before, zoomed, moved, after, part, plain = json.loads(answer)
    assert before == [""] * 4
    # About the point that was clicked, a quarter from the left and half from the top.
    assert zoomed == ["translate(-25%, -50%) scale(2)"] * 3 + [""]
    assert moved == ["translate(-12.5%, -62.5%) scale(2)"] * 3 + [""]
    assert after == moved  # the pointer was let go
    # The part of the picture that the view covers lies where it did.
    assert part == {"width": "400%", "left": "-40%", "top": "-40%"}
    assert plain == {}


def test_pages_are_dark_where_the_system_is_but_not_on_paper(page, tmp_path):
    style = re.search(r"<style>(.*?)</style>", html(page, tmp_path), re.S)[1]
    assert "@media screen and (prefers-color-scheme: dark)" in style
    used = set(re.findall(r"var\(--(\w+)\)", style))
    light, dark = (set(re.findall(r"--(\w+):", part)) for part in style.split("@media screen", 1))
    assert used <= light
    assert light == dark


def test_what_users_write_is_text(page, tmp_path):
    text = "".join(Checker(html(page, tmp_path)).text)
    assert "<script>alert(1)</script>" in text
    assert "<b>x</b>" in text
    assert "Plot <1>" in text
    assert "A & B" in text


def test_table_has_units_headers_and_readable_numbers(page, tmp_path):
    text = html(page, tmp_path)
    assert "cover<small>[m² m⁻²]</small>" in text
    assert ">Count</th>" in text
    for cell in ("0.1235", "–", "−4", "yes", "no"):
        assert f">{cell}</td>" in text
    assert "<details><summary>Folded</summary>" in text


@pytest.mark.parametrize(
    ("column", "header"),
    [
        ("relief_m", ("relief", "m")),
        ("leaf_mass_g_m2", ("leaf mass", "g m⁻²")),
        ("returns_per_m2", ("returns", "m⁻²")),
        ("real_mean", ("real mean", "")),
        ("asked_percent", ("asked for", "%")),
        ("cover_m", ("cover", "m of crown")),
    ],
)
def test_headers_and_units_come_from_names_of_columns_unless_they_are_said(column, header):
    said = {"headers": {"asked_percent": "asked for"}, "units": {"cover_m": "m of crown"}}
    assert Table(pd.DataFrame({column: [1.0]}), **said).header(column) == header


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0"),
        (12.0, "12"),
        (0.74623, "0.7462"),
        (-0.5, "−0.5"),
        (1234.56, "1235"),
        (999.96, "1000"),
        (0.00001234, "1.234e−05"),
        (2.5e7, "2.500e+07"),
        (float("nan"), "–"),
        (float("inf"), "–"),
    ],
)
def test_numbers(value, shown):
    assert format_number(value) == shown


def test_headers_of_a_wide_table_may_break_so_that_its_columns_fit(page, tmp_path):
    rule = re.search(r"\nth \{([^}]*)\}", html(page, tmp_path))
    assert rule is not None
    assert "white-space: normal" in rule[1]


def test_every_page_begins_with_result_trust_and_next_step():
    """Each command that writes a page has its lines, short enough for a phone, and no other has."""
    root = Path(pages.__file__).parents[3]
    source = "\n".join(f.read_text("utf-8") for f in root.rglob("*.py"))
    made = set(re.findall(r'(?:\bPage|run\.pictures)\(\s*"([a-z -]+)"', source))
    answers = tomllib.loads((Path(pages.__file__).parent / "answers.toml").read_text("utf-8"))
    assert made == set(answers) > {"calibrate", "posterior", "validate", "fit-leaf", "map"}
    for command, said in answers.items():
        assert set(said) == {"trust", "next"}, command
        assert all(20 < len(line) < 160 and line[-1] == "." for line in said.values()), command


def test_the_answer_stands_before_all_else_and_the_record_is_folded(page, tmp_path):
    lead = "First. All of 2.5 m2 of leaves."
    record = {"command": "fynjax demo", "input_sha256": '{"a.csv": "12ab"}'}
    text = html(dataclasses.replace(page, lead=lead, record=record, trust="Hardly."), tmp_path)
    heads = re.findall(r"<h[123]>(.*?)</h[123]>", text)
    assert heads[1:4] == ["Result", "May it be trusted?", "What next?"]
    assert "<p>First.</p>" in text
    assert "<p>Hardly.</p>" in text
    assert text.index("What next?") < text.index('class="key"') < text.index("<section>")
    assert "2.5 m² of leaves" in text
    footer = text[text.index("<footer>") :]
    assert footer.startswith("<footer><details>")
    assert "SHA-256 of a.csv</td>" in footer
    assert "{" not in footer[: footer.index("</footer>")]


@pytest.mark.parametrize(
    ("plain", "printed"),
    [
        ("2 m2 m-2", "2 m² m⁻²"),
        ("W m-2 sr-1 um-1", "W m⁻² sr⁻¹ µm⁻¹"),
        ("40 ug cm-2", "40 µg cm⁻²"),
        ("plot_m2, m20, PM2.5, s1 and m1", "plot_m2, m20, PM2.5, s1 and m1"),
        ("from m2-3 on", "from m2-3 on"),
        ("1.2 plants m-2, 3 W/m2 [m2]", "1.2 plants m⁻², 3 W/m² [m²]"),
        ("um", "µm"),
        ("Chlorophyll\n[ug\ncm-2]", "Chlorophyll\n[µg\ncm⁻²]"),
        ("um arbusto", "um arbusto"),
        ("m2.csv, site-m2 and 5 m2.laz", "m2.csv, site-m2 and 5 m2.laz"),
        ("plot s2 of site m-2, quadrat m3", "plot s2 of site m-2, quadrat m3"),
        ("data/m2/h3 of [h2]", "data/m2/h3 of [h2]"),
    ],
)
def test_units_are_typeset_and_names_are_not(plain, printed):
    assert typeset(plain) == printed


def test_a_scale_of_several_panels_stands_below_them_on_a_phone():
    """None of the panels is cut in two by it, and words below all are kept."""
    figure = Figure(figsize=(9, 3), layout="constrained")
    axes = figure.subplots(1, 2)
    maps = [one.imshow([[value]], vmin=0, vmax=1, cmap="gray") for one, value in zip(axes, (0, 1))]
    axes[1].set_facecolor("red")
    maps[1].set_alpha(0.0)
    figure.colorbar(maps[0], ax=list(axes), location="bottom")
    figure.supxlabel("for all")
    left, right, scale, word = stacked_panels(figure, 4.0)
    red = [int((part == (255, 0, 0)).all(axis=-1).sum()) for part in (left, right, scale, word)]
    assert red[1] > 10_000
    assert red == [0, red[1], 0, 0]
    assert len(np.unique(scale)) > 100
    assert word.min() < 50
    assert left.shape[1] < 5 * 160


def test_a_figure_whose_panels_reach_into_each_other_stays_whole():
    figure = Figure(figsize=(9, 3), layout="none")
    for axes in figure.subplots(1, 2, gridspec_kw={"wspace": 0.02}):
        axes.plot([0, 1])
        axes.set_ylabel("a\nb\nc")
    assert stacked_panels(figure, 4.0) == []


def test_an_upright_word_for_all_panels_lies_on_a_phone():
    figure = Figure(figsize=(9, 3), layout="constrained")
    for axes in figure.subplots(1, 2):
        axes.plot([0, 1])
    figure.supylabel("a bound [m2 m-2] of all", color="red")
    *_, word = stacked_panels(figure, 4.0)
    assert len(word) < 40 < 100 < word.shape[1]


def test_units_in_a_figure_are_typeset(tmp_path):
    figure = Figure()
    axes = figure.subplots()
    axes.set_title("area [m2 m-2]")
    axes.barh([0], [1], tick_label=["m2 m-2"])
    save_figure(figure, tmp_path / "a.png")
    assert axes.get_title() == "area [m² m⁻²]"
    assert axes.get_yticklabels()[0].get_text() == "m2 m-2"


def test_words_beside_a_panel_are_whole_on_a_phone():
    """Names of rows end well within the piece that is cut out."""
    figure = Figure(figsize=(9, 2), layout="constrained")
    for axes in figure.subplots(1, 2):
        axes.barh([0], [1], tick_label=["Mmmmmmmm mmmmmmmmmmmmmmmmmmmm"])
    for part in stacked_panels(figure, 4.0):
        assert (part[:, :2] == 255).all()
        assert part[:, 3:40].min() < 100


def test_a_picture_that_warns_when_it_is_drawn_is_drawn_all_the_same():
    """Of warnings those of a layout without room alone leave a phone with the whole picture."""
    for kind, count in ((RuntimeWarning, 2), (UserWarning, 0)):
        figure = Figure(figsize=(9, 3), layout="constrained")
        for axes in figure.subplots(1, 2):
            axes.plot([0, 1])
            axes.xaxis.set_major_formatter(lambda *_, kind=kind: warnings.warn("x", kind, 2) or "")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            assert len(stacked_panels(figure, 4.0)) == count


def test_a_phone_has_the_panels_below_each_other_and_nothing_wider(page, tmp_path):
    """Each panel once, by its colour, and the legend last; a wide single panel drawn anew."""
    figure = Figure(figsize=(9, 3), layout="constrained")
    for axes, colour in zip(figure.subplots(1, 3, sharey=True), ("red", "lime", "blue")):
        axes.plot([0, 1], color=colour, lw=6, label=colour)
    parts = stacked_panels(figure, 4.0)
    assert len(parts) == 3
    pure = np.eye(3) * 255
    for own, part in enumerate(parts):
        count = [int((part == one).all(axis=-1).sum()) for one in pure]
        assert count[own] > 500
        assert sum(count) == count[own]
    figure.legend(loc="outside right upper")
    *_, legend = stacked_panels(figure, 4.0)
    assert len(_) == 3
    assert all((legend == one).all(axis=-1).any() for one in pure)
    assert tuple(figure.get_size_inches()) == (9, 3)
    single = Figure(figsize=(9, 3), layout="constrained")
    single.subplots().plot([0, 1])
    (slim,) = stacked_panels(single, 4.0)
    assert slim.shape[1] < 4.3 * 160
    text = html(dataclasses.replace(page, sections=[Section("", [Picture("a.png", figure, "x")])]),
                tmp_path)  # fmt: skip
    assert text.count("<img ") == 1 + 4
    assert 'name="viewport" content="width=device-width' in text
    style = re.search(r"<style>(.*?)</style>", text, re.S)[1]
    assert ".picture { position: relative; max-width: 100%" in style
    assert ".narrow img { display: block; max-width: 100%" in style
    assert ".scroll { overflow-x: auto" in style
    assert not re.search(r"min-width: *[4-9]\d\d", style)
