"""The controller as C99 (header, law, self-test) and its emulation, from the lines that the proof runs on.

The emulation works in the same integers, or floats of 32 bits, as the C code: equal to the last bit.

The law has one statement per operation, in the order in which `law.one_period` asks for them. With them: how to compile
and run them.
"""

import os
import shutil
import subprocess
from collections.abc import Sequence
from functools import cache, reduce
from math import ceil, floor, inf, pi, sin
from operator import add
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Template

from beamdesign.build.realisation.law import Arithmetic, one_period
from beamdesign.build.realisation.realise import Realisation
from beamdesign.report.page import text_template
from beamdesign.spelling import in_c

VECTORS = 96
"""Samples of the self-test."""
HEADER, LAW, SELF_TEST = "controller.h", "controller.c", "controller_self_test.c"


def shifted(value: Any, places: int) -> Any:
    """Drop binary places, rounding to the nearest and halves away from zero, so that no sign is favoured.

    A float has none to drop.
    """
    if not places:
        return value
    half = (1 << places) >> 1
    return (value + half) >> places if value >= 0 else -((half - value) >> places)


class Machine(Arithmetic[Any]):
    """The controller step by step, equal to the C code to the last bit: in integers, or in floats of 32 bits.

    States in fixed point have `state_extra` binary places more than the words. Of floats no number has places, no limit
    but that of the current is reached, and every operation rounds once, to the nearest.

    Attributes:
        states: by name.
        limited: whether the last current was at its limit: -1, 0 or 1.
    """

    states: dict[str, Any]

    def __init__(self, realisation: Realisation):
        self.realisation, self.limited = realisation, 0
        bits, coefficients = realisation.word_length, realisation.coefficients.items()
        self._number: Any = np.float32 if bits is None else int
        self._most = inf if bits is None else 2 ** (bits - 1) - 1
        self._largest = self._number(realisation.largest_current_A if bits is None else realisation.current_limit)
        given = {name: one.asked if one.integer is None else one.integer for name, one in coefficients}
        self._given = {name: (self._number(given[name]), one.places) for name, one in coefficients}
        self._extra, self._shifts = realisation.state_extra, realisation.current_shifts
        self.reset(*(0 for _ in realisation.channels))

    def reset(self, *readings: float) -> None:
        """At rest under constant readings, so that the first current is that of the static gains."""
        given = [self.signal("", reading) * 2**self._extra for reading in readings]
        places = self.realisation.state_channels
        self.states = {n: given[k] if n[0] == "x" else self._number(0) for n, k in places.items()}

    def step(self, *readings: float) -> Any:
        """The current of one sample, the error first: all as words, or in A from V, m and Pa where in floats."""
        return one_period(self.realisation.channels, [self.signal("", reading) for reading in readings], self)

    def read(self, state: str) -> Any:  # noqa: D102
        return shifted(self.states[state], self._extra)

    def multiply(self, coefficient: str, value: Any) -> Any:  # noqa: D102
        factor, places = self._given[coefficient]
        return shifted(factor * value, places)

    def signal(self, name: str, value: Any) -> Any:  # noqa: D102
        return max(min(self._number(value), self._most), -self._most)  # in this order what is no number stays so

    def current(self, terms: Sequence[tuple[str, Any]]) -> Any:  # noqa: D102
        current = reduce(add, (shifted(self._given[gain][0] * value, self._shifts[gain]) for gain, value in terms))
        self.limited = int(current > self._largest) - int(current < -self._largest)
        return max(min(current, self._largest), -self._largest)

    def advance(self, state: str, coefficient: str, value: Any, held: int) -> None:  # noqa: D102
        if held * self.limited * value > 0:  # it would drive a limited current further
            return
        factor, places = self._given[coefficient]
        after, most = self.states[state] + shifted(factor * value, places - self._extra), self._most * 2**self._extra
        self.states[state] = max(min(after, most), -most)


