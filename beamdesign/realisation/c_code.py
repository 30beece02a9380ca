"""The controller as C99: header, law and self-test, from the lines that the emulation and the proof run on."""

from dataclasses import dataclass
from math import pi, sin

import numpy as np

from beamdesign.realisation.c_law import c_lines
from beamdesign.realisation.emulation import FixedPoint, Float32, to_word
from beamdesign.realisation.realise import Realisation
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
    """Errors and the currents that follow them from reset at zero, as words or as floats of 32 bits."""

    errors: tuple[float, ...]
    currents: tuple[float, ...]


def vectors(realisation: Realisation) -> Vectors:
    """What the self-test runs: steps beyond the limit both ways, tones, and small errors that only rounding sees."""
    volts = [_test_error(k) * realisation.full_scale_V for k in range(VECTORS)]
    if realisation.word_length is None:
        single = Float32(realisation)
        errors = [np.float32(v) for v in volts]
        return Vectors(tuple(float(e) for e in errors), tuple(float(single.step(float(e))) for e in errors))
    machine = FixedPoint(realisation)
    words = [to_word(realisation, v) for v in volts]
    return Vectors(tuple(words), tuple(machine.step(word) for word in words))


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
    about = [
        f"Controller of {name}: from error (command minus sensor voltage, V) to valve current (A).",
        "",
        f"Call controller_step once per sample at {realisation.rate_Hz:g} Hz and hold its current until the next.",
        f"Call controller_reset before the first sample. Both take and give {unit}, in the units below.",
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
            f"#define CONTROLLER_ERROR_PLACES ({realisation.signal_places}) /* error in V = word / 2^places */",
            f"#define CONTROLLER_CURRENT_PLACES ({realisation.current_places}) /* current in A = word / 2^places */",
            "",
            f"typedef {'int16_t' if short else 'int32_t'} controller_word;",
            f"typedef {'int32_t' if short else 'int64_t'} controller_wide;",
        ]  # fmt: skip
        kind, state = "controller_word", "controller_wide"
        unit_of_states = f"V / 2^{realisation.state_places}"
    else:
        lines += [f"#define CONTROLLER_RATE_HZ {realisation.rate_Hz!r}"]
        kind = state = "float"
        unit_of_states = "V"
    meaning = {"x": "what the section has followed of its input", "w": "how fast it follows"}
    lines += ["", "typedef struct {"]
    lines += [f"    {state} {x}; /* {unit_of_states}: section {x[1:]}, {meaning[x[0]]} */" for x in realisation.states]
    lines += [
        "    int limited; /* 1 or -1 while the current is at its upper or lower limit, else 0 */",
        "} controller_state;", "", *linkage[0],
        "/* At rest under a constant error: the next current is that of the static gain. */",
        f"void controller_reset(controller_state *state, {kind} error);", "",
        "/* One sample: current from error. */",
        f"{kind} controller_step(controller_state *state, {kind} error);", "",
        "/* 0 where this machine computes as it should, else the number of the first sample that differs. */",
        "int controller_self_test(void);", "", *linkage[1], "#endif", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _law(realisation: Realisation, name: str) -> str:
    fixed = realisation.word_length is not None
    lines = [*_comment([f"Controller of {name}; see {HEADER}."]), f'#include "{HEADER}"', ""]
    for key, one in realisation.coefficients.items():
        unit = " A/V" if key == "gain" else ""
        if fixed:
            lines.append(
                f"#define {key.upper()} ((controller_wide){one.integer}) /* / 2^places: {one.asked:.9g}{unit} */"
            )
            if key != "gain":
                lines.append(f"#define {key.upper()}_PLACES {one.places}")
        else:
            lines.append(f"#define {key.upper()} {_literal(one.asked)} /* {one.asked:.9g}{unit} */")
    kind = "controller_word" if fixed else "float"
    if fixed:
        most = 2 ** ((realisation.word_length or 0) - 1) - 1
        lines += [
            f"#define CURRENT_SHIFT {realisation.current_shift}",
            f"#define CURRENT_LIMIT ((controller_wide){realisation.current_limit})"
            f" /* {realisation.largest_current_A:g} A */",
            f"#define WORD_MOST ((controller_wide){most})",
        ]
        if realisation.states:
            lines += [
                f"#define STATE_EXTRA {(realisation.word_length or 0) - 2} /* places beyond those of a word */",
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
    lines += ["", f"void controller_reset(controller_state *state, {kind} error)", "{"]
    given = "limited(error, WORD_MOST) * ((controller_wide)1 << STATE_EXTRA)" if fixed else "error"
    if not realisation.states:
        lines.append("    (void)error;")
    zero = "0" if fixed else "0.0f"
    lines += [f"    state->{x} = {given if x[0] == 'x' else zero};" for x in realisation.states]
    lines += ["    state->limited = 0;", "}", "", f"{kind} controller_step(controller_state *state, {kind} error)", "{"]
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
    for title, values in (("errors", made.errors), ("currents", made.currents)):
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
        "    controller_reset(&state, 0);",
        f"    for (k = 0; k < {VECTORS}; k++) {{",
        "        if (controller_step(&state, errors[k]) != currents[k]) {",
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
