"""Kept results: what is edited, swapped, foreign or unreadable is told and computed again, and never crashes."""

import csv
import json
import os
import random
import re
from pathlib import Path

import pytest
import tomli_w
from typer.testing import CliRunner

from beamdesign import InputError
from beamdesign.cli.study import study
from beamdesign.sweep import store, workers
from beamdesign.sweep.case import address_of, case
from beamdesign.sweep.store import case_of, difference
from beamdesign.sweep.sweep_run import plan, run_sweep, sweep_status

ROOT = Path(__file__).parents[1]
COUNT = 4


@pytest.fixture
def laid(tmp_path):
    """A sweep of quick cases."""
    work = {"task": "stable_masses", "base": str(ROOT / "studies" / "prototypes" / "paper_remedy.toml")}
    vary = [{"key": "payload.inner_end_mass_kg", "values": [float(k) for k in range(COUNT)]}]
    path = tmp_path / "sweep.toml"
    path.write_text(tomli_w.dumps({"name": "sweep", "study": work, "vary": vary}), encoding="utf-8")
    return plan(path)


@pytest.fixture
def folder(laid, tmp_path):
    run_sweep(laid, tmp_path / "out")
    return tmp_path / "out"


def file_of(folder, laid, number=1):
    return folder / "cases" / f"{laid.cases[number].address}.json"


def edited(change, sealed=True):
    """Changes the record of a file, and its own digest with it if sealed."""

    def edit(path, other):
        record = json.loads(path.read_text(encoding="utf-8"))
        change(record)
        if sealed:
            record["record_sha256"] = store._digest(record)
        path.write_text(json.dumps(record), encoding="utf-8")

    return edit


def of_other_code(record):
    record["code_sha256"] = "0" * 64
    record["address"] = address_of(record["inputs_sha256"], record["code_sha256"])


def nested(depth):
    return [nested(depth - 1)] if depth else []


def text(words):
    return lambda path, other: path.write_text(words, encoding="utf-8")


def edited_text(pattern, other):
    return lambda path, _: path.write_text(re.sub(pattern, other, path.read_text(encoding="utf-8"), count=1))


TAMPERED = {
    "outputs": (edited(lambda record: record["outputs"].update(crossings_kg=[1.0]), False), "record_sha256"),
    "status": (edited(lambda record: record.update(status="weird")), "status"),
    "code": (edited(lambda record: record.update(code_sha256="0" * 64)), "address"),
    "inputs": (edited(lambda record: record["document"]["sensor"].update(gain_V_per_m=1.0)), "inputs_sha256"),
    "seconds": (edited(lambda record: record.update(seconds="long")), "seconds"),
    "nested output": (edited(lambda record: record["outputs"].update(crossings_kg={})), "outputs"),
    "swapped": (lambda path, other: path.write_bytes(other.read_bytes()), "address"),
    "other code": (edited(of_other_code), "address"),
    "status alone": (text('{"status": "done"}'), "missing"),
    "a list": (text("[]"), "must be a table"),
    "too large": (edited_text(r": \d+\.\d+", ": 1e400"), "no JSON"),
    "not finite": (edited(lambda record: record["outputs"].update(crossings_kg=float("nan")), False), "no JSON"),
    "deep": (text("[" * 100_000), "no JSON"),
    "deep and of another shape": (text('{"status": ' + "[" * 900 + "]" * 900 + "}"), "no JSON|missing"),
    "deep in a part": (edited(lambda record: record["details"].update(deep=nested(700)), False), "record_sha256|deep"),
    "many digits": (text("1" * 10_000), "no JSON"),
    "binary": (lambda path, other: path.write_bytes(bytes(range(256))), "no JSON"),
    "empty": (text(""), "no JSON"),
}


@pytest.mark.parametrize("name", TAMPERED)
def test_what_does_not_hold_is_told_by_all_and_computed_again(laid, folder, name):
    change, words = TAMPERED[name]
    table = (folder / "table.csv").read_bytes()
    change(file_of(folder, laid), file_of(folder, laid, 2))
    with pytest.raises(InputError, match=words):
        case_of(str(folder / "1"))
    there = store.rows_of(folder)
    assert len(there.records) == COUNT - 1
    assert re.search(words, store.in_words(there.unsound)[0])
    found = sweep_status(laid, folder)
    assert (found.counts, found.remaining, found.stale, found.foreign) == ({"done": COUNT - 1}, 1, 0, 0)
    assert re.search(words, found.unsound[0])
    assert re.search(words, difference(folder, folder).unsound[0])
    again = run_sweep(laid, folder)
    assert (again.computed, len(again.unsound)) == (1, 1)
    assert (folder / "table.csv").read_bytes() == table
    assert run_sweep(laid, folder).computed == 0


