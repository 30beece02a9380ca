"""What a compliant controller does on rigs drawn from the tolerances of its prototype: decided rig by rig, sampled."""

from dataclasses import dataclass

from flint import fmpq

from beamdesign.controllers import Controller
from beamdesign.design.end_stiffness import sensed
from beamdesign.design.rig_spread import rig_spread
from beamdesign.loop import close_loop
from beamdesign.polynomial import exact
from beamdesign.proof.contact import Wall, prove_contact
from beamdesign.proof.passivity import active_bands
from beamdesign.proof.stability import is_stable_over
from beamdesign.prototype import Prototype
from beamdesign.tip import tip


@dataclass(frozen=True)
class DrawnRig:
    """One rig with the controller of the prototype.

    Attributes:
        static_N_per_m: static stiffness of its end; not positive for one that cannot stay where it is.
        stable: whether it is with every end mass of the range.
        passive: whether it is stable and its tip is passive.
        wall: whether it is stable against every wall with every end mass.
    """

    static_N_per_m: float
    stable: bool
    passive: bool
    wall: bool


def drawn_rigs(
    prototype: Prototype, masses_kg: tuple[float, float], wall: Wall, count: int, seed: int = 1
) -> tuple[DrawnRig, ...]:
    """Look at rigs whose figures are off by normal deviations, cut off at four.

    Args:
        prototype: with its compliant controller; none are drawn where it states no tolerances.
        masses_kg: range of mass on the outer tip.
        wall: that the tip may lean on.
        count: how many.
        seed: of the draw.
    """
    law = prototype.controller
    assert law is not None
    if not any(prototype.tolerance.model_dump().values()):
        return ()
    spread = rig_spread(prototype, masses_kg[1], 1.0)
    masses = (exact(masses_kg[0]), exact(masses_kg[1]))
    return tuple(_looked_at(spread.rig(z), law, masses, wall) for z in spread.drawn(count, seed))


def _looked_at(rig: Prototype, law: Controller, masses: tuple[fmpq, fmpq], wall: Wall) -> DrawnRig:
    port = tip(close_loop(sensed(rig), law))
    stable = is_stable_over(port.over_mass, *masses)
    return DrawnRig(
        port.static_stiffness(),
        stable,
        stable and not active_bands(port),
        stable and prove_contact(port, masses, wall).holds,
    )


def in_words(rigs: tuple[DrawnRig, ...]) -> str:
    """How many of them are what, for a person."""
    least, most = min(rig.static_N_per_m for rig in rigs), max(rig.static_N_per_m for rig in rigs)
    counts = ", ".join(
        f"{sum(getattr(rig, name) for rig in rigs)} {words}"
        for name, words in (("stable", "stable"), ("passive", "passive"), ("wall", "stable against every wall"))
    )
    return (
        f"Sampled: of {len(rigs)} rigs drawn from the tolerances {counts};"
        f" static stiffness {least:.4g} to {most:.4g} N/m."
    )
