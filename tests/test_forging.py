"""Certificates of every kind are forged: whatever is altered, nothing false is ever called valid."""

import tomllib
from collections.abc import Callable
from copy import deepcopy
from functools import cache
from zlib import crc32

import pytest
from forging import WAYS, Table, is_number, mutations, places, put, resealed
from honest_certificates import (
    AT_LEAST,
    EACH,
    FORGED,
    OF_THE_RIG,
    Honest,
    figures,
    honest,
    is_another,
    share_of_work,
    valid,
)

from beamdesign import check
from beamdesign.checker import KINDS, OF_NO_RIG, Verdict

pytestmark = pytest.mark.long

ENOUGH = 15
"""Forgeries of a certificate of which some are valid all the same."""


def test_every_kind_is_forged_often_enough():
    assert set(FORGED) == set(KINDS) - set(OF_NO_RIG)
    for _, made in FORGED.values():
        assert sum(count for _, count in made.values()) >= AT_LEAST


def test_every_way_to_alter_a_certificate_is_tried():
    words = [words.split()[0] for words, _ in mutations(honest("beamdesign.mass_range", "effects").table, 1, 300)]
    assert set(words) == {way.__name__.strip("_") for way in WAYS}
    first, again = ([words for words, _ in mutations(honest(*EACH[0]).table, 7, 20)] for _ in range(2))
    assert first == again


@cache
def verdict(kind: str, name: str) -> Verdict:
    """On a certificate as it was written, of an eighth of the work that would be done for it."""
    with share_of_work():
        return check(honest(kind, name).text)


@pytest.mark.parametrize(("kind", "name"), EACH)
def test_what_is_honest_is_valid_of_its_prototype_and_not_false(kind: str, name: str):
    """And asks for a share of the work that is done; sealed anew it says the same."""
    made = honest(kind, name)
    again = resealed(made.table)
    assert tomllib.loads(again) == made.table | {"sha256": tomllib.loads(again)["sha256"]}
    assert verdict(kind, name).valid
    assert valid(again, made.given)
    assert FORGED[kind][0](made.table) is not False


@pytest.mark.parametrize(("kind", "name"), EACH)
def test_a_verdict_repeats_every_claim_with_its_number(kind: str, name: str):
    proved = verdict(kind, name).proved
    for claim in honest(kind, name).table.get("claim", []):
        asked = [claim[key] for key in ("limit", "rate_kg_per_s", "dwell_s") if key in claim]
        assert all(any(f"{float(number):.7g}" in words for words in proved) for number in asked)


@pytest.mark.parametrize(("kind", "name"), EACH)
def test_a_verdict_names_the_payloads_that_it_is_about(kind: str, name: str):
    """Which [payload] need not have: contact, and several loops of which no range was stated, were of none by name."""
    table, told = honest(kind, name).table, verdict(kind, name)
    low, high = table["outer_end_mass_kg"] if "outer_end_mass_kg" in table else table["range"]["outer_end_mass"]
    named = f"{float(low):.7g} to {float(high):.7g}"
    assert any(named in words and not words.startswith("payload") for words in (*told.about, *told.proved))


def forged_copies(kind: str, name: str, tried: Callable[[int], int]) -> list[tuple[str, Table]]:
    """What is tried of a certificate, each drawn for itself, with what was done to it in words."""
    many = FORGED[kind][1][name][1]
    count = max(tried(many), min(many, ENOUGH))
    return list(mutations(honest(kind, name).table, seed=crc32(name.encode()), count=count))


def test_every_way_is_tried_of_some_kind_and_nearly_every_way_of_each(tried: Callable[[int], int]):
    """A certificate without effects, for one, has none to alter."""
    every = {way.__name__.strip("_") for way in WAYS}
    done = {kind: {words.split()[0] for name in FORGED[kind][1] for words, _ in forged_copies(kind, name, tried)}
            for kind in FORGED}  # fmt: skip
    assert set().union(*done.values()) == every
    assert all(len(every - ways) <= 2 for ways in done.values())


@pytest.mark.parametrize(("kind", "name"), EACH)
def test_nothing_false_is_valid(kind: str, name: str, tried: Callable[[int], int]):
    """A valid one may state something else that is true; of the same prototype, only about the same rig."""
    true, made = FORGED[kind][0], honest(kind, name)
    before, copies = made.table, forged_copies(kind, name, tried)
    rig = figures({key: before[key] for key in OF_THE_RIG if key in before})
    kept = 0
    for words, forged in copies:
        text = resealed(forged)
        if not valid(text):
            continue
        kept += 1
        assert true(forged) is not False, words
        if figures({key: forged[key] for key in OF_THE_RIG if key in forged}) != rig:
            assert is_another(forged, made.given), words
    assert 0 < kept < len(copies) / 2


@pytest.fixture
def stable() -> Honest:
    """Of the paper's remedy from 3 to 6.8 kg."""
    return honest("beamdesign.mass_range", "stable")


def test_no_place_takes_a_value_of_another_type(stable: Honest):
    """Every single place, with a whole number, a word and a table; of the name any text will do."""
    before = {key: value for key, value in stable.table.items() if key not in ("name", "sha256")}
    for place, value in [*places(before)][1:]:
        for other in (1, "x", {"x": {}}):
            if type(other) is not type(value) or is_number(value):
                table = deepcopy(before) | {"name": "paper"}
                put(table, place, other)
                assert not valid(resealed(table)), (place, other)
