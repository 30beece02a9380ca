"""The controller as code: realised for a rate and a word length, and proved as it is realised."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from beamdesign.build.realisation.c_code import c_files, notes
from beamdesign.build.realisation.loop import prove_any_computing_time, realised_loop
from beamdesign.build.realisation.realise import Realisation, full_scales_of, realise
from beamdesign.build.realisation.verdict import Judgement, judge, worst
from beamdesign.files import write_set
from beamdesign.progress import Progress, silent
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.result import Result, finite, picked


@dataclass(frozen=True, repr=False)
class ProvedCode(Result):
    """A realised controller in its loop.

    Attributes:
        prototype: whose controller it is.
        outer_end_mass_kg: range over which the loop was to be proved.
        realisation: sections, coefficients, words.
        judgement: what rate and rounding cost, and what is proved.
    """

    prototype: Prototype
    outer_end_mass_kg: tuple[float, float]
    realisation: Realisation
    judgement: Judgement

    @property
    def reason(self) -> str:
        """Why there is no code; empty where there is."""
        found = self.judgement
        if found.proved or found.reason:
            return ""
        verdicts = (
            ("at once", found.at_once),
            ("one period late", found.late),
            ("after any computing time up to one period", found.any_time),
        )
        for answer, how in ((False, "not stable"), (None, "not proved stable")):
            for words, one in verdicts:
                if one is not None and one.stable is answer:
                    return f"with its current put out {words} the loop is {how}: {one.reason}; no code is written"
        return "the loop is not proved stable; no code is written"

    def rows(self) -> list[tuple[str, float]]:
        """What the law itself loses."""
        law = self.judgement.law
        return [
            ("largest relative error of a coefficient", law.coefficient),
            ("largest relative shift of a pole by rounding", law.pole),
            (f"gain of the law at {law.at_Hz:.4g} Hz against the continuous one, dB", law.gain_dB),
            ("lag there of the law, degrees", law.lag_deg),
            ("  of the hold", law.hold_lag_deg),
            ("  of one period of computing", law.computing_lag_deg),
        ]

    def loop_rows(self) -> list[tuple[str, float, float, float]]:
        """The worst of the loop at all masses looked at: continuous, put out at once, and one period late."""
        found = [worst([getattr(at, at_what) for at in self.judgement.masses]) for at_what in _PUT_OUT]
        return [
            (words, *(getattr(one, key) for one in found))
            for words, key in (
                ("peak sensitivity", "peak_sensitivity"),
                ("gain margin, factor", "gain_up"),
                ("phase margin, degrees", "phase_deg"),
                ("highest crossover, Hz", "crossover_Hz"),
            )
        ]

    def to_dict(self) -> dict[str, Any]:
        """What `beamdesign code` writes of it."""
        made = self.realisation
        readings = [
            {
                "heard": one.heard,
                "unit": one.unit,
                "full_scale": scale,
                "places": places,
                "sections": len(one.sections),
            }
            for one, scale, places in zip(made.channels, made.full_scales, made.places, strict=True)
        ]
        asked = "asked integer places error"
        fields = {
            **picked(made, "rate_Hz word_length signal_places current_places full_scale_V largest_current_A sections"),
            "readings": readings,
            "coefficients": {name: picked(one, asked) for name, one in made.coefficients.items()},
            "outer_end_mass_kg": list(self.outer_end_mass_kg),
            "reason": self.reason or self.judgement.reason,
            **picked(self.judgement, "proved law at_once one_period_late=late any_computing_time=any_time masses"),
        }
        return finite(fields)

    def write(self, folder: Path) -> list[Path]:
        """Write the C files, all of them or none; their paths.

        Raises:
            OSError: where one cannot be written.
        """
        texts = c_files(self.realisation, self.prototype.name, notes(self.judgement, self.outer_end_mass_kg))
        return list(write_set(folder, {file: (file, text) for file, text in texts.items()}).values())


_PUT_OUT = ("continuous", "at_once", "late")


def code(
    prototype: Prototype,
    rate_Hz: float,
    outer_end_mass_kg: tuple[float, float] | None = None,
    word_length: int | None = 32,
    full_scale_V: float = 10.0,
    largest_current_A: float | None = None,
    any_computing_time: bool = False,
    progress: Progress = silent,
) -> ProvedCode:
    """Realise the controller of a prototype as C code, and prove the loop with it.

    Args:
        prototype: with a controller.
        rate_Hz: sampling rate.
        outer_end_mass_kg: range over which to prove it; else the prototype's payload, or none.
        word_length: bits of a fixed-point word with its sign; None for floats of 32 bits.
        full_scale_V: largest error.
        largest_current_A: limit; else the valve's rated current, or the gain times the full scale.
        any_computing_time: prove it for every computing time up to one period as well.
        progress: called with the share done and what is being done.

    Raises:
        InputError: without a controller, or for one that cannot be realised so.
    """
    if prototype.controller is None:
        raise InputError(prototype.name, [("controller", "missing")])
    masses = outer_end_mass_kg or prototype.payload.outer_end_mass_kg or (0.0, 0.0)
    limit = largest_current_A or prototype.actuator.largest_current_A(prototype)
    try:
        scales = full_scales_of(prototype, full_scale_V)
        made = realise(prototype.controller, rate_Hz, word_length, full_scale_V, limit, full_scales=scales)
    except ValueError as error:
        raise InputError(prototype.name, [("controller", str(error))]) from error
    found = judge(prototype, made, masses)
    if any_computing_time and found.proved:
        found = replace(found, any_time=prove_any_computing_time(realised_loop(prototype, made), *masses, progress))
    return ProvedCode(prototype, masses, made, found)
