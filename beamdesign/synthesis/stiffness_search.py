"""Search for the lag and the force filter that give the end a stiffness over the widest band.

Sampled: curves at both ends of the payload, local search from many starts, rigs drawn from the tolerances. Proved:
whatever is taken, on the nominal rig and on each of those.

A design is carried to a prototype and its two certificates: of the loop, and of the tip as a port. What its controller
does on further rigs drawn from the tolerances is decided rig by rig.
"""

from dataclasses import dataclass, replace
from math import inf
from typing import Any

import numpy as np

from beamdesign.arguments import checked, takes
from beamdesign.controllers import Cascade, Lag, Observer
from beamdesign.loop import Loop, close_loop
from beamdesign.plant.assembly import pace
from beamdesign.plant.linear import Plant
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import exact
from beamdesign.progress import Progress, part_of, silent
from beamdesign.proofs.certificate import Asked, Certificate, goal_claims
from beamdesign.proofs.certifying import certify
from beamdesign.proofs.contact import Wall
from beamdesign.proofs.performance import prove
from beamdesign.proofs.rectangle import Rectangle
from beamdesign.prototype import Compliance, Prototype
from beamdesign.quantities import ComponentFrequency, Frequency, LawGain, Stiffness, range_of
from beamdesign.records import InputError
from beamdesign.result import Result, picked
from beamdesign.synthesis import RIGS
from beamdesign.synthesis.design_run import stating
from beamdesign.synthesis.end_stiffness import (
    NEEDS,
    SHARE,
    EndStiffness,
    Need,
    contact_text,
    controller_of,
    in_contact,
    judge,
    least_gain,
    sensed,
    servo_stiffness,
)
from beamdesign.synthesis.loop_samples import first_miss
from beamdesign.synthesis.rig_spread import deviations_of, rig_spread
from beamdesign.time_limit import leave_out, over, share

_SEARCH_HZ = np.geomspace(1e-2, 1e3, 400)
"""Of a rig as quick as the published one, as are the bounds of frequencies below."""
_ROUNDS, _STARTS, _STEPS = 3, 200, 400
_KEPT_STARTS, _KEPT_STEPS = 40, 40
_REFINING_STEPS = 200
SEED_OF_RIGS = 1000
_REACH = 1.5
"""How many times as far off as the tolerances say the rigs are that a law has to suit."""

_SERVO_OVER_BEAM = 10.0
"""Least stiffness of the servo over that of its outer beam: a command is followed at rest but for a tenth."""

_LOWEST, _HIGHEST = np.log10([1e-6, 0.05, 0.05, 0.3]), np.log10([3.0, 2e3, 2e3, 2e3])
"""Of gain (A/V), pole, zero and force filter (Hz)."""
_OF_EACH = np.log10([(one.low, one.high) for one in map(range_of, (LawGain, Frequency, Frequency, ComponentFrequency))])
"""What a law may have of each."""
_GAINS = 3.0
"""Powers of ten over which gains are sought at the least."""


CONTACTS: dict[str, Need] = {"passive": "passive", "wall": "wall", "none": "stable"}
"""What contact has to be by the name that a user gives it."""


@dataclass(frozen=True, repr=False)
class Design(Result):
    """Outcome of `design` and of `stiffness`.

    Attributes:
        best: what was proved of the law found; None where there is none.
        met: what contact is proved to be.
        tried: how many laws were looked at.
        reason: why there is no answer, or why it is less than was hoped for; empty otherwise.
        prototype: with the controller of a law that was searched and found, what that stands for, and its guarantee.
        certificate: of its loop over the payload.
        contact: text of the certificate of its tip.
        asked: the least that contact was to be.
    """

    best: EndStiffness | None
    met: Need | None
    tried: int
    reason: str = ""
    prototype: Prototype | None = None
    certificate: Certificate | None = None
    contact: str = ""
    asked: Need = "stable"

    @property
    def yes(self) -> bool:
        """Whether there is a law with which contact is what it was to be."""
        return self.best is not None and self.best.meets(self.asked)

    def to_dict(self) -> dict[str, Any]:
        """What a JSON file holds of it."""
        found = {"controller": None} if self.best is None else self.best.to_dict()
        return found | picked(self, "met reason")


