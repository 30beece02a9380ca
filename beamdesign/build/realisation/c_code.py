"""The controller as C99: header, law and self-test, from the lines that the emulation and the proof run on.

The law has one statement per operation, in the order in which `law.one_period` asks for them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from math import pi, sin

import numpy as np

from beamdesign.build.realisation.emulation import FixedPoint, Float32, to_word
from beamdesign.build.realisation.law import Arithmetic, one_period
from beamdesign.build.realisation.realise import Realisation
from beamdesign.spelling import in_c

VECTORS = 96
"""Samples of the self-test."""
_PER_LINE = 6
_OVERFLOW = {
    "l1": ": within them no signal can overflow; larger ones are limited.",
    "l2": "; a signal that a word cannot hold is limited, which long large errors can bring about.",
}
HEADER, LAW, SELF_TEST = "controller.h", "controller.c", "controller_self_test.c"


@dataclass(frozen=True)
class Vectors:
    """Readings by name and the currents that follow them from reset at zero, as words or as floats of 32 bits."""

    readings: dict[str, tuple[float, ...]]
    currents: tuple[float, ...]


def vectors(realisation: Realisation) -> Vectors:
    """What the self-test runs: steps beyond the limit both ways, tones, and small readings that only rounding sees."""
    names = [channel.name for channel in realisation.channels]
    given: list[list[float]] = []
    for place, scale in enumerate(realisation.full_scales):
        values = [_test_error((k + 11 * place) % VECTORS) * scale for k in range(VECTORS)]
        single = realisation.word_length is None
        given.append([float(np.float32(v)) if single else to_word(realisation, v, place) for v in values])
    machine: FixedPoint | Float32 = (Float32 if realisation.word_length is None else FixedPoint)(realisation)
    currents = tuple(float(machine.step(*sample)) for sample in zip(*given, strict=True))
    return Vectors({name: tuple(values) for name, values in zip(names, given, strict=True)}, currents)


def _test_error(k: int) -> float:
    """Share of full scale at one sample."""
    if k < VECTORS // 6:
        return 1.0
    if k < VECTORS // 3:
        return -1.0
    if k < 2 * VECTORS // 3:
        return 0.4 * sin(2 * pi * 0.013 * k * k / 8) + 0.1
    return 0.002 * sin(2.4 * k)


def c_files(realisation: Realisation, name: str, notes: tuple[str, ...] = ()) -> dict[str, str]:
    """Text of every file by its name.

    Args:
        realisation: the controller.
        name: of the prototype.
        notes: lines for the head of the header, such as what is proved.
    """
    return {
        HEADER: _header(realisation, name, notes),
        LAW: _law(realisation, name),
        SELF_TEST: _self_test(realisation, name),
    }


def _comment(lines: list[str]) -> list[str]:
    return ["/*", *(f" * {in_c(line)}".rstrip() for line in lines), " */"]


def _header(realisation: Realisation, name: str, notes: tuple[str, ...]) -> str:
    fixed = realisation.word_length is not None
    limit, scale = realisation.largest_current_A, realisation.full_scale_V
    unit = "words" if fixed else "floats"
    others = realisation.channels[1:]
    more = "".join(f", {one.name.replace('_', ' ')} ({one.unit})" for one in others)
    about = [
        f"Controller of {name}: from error (command minus sensor voltage, V){more} to valve current (A).",
        "",
        f"Call controller_step once per sample at {realisation.rate_Hz:g} Hz and hold its current until the next.",
        f"Call controller_reset before the first sample. Both take and give {unit}, in the units below.",
        *(
            f"The {one.name.replace('_', ' ')} is taken as it is read, up to {most:g} {one.unit}, zero in the middle."
            for one, most in zip(others, realisation.full_scales[1:], strict=True)
        ),
        f"Made for errors up to {scale:g} V" + (_OVERFLOW[realisation.scaling] if fixed else "."),
        f"The current is limited to {limit:g} A. While it is, lag sections do not move further in its direction",
        "(anti-windup); all other sections are stable filters of unit static gain and run on.",
        "No memory is allocated, nothing blocks, nothing depends on the platform beyond C99"
        + ("." if fixed else " and IEEE 754 floats of 32 bits."),
        "" if fixed else "Compile with -std=c99 or -ffp-contract=off: fused operations change the last bit.",
        "" if fixed else "An error that is not a number stays in the states until the next reset: look for it before.",
        *notes,
    ]  # fmt: skip
    lines = [*_comment([line for k, line in enumerate(about) if line or k == 1]), "#ifndef CONTROLLER_H"]
    lines += ["#define CONTROLLER_H", ""]
    linkage = ["#ifdef __cplusplus", 'extern "C" {', "#endif", ""], ["#ifdef __cplusplus", "}", "#endif", ""]
    if fixed:
        short = (realisation.word_length or 0) <= 16
        lines += [
            "#include <stdint.h>", "",
            f"#define CONTROLLER_RATE_HZ {realisation.rate_Hz!r}",
            f"#define CONTROLLER_WORD_LENGTH {realisation.word_length} /* bits, with the sign */",
            *(
                f"#define CONTROLLER_{one.name.upper()}_PLACES ({places})"
                f" /* {one.name.replace('_', ' ')} in {one.unit} = word / 2^places */"
                for one, places in zip(realisation.channels, realisation.places, strict=True)
            ),
            f"#define CONTROLLER_CURRENT_PLACES ({realisation.current_places}) /* current in A = word / 2^places */",
            "",
            f"typedef {'int16_t' if short else 'int32_t'} controller_word;",
            f"typedef {'int32_t' if short else 'int64_t'} controller_wide;",
        ]  # fmt: skip
        kind, state = "controller_word", "controller_wide"
        units = [
            f"{one.unit} / 2^{places + realisation.state_extra}"
            for one, places in zip(realisation.channels, realisation.places, strict=True)
        ]
    else:
        lines += [f"#define CONTROLLER_RATE_HZ {realisation.rate_Hz!r}"]
        kind = state = "float"
        units = [one.unit for one in realisation.channels]
    meaning = {"x": "what the section has followed of its input", "w": "how fast it follows"}
    lines += ["", "typedef struct {"]
    for x, place in realisation.state_channels.items():
        lines.append(f"    {state} {x}; /* {units[place]}: section {x[1:]}, {meaning[x[0]]} */")
    given = _arguments(realisation)
    lines += [
        "    int limited; /* 1 or -1 while the current is at its upper or lower limit, else 0 */",
        "} controller_state;", "", *linkage[0],
        f"/* At rest under {'constant readings' if others else 'a constant error'}: the next current is that of the"
        " static gain. */",
        f"void controller_reset(controller_state *state, {given});", "",
        f"/* One sample: current from {'readings' if others else 'error'}. */",
        f"{kind} controller_step(controller_state *state, {given});", "",
        "/* 0 where this machine computes as it should, else the number of the first sample that differs. */",
        "int controller_self_test(void);", "", *linkage[1], "#endif", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _arguments(realisation: Realisation) -> str:
    """Of step and reset, in C."""
    kind = "float" if realisation.word_length is None else "controller_word"
    return ", ".join(f"{kind} {channel.name}" for channel in realisation.channels)


def _law(realisation: Realisation, name: str) -> str:
    fixed = realisation.word_length is not None
    lines = [*_comment([f"Controller of {name}; see {HEADER}."]), f'#include "{HEADER}"', ""]
    gains = {channel.gain_name: channel.unit for channel in realisation.channels}
    for key, one in realisation.coefficients.items():
        unit = f" A/{gains[key]}" if key in gains else ""
        if fixed:
            lines.append(
                f"#define {key.upper()} ((controller_wide){one.integer}) /* / 2^places: {one.asked:.9g}{unit} */"
            )
            if key not in gains:
                lines.append(f"#define {key.upper()}_PLACES {one.places}")
        else:
            lines.append(f"#define {key.upper()} {_literal(one.asked)} /* {one.asked:.9g}{unit} */")
    kind = "controller_word" if fixed else "float"
    if fixed:
        most = 2 ** ((realisation.word_length or 0) - 1) - 1
        lines += [
            *(f"#define CURRENT_SHIFT{n[4:].upper()} {places}" for n, places in realisation.current_shifts.items()),
            f"#define CURRENT_LIMIT ((controller_wide){realisation.current_limit})"
            f" /* {realisation.largest_current_A:g} A */",
            f"#define WORD_MOST ((controller_wide){most})",
        ]
        if realisation.states:
            lines += [
                f"#define STATE_EXTRA {realisation.state_extra} /* places beyond those of a word */",
                "#define STATE_MOST (WORD_MOST << STATE_EXTRA)",
            ]
        lines += [
            "",
            "/* Drops binary places; to the nearest, halves away from zero. */",
            "static controller_wide shifted(controller_wide value, int places)",
            "{",
            "    const controller_wide half = ((controller_wide)1 << places) >> 1;",
            "    return value >= 0 ? (value + half) >> places : -((half - value) >> places);",
            "}",
            "",
            "static controller_wide limited(controller_wide value, controller_wide most)",
            "{",
            "    return value > most ? most : value < -most ? -most : value;",
            "}",
        ]
    else:
        lines += [f"#define CURRENT_LIMIT {_literal(realisation.largest_current_A)} /* A */"]
    given = _arguments(realisation)
    lines += ["", f"void controller_reset(controller_state *state, {given})", "{"]
    names = [channel.name for channel in realisation.channels]
    heard = {names[place] for place in realisation.state_channels.values()}
    lines += [f"    (void){n};" for n in names if n not in heard]
    zero = "0" if fixed else "0.0f"
    for x, place in realisation.state_channels.items():
        value = names[place]
        if fixed:
            value = f"limited({value}, WORD_MOST) * ((controller_wide)1 << STATE_EXTRA)"
        lines.append(f"    state->{x} = {value if x[0] == 'x' else zero};")
    lines += ["    state->limited = 0;", "}", "", f"{kind} controller_step(controller_state *state, {given})", "{"]
    lines += [f"    {line}".rstrip() for line in c_lines(realisation)]
    result = "state->limited == 0 ? current : state->limited > 0 ? CURRENT_LIMIT : -CURRENT_LIMIT"
    lines += ["", f"    return {f'(controller_word)({result})' if fixed else result};", "}", ""]
    return "\n".join(lines)


def _self_test(realisation: Realisation, name: str) -> str:
    made = vectors(realisation)
    fixed = realisation.word_length is not None
    kind = "controller_word" if fixed else "float"
    lines = _comment(
        [
            f"Self-test of the controller of {name}: {VECTORS} samples from reset at zero, to the last bit.",
            "Compile with -DCONTROLLER_SELF_TEST_MAIN for a program whose exit status is 0 where it passes.",
        ]
    )
    lines += [f'#include "{HEADER}"', ""]
    readings = {f"{name}s": values for name, values in made.readings.items()}
    for title, values in (readings | {"currents": made.currents}).items():
        texts = [str(int(v)) if fixed else _literal(v) for v in values]
        lines.append(f"static const {kind} {title}[{VECTORS}] = {{")
        lines += [f"    {', '.join(texts[k : k + _PER_LINE])}," for k in range(0, VECTORS, _PER_LINE)]
        lines += ["};", ""]
    lines += [
        "int controller_self_test(void)",
        "{",
        "    controller_state state;",
        "    int k;",
        "",
        f"    controller_reset(&state, {', '.join('0' for _ in readings)});",
        f"    for (k = 0; k < {VECTORS}; k++) {{",
        f"        if (controller_step(&state, {', '.join(f'{title}[k]' for title in readings)}) != currents[k]) {{",
        "            return k + 1;",
        "        }",
        "    }",
        "    return 0;",
        "}",
        "",
        "#ifdef CONTROLLER_SELF_TEST_MAIN",
        "int main(void)",
        "{",
        "    return controller_self_test() != 0;",
        "}",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _literal(value: float) -> str:
    """A C99 literal of exactly the nearest float of 32 bits."""
    return f"{float(np.float32(value)).hex()}f"


def c_lines(realisation: Realisation) -> list[str]:
    """Body of `controller_step`, without indentation; sections announce themselves."""
    lines = _FloatLines() if realisation.word_length is None else _FixedLines(realisation)
    titles = {f"x{k}": f"section {k}: {section.words}" for k, section in enumerate(realisation.sections, 1)}
    lines.titles = titles
    names = [channel.name for channel in realisation.channels]
    one_period(realisation.channels, [lines.signal(_short(name), name) for name in names], lines)
    return lines.written


def _short(name: str) -> str:
    """Of a reading, once it is limited."""
    return "e" if name == "error" else f"{name}_read"


class _Lines(Arithmetic[str]):
    """Statements written so far; the expressions of the law are names of variables."""

    kind = ""

    def __init__(self) -> None:
        self.written: list[str] = []
        self.titles: dict[str, str] = {}
        self._sums = 0
        self._title_of_advances = "states, after the current is known"

    def _let(self, name: str, expression: str) -> str:
        self.written.append(f"const {self.kind} {name} = {expression};")
        return name

    def _title(self, state: str) -> None:
        if state in self.titles:
            self.written += ["", f"/* {self.titles[state]} */"]

    def _sum(self, expression: str) -> str:
        self._sums += 1
        return self._let(f"sum{self._sums}", expression)

    def add(self, one: str, other: str) -> str:
        return self._sum(f"{one} + {other}")

    def subtract(self, one: str, other: str) -> str:
        return self._sum(f"{one} - {other}")

    def _limit_current(self, products: Sequence[str]) -> str:
        self.written += ["", "/* current */"]
        named = [self._let(f"part{k}", text) for k, text in enumerate(products, 1)] if len(products) > 1 else products
        product = self._let("current", reduce("{} + {}".format, named))
        self.written += [
            "",
            "/* limit, remembered for the states below */",
            f"state->limited = ({product} > CURRENT_LIMIT) - ({product} < -CURRENT_LIMIT);",
        ]
        return product

    def _advance(self, statements: list[str], value: str, held: bool) -> None:
        if self._title_of_advances:
            self.written += ["", f"/* {self._title_of_advances} */"]
            self._title_of_advances = ""
        if held:
            pushing = f"(state->limited > 0 && {value} > 0) || (state->limited < 0 && {value} < 0)"
            self.written += [f"if (!({pushing})) {{", *(f"    {line}" for line in statements), "}"]
        else:
            self.written += statements


class _FixedLines(_Lines):
    kind = "controller_wide"

    def __init__(self, realisation: Realisation):
        super().__init__()
        self._places = {name: one.places for name, one in realisation.coefficients.items()}

    def read(self, state: str) -> str:
        self._title(state)
        return self._let(state, f"shifted(state->{state}, STATE_EXTRA)")

    def multiply(self, coefficient: str, value: str) -> str:
        name = coefficient.upper()
        return self._let(f"{coefficient}_{value}", f"shifted({name} * {value}, {name}_PLACES)")

    def signal(self, name: str, value: str) -> str:
        return self._let(name, f"limited({value}, WORD_MOST)")

    def current(self, terms: Sequence[tuple[str, str]]) -> str:
        products = [f"shifted({gain.upper()} * {value}, CURRENT_SHIFT{gain[4:].upper()})" for gain, value in terms]
        return self._limit_current(products)

    def advance(self, state: str, coefficient: str, value: str, held: bool) -> None:
        step = f"shifted({coefficient.upper()} * {value}, {coefficient.upper()}_PLACES - STATE_EXTRA)"
        self._advance([f"state->{state} = limited(state->{state} + {step}, STATE_MOST);"], value, held)


class _FloatLines(_Lines):
    kind = "float"

    def read(self, state: str) -> str:
        self._title(state)
        return self._let(state, f"state->{state}")

    def multiply(self, coefficient: str, value: str) -> str:
        return self._let(f"{coefficient}_{value}", f"{coefficient.upper()} * {value}")

    def signal(self, name: str, value: str) -> str:
        return self._let(name, value)

    def current(self, terms: Sequence[tuple[str, str]]) -> str:
        return self._limit_current([f"{gain.upper()} * {value}" for gain, value in terms])

    def advance(self, state: str, coefficient: str, value: str, held: bool) -> None:
        step = f"{coefficient}_{value}"
        product = f"const float {step} = {coefficient.upper()} * {value};"
        self._advance([product, f"state->{state} = state->{state} + {step};"], value, held)
