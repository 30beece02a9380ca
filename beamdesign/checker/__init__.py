"""Certificates proved again from what they state, by nothing but this package and python-flint.

It imports nothing of the programme that writes certificates, and nothing of that imports it to prove. The loop is built
anew from the parameters, the controller and the elements that a certificate states; polynomials of a mass are settled
by another method than the prover's, boxes and Lyapunov functions by the same method in code of its own.

`python -m beamdesign.checker CERTIFICATE [PROTOTYPE]`: exit status 0 if every statement was proved, 1 if one was not,
2 if the file cannot be read.
"""

from codecs import BOM_UTF8
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

from flint import ctx, fmpq

from beamdesign.checker.box_loop import DEVIATIONS, deviations_of, figures, holds, left_exact
from beamdesign.checker.prototype import ALLOY, GUARANTEED, differences, left_open, masses_of, number_of, table_of
from beamdesign.checker.reading import LARGEST_BYTES, Table, Unreadable, rational, read, sealed, short, span, toml
from beamdesign.checker.rig import ONCE, Rig
from beamdesign.checker.roots import Pair
from beamdesign.checker.work import allowed

__all__ = ["KINDS", "VERSION", "Unreadable", "Verdict", "check"]

VERSION = 2
KINDS = {
    "beamdesign.arm_plane": "arm",
    "beamdesign.box": "box",
    "beamdesign.contact": "contact",
    "beamdesign.expression_box": "box",
    "beamdesign.mass_range": "mass_range",
    "beamdesign.stages": "stages",
}
"""Kinds of certificates, and the file of this package that proves what each states."""
_BOXES = ("beamdesign.box", "beamdesign.expression_box")
_OF_KINDS = {
    "plane": ("beamdesign.arm_plane",),
    "range": _BOXES,
    "outer_end_mass_kg": tuple(kind for kind in KINDS if kind not in _BOXES),
}
"""Tables that the comparison with a prototype reads, and the kinds that state them."""
OF_NO_RIG = ("beamdesign.expression_box",)
PRECISION_BITS = 256


PrototypeTable = Mapping[str, Any]


@dataclass(frozen=True)
class Verdict:
    """What came of a certificate.

    Attributes:
        kind: of the certificate.
        about: in words, the rig, its effects and their sizes, and what is asked of it, as stated.
        proved: in words with their numbers, the statements that were proved.
        failed: those that were not.
        open: what was not looked at.
    """

    kind: str
    about: tuple[str, ...]
    proved: tuple[str, ...]
    failed: tuple[str, ...]
    open: tuple[str, ...]

    @property
    def valid(self) -> bool:
        """Whether every statement was proved, and there is one."""
        return bool(self.proved) and not self.failed

    def lines(self) -> Iterator[str]:
        """All of it, a line for each."""
        words = {"about": self.about, "proved": self.proved, "not looked at": self.open, "NOT PROVED": self.failed}
        return (f"{heading}: {_one_line(line)}" for heading, lines in words.items() for line in lines)


