"""Names that a user has chosen: refused where they are no plain line, and plain text in every language written."""

import csv
import io
import re
import subprocess
import tomllib
import unicodedata
from collections.abc import Mapping
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
from finished_run import finished_run
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from pydantic import Field, ValidationError
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, certify, cli, read_prototype, write_prototype
from beamdesign.build.drawing import drawing, dxf_text, svg_text
from beamdesign.build.folder import document_of
from beamdesign.build.realisation.c_code import LAW, PROGRAM, SELF_TEST, c_files, compiled, compiler
from beamdesign.build.realisation.realise import Realisation, realise
from beamdesign.build.specification import specification_of
from beamdesign.cli.output import display, echo, echo_table
from beamdesign.columns import csv_text, read_columns
from beamdesign.controllers import Lag
from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.data.dataset_index import TimeEntry, read_index
from beamdesign.diagnosis.experiment_menu import menu
from beamdesign.proofs.writer import certificate
from beamdesign.records import Longest, Record, parse
from beamdesign.report.canvas import inline_svg
from beamdesign.report.charts import write_record_page
from beamdesign.report.page import Document, Items, Paragraph, Part, Picture, Table, to_html, to_markdown
from beamdesign.scenario import FromCsv, ScenarioRecord
from beamdesign.spelling import LONGEST, in_csv, in_plot, one_line
from beamdesign.sweep.conclusion import draw
from beamdesign.sweep.sweep_file import Picture as Drawn
from beamdesign.sweep.sweep_file import Sweep
from beamdesign.validation.blindcheck_result import Scored
from beamdesign.validation.scoring import Outcome

PROTOTYPES = Path(__file__).parent.parent / "studies" / "prototypes"
PLAIN = "rig"
MARKS = [
    "*/", "/*", "//", "*", "/", "\\", "\n", "??/", "?", "%%c", "%", "^J", "\\U+0041", "\\P", "{}", "$x$", "$\\frac$",
    "_", "`", "|", "](x)", "![a](b)", "<b>", "</p>", "<!--", "&lt;", "#", "- ", "1. ", ">", "---", "===", "~~~",
    "http://a.b", "www.a.b", "<http://a.b>", "\x1b[31m", "\x9b31m", "\x07", "\r", "\t", "\0", "\u202e", "\u2066",
    "\u2028", "\u2029", '"', "'", '"""', "]]>", "=1+1", "+", "-", "@", "[/b]", "[red]", "ä", "中", "\U0001d54f",
    "\ufffe", "\x7f", "\x85", " ", "a", "1",
]  # fmt: skip
pieces = st.sampled_from(MARKS) | st.characters(exclude_categories=["Cs"])
names = st.lists(pieces, min_size=1, max_size=10).map("".join)
broken = st.lists(pieces | st.characters(categories=["Cs"]), min_size=1, max_size=10).map("".join)
every_mark = "".join(MARKS)

# matplotlib has no glyph for most of Unicode and not always room enough, and says so.
pytestmark = pytest.mark.filterwarnings(
    "ignore:Glyph", "ignore:Matplotlib currently does not support", "ignore:constrained_layout not applied"
)


def unfit(character: str) -> bool:
    return unicodedata.category(character) in ("Cc", "Zl", "Zp", "Cs") or ord(character) in {
        *range(0x202A, 0x202F), *range(0x2066, 0x206A), 0xFFFE, 0xFFFF
    }  # fmt: skip


@pytest.fixture(scope="module")
def rig() -> Prototype:
    return read_prototype(PROTOTYPES / "published_lag.toml")


def called(rig: Prototype, name: str) -> Prototype:
    """The rig under a name that no reader would let through."""
    return rig.model_copy(update={"name": name})


# Reading


class Free(Record):
    text: str = ""
    texts: tuple[str, ...] = ()
    table: dict[str, Any] = Field(default_factory=dict)
    inner: tuple["Free", ...] = ()


@example("\u200f")
@example("a" * LONGEST)
@example("a" * (LONGEST + 1))
@given(st.text(st.characters(), max_size=8) | broken)
def test_every_text_of_a_record_is_one_plain_line(text: str) -> None:
    wrong = [c for c in text if unfit(c)]
    tables = {
        "text": {"text": text},
        "texts": {"texts": ["a", text]},
        "table.b": {"table": {"b": [{"c": text}]}},
        "inner.table": {"inner": [{"table": {text: 1}}]},
    }
    for key, table in tables.items():
        if not wrong and len(text) <= LONGEST:
            assert parse(Free, table, "f.toml")
            continue
        with pytest.raises(InputError) as caught:
            parse(Free, table, "f.toml")
        (problem,) = caught.value.problems
        assert problem.key.startswith(key)
        assert (f"U+{ord(wrong[0]):04X}" if wrong else f"{LONGEST}") in problem.reason
        with pytest.raises(ValidationError):
            Free(**{k: tuple(v) if isinstance(v, list) else v for k, v in table.items()})


