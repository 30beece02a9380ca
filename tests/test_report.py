"""The result folder and its report: what a reader sees equals the record, and the page needs nothing from outside."""

import hashlib
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from decimal import Decimal
from html import unescape
from html.parser import HTMLParser
from itertools import combinations, pairwise
from math import inf, pi
from pathlib import Path
from types import SimpleNamespace

import control
import numpy as np
import pytest
from finished_run import STUDY, finished_run
from honest_certificates import screw
from hypothesis import given
from hypothesis import strategies as st
from test_figures import cut_off

import beamdesign
from beamdesign import Prototype, check, critical_gain, read_prototype, state_space
from beamdesign.build import result_folder
from beamdesign.build.acceptance import acceptance
from beamdesign.build.result_folder import FILES, check_row, price_words, report_html, write_result_folder
from beamdesign.loop import loop
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import exact
from beamdesign.prototype import InStage
from beamdesign.quantities import at_least, at_most, decimal, per_cent, quantity
from beamdesign.report.canvas import inline_svg, new_figure
from beamdesign.report.charts import TradePoint, plot_trade, read_trade
from beamdesign.report.drawing import draw_end, draw_section, draw_side
from beamdesign.report.figures import shade_compliance
from beamdesign.report.pictures import (
    CaptionedFigure,
    loop_pictures,
    plot_stable_gains,
    plot_stable_ranges,
    prototype_picture,
    stable_gains,
    trade_picture,
    wider_map,
)
from beamdesign.structure.lumped import lumped_beam
from beamdesign.synthesis.design_run import DesignRun


class Page(HTMLParser):
    """The parts of an HTML page that the tests look at."""

    def __init__(self, text: str):
        super().__init__(convert_charrefs=True)
        self.attributes: list[tuple[str, str, str]] = []
        self.words: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.rows: list[list[str]] = []
        self.headings: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.open.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        if tag in self.open:
            while self.open.pop() != tag:
                pass

    def handle_data(self, data: str) -> None:
        if not {"style", "script"} & set(self.open):
            self.words.append(data)
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data
        if "h1" in self.open:
            self.headings.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def run() -> DesignRun:
    return finished_run()


