"""Records and their TOML files: what goes out comes back; what is wrong is said at once, by file, key and reason."""

import os
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from math import inf, nan
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, ValidationError

from beamdesign import DesignProblem, InputError, Prototype, records
from beamdesign.records import NonNegative, Positive, Problem, Record, numbers, parse, read, read_table, to_toml
from beamdesign.scenario import Scenario
from beamdesign.spelling import fault


class Spring(Record):
    kind: Literal["spring"] = "spring"
    stiffness_N_per_m: Positive


class Damper(Record):
    kind: Literal["damper"] = "damper"
    damping_N_s_per_m: NonNegative
    seal: Literal["soft", "hard"] = "soft"


class Mount(Record):
    """A record with everything the real ones have."""

    name: Annotated[str, Field(min_length=1)]
    width_m: Positive | None = None
    wall_m: Annotated[Positive | None, Field(lt=1)] = None
    range_kg: tuple[NonNegative, NonNegative] | None = None
    part: Annotated[Spring | Damper, Field(discriminator="kind")] | None = None
    parts: tuple[Spring, ...] = ()
    pair: tuple[Spring, ...] | None = Field(None, min_length=2)

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        if (pair := numbers(table, "wall_m", "width_m")) and pair[0] >= pair[1] / 2:
            yield Problem("wall_m", "too thick")


def problems(table: dict[str, Any]) -> list[Problem]:
    with pytest.raises(InputError) as caught:
        parse(Mount, table, "mount.toml")
    assert caught.value.source == "mount.toml"
    return caught.value.problems


# Texts as records have them: one line each.
texts = st.text(st.characters(exclude_categories=["Cc", "Cs", "Zl", "Zp"]), min_size=1).filter(lambda t: not fault(t))
positive = st.floats(min_value=0, exclude_min=True, allow_infinity=False)
parts = st.builds(Spring, stiffness_N_per_m=positive) | st.builds(
    Damper, damping_N_s_per_m=positive, seal=st.sampled_from(["soft", "hard"])
)


@given(
    st.builds(
        Mount,
        name=texts,
        width_m=st.none() | positive,
        range_kg=st.none() | st.tuples(positive, positive),
        part=st.none() | parts,
        parts=st.lists(st.builds(Spring, stiffness_N_per_m=positive), max_size=3).map(tuple),
    )
)
def test_toml_and_back_loses_nothing(tmp_path_factory, record):
    path = tmp_path_factory.mktemp("records") / "mount.toml"
    path.write_bytes(to_toml(record).encode())
    again = read(Mount, path)
    assert again == record
    assert hash(again) == hash(record)


def test_absent_figures_are_left_out():
    assert "width_m" not in to_toml(Mount(name="a"))


def test_records_are_frozen():
    with pytest.raises(ValidationError, match="frozen"):
        Mount(name="a").name = "b"


def test_a_copy_with_changes_is_checked():
    mount = Mount(name="a", width_m=0.1, wall_m=0.01)
    assert mount.but(wall_m=0.02) == Mount(name="a", width_m=0.1, wall_m=0.02)
    assert mount.wall_m == 0.01
    with pytest.raises(ValidationError, match="too thick"):
        mount.but(wall_m=0.06)
    with pytest.raises(ValidationError, match="wal_m"):
        mount.but(wal_m=0.02)


@pytest.mark.parametrize(
    ("changes", "key", "reason"),
    [
        ({"width_m": -1}, "width_m", "must be greater than 0, is -1"),
        ({"width_m": 0}, "width_m", "must be greater than 0, is 0"),
        ({"width_m": nan}, "width_m", "must be a finite number, is nan"),
        ({"width_m": inf}, "width_m", "must be a finite number, is inf"),
        ({"width_m": True}, "width_m", "must be a number, is True"),
        ({"width_m": "0.1"}, "width_m", "must be a number, is '0.1'"),
        ({"width_m": 10**400}, "width_m", "must be a number, is 1" + 56 * "0" + "..."),
        ({"wall_m": 1.0}, "wall_m", "must be less than 1, is 1.0"),
        ({"range_kg": [0.0, -2.5]}, "range_kg", "entry 2: must be at least 0, is -2.5"),
        ({"range_kg": [True, 1.0]}, "range_kg", "entry 1: must be a number, is True"),
        ({"range_kg": [1.0]}, "range_kg", "entry 2: missing"),
        ({"range_kg": [1.0, 2.0, 3.0]}, "range_kg", "must hold 2 entries, holds 3"),
        ({"range_kg": 3.0}, "range_kg", "must be a list in square brackets, is 3.0"),
        ({"name": ""}, "name", "must not be empty"),
        ({"name": 3}, "name", "must be text in quotes, is 3"),
        ({"part": 3}, "part", "must be a table, is 3"),
        ({"part": [1, 2]}, "part", "must be a table, is [1, 2]"),
        ({"part": {"stiffness_N_per_m": 1.0}}, "part", "missing kind"),
        ({"part": {"kind": "mass"}}, "part", "kind must be one of 'spring', 'damper', is 'mass'"),
        ({"part": {"kind": "spring"}}, "part.stiffness_N_per_m", "missing"),
        (
            {"part": {"kind": "damper", "damping_N_s_per_m": 1.0, "seal": "wet"}},
            "part.seal",
            "must be 'soft' or 'hard', is 'wet'",
        ),
        ({"parts": [{"stiffness_N_per_m": 0.0}]}, "parts.stiffness_N_per_m", "entry 1: must be greater than 0, is 0.0"),
        ({"pair": [{"stiffness_N_per_m": 1.0}]}, "pair", "must hold at least 2 entries, holds 1"),
        # Of enough entries one is wrong: that is all that is.
        ({"pair": [{"stiffness_N_per_m": 1.0}, {}]}, "pair.stiffness_N_per_m", "entry 2: missing"),
    ],
)
def test_one_wrong_value(changes, key, reason):
    assert problems({"name": "a"} | changes) == [(key, reason)]


