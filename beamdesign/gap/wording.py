"""A diagnosis in two sentences."""

from collections.abc import Sequence

from beamdesign.gap.diagnosis import Cause, Gap, Verdict, Where


def sentences(
    verdict: Verdict, causes: Sequence[Cause], chosen: Sequence[str], gap: Gap, where: Where, in_step: bool = False
) -> str:
    """The verdict for people: what it is, and how far the gap closes.

    Args:
        verdict: in a word.
        causes: most probable first.
        chosen: names of those that are held responsible.
        gap: as measured.
        where: it lies.
        in_step: whether errors are those of models that follow the records.
    """
    errors = (
        f"On records left out of the fits that measure it, the {'error in step' if in_step else 'prediction error'} "
        "falls from "
        f"{gap.before:.1%} of the signal "
        f"({gap.tuned:.1%} with tolerances re-tuned) to {gap.after:.1%}; "
        f"the sensor's noise alone is {gap.noise_floor:.1%}."
    )
    by_name = {cause.name: cause for cause in causes}
    match verdict:
        case "no_gap":
            first = "There is no gap that the tolerances of the prototype would not explain."
        case "effect":
            first = f"The gap is caused by {_listed([by_name[name] for name in chosen])}."
        case "ambiguous":
            others = [c for c in causes if c.name not in chosen][:3]
            rivals = f"; it may as well be {_listed(others, 'or')}" if others else ""
            first = f"The gap is most probably caused by {_listed([by_name[name] for name in chosen])}{rivals}."
        case _:
            place = f" It lies in the {where.subsystem}." if where.subsystem else ""
            first = f"Nothing that is known here explains the gap.{place}"
    return f"{first} {errors}"


def _listed(causes: Sequence[Cause], word: str = "and") -> str:
    named = [f"{c.name.replace('parameter:', 'a wrong ')} ({c.probability:.0%})" for c in causes]
    return named[0] if len(named) == 1 else f"{', '.join(named[:-1])} {word} {named[-1]}"
