"""Certificates altered on purpose and sealed again, as one who forges them would leave them."""

import hashlib
import re
import tomllib
from collections.abc import Callable, Iterator
from copy import deepcopy
from fractions import Fraction
from random import Random
from typing import Any

import tomli_w

Table = dict[str, Any]
Place = tuple[Any, ...]
"""Keys and numbers of entries that lead to a value."""

_NUMBER = re.compile("-?[0-9]+([.][0-9]+|/[0-9]+)?")
FACTORS = ("0.999999", "1.000001", "0.999", "1.001", "0.9", "1.1", "1/2", "2", "1/10", "10", "1/1000", "1000")
WRITTEN = (
    "{} ",
    " {}",
    "{}_0",
    "+{}",
    "{}e1",
    "{}E-1",
    "0x{}",
    "{}\n",
    "{}/0",
    "{}/-1",
    "--{}",
    "{},0",
    "inf",
    "nan",
    "",
)
DIGITS = [{48 + k: zero + k for k in range(10)} for zero in (0x660, 0xFF10, 0x966)]
"""Arabic, wide and Devanagari digits."""
UNKNOWN = ("bandwidth_Hz", "claims", "proved", "frozen", "member", "note", "valid", "stable_up_to_kg")
BESIDE = {
    "arm": {"length_m": "1.5", "offset_m": ["0", "0.9", "0"]},
    "payload": {"outer_end_mass_kg": ["0", "50"], "inner_end_mass_kg": "0"},
    "goal": {"compliance_m_per_N": "0.00000001", "peak_sensitivity": "1.1", "loop_gain_from_Hz": "100"},
    "compliance": {"points": "all"},
    "material": {"unobtainium": {"youngs_modulus_Pa": "1000000000000", "density_kg_per_m3": "1"}},
}


def resealed(table: Table) -> str:
    """The text of a certificate, under the checksum that belongs to it."""
    text = tomli_w.dumps({key: value for key, value in table.items() if key != "sha256"})
    return f'sha256 = "{hashlib.sha256(text.encode()).hexdigest()}"\n{text}'


def sealed_text(text: str) -> str:
    """A text under the checksum that belongs to it, comments and all."""
    bare = re.sub(r'^sha256 = "[0-9a-f]*"\n', "", text, flags=re.MULTILINE)
    return f'sha256 = "{hashlib.sha256(bare.encode()).hexdigest()}"\n{bare}'


def altered(text: str, place: Place, value: object) -> str:
    """A certificate with another entry at one place."""
    table: Any = tomllib.loads(text)
    inner = table
    for key in place[:-1]:
        inner = inner[key]
    assert inner[place[-1]] != value
    inner[place[-1]] = value
    return resealed(table)


def mutations(table: Table, seed: int, count: int) -> Iterator[tuple[str, Table]]:
    """Altered copies of a certificate, each with what was done to it in words.

    Args:
        table: that was read of it.
        seed: of what is drawn.
        count: how many.
    """
    random, found = Random(seed), 0
    while found < count:
        forged = deepcopy({key: value for key, value in table.items() if key != "sha256"})
        try:
            words = [f"{way.__name__.strip('_')} {told}" for way in _drawn(random) if (told := way(forged, random))]
        except (KeyError, IndexError, TypeError, ValueError, AttributeError, ZeroDivisionError):
            continue  # the first of two changes has left nothing for the second
        if words:
            found += 1
            yield "; ".join(words), forged


def _drawn(random: Random) -> list[Callable[[Table, Random], str]]:
    """One change, or now and then two."""
    return random.choices(WAYS, k=1 if random.random() < 0.8 else 2)


def places(value: Any, at: Place = ()) -> Iterator[tuple[Place, Any]]:
    """Every value of a nested table, itself first, with where it stands."""
    yield at, value
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inner:
        yield from places(item, (*at, key))


def is_number(value: Any) -> bool:
    """Whether it is a number as certificates write it."""
    return isinstance(value, str) and _NUMBER.fullmatch(value) is not None


def put(table: Table, place: Place, value: Any) -> None:
    """Write a value to its place."""
    inner(table, place[:-1])[place[-1]] = value


def inner(table: Table, place: Place) -> Any:
    """What stands at a place."""
    for key in place:
        table = table[key]
    return table


def times(text: str, factor: str | Fraction) -> str:
    """A number as text, times a factor."""
    return spelled(Fraction(text) * Fraction(factor))


def spelled(value: Fraction) -> str:
    """A fraction as text."""
    return f"{value.numerator}/{value.denominator}" if value.denominator != 1 else str(value.numerator)


def _one(table: Table, random: Random, wanted: Callable[[Any], bool], under: Place = ()) -> tuple[Place, Any] | None:
    """One of the values that are wanted, places of a table as likely as each other."""
    found = [(p, v) for p, v in places(table) if p and wanted(v) and p[: len(under)] == under]
    if not found:
        return None
    heads = sorted({str(p[0]) for p, _ in found})
    head = random.choice(heads)
    return random.choice([item for item in found if str(item[0][0]) == head])


