"""Lost margin over sampling rate and word length."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import inf

from beamdesign import Prototype
from beamdesign.build.realisation.code import LoopFigures, continuous_figures, figures_at, masses_between, worst
from beamdesign.build.realisation.loop import prove_sampled, realised_loop
from beamdesign.build.realisation.realise import FULL_SCALE_V, realise
from beamdesign.loop import loop

RATES_HZ = (500.0, 1000.0, 2000.0, 5000.0, 10000.0, 20000.0)
WORDS: tuple[int | None, ...] = (8, 10, 12, 16, 24, 32, None)


@dataclass(frozen=True)
class RateAndWord:
    """A controller at a rate in a word length, judged over a range of payloads.

    Attributes:
        rate_Hz: sampling rate.
        word_length: bits; None for floats of 32 bits.
        continuous: worst figures of the design over the masses looked at.
        at_once: as realised, the current put out at its sample; None where it cannot be realised.
        late: likewise one period later.
        proved: whether stability one period late is proved for the whole range; None where that is open or not asked.
        rounding_m: largest motion of the tip by rounding, one period late; infinite where that loop is not stable.
        expected_rounding_m: root mean square of it, likewise.
        reason: why it cannot be realised or proved; empty where it is.
    """

    rate_Hz: float
    word_length: int | None
    continuous: LoopFigures
    at_once: LoopFigures | None
    late: LoopFigures | None
    proved: bool | None
    rounding_m: float
    expected_rounding_m: float
    reason: str

    @property
    def lost_sensitivity(self) -> float:
        """What the peak sensitivity one period late is above that of the design."""
        return inf if self.late is None else self.late.peak_sensitivity - self.continuous.peak_sensitivity


def trade(
    prototype: Prototype,
    masses_kg: tuple[float, float],
    rates_Hz: Iterable[float] = RATES_HZ,
    words: Sequence[int | None] = WORDS,
    full_scale_V: float = FULL_SCALE_V,
    looked_at: int = 5,
    prove: bool = True,
    progress: Callable[[float, float], None] = lambda rate_Hz, word: None,
) -> list[RateAndWord]:
    """Realise a prototype's controller at every rate in every word length.

    Args:
        prototype: with a controller, without effects.
        masses_kg: range of outer end mass.
        rates_Hz: sampling rates.
        words: word lengths, None for floats.
        full_scale_V: largest error.
        looked_at: number of masses at which figures are computed.
        prove: whether each loop is proved over the range, which takes most of the time.
        progress: told rate and word length (0 for floats) of what comes next.

    Raises:
        InputError: for a prototype with effects.
        ValueError: without a controller.
    """
    if prototype.controller is None:
        raise ValueError("the prototype has no [controller]")
    rows = []
    masses = masses_between(masses_kg, looked_at)
    design = worst([continuous_figures(loop(prototype).at(mass)) for mass in masses])
    for rate in rates_Hz:
        for word in words:
            progress(rate, word or 0)
            try:
                made = realise(prototype.controller, rate, word, full_scale_V)
            except ValueError as error:
                rows.append(RateAndWord(rate, word, design, None, None, None, inf, inf, str(error)))
                continue
            found = [figures_at(prototype, made, mass) for mass in masses]
            verdict = prove_sampled(realised_loop(prototype, made), *masses_kg) if prove else None
            effects = [at.rounding for at in found]
            most = max(inf if one is None else one.displacement_m for one in effects)
            expected = max(inf if one is None else one.expected_displacement_m for one in effects)
            rows.append(
                RateAndWord(
                    rate,
                    word,
                    design,
                    worst([at.at_once for at in found]),
                    worst([at.late for at in found]),
                    None if verdict is None else verdict.stable,
                    most,
                    expected,
                    "" if verdict is None else verdict.reason,
                )
            )
    return rows


def sufficient(rows: Sequence[RateAndWord], peak_sensitivity: float, rounding_m: float) -> RateAndWord | None:
    """The lowest rate, and at it the shortest word, that is proved and keeps both limits one period late.

    Args:
        rows: of `trade`.
        peak_sensitivity: largest allowed.
        rounding_m: largest motion of the tip by rounding allowed.
    """
    enough = [
        row
        for row in rows
        if row.proved
        and row.late is not None
        and row.late.peak_sensitivity <= peak_sensitivity
        and row.rounding_m <= rounding_m
    ]
    return min(enough, key=lambda row: (row.rate_Hz, row.word_length or 33), default=None)