def test_pipe_in_place_of_a_result_is_refused_before_anything_is_computed(laid, folder):
    file_of(folder, laid, 0).unlink()
    file_of(folder, laid).unlink()
    os.mkfifo(file_of(folder, laid))
    assert "a pipe" in sweep_status(laid, folder).unsound[0]
    with pytest.raises(InputError, match="a pipe"):
        run_sweep(laid, folder)
    assert not file_of(folder, laid, 0).exists()


def test_any_changed_byte_of_a_result_is_noticed(laid, folder):
    path, draw = file_of(folder, laid), random.Random(1)
    whole = path.read_bytes()
    record = json.loads(whole)
    for _ in range(200):
        place, byte = draw.randrange(len(whole)), draw.randrange(256)
        path.write_bytes(whole[:place] + bytes([byte]) + whole[place + 1 :])
        there = store.rows_of(folder)
        assert len(there.records) + len(there.unsound) == COUNT
        assert there.unsound or there.records[1] == record  # white space between the parts is none of the record


def test_results_of_other_code_and_other_inputs_are_counted(laid, folder):
    record = json.loads(file_of(folder, laid).read_text(encoding="utf-8"))
    of_other_code(record)
    store.keep(folder, record | {"task": "of that version"})
    one = case("stable_masses", laid.base, {"to_kg": 31.0}, {})
    inputs = {"inputs_sha256": one.inputs_sha256, "document": one.document, "options": one.options}
    store.keep(folder, run_sweep(laid, folder).records[0] | inputs | {"address": one.address})
    found = sweep_status(laid, folder)
    assert (found.remaining, found.stale, found.foreign, found.unsound) == (0, 1, 1, ())


@pytest.mark.parametrize("sweep", sorted((ROOT / "studies" / "sweeps").glob("*.toml")), ids=lambda path: path.stem)
def test_digest_of_inputs_is_that_of_what_is_kept_of_them(sweep):
    for one in plan(sweep, 40).cases[:5]:
        document, options = json.loads(json.dumps([one.document, one.options]))
        assert case(one.task, document, options, {}).inputs_sha256 == one.inputs_sha256
        assert case(one.task, document | {"name": "another"}, options, {}).inputs_sha256 != one.inputs_sha256


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{}", "rows: missing"),
        ("[]", "must be a table"),
        ("{", "no JSON"),
        ('{"method": "grid", "complete": true, "rows": []}', "name: missing"),
        ('{"name": "a", "method": "grid", "complete": true, "rows": ["../../table"]}', "rows"),
        ('{"name": "a", "method": "grid", "complete": 1, "rows": []}', "complete"),
    ],
)
def test_index_that_is_none_is_bad_input_with_its_key(laid, folder, content, words):
    (folder / store.INDEX).write_text(content, encoding="utf-8")
    for read in (store.rows_of, lambda where: difference(where, where), lambda where: case_of(str(where / "0"))):
        with pytest.raises(InputError, match=words):
            read(folder)
    assert run_sweep(laid, folder).computed == 0
    assert len(store.rows_of(folder).records) == COUNT


def test_cases_that_cannot_be_read_are_no_empty_folder(laid, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "cases").write_text("not a folder", encoding="utf-8")
    for read in (run_sweep, sweep_status):
        with pytest.raises(InputError, match="cannot be read"):
            read(laid, tmp_path / "out")


def test_folder_of_a_first_run_that_is_under_way_shows_what_it_has(laid, folder):
    (folder / store.INDEX).unlink()
    file_of(folder, laid).unlink()
    assert len(store.rows_of(folder).records) == COUNT - 1
    assert case_of(str(folder / "0"))["status"] == "done"


def test_rows_of_a_run_that_is_interrupted_have_the_numbers_by_which_they_are_found(laid, tmp_path):
    def last_first(cases):
        yield COUNT - 1, workers.compute(cases[COUNT - 1])
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_sweep(laid, tmp_path / "out", last_first)
    (row,) = csv.DictReader((tmp_path / "out" / "table.csv").read_text(encoding="utf-8").splitlines())
    shown = CliRunner().invoke(study, ["show", str(tmp_path / "out"), "--json", str(tmp_path / "shown.json")])
    assert shown.exit_code == 0, shown.output
    (told,) = json.loads((tmp_path / "shown.json").read_text())["rows"]
    for one in (row, told):
        assert case_of(str(tmp_path / "out" / str(one["case"])))["address"].startswith(one["address"])


def test_what_no_file_can_replace_is_refused_before_anything_is_computed(laid, tmp_path):
    (tmp_path / "out" / "study.json").mkdir(parents=True)
    with pytest.raises(OSError, match="is a folder"):
        run_sweep(laid, tmp_path / "out")
    assert not (tmp_path / "out" / "cases").exists()


def test_a_refused_case_is_named_as_it_was_given(tmp_path):
    with pytest.raises(InputError, match=r"^none/3: none: .*no study") as caught:
        case_of("none/3")
    assert caught.value.source == "none/3"