def _told(place: Place, before: Any, after: Any) -> str:
    return f"{'.'.join(map(str, place))}: {str(before)[:40]!r} -> {str(after)[:40]!r}"


def _change(table: Table, place: Place, value: Any) -> str:
    before = inner(table, place)
    put(table, place, value)
    return _told(place, before, value)


# Each way is a function: it alters the table and says how, or says nothing where there is nothing to alter.


def _scaled(table: Table, random: Random) -> str:
    place, value = _one(table, random, is_number) or ((), "")
    return _change(table, place, times(value, random.choice(FACTORS))) if place else ""


def _rig_scaled(table: Table, random: Random) -> str:
    """Another rig, for which what is claimed may not hold."""
    place, value = _one(table, random, is_number, ("rig",)) or ((), "")
    return _change(table, place, times(value, random.choice(FACTORS))) if place else ""


def _signed(table: Table, random: Random) -> str:
    place, value = _one(table, random, is_number) or ((), "")
    return _change(table, place, random.choice(("0", "-0", "0/1", times(value, "-1")))) if place else ""


def _written(table: Table, random: Random) -> str:
    """A number by another grammar, of the same value or not."""
    place, value = _one(table, random, is_number) or ((), "")
    if not place:
        return ""
    forms: list[Any] = [form.format(value) for form in WRITTEN]
    forms += [value.translate(digits) for digits in DIGITS]
    forms += [float(Fraction(value)), int(Fraction(value)), value + ".", "." + value, "9" * 4000, value + "0" * 4000]
    new = random.choice(forms)
    return _change(table, place, new) if new != value else ""


def _range(table: Table, random: Random) -> str:
    """Two numbers in a row narrowed, widened or turned."""
    found = _one(table, random, lambda v: isinstance(v, list) and len(v) == 2 and all(map(is_number, v)))
    if found is None:
        return ""
    place, (low, high) = found
    a, b = Fraction(low), Fraction(high)
    step = (b - a or abs(a) or Fraction(1)) * random.choice((Fraction(1, 1000), Fraction(1, 10), Fraction(1, 2), 5))
    new = random.choice(((a - step, b), (a, b + step), (a - step, b + step), (a + step, b), (a, b - step),
                         (a + step, b - step), (b, a), (a, a), (b, b)))  # fmt: skip
    return _change(table, place, [spelled(value) for value in new])


def _dropped(table: Table, random: Random) -> str:
    place, value = _one(table, random, lambda v: True) or ((), "")
    del inner(table, place[:-1])[place[-1]]
    return _told(place, value, "nothing")


def _doubled(table: Table, random: Random) -> str:
    found = _one(table, random, lambda v: isinstance(v, list) and len(v) > 0)
    if found is None:
        return ""
    place, value = found
    k = random.randrange(len(value))
    value.insert(random.randrange(len(value) + 1), deepcopy(value[k]))
    return f"{'.'.join(map(str, place))}[{k}]"


def _swapped(table: Table, random: Random) -> str:
    """Two neighbours exchanged: entries of a list, or values of two keys of a table."""
    place, value = _one(table, random, lambda v: isinstance(v, list | dict) and len(v) > 1) or ((), {})
    if not place:
        return ""
    keys = list(value) if isinstance(value, dict) else list(range(len(value)))
    k = random.randrange(len(keys) - 1)
    one, other = keys[k], keys[k + 1]
    value[one], value[other] = value[other], value[one]
    return f"{'.'.join(map(str, place))}: {one} and {other}"


def _unknown(table: Table, random: Random) -> str:
    """A key or a table that no certificate has."""
    place, _ = random.choice([(p, v) for p, v in places(table) if isinstance(v, dict)])
    key = random.choice([key for key in UNKNOWN if key not in inner(table, place)])
    value = random.choice(("9", True, {"kind": "gain_margin", "limit": "9", "holds": True}, [{"limit": "9"}], []))
    inner(table, place)[key] = value
    return f"{'.'.join(map(str, place))}: {key} = {value}"


def _flipped(table: Table, random: Random) -> str:
    place, value = _one(table, random, lambda v: isinstance(v, bool)) or ((), None)
    return _change(table, place, not value) if place else ""


def _reworded(table: Table, random: Random) -> str:
    """A word in the place of another, or of a key."""
    words = sorted({v for _, v in places(table) if isinstance(v, str) and not is_number(v) and v})
    place, value = _one(table, random, lambda v: v in words if isinstance(v, str) else False) or ((), None)
    other = random.choice(
        [*words, *UNKNOWN, *(str(key) for key in table), "infinite", "lag", "decay_rate", "", "../.."]
    )
    if not place or random.random() < 0.7:
        return _change(table, place, other) if place and other != value else ""
    holder = inner(table, place[:-1])
    if not isinstance(holder, dict) or other in holder:
        return ""
    holder[other] = holder.pop(place[-1])
    return f"{'.'.join(map(str, place))} is now {other}"