def to_word(realisation: Realisation, reading: float, channel: int = 0) -> float:
    """A reading (V, m, Pa) as the machine takes it: the nearest word, halves away from zero, or the nearest float."""
    if realisation.word_length is None:
        return float(np.float32(reading))
    scaled = reading * 2.0 ** realisation.places[channel]
    return floor(scaled + 0.5) if scaled >= 0 else ceil(scaled - 0.5)


def vectors(realisation: Realisation) -> dict[str, list[float]]:
    """What the self-test runs: steps beyond the limit both ways, tones, and small readings that only rounding sees.

    Returns:
        Readings by their names and an s, then the `currents` that follow them from reset at zero, as words or as floats
        of 32 bits.
    """
    given: list[list[float]] = []
    for place, scale in enumerate(realisation.full_scales):
        values = [_test_error((k + 11 * place) % VECTORS) * scale for k in range(VECTORS)]
        given.append([to_word(realisation, value, place) for value in values])
    machine = Machine(realisation)
    currents = [float(machine.step(*sample)) for sample in zip(*given, strict=True)]
    return dict(zip((*(f"{one.name}s" for one in realisation.channels), "currents"), (*given, currents), strict=True))


def _test_error(k: int) -> float:
    """Share of full scale at one sample."""
    if k < VECTORS // 6:
        return 1.0
    if k < VECTORS // 3:
        return -1.0
    if k < 2 * VECTORS // 3:
        return 0.4 * sin(2 * pi * 0.013 * k * k / 8) + 0.1
    return 0.002 * sin(2.4 * k)


@cache
def _template(file: str) -> Template:
    """The template of one of the files, compiled once."""
    path = Path(__file__).with_name(f"{file}.j2")
    return text_template(path, spaced=lambda name: name.replace("_", " "), literal=_literal)


def c_files(realisation: Realisation, name: str, notes: tuple[str, ...] = ()) -> dict[str, str]:
    """Text of every file by its name, from the templates beside this module.

    Args:
        realisation: the controller.
        name: of the prototype.
        notes: lines for the head of the header, such as what is proved.
    """
    fixed = realisation.word_length is not None
    kind = "controller_word" if fixed else "float"
    given = {
        "law": realisation,
        "name": in_c(name),
        "notes": [in_c(note) for note in notes],
        "fixed": fixed,
        "kind": kind,
        "others": realisation.channels[1:],
        "arguments": ", ".join(f"{kind} {channel.name}" for channel in realisation.channels),
        "gains": {channel.gain_name: channel.unit for channel in realisation.channels},
        "statements": c_lines(realisation),
        "count": VECTORS,
        "tables": vectors(realisation),
    }
    return {file: _template(file).render(given) + "\n" for file in (HEADER, LAW, SELF_TEST)}


def _literal(value: float) -> str:
    """A C99 literal of exactly the nearest float of 32 bits."""
    return f"{float(np.float32(value)).hex()}f"


def c_lines(realisation: Realisation) -> list[str]:
    """Body of `controller_step`, without indentation; sections announce themselves."""
    titles = {f"x{k}": f"section {k}: {section.words}" for k, section in enumerate(realisation.sections, 1)}
    lines = _Lines(realisation.word_length is not None, titles)
    limited = {name: "e" if name == "error" else f"{name}_read" for name in (c.name for c in realisation.channels)}
    one_period(realisation.channels, [lines.signal(short, name) for name, short in limited.items()], lines)
    return lines.written


