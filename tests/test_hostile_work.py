"""Small certificates that ask for hours of work are refused before it is done; `test_forging.py` has honest ones."""

import tomllib
from collections.abc import Callable
from random import Random
from typing import Any

import pytest
from forging import resealed
from honest_certificates import SHARE, honest, share_of_work

from beamdesign import check
from beamdesign.checker import Unreadable, reading

Table = dict[str, Any]


def of(kind: str, name: str) -> Table:
    return tomllib.loads(honest(f"beamdesign.{kind}", name).text)


def long_law(kind: str, name: str, degree: int = 30, digits: int = 60) -> Table:
    """A controller of a high degree with long figures."""
    random, table = Random(4), of(kind, name)
    first, *rest = ([str(random.randrange(10**digits)) for _ in range(degree + 1)] for _ in range(4))
    quotients = [f"{p}/{q}1" for p, q in zip(first, rest[0], strict=True)]
    law = {"sensors": ["displacement_m"], "numerators": [rest[1][:degree]], "denominator": quotients}
    return table | {"controller": {"kind": "homemade", "law": law}}


def coordinates() -> Table:
    """An effect with eighteen coordinates more, of which the tip and the rod move with all."""
    names = [f"c{k}" for k in range(18)]
    resists = ["1000*outer_stiffness", "1", "1*inner_mass + 1*outer_mass"]
    ring = [
        {"motion": {one: "1", other: "1"}, "resists": resists}
        for one, other in zip(names, [*names[1:], names[0]], strict=True)
    ]
    points = {key: {at: f"1/{k + 3}" for k, at in enumerate(names)} for key in ("tip", "rod")}
    effect = {"name": "e", "parameters": {}, "elements": {"points": points, "impedance": ring}}
    return of("mass_range", "effects") | {"effect": [effect]}


def claims() -> Table:
    """Sixty-four claims about as many loops."""
    table, spans = of("mass_range", "effects"), {"a": {"ends": ["0", "1"], "performing": ["0", "1"]}}
    elements = {"impedance": [{"motion": {"slide": "1"}, "resists": ["1*a", "1*a"]}]}
    table["effect"] += [{"name": f"e{k}", "parameters": {}, "span": spans, "elements": elements} for k in range(5)]
    return table | {"claim": [{"kind": "decay_rate", "limit": f"1/{k}", "holds": True} for k in range(1000, 1064)]}


def pieces() -> Table:
    """Integrals of responses on two hundred pieces, of several loops: nothing else in it asks for much."""
    table = of("mass_range", "moving")
    one = next(one for one in table["nonlinear"] if one["kind"] == "deviation") | {"pieces": 200}
    return table | {"nonlinear": [one]}


def grid() -> Table:
    """A leaf of more than a thousand terms on a grid of hundreds of points, in a tree that cuts again and again."""
    names = "abcdef"
    leaf = "*".join(f"({x}**2+{x}+1)" for x in names) + "*(1+s)"
    return {
        "kind": "beamdesign.expression_box", "version": 2, "name": "grid", "stable": True, "sha256": "", "p": "l",
        "range": {x: ["1", "2"] for x in names}, "member": dict.fromkeys(names, "1"), "leaf": {"l": leaf},
        "bound": [["l"]], "tree": ["w=1", *(9 * [*names]), *(60 * ["1,0"])],
    }  # fmt: skip


def matrices() -> Table:
    """An observer of sixty states."""
    table, n = of("mass_range", "sensors"), 60
    table["controller"] |= {
        "a": [[f"1/{10**9 + 7 * i + j * j}" for j in range(n)] for i in range(n)],
        "b": [["1", "1/3"]] * n,
        "c": ["1"] * n,
    }
    return table


LITTLE = 4 * SHARE
"""One over a share of the work that these ask for many times: to refuse them takes a fraction of a second."""
MADE: dict[str, Callable[[], Table]] = {
    "long law": lambda: long_law("mass_range", "stable"),
    "long law at walls": lambda: long_law("contact", "walls"),
    "long law of an arm": lambda: long_law("arm_plane", "twisted"),
    "high degree": lambda: long_law("mass_range", "stable", 50, 3),
    "coordinates": coordinates,
    "claims": claims,
    "pieces": pieces,
    "grid": grid,
    "matrices": matrices,
}


@pytest.mark.parametrize(
    ("kind", "name"),
    [("mass_range", "stable"), ("mass_range", "effects"), ("mass_range", "moving"), ("mass_range", "sensors"),
     ("contact", "walls"), ("arm_plane", "twisted")],
)  # fmt: skip
def test_what_they_are_made_of_asks_for_less(kind: str, name: str):
    with share_of_work(LITTLE):
        assert check(honest(f"beamdesign.{kind}", name).text).valid


@pytest.mark.parametrize("name", MADE)
def test_what_asks_for_more_work_than_is_done_is_refused_before(name: str):
    with share_of_work(LITTLE), pytest.raises(Unreadable, match="more work than is done"):
        check(resealed(MADE[name]()))


def test_filters_beside_a_box_are_of_a_low_degree_before_anything_is_multiplied_out():
    table = of("box", "performing")
    volts = [{"numerator": ["1", "1*outer_mass"], "denominator": ["1", "1*inner_mass", "1"]}] * 40
    table["effect"] = [{"name": "e", "parameters": {}, "elements": {"volts": volts}}]
    with pytest.raises(Unreadable, match="has degree 81, more than 60"):
        check(resealed(table))


@pytest.mark.parametrize("key", ["a", '"a"', "'a b'", '"a\\" # b"', "a-1 "])
@pytest.mark.parametrize("line", ["{} = 1", "[{}]", "x = {{ {} = 1 }}", "  [[{}]]"])
def test_a_dotted_key_of_thousands_of_parts_is_not_even_parsed(monkeypatch: pytest.MonkeyPatch, key: str, line: str):
    """`tomllib` takes time with the square of their number: 3 s for 4,000, hours for a file of 200 kB."""

    def loads(text: str) -> Table:
        raise AssertionError("parsed")

    monkeypatch.setattr(reading.tomllib, "loads", loads)
    for count in (40, 4_000):
        with pytest.raises(Unreadable, match="nested more than 32 deep"):
            check(line.format(".".join([key] * count)) + "\n")


def test_a_line_of_many_dots_is_no_long_key():
    table = of("mass_range", "stable") | {"name": f"a.b.c, {', '.join(['0.5', '.'] * 40)} {'1..' * 40}"}
    assert check(resealed(table)).valid


def test_a_tree_that_only_cuts_is_refused_before_it_fills_the_memory():
    """Each piece that waits has ranges as long as the tree is deep: 200,000 cuts, 400 kB, came to some 15 GB."""
    table = of("box", "stable")
    (name, *_) = (name for name, (low, high) in table["range"].items() if low != high and name != "outer_end_mass")
    with pytest.raises(Unreadable, match="leaves more than 1000 open"):
        check(resealed(table | {"tree": [" ".join([name] * 20_000)]}))
