"""Whether what a prototype states under [guarantee] is what the certificate it names proves of it."""

from collections.abc import Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from flint import fmpq

from beamdesign.checker.box_loop import deviations_of, figures, holds
from beamdesign.checker.prototype import masses_of, number_of, table_of
from beamdesign.checker.reading import Table
from beamdesign.checker.rig import Rig
from beamdesign.checker.roots import Pair


def rests_on(
    prototype: Mapping[str, Any], data: bytes, source: str | Path, table: Table, rig: Rig
) -> Iterator[tuple[bool, str]]:
    """Whether the guarantee that a prototype states rests on this certificate, where it says so, and keeps to it.

    Args:
        prototype: its table.
        data: the certificate as it was read.
        source: where from.
        table: the certificate, whose statements are proved elsewhere.
        rig: that it states.
    """
    guarantee = prototype.get("guarantee")
    if not isinstance(guarantee, dict):
        return
    if guarantee.get("certificate_sha256") == sha256(data).hexdigest():
        beyond = list(_beyond(prototype, table.again(), rig))
        yield from ((False, f"the prototype's [guarantee] states {words}") for words in beyond)
        if not beyond:
            yield True, "the prototype's [guarantee] rests on this very file"
    elif isinstance(source, Path) and guarantee.get("certificate") == source.name:
        yield False, "the prototype's [guarantee] rests on a file of this name with another content (sha256)"


def _beyond(prototype: Mapping[str, Any], table: Table, rig: Rig) -> Iterator[str]:
    """What is stated beyond what the certificate says, in words."""
    guarantee, compliance = prototype["guarantee"], number_of(prototype, "goal", "compliance_m_per_N")
    box = table.optional("range")
    bandwidth, peak, count = (
        number_of(prototype, "guarantee", key) if key in guarantee else fmpq(0)
        for key in ("bandwidth_Hz", "peak_sensitivity", "sigmas")
    )
    asked, key = (box, "outer_end_mass") if box.keys else (table, "outer_end_mass_kg")
    spread = deviations_of(table, figures(rig)) if box.keys else {}
    tolerated = "outer_end_mass" in table_of(prototype, "tolerance")
    share = count * number_of(prototype, "tolerance", "outer_end_mass") if tolerated else fmpq(0)
    low, high = masses_of(guarantee) if "outer_end_mass_kg" in guarantee else asked.range(key)
    asked_masses = (low * (1 - share), high * (1 + share)) if "outer_end_mass_kg" in guarantee else (low, high)
    if count and (not box.keys or ("tolerance" not in table and any(table_of(prototype, "tolerance").values()))):
        yield "standard deviations, of which the certificate is not"
    for name, deviations in spread.items():
        value = figures(rig).get(name, fmpq(0))
        held = box.range(name) if name in box else (value, value)
        if count and value and any(deviations) and not holds(held, value, count, *deviations):
            yield f"more standard deviations of {name} than the certificate is of"
    if not _within(asked_masses, asked.range(key)):
        yield "payloads beyond those of the certificate"
    claims = [one for one in table.tables("claim") if _is_about(one, key, asked_masses)]
    if bandwidth and not any(_reaches(one, compliance, bandwidth) for one in claims):
        yield "a bandwidth beyond that of the certificate"
    if peak and not any(one.take("kind") == "peak_sensitivity" and one.number("limit") <= peak for one in claims):
        yield "a peak sensitivity below that of the certificate"


def _is_about(claim: Table, key: str, masses: Pair) -> bool:
    """Whether a claim is said to hold, over all of some payloads."""
    own = claim.optional("range")
    return ("holds" not in claim or claim.flag("holds")) and (key not in own or _within(masses, own.range(key)))


def _reaches(claim: Table, compliance: fmpq, bandwidth: fmpq) -> bool:
    """Whether it is of a compliance, up to a frequency."""
    if claim.take("kind") != "compliance" or claim.number("limit") > compliance:
        return False
    until = claim.take("bandwidth_Hz") if "bandwidth_Hz" in claim else "infinite"
    return until == "infinite" or bandwidth <= claim.number("bandwidth_Hz")


def _within(inner: Pair, outer: Pair) -> bool:
    return bool(outer[0] <= inner[0] <= inner[1] <= outer[1])
