"""A diagnosis from critical gains and responses in words."""

from collections.abc import Sequence

import numpy as np

from beamdesign.gap.diagnosis import Gap, Verdict
from beamdesign.gap.fitting.gain_evidence import GainEvidence
from beamdesign.gap.fitting.hypothesis import NOTHING
from beamdesign.gap.gains.search import Figure
from beamdesign.gap.gains.shares import CommonFactor, GainShares

_DIFFERS = 0.1  # of a gain, from which the model is said to be another than the designers'
_SHOWN = 5


def sentences(verdict: Verdict, rivals: Sequence[str], chosen: Sequence[str], gap: Gap) -> str:
    """The verdict in two sentences."""
    errors = (
        f"Each figure as predicted from the others is off by {gap.before:.0%} for the believed model, by"
        f" {gap.tuned:.0%} with tolerances fitted and by {gap.after:.0%} with the best explanation; their own errors"
        f" are {gap.noise_floor:.0%}."
    )
    named = [_plain(name) for name in rivals]
    match verdict:
        case "no_gap":
            first = "There is no gap that the tolerances of the prototype would not explain."
            return f"{first} {errors}"
        case "effect":
            first = f"The gap is caused by {_plain(' + '.join(chosen))}."
        case "ambiguous":
            more = f"; and {len(named) - _SHOWN} more" if len(named) > _SHOWN else ""
            common = f"All of them hold {_plain(' + '.join(chosen))}." if chosen else "No single culprit can be named."
            first = f"These figures cannot tell apart: {'; '.join(named[:_SHOWN])}{more}. {common}"
        case _:
            first = "Nothing that is known here explains these figures."
    return f"{first} {errors}"


def notes_of(silent: Sequence[str], shares: GainShares | None, factor: CommonFactor | None) -> tuple[str, ...]:
    """What else has to be said."""
    said = [
        "Critical gains and responses are those of the linear loop at small motion beyond deadband, hysteresis, play"
        " and dry friction; of unequal sides the smaller one governs the gain."
    ]
    if silent:
        said.append(f"Of no consequence here whatever their size, so neither found nor excluded: {', '.join(silent)}.")
    if factor is not None:
        said.append(
            f"One common factor of {factor.factor:.2f} +- {factor.std:.2f} on the model's gains takes away"
            f" {factor.explained:.0%} of the mean square distance ({factor.before:.0%} to {factor.left:.0%})."
            " Flow gain, sensor gain and piston area all act as such a factor."
        )
    if shares is not None:
        parts = ", ".join(
            f"{s.name} {s.share:+.2f} (alone {s.alone:+.2f})" for s in shares.shares if s.name != "common_factor"
        )
        said.append(
            f"Of the mean ln(measured/model) of {shares.total:+.2f}, the published rig's filter and smaller piston side"
            f" would carry {shares.together:+.2f} together: {parts}, means over the orders of adding them;"
            f" {shares.total - shares.together:+.2f} would be left to a common factor."
        )
    return tuple(said)


def notes_on_predictions(evidence: Sequence[Figure], factor: CommonFactor | None, explained: str) -> tuple[str, ...]:
    """What measurement and the designers' own predictions say, and where the believed model is another than theirs."""
    said = []
    if factor is not None:
        said.append(
            f"Against the designers' own predictions one common factor of {factor.factor:.2f} +- {factor.std:.2f} takes"
            f" away {factor.explained:.0%} of the mean square distance ({factor.before:.0%} to {factor.left:.0%})."
        )
    said.append(f"From these predictions, with the model telling the changes only: {explained}")
    for piece in evidence:
        if not isinstance(piece, GainEvidence) or piece.measured.predicted_gain is None:
            continue
        placement = NOTHING.placement(piece.prototype)
        told, at = piece.measured.predicted_gain, piece.predicted(placement, np.zeros(len(placement.unknowns)))
        if at is not None and abs(at.gain / told - 1) > _DIFFERS:
            said.append(
                f"{piece.name}: the believed model gives {1e3 * at.gain:.3g} mA/V where the designers predicted"
                f" {1e3 * told:.3g}, so that its gap holds what their models differ in."
            )
    return tuple(said)


def _plain(name: str) -> str:
    return "something unknown" if name == "unknown" else name.replace("parameter:", "a wrong ").replace("_", " ")