@takes("Prototype")
def stiffness(
    prototype: Prototype,
    end_stiffness_N_per_m: float | None = None,
    outer_end_mass_kg: tuple[float, float] | None = None,
    wall_N_per_m: tuple[float, float] = (0.0, 1e9),
    wall_damping_N_s_per_m: tuple[float, float] = (0.0, 0.0),
    contact: str = "wall",
    keep_controller: bool = False,
    rigs: int = RIGS,
    progress: Progress = silent,
) -> Design:
    """Give the end of a link a stiffness, and prove what contact it bears; or judge the controller as it is.

    Args:
        prototype: the rig; its goal limits the peak sensitivity, and loop gain and effort where it sets them.
        end_stiffness_N_per_m: static F / x that the end is to have; None to judge the prototype's own controller.
        outer_end_mass_kg: range of payloads; else the prototype's.
        wall_N_per_m: stiffness of the walls that it may touch, least and most.
        wall_damping_N_s_per_m: damping of these walls.
        contact: the least that contact has to be: "passive", "wall" or "none"; more is taken where it can be had.
        keep_controller: keep the prototype's controller, and choose the force filter alone.
        rigs: drawn from the prototype's tolerances, that the law has to suit as well.
        progress: told the share done and what is being done.

    Raises:
        InputError: for effects, without a range of payloads, without a controller to keep, or for figures that are not
            plausible.
        ValueError: for a controller that cannot be judged, see `judge`, or an empty range.
    """
    ranges = {"wall_N_per_m": wall_N_per_m, "wall_damping_N_s_per_m": wall_damping_N_s_per_m}
    wrong = [
        (key, f"expected a least and a largest figure, neither negative, is {low:g}:{high:g}")
        for key, (low, high) in ranges.items()
        if not 0 <= low <= high < inf
    ]
    if contact not in CONTACTS:
        wrong.append(("contact", f"is {contact!r}; expected {', '.join(CONTACTS)}"))
    if wrong:
        raise InputError(prototype.name, wrong)
    need, masses = CONTACTS[contact], prototype.asked_kg(outer_end_mass_kg)
    wall = Wall(*((exact(low), exact(high)) for low, high in (wall_N_per_m, wall_damping_N_s_per_m)))
    if end_stiffness_N_per_m is None:
        judged = judge(prototype, None, masses, wall)
        refused = "" if judged.meets(need) else judged.reason or f"the end is not {NEEDS[need]}"
        return Design(judged, judged.met, 0, refused, asked=need)
    checked(prototype.name, "end_stiffness_N_per_m", Stiffness, end_stiffness_N_per_m)
    servo = prototype.kept_servo if keep_controller else None
    others = plants_drawn(prototype, masses[1], rigs, SEED_OF_RIGS, _REACH) if rigs else []
    if servo is not None and (most := servo_stiffness(prototype, servo)) < end_stiffness_N_per_m:
        reason = f"the servo alone holds {most:.4g} N/m, less than {end_stiffness_N_per_m:.4g} N/m; it needs more gain"
        return Design(None, None, 0, reason)
    needs, tried, refused = list(NEEDS), 0, ""
    needs = needs[: needs.index(need) + 1]
    for k, one in enumerate(needs):
        search = _Search(prototype, others, end_stiffness_N_per_m, masses, wall, one, servo)
        with share(1 / (len(needs) - k)):
            law = search.best(part_of(progress, k / len(needs), (k + 1) / len(needs)))
        tried += search.tried
        if law is not None:
            found = judge(prototype, law, masses, wall)
            return replace(carried_out(prototype, found), tried=tried, reason=refused, asked=need)
        drawn = f", as it is and on {len(others)} rigs drawn from its tolerances" if others else ""
        refused = f"of {tried} laws that were tried, none that keeps the goal is {NEEDS[one]}{drawn}"
    return Design(None, None, tried, refused + _blurred(prototype, end_stiffness_N_per_m) if others else refused)


