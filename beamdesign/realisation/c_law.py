"""The law as lines of C: one statement per operation, in the order in which `law.one_period` asks for them."""

from collections.abc import Sequence
from functools import reduce

from beamdesign.realisation.law import one_period
from beamdesign.realisation.realise import Realisation


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


class _Lines:
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

    def begin(self, channel: int) -> None:
        pass

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