def _one_line(words: str) -> str:
    """Words of a file as one line that can be printed, whatever they hold."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in words)


def check(
    source: str | Path,
    prototype: str | Path | PrototypeTable | Callable[[float | None, Mapping[str, Pair]], PrototypeTable] | None = None,
) -> Verdict:
    """Prove a certificate again, and that it is of a prototype.

    Args:
        source: path of the certificate, or its text.
        prototype: path of a prototype.toml; or its table with every default filled in, and with the tables that stand
            for its effects under `effect` where whoever asks can tell; or what gives that for a largest payload in kg
            and the ranges of a box.

    Raises:
        Unreadable: where either cannot be read, or is beyond the limits.
    """
    if not isinstance(source, str | Path):
        raise Unreadable(f"a certificate is given by its path or text, not by what is of type {type(source).__name__}")
    if not (prototype is None or callable(prototype) or isinstance(prototype, str | Path | Mapping)):
        raise Unreadable(
            f"a prototype is given by its path or table, not by what is of type {type(prototype).__name__}"
        )
    source = Path(source) if isinstance(source, str) and "\n" not in source else source
    data = source.encode() if isinstance(source, str) else _bytes(source)
    table, text = read(data)
    kind = table.word("kind", *KINDS)
    if (version := table.take("version")) != VERSION:
        remedy = "; make the certificate again" if version == 1 else ""
        raise Unreadable(f"format {str(version)[:20]} is not read here, only format {VERSION}{remedy}")
    if strange := [key for key, kinds in _OF_KINDS.items() if key in table and kind not in kinds]:
        raise Unreadable(f"not known in a certificate of this kind: {', '.join(strange)}")
    room = import_module(f"{__name__}.{KINDS[kind]}")
    try:
        with ctx.workprec(PRECISION_BITS), allowed(len(data)):
            rig = None if kind in OF_NO_RIG else Rig(table)
            given = None if prototype is None else _given(prototype, table)
            results = [sealed(table, text), *(rig.statements() if rig else ()), *room.statements(table, rig)]
            unread = ["what follows a #, in which nothing is proved"] if "#" in text else []
            if rig is not None:
                unread += rig.left_open(of_effects=given is None or "effect" not in given)
                unread += left_aside(kind, table.again().optional("arm"))
                unread += left_exact(table, rig) if kind in _BOXES else ()
            if "nonlinear" in table:
                unread.append("that its effects are the characteristics, gains and errors of which it states something")
            if given is not None and rig is None:
                results.append((False, "not of this prototype: it is of an expression, and of no rig"))
            elif given is not None and rig is not None:
                others = [(False, f"not of this prototype: {line}") for line in differences(table, rig, given)]
                results += others or [(True, "it is of this prototype")]
                results += (resting := [*rests_on(given, data, source, table, rig)])
                if "guarantee" in given and not resting:
                    unread.append("what the prototype's [guarantee] states, which is not said to rest on this file")
                unread += left_open(table, rig, given)
            words = tuple(about(table, rig))
            table.done()
    except (ArithmeticError, RecursionError, MemoryError) as error:
        raise Unreadable(f"its figures make no loop: {error}") from error
    proved, failed = (tuple(line for held, line in results if held is wanted) for wanted in (True, False))
    return Verdict(kind, words, proved, failed, tuple(unread))


def left_aside(kind: str, arm: Table) -> Iterator[str]:
    """What [arm] states and no loop on the axis has, in words; every kind but that of a plane is of such a loop."""
    if kind == "beamdesign.arm_plane":
        return
    beside = [key for key in ("offset_m", "sensor_m") if key in arm and any(arm.numbers(key, 3))]
    if beside:
        yield f"[arm] {' and '.join(beside)}: the loop is that of a payload and a sensor at the tip, on the beam's axis"
    if "second_controller" in arm:
        yield "[arm.second_controller]: the loop is that of [controller]"


def _given(prototype: Any, table: Table) -> PrototypeTable:
    if callable(prototype):
        box = table.optional("range")
        varying = {name: box.range(name) for name in box.keys}
        masses = table.range("outer_end_mass_kg") if "outer_end_mass_kg" in table else varying.get("outer_end_mass")
        return prototype(
            None if masses is None else int(masses[1].p) / int(masses[1].q),
            {name: ends for name, ends in varying.items() if ends[0] < ends[1]},
        )
    if isinstance(prototype, Mapping):
        return prototype
    try:
        given, _ = toml(_bytes(Path(prototype)).removeprefix(BOM_UTF8))  # an editor's
    except Unreadable as error:
        raise Unreadable(f"the prototype: {error}") from error
    # No file says what its effects come to: only a caller who works them out may.
    return {key: value for key, value in given.items() if key != "effect"}


def _bytes(path: Path) -> bytes:
    if "\0" in str(path):
        raise Unreadable("no path holds a NUL")
    try:
        if path.exists() and not path.is_file():  # a pipe would keep whoever opens it waiting
            raise Unreadable("is not a regular file")
        with path.open("rb") as file:
            return file.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise Unreadable(f"cannot be read: {error.strerror or error}") from error


# Whether what a prototype states under [guarantee] is what the certificate it names proves of it.


def rests_on(
    prototype: PrototypeTable, data: bytes, source: str | Path, table: Table, rig: Rig
) -> Iterator[tuple[bool, str]]:
    """Whether the guarantee that a prototype states rests on this certificate, where it says so, and keeps to it.

    Args:
        prototype: its table.
        data: the certificate as it was read.
        source: where from.
        table: the certificate, whose statements are proved elsewhere.
        rig: that it states.
    """
    guarantee = prototype.get("guarantee")
    if not isinstance(guarantee, dict):
        return
    if guarantee.get("certificate_sha256") == sha256(data).hexdigest():
        beyond = list(_beyond(prototype, table.again(), rig))
        yield from ((False, f"the prototype's [guarantee] states {words}") for words in beyond)
        if not beyond:
            yield True, "the prototype's [guarantee] rests on this very file"
    elif isinstance(source, Path) and guarantee.get("certificate") == source.name:
        yield False, "the prototype's [guarantee] rests on a file of this name with another content (sha256)"


def _beyond(prototype: PrototypeTable, table: Table, rig: Rig) -> Iterator[str]:
    """What is stated beyond what the certificate says, in words."""
    guarantee, compliance = prototype["guarantee"], number_of(prototype, "goal", "compliance_m_per_N")
    box = table.optional("range")
    bandwidth, peak, count = (
        number_of(prototype, "guarantee", key) if key in guarantee else fmpq(0)
        for key in ("bandwidth_Hz", "peak_sensitivity", "sigmas")
    )
    asked, key = (box, "outer_end_mass") if box.keys else (table, "outer_end_mass_kg")
    spread = deviations_of(table, figures(rig)) if box.keys else {}
    tolerated = "outer_end_mass" in table_of(prototype, "tolerance")
    share = count * number_of(prototype, "tolerance", "outer_end_mass") if tolerated else fmpq(0)
    low, high = masses_of(guarantee) if "outer_end_mass_kg" in guarantee else asked.range(key)
    asked_masses = (low * (1 - share), high * (1 + share)) if "outer_end_mass_kg" in guarantee else (low, high)
    yield from (f"{repr(key)[:60]}, which is not known here" for key in guarantee if key not in GUARANTEED)
    if "stage" in table_of(prototype, "controller") and rig.schedule is None:
        yield "what all of its laws keep, of which the certificate is of one"
    untold = not table.optional("tolerance").keys and any(table_of(prototype, "tolerance").values())
    if count and (not box.keys or untold):
        yield "standard deviations, of which the certificate is not"
    for name, deviations in spread.items():
        value = figures(rig).get(name, fmpq(0))
        held = box.range(name) if name in box else (value, value)
        if count and value and any(deviations) and not holds(held, value, count, *deviations):
            yield f"more standard deviations of {name} than the certificate is of"
    if not _within(asked_masses, asked.range(key)):
        yield "payloads beyond those of the certificate"
    claims = [one for one in table.tables("claim") if _is_about(one, key, asked_masses)]
    if bandwidth and not any(_reaches(one, compliance, bandwidth) for one in claims):
        yield "a bandwidth beyond that of the certificate"
    peaks = [one.number("limit") for one in claims if one.take("kind") == "peak_sensitivity"]
    if not peaks:  # of a loop that has one it is claimed
        yield "that a loop is stable of which the certificate claims no peak sensitivity"
    elif "peak_sensitivity" in guarantee and min(peaks) > peak:
        yield "a peak sensitivity below that of the certificate"


def _is_about(claim: Table, key: str, masses: Pair) -> bool:
    """Whether a claim is said to hold, over all of some payloads."""
    own = claim.optional("range")
    return ("holds" not in claim or claim.flag("holds")) and (key not in own or _within(masses, own.range(key)))


def _reaches(claim: Table, compliance: fmpq, bandwidth: fmpq) -> bool:
    """Whether it is of a compliance, up to a frequency."""
    if claim.take("kind") != "compliance" or claim.number("limit") > compliance:
        return False
    until = claim.take("bandwidth_Hz") if "bandwidth_Hz" in claim else "infinite"
    return until == "infinite" or bandwidth <= claim.number("bandwidth_Hz")


def _within(inner: Pair, outer: Pair) -> bool:
    return bool(outer[0] <= inner[0] <= inner[1] <= outer[1])


# What a certificate is about, in words: its rig, its controller, its effects with their sizes, and what is asked.


KEYS = {
    "payload": ("outer_end_mass_kg", "inner_end_mass_kg", "largest_force_N"),
    "goal": (
        "compliance_m_per_N", "peak_sensitivity", "lower_gains", "comes_to_rest", "loop_gain", "loop_gain_from_Hz",
        "controller_effort_A_per_V", "peak_over_passive",
    ),
    "arm": (
        "offset_m", "tool_m", "sensor_m", "end_polar_inertia_kg_m2", "payload_polar_inertia_kg_m2",
        "torsional_stiffness_N_m_per_rad", "torsional_damping_ratio", "second_controller", "plane",
    ),
    "compliance": ("end_stiffness_N_per_m", "force_filter_Hz", "servo"),
    "tolerance": tuple(dict.fromkeys(DEVIATIONS.values())),
}  # fmt: skip
_LENGTHS = {"outer_end_mass_kg": 2, "offset_m": 3, "tool_m": 3, "sensor_m": 3}
_LAWS = ("second_controller", "servo")


def about(table: Table, rig: Rig | None) -> Iterator[str]:
    """The rig as it is stated, a line for each part, figures with their units in their names."""
    yield f"label (not proved): {table.word('name')[:200]!r}"
    if rig is None:
        yield "an expression, and no rig"
        return
    figures = ", ".join(f"{name} {short(value)}" for name, value in rig.figures.items())
    yield f"rig: {figures}, inner_end_mass_kg {short(rig.inner_end_mass)}"
    if "outer_end_mass_kg" in table:  # which may be others than those of [payload]
        yield f"outer end masses from {span(table.range('outer_end_mass_kg'))} kg"
    if (controller := rig.law or rig.schedule) is not None:
        yield f"controller: {_words(controller.figures)}"
    for effect in rig.effects:
        sizes = ", ".join(f"{key} {short(value)}" for key, value in effect.parameters.items())
        yield f"effect {effect.name}: {sizes}"
        if effect.gain != ONCE:
            yield f"effect {effect.name}: gain times {span(effect.gain)}, {span(effect.performing)} to perform"
        for name, own in effect.spans.items():
            yield f"effect {effect.name}: {name} at {span(own.ends, ' and ')}, {span(own.performing)} to perform"
    for name, known in KEYS.items():
        yield from _figures(table.optional(name), known)
    alloys = table.optional("material")
    for name in alloys.keys:
        yield from _figures(alloys.table(name), ALLOY)


def _figures(table: Table, known: Iterable[str]) -> Iterator[str]:
    """A table of which nothing is proved, but whose keys are known and whose figures are numbers."""
    entries = {key: table.take(key) for key in known if key in table}
    for key in entries:
        if key in _LAWS:
            _refuse_words(entries[key], table.place_of(key))
        elif key in ("lower_gains", "comes_to_rest"):
            table.flag(key)
        elif key == "plane":
            table.word(key, "y", "z")
        elif key not in _LENGTHS:
            table.number(key)
        else:
            table.numbers(key, _LENGTHS[key])
    if entries:
        yield f"{table.place}: {_words(entries)}"


def _refuse_words(value: Any, place: str) -> None:
    """Refuse whatever is no number in a controller's figures, but for its kind and its sensors."""
    if not isinstance(value, dict | list):
        rational(value, place)
        return
    for key, item in value.items() if isinstance(value, dict) else enumerate(value, start=1):
        if key not in ("kind", "sensors"):
            _refuse_words(item, f"{place}.{key}")


def _words(value: Any) -> str:
    """Entries as they stand, with their names."""
    if isinstance(value, dict):
        return ", ".join(f"{key} {_words(item)}" for key, item in value.items())[:2000]
    if isinstance(value, list):
        return f"[{', '.join(map(_words, value))}]"
    return str(value)