def _blurred(prototype: Prototype, end_stiffness: float) -> str:
    """What to change where the outer beam is not known well: the force is what bends it, less the cylinder's."""
    deviation = prototype.tolerance.stiffness * paper_model(prototype).figures["outer_stiffness"]
    if end_stiffness > 4 * deviation:
        return ""
    return (
        f"; the outer beam is known to {deviation:.3g} N/m (standard deviation), and the end is stiffer or softer by"
        " as much: measure tolerance.stiffness better, or ask for more"
    )


def plants_drawn(prototype: Prototype, largest_kg: float, count: int, seed: int, reach: float = 1.0) -> list[Plant]:
    """Plants of rigs drawn so many times as far off as the tolerances say; none where no figure of a rig has one."""
    if not deviations_of(prototype):
        return []
    spread = rig_spread(prototype, largest_kg, 1.0)
    return [sensed(spread.rig(z)) for z in spread.drawn(count, seed, reach)]


_Best = tuple[float, np.ndarray | None]
"""Score and point of a law; none scores 0."""


@dataclass
class _Search:
    """One search: laws as logarithms of their figures, scored on samples, admitted by proof."""

    prototype: Prototype
    others: list[Plant]
    end_stiffness: float
    masses_kg: tuple[float, float]
    wall: Wall
    need: Need
    servo: Cascade | None
    tried: int = 0

    def __post_init__(self) -> None:
        self.plant = sensed(self.prototype)
        self.masses = (exact(self.masses_kg[0]), exact(self.masses_kg[1]))
        self.figures = paper_model(self.prototype).figures
        self.frequency_Hz = pace(self.figures) * _SEARCH_HZ

    def best(self, progress: Progress) -> Compliance | None:
        """The admitted law with the largest score; None where none is."""
        words = f"laws that are {NEEDS[self.need]}"
        quicker = np.log10(pace(self.figures)) * np.array([0, 1, 1, 1])
        bounds = np.clip([_LOWEST + quicker, _HIGHEST + quicker], *_OF_EACH.T)
        if self.servo:
            progress(0.0, words)
            point = self._local_search(0, bounds[:, 3:], _KEPT_STARTS, _KEPT_STEPS)[1]
            return None if point is None else self._law(point)
        least = max(1.05 * self.end_stiffness, _SERVO_OVER_BEAM * self.figures["outer_stiffness"])
        bounds[0, 0] = np.log10(max(least_gain(self.prototype, least), 10 ** bounds[0, 0]))
        # What a drive needs of current is its own affair, and may be more: a screw's, or that of a small piston.
        bounds[1, 0] = min(max(bounds[1, 0], bounds[0, 0] + _GAINS), _OF_EACH[0, 1])
        if bounds[0, 0] > bounds[1, 0]:
            return None
        found: list[_Best] = []
        for k in range(_ROUNDS):
            progress(k / (_ROUNDS + 1), words)
            with share(1 / (_ROUNDS + 1 - k)):
                found.append(self._local_search(k, bounds, _STARTS, _STEPS))
        best = max(found, key=lambda one: one[0])
        progress(_ROUNDS / (_ROUNDS + 1), words)
        _, point = self._local_search(_ROUNDS, bounds, 0, _REFINING_STEPS, best, 0.05)
        return None if point is None else self._law(point)

    def _local_search(
        self, seed: int, bounds: np.ndarray, starts: int, steps: int, begin: _Best = (0.0, None), width: float = 0.4
    ) -> _Best:
        """The best law of a local search by ever smaller steps, after scattered starts."""
        (top, point), random = begin, np.random.default_rng(seed)
        for k in range(starts + steps):
            if over():
                leave_out("further laws")
                break
            if k < starts or point is None:
                here = random.uniform(*bounds)
            else:
                reach = width * 0.1 ** ((k - starts) / steps)
                here = np.clip(point + reach * random.standard_normal(len(point)), *bounds)
            controller = controller_of(self.prototype, self._law(here))
            closed = close_loop(self.plant, controller)
            self.tried += 1
            score = self._band(closed)
            if score > top and self._admitted(closed) and self._on_others(controller):
                top, point = score, here
        return top, point

    def _law(self, logarithms: np.ndarray) -> Compliance:
        figures = [float(f"{10**value:.4g}") for value in logarithms]
        servo = self.servo or Lag(gain_A_per_V=figures[0], pole_Hz=figures[1], zero_Hz=figures[2])
        return Compliance(end_stiffness_N_per_m=self.end_stiffness, force_filter_Hz=figures[-1], servo=servo)

    def _band(self, closed: Loop) -> float:
        """First sampled frequency at which the stiffness is off by more than `SHARE`, interpolated, Hz."""
        found = [closed.at(mass).stiffness_response(self.frequency_Hz) / self.end_stiffness for mass in self.masses_kg]
        return min(first_miss(self.frequency_Hz, SHARE - np.abs(ratio - 1)) for ratio in found)

    def _admitted(self, closed: Loop) -> bool:
        """Whether stability, contact and the goal's limits are proved."""
        goal = self.prototype.goal
        asked = (Asked("peak_sensitivity", goal.peak_sensitivity), *goal_claims(goal))
        touches = in_contact(closed, self.masses, self.wall, self.need)
        return touches and all(prove(Rectangle(closed, *self.masses), one).holds for one in asked)

    def _on_others(self, controller: Observer) -> bool:
        """The same on the drawn rigs; one that refuses is asked first the next time."""
        for k, plant in enumerate(self.others):
            if not in_contact(close_loop(plant, controller), self.masses, self.wall, self.need):
                self.others.insert(0, self.others.pop(k))
                return False
        return True