def _typed(table: Table, random: Random) -> str:
    """A value of another type."""
    place, value = _one(table, random, lambda v: True) or ((), None)
    new = random.choice(([value], {"value": value}, str(value), 1, True, 1.5, [], {}, ""))
    return _change(table, place, new) if type(new) is not type(value) else ""


def _bolder(table: Table, random: Random) -> str:
    """A claim that says more, and a wider range with all that states it."""
    claims = [claim for claim in table.get("claim", []) if claim.get("holds") is True]
    if claims and random.random() < 0.75:
        claim = random.choice(claims)
        more = Fraction(random.choice(("1.00001", "1.001", "1.05", "1.5", "10")))
        keys = [key for key in ("limit", "bandwidth_Hz", "from_Hz") if is_number(claim.get(key))]
        key = random.choice(keys)
        grows = key == "bandwidth_Hz" or (key == "limit" and claim["kind"] in ("decay_rate", "gain_margin"))
        before, claim[key] = claim[key], times(claim[key], more if grows else 1 / more)
        return f"claim {claim['kind']} {_told((key,), before, claim[key])}"
    low, high = table["outer_end_mass_kg"]
    new = random.choice(([low, times(high, "1.2")], [low, times(high, 5)], [times(low, "0.7"), high], ["0", high]))
    for place, value in list(places(table.get("stability", {}))):
        if place and place[-1] in ("low", "high") and value in (low, high):
            put(table["stability"], place, new[value == high])
    return _change(table, ("outer_end_mass_kg",), new)


def _effect(table: Table, random: Random) -> str:
    """An effect that does less, or is another, or is gone but for its name."""
    if not table.get("effect"):
        return ""
    k = random.randrange(len(table["effect"]))
    effect = table["effect"][k]
    ranges = [(p, v) for p, v in places(effect) if p and p[-1] in ("gain", "performing_gain", "ends", "performing")]
    numbers = [(p, v) for p, v in places(effect.get("elements", {})) if is_number(v)]
    what = random.randrange(5)
    if what == 0:
        table["effect"].pop(k)
        table["name"] = f"{table['name']} with {effect['name']}"
        return f"{effect['name']} is gone"
    if what in (1, 2) and ranges:
        place, (low, high) = random.choice(ranges)
        middle = (Fraction(low) + Fraction(high)) / 2
        return _change(effect, place, random.choice(([low, spelled(middle)], [spelled(middle), high], [low, low])))
    if what == 3 and numbers:
        place, value = random.choice(numbers)
        return _change(effect["elements"], place, times(value, random.choice(FACTORS)))
    effect["elements"] = {}
    return f"{effect['name']} is made of nothing"


def _disguised(table: Table, random: Random) -> str:
    """The tables of another rig as the name of this one."""
    other = deepcopy(table)
    _rig_scaled(other, random)
    return _change(table, ("name",), tomli_w.dumps(other))


def _beside(table: Table, random: Random) -> str:
    """What a certificate repeats of the prototype, altered or added."""
    name = random.choice(sorted(BESIDE))
    numbers = [p for p, v in places(table.get(name, {})) if is_number(v)]
    if numbers and random.random() < 0.7:
        place = random.choice(numbers)
        return _change(table, (name, *place), times(inner(table[name], place), random.choice(FACTORS)))
    table[name] = table.get(name, {}) | BESIDE[name]
    return name


def _controller(table: Table, random: Random) -> str:
    """Another controller whose figures and polynomials agree."""
    law = table.get("controller", {}).get("law")
    if not law or "gain_A_per_V" not in table["controller"]:
        return ""
    factor = random.choice((*FACTORS, "-1"))
    law["numerators"] = [[times(c, factor) for c in row] for row in law["numerators"]]
    return _change(table, ("controller", "gain_A_per_V"), times(table["controller"]["gain_A_per_V"], factor))


def _valve(table: Table, random: Random) -> str:
    """Another frequency, stated in both units."""
    rig, factor = table.get("rig", {}), random.choice(FACTORS)
    name = random.choice([name for name in ("valve", "filter") if f"{name}_frequency_Hz" in rig] or [""])
    for unit in ("Hz", "rad_per_s") if name else ():
        rig[f"{name}_frequency_{unit}"] = times(rig[f"{name}_frequency_{unit}"], factor)
    return f"{name} times {factor}" if name else ""


WAYS = (
    _scaled, _scaled, _rig_scaled, _rig_scaled, _signed, _written, _written, _range, _range, _dropped, _dropped,
    _doubled, _swapped, _unknown, _unknown, _flipped, _reworded, _typed, _bolder, _bolder, _effect, _effect, _disguised,
    _beside, _beside, _controller, _controller, _valve,
)  # fmt: skip
