"""What there is to say of one design in a search for a law: its worth, its worst rigs, and what is proved of it."""

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from beamdesign.controllers import Controller
from beamdesign.controllers.form import Form
from beamdesign.polynomial import exact
from beamdesign.proofs.absolute_stability import FOR_ODD, absolute_stability
from beamdesign.proofs.performance import bandwidth
from beamdesign.prototype import Goal
from beamdesign.synthesis.law_task import Search
from beamdesign.synthesis.loop_limits import LARGEST_BANDWIDTH_HZ, LoopSet, Proved, calmer, loop_set
from beamdesign.synthesis.rig_spread import BoxTask, Cut
from beamdesign.time_limit import over

ENOUGH = 0.985
"""Share of the sampled bandwidth which, if proved, ends the search for more."""

ROOM = 2e-3
"""By how much (logarithm) limits are kept to spare of a design that is proved over a box, where proofs need room."""

_KNOWN = 0.98
"""Share of the largest compliance with the servo off of a box that is enough on samples."""


@dataclass(frozen=True)
class Design:
    """A form, variables with the mass inside and what sections there are, and their value on samples."""

    form: Form
    variables: np.ndarray
    value: float

    @property
    def law(self) -> Controller:
        """Its controller."""
        return self.form.record(self.variables[: self.form.size])

    @property
    def inner_end_mass(self) -> float:
        """Mass inside, kg, rounded."""
        return round(float(self.variables[self.form.size]), 6)

    @property
    def chosen(self) -> np.ndarray:
        """Its sections."""
        return self.variables[self.form.size + 1 :]


def unknown(task: Search, design: Design) -> list[Cut]:
    """The rig of the box with the largest compliance with the servo off, where the samples know none like it.

    Over a box compliance is compared worst with worst, and on its samples likewise.
    """
    points = task.points_with(design.chosen) or task.points
    if task.goal.peak_over_passive == inf:
        return []
    box = over_box(task, design)
    known = points.servo_off(design.inner_end_mass) > _KNOWN * box.servo_off_m_per_N
    return [] if known else [box.softest_without_servo()]


def touches(task: Search, design: Design) -> bool:
    """Whether a compliance that is kept with little to spare far below the bandwidth costs most of it."""
    reached = task.reached(design.form, design.variables)
    return task.reached(design.form, design.variables, ROOM) < ENOUGH * reached


def whole(task: Search, design: Design, loops: LoopSet) -> tuple[Proved | None, str, list[Cut]]:
    """What is proved of a design whose nominal loops keep all limits: of these, or of the whole box.

    Or why not, and the rigs that refute it.
    """
    width = min(bandwidth(loops.performing, task.goal.compliance_m_per_N), LARGEST_BANDWIDTH_HZ)
    peak = min(loops.peak_sensitivity(), task.goal.peak_sensitivity)
    figures = design.law, design.inner_end_mass, width, peak, design.variables
    softest = inf if task.spread is not None else loops.peak_compliance(task.goal)
    found = Proved(*figures, peak_compliance_m_per_N=softest, servo_off_m_per_N=loops.servo_off_m_per_N)
    if task.spread is None:
        return found, "", []
    over, reason, cuts = over_box(task, design).proof(task.reached(design.form, design.variables, ROOM))
    return (None, reason, cuts) if over is None else (found.over(over), "", [])


def rests(task: Search, design: Design, found: Proved) -> tuple[Proved | None, str]:
    """What was proved of a design with that proof as well, or why there is none."""
    if not task.goal.lower_gains:
        return None, "it need not be stable at every lower gain"
    if found.over_box is not None:
        over, reason = over_box(task, design).at_rest(found.over_box)
        return (None, reason) if over is None else (replace(found, over_box=over), "")
    if not task.goal.comes_to_rest:
        return found, ""
    members = task.members_with(design.chosen, rounded=True)
    each = loop_set(members, found.controller, found.inner_end_mass_kg, task.masses_kg).stable
    proof = absolute_stability([one.loop.scaled(one.most) for one in each], *map(exact, task.masses_kg))
    if proof.multiplier is not None and proof.multiplier.for_odd_only:
        return None, f"the multiplier that was found is {FOR_ODD} alone"
    return (None, proof.reason) if proof.multiplier is None else (found, "")


def value_of(task: Search, design: Design) -> float:
    """What a design is worth on samples; of a box anew, as it was found before the worst rigs were known."""
    if task.spread is None:
        return design.value
    return task.value(design.form, design.variables, task.reached(design.form, design.variables))


def over_box(task: Search, design: Design) -> BoxTask:
    """A design as what is to hold over the whole box."""
    assert task.spread is not None
    rig = task.prototype_with(design.chosen, rounded=True)
    payload = rig.payload.but(outer_end_mass_kg=task.masses_kg, inner_end_mass_kg=design.inner_end_mass)
    whole = task.masses_kg if task.spread.stage is None else task.spread.stage[1]
    built = rig.but(controller=design.law, payload=payload, goal=calmer(task.goal), guarantee=None)
    return BoxTask(built, task.spread, task.masses_kg, whole)


def in_box(task: Search, design: Design, missed: float = -ROOM / 2) -> list[tuple[str, float, Cut]]:
    """Rigs of the box that miss a limit by more than so much, or keep it by less than a proof needs."""
    return over_box(task, design).worst(task.reached(design.form, design.variables, ROOM), missed)


def no_answer(kind: str, goal: Goal, masses_kg: tuple[float, float], failure: str) -> str:
    """Why there is no design, and what may allow one."""
    if over():
        return f"no {kind} controller was proved in the time given ({failure}); more time may find one"
    ratio = goal.peak_over_passive
    softer = f" and {ratio:g} times its largest with the servo off at any" if ratio < inf else ""
    return (
        f"no {kind} controller was found that is proved stable with peak sensitivity at most"
        f" {goal.peak_sensitivity:g} for outer end masses of {masses_kg[0]:g} to {masses_kg[1]:g} kg, and keeps"
        f" {goal.compliance_m_per_N:g} m/N up to any useful frequency{softer} ({failure}); a narrower range,"
        " a larger peak sensitivity, a larger compliance or peak_over_passive, or more inner end mass may allow one"
    )