def test_names_of_files_may_be_longer_but_are_plain_as_well() -> None:
    (most,) = (mark.characters for mark in TimeEntry.model_fields["file"].metadata if isinstance(mark, Longest))
    assert most > LONGEST
    assert FromCsv(file="a" * most)
    for wrong in ("a" * (most + 1), "a\nb"):
        with pytest.raises(ValidationError):
            FromCsv(file=wrong)


def test_the_longest_name_leaves_room_for_what_is_put_to_it(rig: Prototype) -> None:
    law = Lag(gain_A_per_V=0.1, pole_Hz=1.0, zero_Hz=20.0)
    times = np.arange(1000) * 1e-3
    pushed = TimeRecord("one", times, np.column_stack([np.sin(20 * times), 0 * times]), {}, 0.0, 0.0, law)
    one = next(menu(Dataset("set", Path(), rig.but(name="a" * LONGEST), (pushed,))))
    assert one.scenario.name.endswith("a: next experiment")


def test_columns_have_plain_names(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t_s,x\x1b[31m\n0,1\n1,2\n2,3\n")
    with pytest.raises(InputError, match=r"U\+001B"):
        read_columns(tmp_path / "a.csv")


# C


def without_comments(text: str) -> str:
    """C after its translation phases 1 to 3: trigraphs, joined lines, comments as one space each."""
    trigraphs = {"=": "#", "(": "[", "/": "\\", ")": "]", "'": "^", "<": "{", "!": "|", ">": "}", "-": "~"}
    text = re.sub(r"\?\?([=(/)'<!>-])", lambda found: trigraphs[found[1]], text).replace("\\\n", "")
    return re.sub(r'("(?:\\.|[^"\\\n])*")|/\*.*?\*/|//[^\n]*', lambda found: found[1] or " ", text, flags=re.DOTALL)


@pytest.fixture(scope="module")
def realised() -> Realisation:
    return realise(Lag(gain_A_per_V=0.1, pole_Hz=1.0, zero_Hz=20.0), 10_000.0, None, full_scale_V=10.0)


@example(every_mark)
@settings(max_examples=40)  # the first compiles the templates
@given(name=broken)
def test_no_name_leaves_its_comment_in_c(realised: Realisation, name: str) -> None:
    made, plain = (c_files(realised, one, (one,)) for one in (name, PLAIN))
    for file, text in made.items():
        assert text.isascii()
        assert without_comments(text) == without_comments(plain[file])


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_a_strict_compiler_finds_nothing_in_names(realised: Realisation, tmp_path: Path) -> None:
    for file, text in c_files(realised, every_mark, (every_mark, *MARKS)).items():
        (tmp_path / file).write_text(text)
    flags = ["-std=c99", "-trigraphs", "-Wall", "-Wcomment", "-Werror", "-fsyntax-only"]
    for file in (LAW, SELF_TEST):
        assert subprocess.run([str(compiler()), *flags, file], cwd=tmp_path, check=False).returncode == 0


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("line_goes_on", ["\\\n", "??/\n"])
def test_no_name_runs_code(rig: Prototype, realised: Realisation, line_goes_on: str, tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    code = f'__attribute__((constructor)) static void f(void) {{ if (system("touch {ran}")) {{}} }}'
    once = f"#ifndef RAN\n#define RAN\nint system(const char *);\n{code}\n#endif"
    name = f"*{line_goes_on}/\n{once}\n/{line_goes_on}*"
    write_prototype(called(rig, name), tmp_path / "rig.toml")
    given = ["code", str(tmp_path / "rig.toml"), "--rate-Hz", "10000", "--float", "--compile"]
    done = CliRunner().invoke(cli.app, [*given, "--outer-end-mass", "0:0", "--out", str(tmp_path / "out")])
    assert isinstance(done.exception, InputError)
    assert not (tmp_path / "out").exists()
    for file, text in c_files(realised, name).items():
        (tmp_path / file).write_text(text)
    assert subprocess.run([compiled(tmp_path, tmp_path / "self_test", PROGRAM)], check=False).returncode == 0
    assert not ran.exists()


# Markdown


def blocks(text: str) -> tuple[list[Any], str]:
    """Blocks, and what is in their lines but plain text; and that text."""
    kinds: list[Any] = []
    words = ""
    for token in MarkdownIt("commonmark").enable(["table", "strikethrough"]).parse(text):
        inside = [child.type for child in token.children or () if child.type not in ("text", "code_inline")]
        kinds.append((token.type, token.tag, inside))
        words += "".join(child.content for child in token.children or ())
    return kinds, words


def page(name: str, blocked: str) -> Document:
    parts = (Paragraph(blocked), Items((blocked, blocked)), Table(("a", blocked), ((blocked, "1"),), blocked))
    picture = Picture("<svg/>", "a.svg", blocked)
    return Document(name, "Specification", blocked, ((blocked, blocked),), (Part(name, (*parts, picture)),))


@example(every_mark)
@example("`a|b`")
@example("-")
@settings(max_examples=60)
@given(broken)
def test_no_name_is_a_mark_of_markdown(name: str) -> None:
    assume(one_line(" ".join(name.split())).strip())
    kinds, words = blocks(to_markdown(page(name, name)))
    assert kinds == blocks(to_markdown(page(PLAIN, PLAIN)))[0]
    if "`" not in name:  # which begins code in what is written here, but not in a title
        assert words.count(one_line(re.sub(r"\s+", " ", name)).strip()) >= 10


@given(broken)
def test_titles_are_the_names(name: str) -> None:
    _, words = blocks(to_markdown(Document(name, "Specification", "", (), ())))
    assert words == ("Specification: " + one_line(re.sub(r"\s+", " ", name))).strip()


def test_the_specification_of_a_design_under_any_name() -> None:
    spec = specification_of(finished_run())
    made, plain = (
        blocks(to_markdown(document_of(replace(spec, prototype=called(spec.prototype, name)))))
        for name in (every_mark, PLAIN)
    )
    assert made[0] == plain[0]


@settings(max_examples=15)
@given(broken.filter(str.split))
def test_a_blind_check_of_any_effect(name: str) -> None:
    def told(name: str) -> str:
        one = Outcome("0", "single", (name,), "sensor", 10.0, 10.0, "effect", chosen=(name,), named=name)
        return Scored((one,), {"planned": 1, "records": "One.", "command": name}).markdown()

    assert blocks(told(name))[0] == blocks(told(PLAIN))[0]


# DXF and SVG


@example(every_mark)
@settings(max_examples=4)
@given(name=broken)
def test_a_drawing_bears_the_name(rig_with_tubes: Prototype, name: str) -> None:
    document = drawing(called(rig_with_tubes, name))
    again = ezdxf.read(io.StringIO(dxf_text(document)))
    assert not again.audit().errors
    texts = [text.plain_text() for text in again.modelspace().query("TEXT")]
    assert texts[1:] == [text.plain_text() for text in document.modelspace().query("TEXT")][1:]
    assert len(texts) == 6
    assert re.sub(r"<U\+([0-9A-F]{4,})>", lambda found: chr(int(found[1], 16)), texts[0]) == name
    assert ElementTree.fromstring(svg_text(document, name)).get("aria-label") == one_line(name)


@pytest.fixture(scope="module")
def rig_with_tubes() -> Prototype:
    prototype = finished_run().prototype
    assert prototype is not None
    return prototype


def cases(name: str) -> tuple[Sweep, list[Mapping[str, Any]]]:
    sweep = Sweep.model_construct(
        name=name,
        picture=tuple(
            Drawn.model_construct(kind=kind, x="x", y="y", series="s", title=name, x_label=name, y_label=name)
            for kind in ("lines", "bars")
        ),
    )
    fixed = {"document": {}, "options": {}, "status": "done"}
    rows = [fixed | {"outputs": {"y": 1.0 + k}, "varied": {"x": 1.0 * k, "s": name}} for k in (1, 2)]
    return sweep, rows


@example(every_mark)
@example("$\\frac$")
@example("_a")
@settings(max_examples=4)
@given(name=broken)
def test_pictures_bear_names_as_they_are(tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    folder = tmp_path_factory.mktemp("drawn")
    sweep, rows = cases(name)
    lines, bars = (path for path in draw(sweep, rows, {}, folder) if path.suffix == ".svg")
    wanted = one_line(name).strip()
    for path, count in ((lines, 3), (bars, 2)):
        texts = [(one.text or "").strip() for one in ElementTree.parse(path).iter("{http://www.w3.org/2000/svg}text")]
        assert texts.count(wanted) >= count or not wanted
    legend = "".join(ElementTree.parse(lines).getroot().itertext())
    assert f"s: {one_line(name)}" in legend


def test_a_legend_shows_what_begins_with_a_mark_of_matplotlib() -> None:
    assert not in_plot("_a").startswith("_")


# HTML


class Tags(HTMLParser):
    """Tags with the names of their attributes, and the text between them."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[Any] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[Any]) -> None:
        self.tags.append((tag, [key for key, _ in attrs]))

    def handle_endtag(self, tag: str) -> None:
        self.tags.append(tag)

    def handle_comment(self, data: str) -> None:
        self.tags.append(data)

    def handle_data(self, data: str) -> None:
        self.text += data


@example(every_mark)
@settings(max_examples=15)
@given(names)
def test_no_name_is_a_tag(tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    code = name.replace("`", "") or "x"
    page_of, plain = (Tags(to_html(page(one, other))) for one, other in ((name, code), (PLAIN, PLAIN)))
    assert page_of.tags == plain.tags
    assert name in page_of.text
    folder = tmp_path_factory.mktemp("page")
    found = []
    for one in (name, PLAIN):
        path, _ = write_record_page(one, one, {one: {one: 1.0}}, [], {}, folder)
        found.append(Tags(path.read_bytes().decode()))
    assert found[0].tags == found[1].tags


def test_pictures_of_pages_are_described_by_any_name() -> None:
    from beamdesign.report.canvas import new_figure

    figure = new_figure(40, 30)
    figure.suptitle(in_plot(every_mark))
    read = ElementTree.fromstring(inline_svg(figure, "a", every_mark).replace("xlink:href", "href"))
    assert read.get("aria-label") == one_line(every_mark)


# TOML


@example(every_mark)
@given(names)
def test_no_name_leaves_its_comment_or_its_quotes_in_toml(name: str) -> None:
    found = tomllib.loads(certificate("kind", name, {"a": 1}, f"{name}\nproved"))
    found.pop("sha256")
    assert found == {"kind": "kind", "version": 2, "name": name, "a": 1}


def test_a_certificate_of_any_name_says_the_same(rig: Prototype) -> None:
    made, plain = (tomllib.loads(certify(called(rig, name), 0.0, 0.0).text) for name in (every_mark, PLAIN))
    assert made.pop("name") == every_mark
    assert made.pop("sha256") != plain.pop("sha256")
    plain.pop("name")
    assert made == plain


# Terminal


@example(every_mark)
@settings(max_examples=30)
@given(name=broken)
def test_nothing_in_a_name_steers_a_terminal(name: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        told = io.StringIO()
        patch.setattr("sys.stdout", told)
        patch.setattr("sys.stderr", told)
        echo(name)
        echo_table(name, (name, "b"), [(name, 1.0)])
        for error in (InputError(name, [(name, name)]), OSError(1, name, name), ValueError(name)):
            patch.setattr(cli, "app", lambda error=error: (_ for _ in ()).throw(error))
            with pytest.raises(SystemExit):
                cli.main()
    assert not [c for c in told.getvalue() if unfit(c) and c != "\n"]


def test_a_progress_bar_takes_no_name_for_a_style(capsys: pytest.CaptureFixture[str]) -> None:
    with display("a[/b][red]") as update:
        update(0.5, "[/c]")


# CSV


@example("=1+1")
@example("-1.5; 2e-3")
@given(names)
def test_no_cell_is_a_formula(name: str) -> None:
    cell = in_csv(name)
    figures = re.fullmatch(r"[-+0-9.einfatyINFATY;\s_]*", name)
    assert cell[0] not in "=+-@" or figures
    assert cell.removeprefix("'") == name.removeprefix("'")
    assert in_csv("-1.5; 2e-3") == "-1.5; 2e-3"


def test_tables_are_written_so() -> None:
    assert list(csv.reader(io.StringIO(csv_text([{"name": "=1+1", "x": -1.5}]))))[1] == ["'=1+1", "-1.5"]


# Files


@pytest.mark.parametrize("name", ["../x", "..", "a/b", "/x", "a\\b", ".x", "x\n", ""])
def test_records_of_a_scenario_are_no_paths(name: str) -> None:
    with pytest.raises(ValidationError):
        ScenarioRecord(name=name)


def test_what_is_read_from_beside_is_written_into_the_folder(rig: Prototype, tmp_path: Path) -> None:
    data, out = tmp_path / "data", tmp_path / "out" / "here"
    data.mkdir()
    write_prototype(rig, data / "prototype.toml")
    rows = "".join(f"{0.001 * k:.3f},{float(k > 20)},0\n" for k in range(60))
    for place in (tmp_path / "x.csv", tmp_path / "out" / "y.csv"):
        place.parent.mkdir(exist_ok=True)
        place.write_text("t_s,disturbance_N,command_V\n" + rows)
    files = ["../x.csv", str(tmp_path / "out" / "y.csv")]
    (data / "dataset.toml").write_text("".join(f"[[record]]\nfile = '{file}'\n" for file in files))
    assert [row.file for row in read_index(data / "dataset.toml")[0].record] == files
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    done = CliRunner().invoke(cli.app, ["gap", "predict", str(data / "prototype.toml"), str(data), "--out", str(out)])
    assert done.exit_code == 0, done.output
    after = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file() and out not in path.parents}
    assert after == before
    assert list(out.iterdir())
