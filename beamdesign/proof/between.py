"""Stability of a prototype between the ends of its effects' frozen figures, which its linear members stand at."""

from beamdesign.members import family
from beamdesign.proof.box import BoxVerdict, certify_box
from beamdesign.proof.tolerance_box import tolerance_box
from beamdesign.prototype import Prototype

BUDGET = 4000


def between(prototype: Prototype, low_kg: float, high_kg: float) -> BoxVerdict | None:
    """Prove or refute stability for every value of every frozen figure, factor on the gain and outer end mass at once.

    None where there is no frozen figure, so that the members leave nothing open.

    Raises:
        InputError: for effects for which no linear loop stands.
        ValueError: without a controller.
    """
    found = family(prototype, high_kg)
    if not any(span.low < span.high for span in found.spans.values()):
        return None
    box = tolerance_box(prototype, 0.0, None, (low_kg, high_kg))
    return certify_box(prototype, box, BUDGET, volumes=False)


def in_words(verdict: BoxVerdict | None) -> str:
    """What is known between the ends of the frozen figures; empty where there are none."""
    if verdict is None:
        return ""
    if verdict.stable:
        return "stable at every value between the ends of the frozen figures too, all of them and the masses at once"
    if verdict.stable is None:
        return f"between the ends of the frozen figures stability is undecided: {verdict.reason}"
    return f"between the ends of the frozen figures {verdict.reason}"