class Kept(Record):
    file: Annotated[str, Field(pattern="^[a-z]+$")] = "a"
    count: int = 1
    fixed: bool = True


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ({"file": "a/b"}, "must be of letters that a file may be named with, is 'a/b'"),
        ({"count": 2.5}, "must be a whole number, is 2.5"),
        ({"count": "2"}, "must be a whole number, is '2'"),
        ({"fixed": "yes"}, "must be true or false, is 'yes'"),
    ],
)
def test_whole_numbers_and_truth_and_names_of_files_in_plain_words(table, reason):
    with pytest.raises(InputError) as caught:
        parse(Kept, table, "kept.toml")
    assert caught.value.problems == [(*table, reason)]


@pytest.mark.parametrize(
    ("table", "key", "reason"),
    [
        ({"widht_m": 1.0}, "widht_m", "unknown key; did you mean width_m?"),
        ({"width_mm": 1.0}, "width_mm", "wrong unit mm: give width_m, in m"),
        ({"range_g": [0.0, 1.0]}, "range_g", "wrong unit g: give range_kg, in kg"),
        ({"payload": 1}, "payload", "unknown key; known here are name, width_m, wall_m, range_kg, part, parts, pair"),
        (
            {"part": {"kind": "spring", "stiffness_N_per_m": 1.0, "stiffness_N_per_cm": 1.0}},
            "part.stiffness_N_per_cm",
            "wrong unit N_per_cm: give stiffness_N_per_m, in N/m",
        ),
        # The keys of the spring are known there, not those of the damper.
        (
            {"part": {"kind": "spring", "stiffness_N_per_m": 1.0, "seal": "soft"}},
            "part.seal",
            "unknown key; known here are kind, stiffness_N_per_m",
        ),
        (
            {"parts": [{"stiffness_N_per_m": 1.0, "stifness": 1.0}]},
            "parts.stifness",
            "entry 1: unknown key; did you mean stiffness_N_per_m?",
        ),
    ],
)
def test_unknown_keys_with_what_was_meant(table, key, reason):
    assert problems({"name": "a"} | table) == [(key, reason)]


def test_all_problems_come_at_once():
    found = problems(
        {"width_m": 0.1, "wall_m": 0.06, "range_kg": [nan, 1.0], "part": {"kind": "spring"}, "colour": "red"}
    )
    assert {problem.key for problem in found} == {"name", "wall_m", "range_kg", "part.stiffness_N_per_m", "colour"}
    assert ("wall_m", "too thick") in found


def test_a_line_per_problem():
    error = InputError("rig.toml", [("name", "missing"), ("width_m", "must be greater than 0, is -1")])
    assert str(error) == "rig.toml: name: missing\nrig.toml: width_m: must be greater than 0, is -1"


def test_long_values_are_cut_in_the_message():
    found = problems({"name": "a", "width_m": "x" * 1000})
    assert {key for key, _ in found} == {"width_m"}
    assert all(len(reason) < 90 for _, reason in found)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"a = ", "not valid TOML: Invalid value"),
        (b"a = 1\na = 2", "not valid TOML: Cannot overwrite a value"),
        (b'name = "\xff"', "not valid TOML: 'utf-8' codec can't decode byte 0xff"),
        (b"\x00", "not valid TOML"),
    ],
)
def test_what_is_not_toml_is_named(tmp_path, content, reason):
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_table(path)
    ((key, words),) = caught.value.problems
    assert (caught.value.source, key) == (str(path), "(file)")
    assert words.startswith(reason)


