"""What `beamdesign tune --robust` and `certify --robust` tell of the rigs that they prove beside the nominal one."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamdesign.cli.certificate_file import write_certificate
from beamdesign.cli.output import say, say_table

if TYPE_CHECKING:
    from beamdesign.design.rig_spread import RigSpread, Shape
    from beamdesign.design.tuning import Tuning
    from beamdesign.proof.certificate import Asked
    from beamdesign.prototype import InStage, Prototype

DRAWS = 32
"""Rigs that are drawn at random, each decided in exact arithmetic."""


def with_stated_tolerances(record: "Prototype") -> "Prototype":
    """The prototype as it is where it states tolerances, else with typical ones, and a word on it."""
    from beamdesign.gap.examination.caution import with_tolerances

    found, cautions = with_tolerances(record)
    for caution in cautions:
        say(caution.text)
    return found


def told_of_rigs(
    stage: "InStage", law: "Tuning", shape: tuple[float, "Shape"], texts: dict[str, tuple[str, str]]
) -> dict[str, Any]:
    """Prove the worst rigs, draw others, say what they keep; what the JSON file says of it.

    Certificates are added to `texts`, name of the file and content by kind.
    """
    from beamdesign.design.rig_spread import rig_spread
    from beamdesign.design.robust_tuning import rigs_of
    from beamdesign.study.robust_proof import CONFIDENCE, draw_rigs, prove_rigs

    best, masses, end = law.best, stage.outer_end_mass_kg, stage.suffix
    assert best is not None
    spread = rig_spread(stage.prototype, masses[1], *shape)
    found = rigs_of(spread, law.worst)
    certificates = prove_rigs(found.rigs, best, masses)
    if refuted := [certificate.reason for certificate in certificates if not certificate.holds]:
        raise AssertionError(f"a rig that was proved is refuted: {refuted[0]}")
    for k, certificate in enumerate(certificates, start=1):
        texts[f"certificate_rig_{k}{end.replace('.', '_')}"] = (f"certificate{end}.rig-{k}.toml", certificate.text)
    _table(spread, found.factors)
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


def _table(spread: "RigSpread", factors: Sequence[dict[str, float]]) -> None:
    """What the figures of each rig are off by."""
    names = [name for name in spread.deviations if any(one.get(name, 1.0) != 1.0 for one in factors)]
    rows = [(name, *(f"{100 * (one.get(name, 1.0) - 1):+.1f}" for one in factors)) for name in names]
    say_table("worst rigs: figures off by, %", ("figure", *(str(k + 1) for k in range(len(factors)))), rows)


def certified_rigs(
    record: "Prototype",
    masses: tuple[float, float],
    asked: Sequence["Asked"],
    sigmas: float,
    shape: "Shape",
    path: Path,
) -> tuple[bool, dict[str, Any]]:
    """Certify the worst rigs of a prototype and say what each guarantees; whether all keep what was asked, and which.

    Certificates go beside that of the nominal rig.
    """
    from beamdesign.design.rig_spread import rig_spread
    from beamdesign.design.robust_tuning import worst_of
    from beamdesign.proof.certifying import certify

    spread = rig_spread(with_stated_tolerances(record).but(guarantee=None), masses[1], sigmas, shape)
    found = worst_of(spread, masses)
    _table(spread, found.factors)
    every, rows = True, []
    for k, rig in enumerate(found.rigs, start=1):
        certificate = certify(rig, *masses, asked)
        write_certificate(path.with_suffix(f".rig-{k}.toml"), certificate.text)
        every = every and certificate.holds
        reached = certificate.guaranteed
        rows.append(
            (
                str(k),
                "no" if reached is None else "yes",
                "" if reached is None else f"{reached.bandwidth_Hz:.4g}",
                "" if reached is None else f"{reached.peak_sensitivity:.4g}",
                certificate.reason,
            )
        )
    say_table("proved of each", ("rig", "stable", "bandwidth, Hz", "peak sensitivity", "refuted"), rows)
    say(f"{reach_in_words(spread)}; the rigs between are not proved")
    return every, {"robust": {"sigmas": sigmas, "shape": shape, "rigs": list(found.factors), "holds": every}}


def reach_in_words(spread: "RigSpread") -> str:
    """How far the rigs are off that the design was tuned for."""
    if spread.shape == "box":
        return (
            f"the worst rigs of a box of {spread.sigmas:g} standard deviations of every figure were sought on samples"
        )
    return f"the worst rigs {spread.sigmas:g} standard deviations off in all were sought on samples"
