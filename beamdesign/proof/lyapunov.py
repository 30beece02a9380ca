"""What is proved of a loop whose payload changes in motion: at any rate, at a bounded rate, and in sudden steps."""

from dataclasses import dataclass
from math import inf

from flint import fmpq

from beamdesign.polynomial import exact
from beamdesign.proof.any_change import AnyChange, Status, any_change
from beamdesign.proof.bounded_rate import BoundedRate, Update, bounded_rate, quiet
from beamdesign.proof.decrease import Joining
from beamdesign.proof.growth import Frozen, frozen
from beamdesign.proof.mass_family import MassFamily, closed_loop
from beamdesign.proof.rational import nearest
from beamdesign.proof.sudden_change import SuddenChange, sudden_change
from beamdesign.prototype import Prototype

JOININGS: tuple[Joining, ...] = ("matched", "from_rest")


@dataclass(frozen=True)
class Switching:
    """Everything that was proved, or not, about a mass m(t) that moves within a range.

    Each claim is about one kind of course; a course that mixes them, such as sudden changes between ramps, is covered
    by `any_change` alone, and only where payload is matched in velocity.

    Attributes:
        outer_end_mass_kg: the range.
        frozen: every mass that stays, exactly.
        any_change: however fast, payload matched in velocity.
        rates: bounded |dm/dt|, one for each way of joining.
        sudden: sudden changes with time between them, one for each way of joining.
        wanted_kg_per_s: the rate that was asked for, None where the largest was searched for.
        family: the loop it is about.
    """

    outer_end_mass_kg: tuple[float, float]
    frozen: Frozen
    any_change: AnyChange
    rates: tuple[BoundedRate, ...]
    sudden: tuple[SuddenChange, ...]
    wanted_kg_per_s: float | None
    family: MassFamily

    @property
    def stable(self) -> bool:
        """Whether a rate is proved for both ways of joining: the one asked for, or else any at all."""
        return all(rate.status == "proved" for rate in self.rates)

    @property
    def reason(self) -> str:
        """Why the answer is no, in words; empty where it is yes."""
        return "; ".join(f"payload {r.joining.replace('_', ' ')}: {r.reason}" for r in self.rates if r.reason)


def switching(
    prototype: Prototype, low_kg: float, high_kg: float, wanted_kg_per_s: float | None = None, update: Update = quiet
) -> Switching:
    """Prove what can be proved of a prototype's loop while its outer end mass changes between two masses.

    Args:
        prototype: with a controller.
        low_kg: least mass.
        high_kg: largest mass, above `low_kg`.
        wanted_kg_per_s: a rate |dm/dt| to prove; the largest is searched for where it is left out.
        update: told of progress.

    Raises:
        ValueError: without a controller, for a range that does not hold two masses, or a rate that is not positive.
    """
    if not low_kg < high_kg:
        raise ValueError(f"the mass cannot change between {low_kg:g} and {high_kg:g} kg")
    if wanted_kg_per_s is not None and not 0 < wanted_kg_per_s < inf:
        raise ValueError(f"the rate must be positive and finite, is {wanted_kg_per_s}")
    family = closed_loop(prototype)
    low, high = exact(low_kg), exact(high_kg)
    stays = frozen(family, low, high)
    if not stays.stable:
        return _refuted(family, (low_kg, high_kg), stays, wanted_kg_per_s)
    update(0.05, "any change")
    common, reached = any_change(family, low, high)
    wanted = None if wanted_kg_per_s is None else exact(wanted_kg_per_s)
    rates: list[BoundedRate] = []
    sudden: list[SuddenChange] = []
    for share, joining in zip((0.3, 0.65), JOININGS, strict=True):
        if joining == "matched" and common.status == "proved" and common.function is not None:
            rates.append(BoundedRate("proved", "", joining, inf, (common.function,)))
            sudden.append(SuddenChange("proved", "", joining, fmpq(0), fmpq(1), fmpq(0), (common.function,)))
            continue

        def part(fraction: float, text: str = "", share: float = share) -> None:
            update(share + 0.3 * fraction, text)

        rates.append(bounded_rate(family, low, high, joining, reached.coordinates, wanted, update=part))
        update(share + 0.3, f"sudden changes, mass {joining.replace('_', ' ')}")
        sudden.append(sudden_change(family, low, high, joining, reached.coordinates))
    return Switching((low_kg, high_kg), stays, common, tuple(rates), tuple(sudden), wanted_kg_per_s, family)


def _refuted(family: MassFamily, range_kg: tuple[float, float], stays: Frozen, wanted: float | None) -> Switching:
    """A mass that stays is a course of m(t) too: where one is not stable, no claim about all courses holds."""
    reason = f"not stable even for a mass that stays: {stays.reason}"
    return Switching(
        range_kg,
        stays,
        AnyChange("refuted", reason, range_kg, None, None, None),
        tuple(BoundedRate("refuted", reason, joining, None, ()) for joining in JOININGS),
        tuple(SuddenChange("refuted", reason, joining, None, fmpq(0), fmpq(0), ()) for joining in JOININGS),
        wanted,
        family,
    )


def describe(found: Switching) -> list[str]:
    """The result in words, one line for each statement."""
    low, high = found.outer_end_mass_kg
    if not found.frozen.stable:
        return [
            f"REFUTED: not every mass from {low:g} to {high:g} kg is stable even if it stays: {found.frozen.reason}"
        ]
    lines = [f"proved: stable for every mass from {low:g} to {high:g} kg that stays"]
    common = found.any_change
    matched = "however fast the mass changes, payload joining and leaving with the tip's velocity"
    if common.status == "proved":
        lines.append(f"proved: stable {matched}")
    else:
        lines.append(f"{_head(common.status)}: {matched}: {common.reason}")
        if common.proved_up_to_kg is not None:
            lines.append(f"proved: the same from {low:g} to {common.proved_up_to_kg:g} kg")
    for rate in found.rates:
        if rate.rate_kg_per_s == inf:
            continue
        if rate.status == "proved":
            lines.append(f"proved: stable for |dm/dt| up to {rate.rate_kg_per_s:g} kg/s, {_WORDS[rate.joining]}")
        else:
            asked = "any rate" if found.wanted_kg_per_s is None else f"|dm/dt| up to {found.wanted_kg_per_s:g} kg/s"
            lines.append(f"{_head(rate.status)}: {asked}, {_WORDS[rate.joining]}: {rate.reason}")
    for sudden in found.sudden:
        if sudden.dwell_s == 0:
            continue
        if sudden.status == "proved" and sudden.dwell_s is not None:
            dwell = f"{nearest(sudden.dwell_s):.4g} s"
            lines.append(
                f"proved: stable for sudden changes at least {dwell} apart on average, {_WORDS[sudden.joining]}"
            )
        else:
            lines.append(f"{_head(sudden.status)}: sudden changes, {_WORDS[sudden.joining]}: {sudden.reason}")
    return lines


_WORDS = {
    "matched": "payload joining with the tip's velocity",
    "from_rest": "payload joining at rest or with any part of the tip's velocity",
}


def _head(status: Status) -> str:
    return {"unverified": "UNVERIFIED, so not known to be stable"}.get(status, status.upper())