def carried_out(prototype: Prototype, found: EndStiffness) -> Design:
    """Write the controller of a law that was searched into its prototype, and the proofs."""
    law, masses_kg = found.law, found.outer_end_mass_kg
    assert law is not None  # else its controller was judged as it is
    inside = prototype.payload.inner_end_mass_kg
    rig = prototype.with_law(controller_of(prototype, law), masses_kg, inside).but(compliance=law)
    asked = (Asked("peak_sensitivity", found.peak_sensitivity), *goal_claims(prototype.goal))
    proof = certify(rig, *masses_kg, asked)
    bandwidth = 0.0 if proof.guaranteed is None else proof.guaranteed.bandwidth_Hz
    made = stating(rig, proof.text, masses_kg, bandwidth, found.peak_sensitivity)
    return Design(found, found.met, 0, "", made, proof, contact_text(rig, found))


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


def drawn_rigs(prototype: Prototype, masses_kg: tuple[float, float], wall: Wall, count: int) -> tuple[DrawnRig, ...]:
    """Look at rigs whose figures are off by normal deviations, cut off at four.

    Args:
        prototype: with its compliant controller; none are drawn where it states no tolerances.
        masses_kg: range of mass on the outer tip.
        wall: that the tip may lean on.
        count: how many.
    """
    law, masses = prototype.own_controller, (exact(masses_kg[0]), exact(masses_kg[1]))
    drawn = [close_loop(plant, law) for plant in plants_drawn(prototype, masses_kg[1], count, seed=1)]
    return tuple(
        DrawnRig(one.at(0.0).static_stiffness(), **{need: in_contact(one, masses, wall, need) for need in NEEDS})
        for one in drawn
    )


def drawn_in_words(rigs: tuple[DrawnRig, ...]) -> str:
    """How many of them are what, for a person."""
    least, most = min(rig.static_N_per_m for rig in rigs), max(rig.static_N_per_m for rig in rigs)
    kinds = {"stable": "stable", "passive": "passive", "wall": "stable against every wall asked about"}
    counts = ", ".join(f"{sum(getattr(rig, name) for rig in rigs)} {words}" for name, words in kinds.items())
    return (
        f"Sampled: of {len(rigs)} rigs drawn from the tolerances {counts};"
        f" static stiffness {least:.4g} to {most:.4g} N/m."
    )