@pytest.fixture(scope="module")
def folder(run: DesignRun, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_result_folder(run, tmp_path_factory.mktemp("result") / "new" / "folder")


@pytest.fixture(scope="module")
def of_its_loop(run: DesignRun) -> list[CaptionedFigure]:
    """Pictures of the loop, only to be looked at."""
    return loop_pictures(designed(run), loop(designed(run)))


@pytest.fixture(scope="module")
def html(folder: dict[str, Path]) -> str:
    return folder["report"].read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


def designed(run: DesignRun) -> Prototype:
    assert run.prototype is not None
    return run.prototype


def test_the_folder_holds_the_record_and_a_certificate_that_proves_it_again(
    run: DesignRun, folder: dict[str, Path]
) -> None:
    assert {kind: path.name for kind, path in folder.items()} == FILES
    assert sorted(path.name for path in folder["report"].parent.iterdir()) == sorted(FILES.values())
    prototype = read_prototype(folder["prototype"])
    assert prototype == run.prototype
    assert prototype.guarantee is not None
    assert prototype.guarantee.certificate == folder["certificate"].name
    assert prototype.guarantee.certificate_sha256 == hashlib.sha256(folder["certificate"].read_bytes()).hexdigest()
    assert check(folder["certificate"]).valid


def test_a_run_without_a_result_writes_nothing(run: DesignRun, tmp_path: Path) -> None:
    nothing = DesignRun(run.problem, run.sizing, None, None, None, "nothing fits")
    with pytest.raises(ValueError, match="nothing fits"):
        write_result_folder(nothing, tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_a_folder_that_cannot_be_made_is_bad_input(
    run: DesignRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(result_folder, "report_html", lambda *_: "whatever the page is")
    taken = tmp_path / "taken"
    taken.write_text("a file", encoding="utf-8")
    with pytest.raises(NotADirectoryError, match="taken"):
        write_result_folder(run, taken)
    assert taken.read_text(encoding="utf-8") == "a file"


def test_the_page_requests_nothing(html: str, page: Page) -> None:
    loading = {"src", "srcset", "data", "action", "poster", "background", "xlink:href", "href"}
    targets = [(tag, value) for tag, name, value in page.attributes if name in loading]
    assert targets
    for tag, value in targets:
        beside = tag == "a" and value in FILES.values()
        assert value.startswith(("#", "data:")) or beside, (tag, value)
    assert not {"iframe", "object", "embed", "img"} & set(page.tags)
    assert not re.search(r"fetch\(|XMLHttpRequest|import\(|WebSocket|sendBeacon", html)
    assert "@import" not in html
    assert set(re.findall(r"url\(\s*['\"]?(.)", html)) <= {"#"}
    addresses = set(re.findall(r"https?://[^\s\"'<]+", html))
    assert addresses <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}


def test_every_reference_inside_the_page_has_one_target(html: str, page: Page) -> None:
    names = [value for _, name, value in page.attributes if name == "id"]
    assert len(names) == len(set(names))
    links = {value for _, name, value in page.attributes if name in ("href", "xlink:href") and value.startswith("#")}
    assert {link[1:] for link in links} | set(re.findall(r"url\(#([^)]+)\)", html)) <= set(names)


def test_every_figure_is_valid_xml_with_a_description_and_no_colour_of_one_theme(html: str) -> None:
    figures = re.findall(r"<svg.*?</svg>", html, flags=re.DOTALL)
    assert len(figures) == html.count("<figure")
    assert len(figures) >= 6
    for text in figures:
        root = ElementTree.fromstring(text)
        assert root.get("role") == "img"
        assert root.get("aria-label")
        assert root.get("viewBox")
        assert not re.search(r"#(000000|ffffff)\b", text)
    assert "prefers-color-scheme: dark" in html
    assert "@media print" in html


def test_text_of_every_figure_lies_within_it(run: DesignRun, of_its_loop: list[CaptionedFigure]) -> None:
    pictures = [prototype_picture(designed(run), 2000.0), *of_its_loop]
    assert {"prototype", "compliance", "locus", "ranges", "gains"} <= {picture.name for picture in pictures}
    for picture in pictures:
        assert cut_off(picture.figure) == [], picture.name
        root = ElementTree.fromstring(inline_svg(picture.figure, picture.name, picture.caption))
        _, _, width, height = (float(end) for end in root.get("viewBox", "").split())
        texts = list(root.iter("{http://www.w3.org/2000/svg}text"))
        assert texts
        for text in texts:
            moved = re.search(r"translate\(([-\d.]+)[ ,]+([-\d.]+)\)", text.get("transform", ""))
            x, y = (moved[1], moved[2]) if moved else (text.get("x", "nan"), text.get("y", "nan"))
            assert 0 <= float(x) <= width, text.text
            assert 0 <= float(y) <= height, text.text


def test_values_under_the_pointer_are_those_of_the_curves_at_their_places(html: str, run: DesignRun) -> None:
    (figure,) = re.findall(r'<figure id="figure-compliance">.*?</figure>', html, flags=re.DOTALL)
    (data,) = re.findall(r'<script type="application/json" class="readings">(.*?)</script>', figure, flags=re.DOTALL)
    curves = [curve for curve in json.loads(data) if curve["name"].startswith("6.8 kg")]
    (curve,) = curves
    assert curve["x"] == "frequency, Hz"
    _, _, frequency, compliance = np.array(curve["points"]).T
    exact = np.abs(loop(designed(run)).at(6.8).compliance_response(frequency))
    np.testing.assert_allclose(compliance, exact, rtol=2e-3)  # both to five digits, next to a steep slope
    # Both scales are logarithmic: places are linear in the logarithms, x to the right and y downwards.
    places = np.array(curve["points"])[:, :2]
    for place, value, sense in ((places[:, 0], frequency, 1), (places[:, 1], compliance, -1)):
        slope, offset = np.polyfit(np.log(value), place, 1)
        assert slope * sense > 0
        assert np.abs(slope * np.log(value) + offset - place).max() < 0.2
    # The drawn line passes through those places.
    drawn = [
        np.array(re.findall(r"[ML] ([\d.]+) ([\d.]+)", path), float)
        for path in re.findall(r'<path d="(M [^"]*)" clip-path', figure)
    ]
    shares = np.linspace(0.0, 1.0, 40)[:, None, None]
    dense = [((1 - shares) * line[:-1] + shares * line[1:]).reshape(-1, 2) for line in drawn if len(line) > 20]
    near = min(np.hypot(*(places[:, None, :] - line[None]).transpose(2, 0, 1)).min(axis=1).max() for line in dense)
    assert near < 0.5


def test_shading_holds_every_compliance_between_the_ends_of_the_range(run: DesignRun) -> None:
    closed = loop(designed(run))
    axes = new_figure().subplots()
    shade_compliance(axes, [closed.at(float(mass)) for mass in np.linspace(0.0, 6.8, 41)], "family")
    (band,) = axes.collections
    outline = band.get_paths()[0].vertices
    for mass in (0.0, 1.7, 3.4, 6.8):
        for frequency in (0.5, 5.0, 30.0, 200.0):
            column = outline[np.abs(np.log(outline[:, 0] / frequency)).argsort()[:4], 1]
            value = abs(closed.at(mass).compliance_response(np.array([frequency]))[0])
            assert column.min() * 0.9 <= value <= column.max() * 1.1


def test_the_line_that_is_proved_says_of_which_rigs_and_of_which_curves(of_its_loop: list[CaptionedFigure]) -> None:
    """With the servo off the rig is softer than the line promises, and is drawn beside it."""
    (caption,) = (one.caption for one in of_its_loop if one.name == "compliance")
    assert "proved for exactly these figures: with the servo on and every mass of 0 to 6.8 kg no curve" in caption
    assert "of the law and the figures that stand in certificate.toml." in caption  # whatever was edited since


def test_root_locus_passes_the_axis_at_the_critical_gain_that_the_loop_states(
    run: DesignRun, of_its_loop: list[CaptionedFigure]
) -> None:
    """The branches cross the stability boundary where the exact critical frequency lies."""
    (locus,) = [p for p in of_its_loop if p.name == "locus"]
    for axes, mass in zip(locus.figure.axes, (0.0, 6.8), strict=True):
        crossings = []
        for line in axes.lines:
            x, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
            over = np.nonzero((x[:-1] < 0) & (x[1:] >= 0) & (y[:-1] > 0.2))[0] if len(x) > 20 else []
            crossings += [np.interp(0.0, x[k : k + 2], y[k : k + 2]) for k in over]
        stated = critical_gain(designed(run), mass).frequency_Hz
        assert any(abs(crossing / stated - 1) < 0.01 for crossing in crossings), (mass, crossings, stated)


def test_poles_and_locus_show_the_oscillation_at_which_the_loop_is_lost() -> None:
    """With a ball screw, whose fastest poles are far off, where ten times the gain loses the loop with no payload."""
    rig = screw()
    stiff = rig.but(controller=rig.controller.but(gain_A_per_V=rig.controller.gain_A_per_V / 6))
    fastest = max(abs(pole) for pole in loop(stiff).at(0.0).poles()) / (2 * pi)
    lost = [stated.frequency_Hz for mass in (0.0, 6.8) if (stated := critical_gain(stiff, mass)) is not None]
    found = {one.name: one for one in loop_pictures(stiff, loop(stiff))}
    for axes in found["locus"].figure.axes:
        assert max(lost) < axes.get_ylim()[1] < 1.5 * max(lost) < fastest
    (axes,) = found["poles"].figure.axes
    drawn = np.concatenate([np.hypot(line.get_xdata(), line.get_ydata()) for line in axes.lines[:3]])
    assert drawn.max() < 1.5 * max(lost)
    assert not any("valve" in one.caption for one in found.values())


def test_pictures_of_one_payload_show_it_once() -> None:
    tame = read_prototype(Path(__file__).parent.parent / "studies" / "prototypes" / "tame_lag.toml")
    one = tame.but(payload=tame.payload.but(outer_end_mass_kg=(3.4, 3.4)))
    found = {picture.name: picture for picture in loop_pictures(one, loop(one))}
    assert [axes.get_title() for axes in found["locus"].figure.axes] == ["3.4 kg outside"]
    for name in ("poles", "compliance"):
        legend = found[name].figure.axes[0].get_legend()
        texts = [text.get_text() for text in legend.get_texts()]
        assert sum("3.4 kg" in text for text in texts) == 1, texts
    assert not any("3.4 to 3.4" in picture.caption for picture in found.values())


def test_notes_at_neighbouring_ends_of_stability_do_not_overlap() -> None:
    crossings = [SimpleNamespace(value=at, frequency_Hz=36.71, finite=True) for at in (4.5678, 5.0123, 9.0)]
    parts = [(0.0, 4.5678, True), (4.5678, 5.0123, False), (5.0123, 9.0, True), (9.0, 11.0, False)]
    ranges = [SimpleNamespace(low=exact(low), high=exact(high), stable=stable) for low, high, stable in parts]
    axes = (figure := new_figure(150, 48)).subplots()
    plot_stable_ranges(
        axes, {"": SimpleNamespace(ranges=ranges, crossings=crossings, low=exact(0.0), high=exact(11.0))}, (0.0, 4.0)
    )
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in axes.texts if "Hz" in text.get_text()]
    assert len(boxes) == 3
    assert all(right.x0 > left.x1 for left, right in pairwise(boxes))


@pytest.mark.usefixtures("no_pictures")
def test_a_front_beside_the_result_is_shown(run: DesignRun, tmp_path: Path) -> None:
    rows = [
        "outer_end_mass_high_kg,bandwidth_Hz,moving_mass_kg,proved",
        "6.8,3.0,9.0,True",
        "6.8,4.0,9.4,True",
        "6.8,9.0,,False",
    ]
    (tmp_path / "front.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    assert read_trade(tmp_path) == (TradePoint(6.8, 3.0, 9.0), TradePoint(6.8, 4.0, 9.4))
    assert read_trade(tmp_path / "none") == ()
    axes = plot_trade(new_figure().subplots(), read_trade(tmp_path), (3.5, 9.8))
    assert [list(line.get_xdata()) for line in axes.lines] == [[3.0, 4.0], [3.5]]
    page = report_html(run, FILES, read_trade(tmp_path))
    assert "Trade curves" in page
    assert 'id="figure-trade"' in page
    # Of a front it is told for which rigs it is proved, and of the design where that is for others.
    caption = trade_picture((TradePoint(6.8, 3.0, 9.0, 2.0),), run.prototype.guarantee, 9.8).caption
    assert "proved for every rig within 2 standard deviations" in caption
    assert "this design for exactly these figures" in caption


WATCH = """<script>
const watched = { errors: [] };
addEventListener("error", (event) => watched.errors.push(event.message));
for (const kind of ["error", "warn"]) console[kind] = (...words) => watched.errors.push(words.join(" "));
addEventListener("load", () => {
  watched.clipped = [];
  for (const svg of document.querySelectorAll("svg")) {
    const box = svg.getBoundingClientRect();
    for (const text of svg.querySelectorAll("text")) {
      const own = text.getBoundingClientRect();
      if (own.left < box.left - 1 || own.right > box.right + 1 || own.top < box.top - 1 || own.bottom > box.bottom + 1)
        watched.clipped.push(text.textContent);
    }
  }
  watched.sideways = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  const figure = document.querySelector("#figure-compliance"), svg = figure.querySelector("svg");
  const curve = JSON.parse(figure.querySelector("script.readings").textContent)[0], [x, y] = curve.points[60];
  const at = new DOMPoint(x, y).matrixTransform(svg.getScreenCTM());
  svg.dispatchEvent(new PointerEvent("pointermove", { clientX: at.x, clientY: at.y }));
  watched.told = figure.querySelector(".tip").textContent;
  watched.expected = [curve.name, curve.points[60][2], curve.points[60][3]];
  svg.dispatchEvent(new PointerEvent("pointerleave"));
  watched.left = document.querySelectorAll(".tip").length;
  const output = document.createElement("output");
  output.textContent = JSON.stringify(watched);
  document.body.append(output);
});
</script>"""
"""Put into a copy of the page: notes what a browser has to say of it."""


def test_a_browser_has_nothing_to_complain_of(html: str, tmp_path: Path) -> None:
    """A Chromium on this machine lays the page out and moves a pointer; without one its source alone is judged."""
    balanced = Page(html)
    assert [tag for tag in balanced.open if tag not in ("meta", "link")] == []
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        return
    path = tmp_path / "page.html"
    path.write_text(html.replace("<head>", "<head>" + WATCH, 1), encoding="utf-8")
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    done = subprocess.run(
        [*command, "--dump-dom", "--window-size=1200,3000", path.as_uri()], check=True, capture_output=True, text=True
    )
    (found,) = re.findall(r"<output>(.*?)</output>", done.stdout, flags=re.DOTALL)
    seen = json.loads(unescape(found))
    assert seen["errors"] == []
    assert seen["clipped"] == []
    assert seen["sideways"] <= 0
    name, frequency, compliance = seen["expected"]
    first, along, value = seen["told"].split("\n")
    assert first == name
    assert float(re.findall(r"[\d.e-]+", along)[-1]) == pytest.approx(frequency, rel=1e-3)
    assert float(re.search(r": ([\d.e+-]+) m/N", value)[1]) == pytest.approx(compliance, rel=1e-3)
    assert seen["left"] == 0


def test_every_check_stands_in_the_page_and_the_governing_one_is_named(run: DesignRun, page: Page) -> None:
    rows = {row[0]: row for row in page.rows if len(row) == 5}
    for one in run.sizing.checks:
        name, value, limit, used = check_row(one)
        shown = f"{name} (governing)" if name == run.sizing.governing else name
        assert rows[shown][1:3] == [value, limit]
        assert rows[shown][3].startswith(used)
    assert f"{run.sizing.governing} (governing)" in rows


def test_every_guarantee_stands_in_the_page(run: DesignRun, page: Page) -> None:
    guarantee = designed(run).guarantee
    assert guarantee is not None
    shown = [Decimal(found) for found in re.findall(r"up to ([\d.]+) Hz", page.text)]
    assert shown
    for bandwidth in shown:
        assert 0.999 * guarantee.bandwidth_Hz < bandwidth <= Decimal(repr(guarantee.bandwidth_Hz))
    proved = [row for row in page.rows if len(row) == 3 and row[1] == "proved"]
    assert len(proved) == 5  # stability, both compliances, peak sensitivity, stability at lower gains
    assert all("0 to 6.8 kg" in row[0] for row in proved)
    assert guarantee.certificate_sha256 in page.text
    assert run.certificate is not None
    assert " ".join(run.certificate.text.split()) in page.text


def test_what_is_not_proved_is_not_called_proved(page: Page) -> None:
    foundations = {row[0]: row[1] for row in page.rows if len(row) == 3}
    assert foundations["no lighter pair of free sizes exists"] == "sampled"
    assert foundations["no other controller of this kind guarantees more"] == "sampled"
    assert foundations["no lighter pair of the stock list passes"] == "verified numerically"
    (how,) = (row[2] for row in page.rows if row[0] == "no other controller of this kind guarantees more")
    assert how == "a local search from a coarse one; that it is the best is not proved"


def test_names_are_escaped(run: DesignRun, html: str, page: Page) -> None:
    assert "<rig>" in run.problem.name
    assert "<rig>" not in html
    assert "".join(page.headings) == run.problem.name


@given(
    st.floats(min_value=-1e6, max_value=1e6, allow_subnormal=False).filter(lambda x: x == 0 or abs(x) > 1e-9),
    st.integers(min_value=1, max_value=9),
)
def test_decimals_are_rounded_to_their_digits_and_guarantees_to_the_safe_side(value: float, digits: int) -> None:
    exact = Decimal(repr(value))
    unit = Decimal(1).scaleb(min(exact.adjusted() - digits + 1, 0)) if value else Decimal(0)
    assert abs(Decimal(decimal(value, digits)) - exact) <= unit / 2 + abs(exact) * Decimal("1e-12")
    low, high = (Decimal(shown(value, "N", digits).split()[0]) for shown in (at_least, at_most))
    assert high - low <= unit
    if abs(value) >= 1e-5:
        assert low <= exact <= high


@pytest.mark.parametrize(
    ("value", "unit", "shown"),
    [
        (5.71e-8, "m/N", "57.1 nm/N"),
        (1.13e-2, "m3/s/A", "11.3 cm³/s/mA"),
        (3.8e-13, "m3/s/Pa", "0.38 cm³/s/MPa"),
        (0.15, "A/V", "150 mA/V"),
        (4.987, "A/V", "4.987 A/V"),
        (486_800.0, "N/m", "486.8 kN/m"),
        (20e6, "Pa", "20 MPa"),
        (0.0023, "m", "2.3 mm"),
        (inf, "A/V", "∞ mA/V"),
        (0.05, "m/s/A", "0.05 m/s/A"),  # of an actuator of one's own
    ],
)
def test_published_figures_in_the_units_they_were_published_in(value: float, unit: str, shown: str) -> None:
    assert quantity(value, unit) == shown


def test_a_missed_check_never_reads_as_full_use() -> None:
    assert per_cent(1.0) == "100.0 %"
    assert per_cent(1.0000001) == "just over 100 %"
    assert per_cent(0.99996) == "just under 100 %"


def test_prices_in_words() -> None:
    words = price_words(
        {"least_wall_kg_per_mm": 2.4, "tip_force_kg_per_percent": 0.0275, "largest_width_kg_per_mm": -0.01}
        | {"clearance_assembly_kg_per_mm": 0.0}
    )
    assert words == [
        "0.1 mm more least wall costs 0.24 kg of beam mass.",
        "1 % more tip force costs 0.0275 kg of beam mass.",
        "0.1 mm more largest width saves 0.001 kg of beam mass.",
        "A little more or less of these changes nothing: clearance at assembly.",
    ]


def test_expected_compliance_agrees_with_the_state_space_matrices(run: DesignRun) -> None:
    prototype = designed(run)
    controller = prototype.controller
    assert controller is not None
    assert controller.kind == "lag"
    bounds = prototype.payload.outer_end_mass_kg
    assert bounds is not None
    for row in acceptance(prototype, InStage(prototype, bounds).looked_at_kg):
        a, b, c = paper_model(prototype).matrices(row.outer_end_mass_kg, prototype.payload.inner_end_mass_kg)
        for frequency, compliance in row.compliance_m_per_N.items():
            s = 2j * pi * frequency
            g = c @ np.linalg.solve(s * np.eye(len(a)) - a, b)
            k = controller.gain_A_per_V * (1 + 1j * frequency / controller.zero_Hz)
            k /= 1 + 1j * frequency / controller.pole_Hz
            closed = g[0, 0] - g[0, 1] * k * g[1, 0] / (1 + k * g[1, 1])
            assert compliance.nominal == pytest.approx(abs(closed), rel=1e-8)


def test_stable_gains_agree_with_the_poles_and_with_the_published_critical_gain(paper: Prototype) -> None:
    from beamdesign.controllers import Proportional

    loaded = paper.but(controller=Proportional(gain_A_per_V=0.01))
    intervals = stable_gains(loop(loaded), 0.0)
    assert intervals[0] == (0.0, pytest.approx(critical_gain(loaded).gain_A_per_V / 0.01))
    assert 0.01 * intervals[0][1] == pytest.approx(0.024, rel=0.03)  # Zalucky and Hardt's prediction, 24 mA/V


@pytest.mark.parametrize("mass", [0.0, 6.8, 18.0])
def test_stable_gain_intervals_are_those_without_poles_on_the_right(remedy: Prototype, mass: float) -> None:
    closed = loop(remedy)
    here = closed.at(mass)
    opened, returned = (
        np.array([float(value) for value in reversed(p.coeffs())]) for p in (here.loop_denominator, here.loop_numerator)
    )
    intervals = stable_gains(closed, mass)
    for factor in np.geomspace(0.02, 30.0, 60):
        poles = np.roots(np.polyadd(opened, factor * returned))
        assert (poles.real.max() < 0) == any(low < factor < high for low, high in intervals)


def test_shaded_gains_are_those_without_poles_on_the_right_and_their_region_closes(run: DesignRun) -> None:
    """Eigenvalues of the closed loop's matrices at random places; the edges of a lobe meet where it begins."""
    prototype = designed(run)
    assert prototype.controller is not None
    gain, masses = prototype.controller.gain_A_per_V, np.linspace(0.0, 15.0, 16).tolist()
    axes = plot_stable_gains(new_figure().subplots(), loop(prototype), gain, masses, (0.0, 6.8))
    shaded = axes.patches[0].get_path()
    least, most = axes.get_ylim()
    random = np.random.default_rng(5)
    for mass, shown in zip(
        random.uniform(0, 15, 150), np.exp(random.uniform(*np.log([least, most]), 150)), strict=True
    ):
        louder = prototype.but(controller=prototype.controller.but(gain_A_per_V=shown / 1e3))
        stable = state_space(louder, mass).poles().real.max() < 0
        assert bool(shaded.contains_point((mass, shown))) == stable, (mass, shown)
    edges = [np.asarray(line.get_xydata()) for line in axes.lines if line.get_linestyle() == "-"]
    begun = [edge[0] for edge in edges if 0 < edge[0, 0] < 15 and np.isfinite(edge[0, 1])]
    assert len(begun) == 3  # of the lobe both edges, and the one above it goes on
    begun.sort(key=lambda at: at[1])
    assert begun[0] == pytest.approx(begun[1], rel=1e-3)


def test_margins_of_the_table_are_those_of_python_control(run: DesignRun, page: Page) -> None:
    for mass in (0.0, 3.4, 6.8):
        opened = state_space(designed(run), mass, loop="open")["sensor_V", "command_V"]
        up, degrees, at_up, at_phase = control.margin(opened)
        (row,) = [row for row in page.rows if row[0] == quantity(mass, "kg") and "dB" in row[4]]
        found = [float(re.split(r"[°\s]", cell)[0]) for cell in row[2:6]]
        assert found == pytest.approx([degrees, at_phase / (2 * pi), up, at_up / (2 * pi)], rel=1e-3)


def test_pictures_of_a_result_and_of_its_rig_are_those_of_the_report(
    run: DesignRun, html: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("beamdesign.report.figures.STEP", inf)  # nobody looks at the shape of a root locus here
    drawn = run.pictures()
    assert list(drawn) == list(beamdesign.pictures(designed(run)))
    assert {"loop", "nyquist", "compliance", "locus", "gains"} <= set(drawn)
    assert all(f'id="figure-{name}"' in html for name in drawn)
    with pytest.raises(ValueError, match="no rig"):
        run.sizing.pictures()
    stages = beamdesign.pictures(read_prototype(STUDY.parent / "scheduled" / "prototype.toml"))
    assert {"loop.stage_1", "loop.stage_2", "loop.stage_3"} <= set(stages)


def test_the_chart_of_the_remedy_shows_both_crossings(remedy: Prototype) -> None:
    found = wider_map(loop(remedy), 0.0, 6.8)
    assert [crossing.value for crossing in found.crossings] == pytest.approx([1.968442, 17.79211], rel=1e-6)
    assert [part.stable for part in found.ranges] == [False, True, False]


def test_drawings_are_to_scale(run: DesignRun) -> None:
    prototype = designed(run)
    outer, inner = prototype.outer_beam, prototype.inner_beam
    assert None not in (outer.width_m, inner.width_m, outer.wall_m, outer.length_m)
    axes = draw_section(prototype, new_figure().subplots())
    rings = [patch.get_extents().width for patch in axes.patches]
    assert rings[1] / rings[0] == pytest.approx(inner.width_m / outer.width_m, rel=1e-6)
    assert axes.get_aspect() == 1.0

    force = run.problem.load.tip_force_N
    axes = draw_side(prototype, force, new_figure().subplots(), servo_on=True)
    assert axes.get_aspect() == 1.0
    strips = [walls.get_paths()[0].vertices for walls in axes.collections]
    outer_top, inner_top = strips[1], strips[3]
    assert np.ptp(outer_top[:, 1]) == pytest.approx(1e3 * outer.wall_m)
    assert np.ptp(outer_top[:, 0]) == pytest.approx(1e3 * outer.length_m)
    at_tip = inner_top[inner_top[:, 0] == 0.0][:, 1].max()
    sag = 1e3 * force / lumped_beam(inner).stiffness
    assert at_tip == pytest.approx(1e3 * inner.width_m / 2 - sag)


@pytest.mark.parametrize("factor", [0.25, 1.0, 5.0, 30.0])
def test_words_of_a_stubby_and_of_a_slender_link_neither_touch_nor_leave_the_picture(factor: float) -> None:
    tame = read_prototype(Path(__file__).parent.parent / "studies" / "prototypes" / "tame_lag.toml")
    lengths = ("length_m", "free_length_m")
    own = dict.fromkeys(("stiffness_N_per_m", "effective_mass_kg"))
    beams = {
        name: (beam := getattr(tame, name)).but(**{key: factor * getattr(beam, key) for key in lengths}, **own)
        for name in ("outer_beam", "inner_beam")
    }
    figure = prototype_picture(tame.but(**beams), 12345.0).figure
    assert cut_off(figure) == []
    page = figure.bbox
    for axes in figure.axes[1:]:
        words = [text for text in (*axes.texts, axes.title) if text.get_text()]
        assert any(text.get_text() == "12345 N" for text in words)
        boxes = [text.get_window_extent() for text in words]
        assert all(page.x0 <= box.x0 and box.x1 <= page.x1 for box in boxes)
        assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


def test_a_beam_without_geometry_cannot_be_drawn(paper: Prototype) -> None:
    with pytest.raises(ValueError, match="width and the wall"):
        draw_section(paper, new_figure().subplots())


def test_two_pictures_on_one_page_share_no_identifier() -> None:
    def names(name: str) -> set[str]:
        figure = new_figure(60, 40)
        figure.subplots().plot([0, 1], [0, 1], "o-")
        root = ElementTree.fromstring(inline_svg(figure, name, "a <line> & dots"))
        assert root.get("aria-label") == "a <line> & dots"
        return {str(part.get("id")) for part in root.iter() if part.get("id")}

    assert names("one")
    assert not names("one") & names("two")


def test_the_picture_of_the_readme_is_drawn_from_prototypes(remedy: Prototype, run: DesignRun, tmp_path: Path) -> None:
    import runpy

    script = Path(__file__).parent.parent / "studies" / "remedy_picture.py"
    picture = runpy.run_path(str(script))["draw"](remedy, designed(run), tmp_path / "picture.svg")
    words = {text.strip() for text in ElementTree.parse(picture).getroot().itertext() if text.strip()}
    assert {"gain 150 mA/V", "stable", "outer end mass, kg"} <= words


def test_the_labels_of_an_axis_do_not_touch() -> None:
    """A tip that sinks far makes the view of its end tall; two panels of a locus share one width."""
    tame = read_prototype(Path(__file__).parent.parent / "studies" / "prototypes" / "tame_lag.toml")
    soft = tame.but(controller=tame.controller.but(gain_A_per_V=0.02))
    end = new_figure(220.0, 150.0)
    draw_end(end.subplots(2, 2)[0, 1], soft, beamdesign.arm(soft, (2.0, 6.8)))
    fast = screw()
    fast = fast.but(actuator=fast.actuator.but(rotor_inertia_kg_m2=1e-4))
    (locus,) = [one for one in loop_pictures(fast, loop(fast)) if one.name == "locus"]
    for figure in (end, locus.figure):
        figure.canvas.draw()
        for axes in figure.axes:
            low, high = axes.get_xlim()
            ticks = zip(axes.get_xticks(), axes.get_xticklabels(), strict=True)
            boxes = [label.get_window_extent() for at, label in ticks if low <= at <= high and label.get_text()]
            assert all(right.x0 - left.x1 > 3 for left, right in pairwise(boxes))
