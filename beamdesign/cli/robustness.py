"""What `beamdesign tune --robust` tells of the rigs that it proved beside the nominal one."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamdesign.cli.output import say, say_table
from beamdesign.whole_file import write_whole

if TYPE_CHECKING:
    from beamdesign.design.refinement import Proved
    from beamdesign.design.rig_spread import RigSpread
    from beamdesign.design.robust_tuning import RobustTuning
    from beamdesign.prototype import Prototype

DRAWS = 32
"""Rigs that are drawn at random, each decided in exact arithmetic."""


def with_stated_tolerances(record: "Prototype") -> "Prototype":
    """The prototype as it is where it states tolerances, else with typical ones, and a word on it."""
    from beamdesign.gap.examination.typical_tolerances import with_tolerances

    found, cautions = with_tolerances(record)
    for caution in cautions:
        say(caution.text)
    return found


def told_of_rigs(
    found: "RobustTuning", best: "Proved", masses: tuple[float, float], out: Path | None, paths: dict[str, Path]
) -> dict[str, Any]:
    """Prove the worst rigs, draw others, say what they keep, write certificates; what the JSON file says of it."""
    from beamdesign.study.robust_proof import CONFIDENCE, draw_rigs, prove_rigs

    spread = found.spread
    certificates = prove_rigs(found.rigs, best, masses)
    if refuted := [certificate.reason for certificate in certificates if not certificate.holds]:
        raise AssertionError(f"a rig that was proved is refuted: {refuted[0]}")
    for k, certificate in enumerate(certificates, start=1):
        if out is not None:
            paths[f"certificate_rig_{k}"] = out / f"certificate.rig-{k}.toml"
            write_whole(paths[f"certificate_rig_{k}"], certificate.text)
    names = [name for name in spread.deviations if any(factors.get(name, 1.0) != 1.0 for factors in found.factors)]
    rows = [(name, *(f"{100 * (factors.get(name, 1.0) - 1):+.1f}" for factors in found.factors)) for name in names]
    say_table("worst rigs: figures off by, %", ("figure", *(str(k + 1) for k in range(len(found.factors)))), rows)
    say(f"proved: these {len(certificates)} rigs and the nominal one, each for every outer end mass")
    draws = draw_rigs(spread, best, masses, DRAWS)
    say(
        f"sampled: {reach_in_words(spread)}; of {draws.count} rigs drawn from the tolerances {draws.bandwidth_kept}"
        f" keep the bandwidth (at least {100 * draws.least_share:.0f} % of all, at {100 * CONFIDENCE:.0f} %"
        f" confidence), {draws.kept} every limit; the draws are decided in exact arithmetic, the rigs between are not"
    )
    return {
        "sigmas": spread.sigmas,
        "shape": spread.shape,
        "deviations": dict(spread.deviations),
        "rigs": list(found.factors),
        "drawn": draws.count,
        "drawn_bandwidth_kept": draws.bandwidth_kept,
        "drawn_all_kept": draws.kept,
        "least_share_bandwidth_kept": draws.least_share,
        "confidence": CONFIDENCE,
    }


def reach_in_words(spread: "RigSpread") -> str:
    """How far the rigs are off that the design was tuned for."""
    if spread.shape == "box":
        return (
            f"the worst rigs of a box of {spread.sigmas:g} standard deviations of every figure were sought on samples"
        )
    return f"the worst rigs {spread.sigmas:g} standard deviations off in all were sought on samples"