class _Lines(Arithmetic[str]):
    """Statements written so far, in fixed point or in floats; the expressions of the law are names of variables."""

    def __init__(self, fixed: bool, titles: dict[str, str]):
        self.written: list[str] = []
        self._fixed, self._titles, self._sums = fixed, titles, 0
        self._title_of_advances = "states, after the current is known"

    def _shifted(self, expression: str, places: str) -> str:
        return f"shifted({expression}, {places})" if self._fixed else expression

    def _limited(self, expression: str, most: str) -> str:
        return f"limited({expression}, {most})" if self._fixed else expression

    def _let(self, name: str, expression: str) -> str:
        self.written.append(f"const {'controller_wide' if self._fixed else 'float'} {name} = {expression};")
        return name

    def _sum(self, expression: str) -> str:
        self._sums += 1
        return self._let(f"sum{self._sums}", expression)

    def read(self, state: str) -> str:
        if state in self._titles:
            self.written += ["", f"/* {self._titles[state]} */"]
        return self._let(state, self._shifted(f"state->{state}", "STATE_EXTRA"))

    def multiply(self, coefficient: str, value: str) -> str:
        name = coefficient.upper()
        return self._let(f"{coefficient}_{value}", self._shifted(f"{name} * {value}", f"{name}_PLACES"))

    def add(self, one: str, other: str) -> str:
        return self._sum(f"{one} + {other}")

    def subtract(self, one: str, other: str) -> str:
        return self._sum(f"{one} - {other}")

    def signal(self, name: str, value: str) -> str:
        return self._let(name, self._limited(value, "WORD_MOST"))

    def current(self, terms: Sequence[tuple[str, str]]) -> str:
        gains = [(gain.upper(), value) for gain, value in terms]
        products = [self._shifted(f"{gain} * {value}", f"CURRENT_SHIFT{gain[4:]}") for gain, value in gains]
        self.written += ["", "/* current */"]
        named = [self._let(f"part{k}", text) for k, text in enumerate(products, 1)] if len(products) > 1 else products
        product = self._let("current", reduce("{} + {}".format, named))
        limited = f"state->limited = ({product} > CURRENT_LIMIT) - ({product} < -CURRENT_LIMIT);"
        self.written += ["", "/* limit, remembered for the states below */", limited]
        return product

    def advance(self, state: str, coefficient: str, value: str, held: int) -> None:
        if self._title_of_advances:
            self.written += ["", f"/* {self._title_of_advances} */"]
            self._title_of_advances = ""
        name, step, statements = coefficient.upper(), f"{coefficient}_{value}", list[str]()
        product = self._shifted(f"{name} * {value}", f"{name}_PLACES - STATE_EXTRA")
        if not self._fixed:
            statements, product = [f"const float {step} = {product};"], step
        statements.append(f"state->{state} = {self._limited(f'state->{state} + {product}', 'STATE_MOST')};")
        if held:
            up, down = "><" if held > 0 else "<>"
            pushing = f"(state->limited > 0 && {value} {up} 0) || (state->limited < 0 && {value} {down} 0)"
            statements = [f"if (!({pushing})) {{", *(f"    {line}" for line in statements), "}"]
        self.written += statements


PROGRAM = "-DCONTROLLER_SELF_TEST_MAIN"
"""Flag for a program whose exit status is 0 where the self-test passes."""
FLAGS = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O2", "-ffp-contract=off")


def compiler() -> str | None:
    """The C compiler: that of the environment variable CC, or the first of cc, gcc and clang on the path."""
    names = [name for name in (os.environ.get("CC", ""), "cc", "gcc", "clang") if name]
    return next((found for name in names if (found := shutil.which(name))), None)


def compiled(folder: Path, target: Path, *more: str) -> Path:
    """Compile the files of a folder to a target with further flags.

    Raises:
        ValueError: without a compiler, or where it finds fault with the files, in its own words.
    """
    program = compiler()
    if program is None:
        raise ValueError("no C compiler found: neither cc, gcc nor clang is on the path")
    done = subprocess.run(
        [program, *FLAGS, *more, "-o", str(target), *(str(folder / name) for name in (LAW, SELF_TEST))],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise ValueError(f"{program} finds fault with {folder / HEADER} or what belongs to it:\n{done.stderr.strip()}")
    return target