def test_no_file_and_a_folder(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.toml: \(file\): No such file or directory"):
        read_table(tmp_path / "nothing.toml")
    with pytest.raises(InputError, match=r"\(file\): "):
        read_table(tmp_path)
    assert os.listdir(tmp_path) == []


def test_an_empty_file_names_every_table_that_is_needed(tmp_path: Path):
    path = tmp_path / "empty.toml"
    path.touch()
    with pytest.raises(InputError, match="name: missing"):
        read(Mount, path)


@pytest.mark.parametrize("value", [None, True, "1", nan, inf, 10**400, [1.0]])
def test_numbers_passes_over_what_is_no_figure(value):
    assert numbers({"a": value, "b": 1.0}, "a", "b") is None


def test_numbers_looks_into_tables_and_records():
    assert numbers({"a": {"b": 2}, "c": 3.5}, "a.b", "c") == (2.0, 3.5)
    assert numbers({"part": Spring(stiffness_N_per_m=4.0)}, "part.stiffness_N_per_m") == (4.0,)
    assert numbers({"a": 1.0}, "a.b") is None


DEEP = "a = " + "[" * 5000 + "]" * 5000
LONG_NAME = ".".join(["a"] * 5000) + " = 1"
DIGITS = "a = " + "9" * 5000
BEYOND = "[b]\na = " + "9" * 30
LONG_LIST = "a = [" + "0, " * 200_000 + "]"


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        (DEEP, "(file)", "nested"),
        (LONG_NAME, "a.a", "nested"),
        ("x = {" + " . ".join(["'a b'"] * 5000) + " = 1}", "'a b'", "nested"),
        ("a = 0x" + "f" * 5000, "a", "thousands of digits"),
        (DIGITS, "(file)", "digits"),
        (BEYOND, "b.a", "30 digits"),
        (LONG_LIST, "a", "200000 entries"),
        ("a = 1\n" * 3_000_000, "(file)", "MB"),
    ],
)
def test_a_file_of_a_size_that_none_of_ours_has_is_refused(tmp_path: Path, text: str, key: str, words: str) -> None:
    path = tmp_path / "x.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_table(path)
    (problem,) = caught.value.problems
    assert problem.key.startswith(key)
    assert words in problem.reason


def test_a_key_of_thousands_of_parts_is_not_even_parsed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`tomllib` takes time with the square of their number: 3 s for 4,000, hours for a file of 200 kB."""
    path = tmp_path / "x.toml"
    path.write_text(LONG_NAME)
    monkeypatch.setattr(records.tomllib, "loads", None)
    with pytest.raises(InputError, match="nested more than 20 levels deep"):
        read_table(path)


def test_a_byte_order_mark_is_understood(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_bytes(b"\xef\xbb\xbfa = 1\n")
    assert read_table(path) == {"a": 1}


def test_a_missing_file_gets_a_guess_only_where_one_is_near(tmp_path: Path) -> None:
    (tmp_path / "prototype.toml").write_text("")
    (tmp_path / "studies").mkdir()
    (tmp_path / "lost.toml").symlink_to(tmp_path / "gone.toml")
    told = {}
    for name in ("protoype.toml", "study.toml", "lost.toml", "records.csv"):
        with pytest.raises(InputError) as caught:
            read_table(tmp_path / name)
        told[name] = caught.value.problems[0].reason
    assert str(tmp_path / "prototype.toml") in told["protoype.toml"]
    assert all("did you mean" not in told[name] for name in ("study.toml", "lost.toml", "records.csv"))
    assert "link" in told["lost.toml"]


SHIPPED = {
    Path("studies/scheduled/prototype.toml"): Prototype,
    Path("studies/prototypes/arm.toml"): Prototype,
    Path("studies/ball_screw.toml"): DesignProblem,
    Path("beamdesign/templates/scenario.toml"): Scenario,
}


def replaced(part: Any, other: Any) -> Iterator[Any]:
    """A table once for each value in it, however deep, with something else in its place."""
    places = part.items() if isinstance(part, dict) else enumerate(part) if isinstance(part, list) else ()
    for place, value in places:
        for changed in (other, *replaced(value, other)):
            yield part | {place: changed} if isinstance(part, dict) else [*part[:place], changed, *part[place + 1 :]]


@pytest.mark.parametrize("path", SHIPPED, ids=str)
def test_whatever_stands_at_a_key_is_taken_or_refused_with_a_reason(path: Path):
    table = tomllib.loads((Path(__file__).parents[1] / path).read_text(encoding="utf-8"))
    parse(SHIPPED[path], table, path)
    for other in ({"a": 1}, [1], 3, "x"):
        for changed in replaced(table, other):
            with suppress(InputError):
                parse(SHIPPED[path], changed, path)
