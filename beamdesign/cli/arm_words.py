"""What `beamdesign arm` tells people."""

from typing import TYPE_CHECKING, Any

from beamdesign.cli.output import say, say_table

if TYPE_CHECKING:
    from beamdesign.arm.remaining import InnerTravel, TwistRemedy, Vector
    from beamdesign.arm.result import ArmResult
    from beamdesign.proof.box import BoxVerdict
    from beamdesign.prototype import Prototype


def say_figures(record: "Prototype", found: "ArmResult") -> None:
    """Where the payload is, what stands for what, natural frequencies."""
    from beamdesign.arm.figures import arm_of, sensor_of

    offset = arm_of(record).offset_m
    place = ", ".join(f"{name} {value:g}" for name, value in zip("xyz", offset, strict=True))
    say(f"{record.name}: payload's centre at {place} m from the tip (x along the beam, y sideways, z upwards)")
    if any(sensor := sensor_of(record)):
        place = ", ".join(f"{name} {value:g}" for name, value in zip("xyz", sensor, strict=True))
        say(f"  servos measure at {place} m from the tip")
    for note in found.figures.notes:
        say(f"  {note}")
    rows = [
        (f"{at.outer_end_mass_kg:g}", *at.modes_Hz, at.torsion_held_Hz, at.turning_held_Hz) for at in found.frequencies
    ]
    columns = ("payload, kg", "1st", "2nd", "3rd", "tip held: torsion", "turning")
    say_table("Natural frequencies of the outer beam, Hz", columns, rows)


def say_proof(record: "Prototype", found: "ArmResult") -> None:
    """What is proved of the planes."""
    low, high = found.outer_end_mass_kg
    if found.both is not None:
        verdict = {True: "stable", False: "NOT stable", None: "UNDECIDED"}[found.both.stable]
        reason = f": {found.both.reason}" if found.both.reason else ""
        say(f"both planes, coupled by the payload: {verdict} from {low:g} to {high:g} kg{reason}")
        say("  method: zero exclusion in ball arithmetic over the payload; bandwidth and peaks are not proved")
        if found.sampled_load_Hz is not None:
            in_y, in_z = found.sampled_load_Hz
            limit = record.goal.compliance_m_per_N
            say(f"  sampled: a force on the payload moves it by at most {limit:.4g} m/N up to")
            say(f"    {in_y:.4g} Hz in y and {in_z:.4g} Hz in z")
        for mass, stable in found.sampled_stable:
            say(f"  at {mass:g} kg: {'stable' if stable else 'not stable'} (poles, sampled)")
        return
    for plane in found.planes:
        with_what = "with torsion" if plane.coupled else "without torsion, which the payload does not bring in"
        if not plane.stable:
            say(f"plane {plane.name}, {with_what}: NOT stable from {low:g} to {high:g} kg: {plane.reason}")
            for least, most in plane.stability.stable_ranges:
                say(f"  stable from {least:.7g} to {most:.7g} kg")
            for crossing in plane.crossings:
                say(f"  a root pair lies on the axis at {crossing.value:.7g} kg, {crossing.frequency_Hz:.6g} Hz")
            continue
        say(f"plane {plane.name}, {with_what}: stable for every payload from {low:g} to {high:g} kg")
        if (sure := plane.guaranteed) is None:
            continue
        goal = record.goal
        say(f"  guaranteed at the tip: at most {goal.compliance_m_per_N:.4g} m/N up to {sure.tip_bandwidth_Hz:.6g} Hz")
        if sure.load_bandwidth_Hz > 0:
            say(f"  guaranteed at the payload: the same up to {sure.load_bandwidth_Hz:.6g} Hz")
        else:
            say(f"  at the payload even a steady force moves it by {sure.load_static_m_per_N:.4g} m/N, beyond the goal")
        met = "within" if sure.peak_sensitivity <= goal.peak_sensitivity else "beyond"
        say(f"  guaranteed: peak sensitivity at most {sure.peak_sensitivity:.6g}, {met} the goal")
        if sure.loop_gain is not None and goal.loop_gain is not None:
            met = "within" if sure.loop_gain <= goal.loop_gain else "beyond"
            say(f"  guaranteed: |L| at most {sure.loop_gain:.6g} from {goal.loop_gain_from_Hz:g} Hz up, {met} the goal")
        if sure.controller_effort_A_per_V is not None and goal.controller_effort_A_per_V is not None:
            met = "within" if sure.controller_effort_A_per_V <= goal.controller_effort_A_per_V else "beyond"
            say(f"  guaranteed: |C/(1+L)| at most {sure.controller_effort_A_per_V:.6g} A/V, {met} the goal")


def say_place(name: str, verdict: "BoxVerdict") -> None:
    """What is proved over the places of the payload's centre."""
    planes = "both planes" if name == "both" else f"plane {name}"
    words = {True: "stable", False: "NOT stable", None: "UNDECIDED"}[verdict.stable]
    reason = f": {verdict.reason}" if verdict.reason else ""
    say(f"{planes}, for every payload and every place of its centre asked for: {words}{reason}")


def say_compliance(found: "ArmResult") -> None:
    """Steady compliance at the tip and at the payload."""
    rows = []
    for place, passive, active in (
        ("tip", found.tip_passive, found.tip_active),
        ("payload", found.passive, found.active),
    ):
        for direction, i, turn in (("y", 1, 5), ("z", 2, 4)):
            cells = [1e9 * passive[i, i], 1e9 * passive[turn, i], 1e9 * passive[3, i]]
            cells += ["-"] * 3 if active is None else [1e9 * active[k, i] for k in (i, turn, 3)]
            rows.append((f"{place}, {direction}", *map(_cell, cells)))
    columns = ("at", "moves", "turns", "twists", "servo: moves", "turns", "twists")
    say_table("Under 1 N, steady, the outer beam alone and with both servos: nm, nrad", columns, rows)


def _cell(value: Any) -> Any:
    return value if isinstance(value, str) else float(value) + 0.0  # no negative zero


def say_remaining(found: "ArmResult", force: "Vector") -> None:
    """What a load leaves, by cause."""
    rows = []
    for words, case in (("alone", found.without), ("servos", found.with_servo)):
        if case is not None:
            turns = [1e3 * value + 0.0 for value in case.rotation_rad]
            sizes = (case.size_m, *case.shares_m.values())
            rows.append((words, *(f"{1e3 * size:.3g}" for size in sizes), *(f"{angle:.3g}" for angle in turns)))
    load = ", ".join(f"{value:g}" for value in force)
    columns = ("beam", "error", "tip", "turning", "twist", "about x", "y", "z")
    say_table(f"What a steady load of ({load}) N leaves: mm, by cause; mrad of the end", columns, rows)
    if found.with_servo is None:
        say("with servo: nothing is told of loops that are not proved stable")
    else:
        y, z = found.with_servo.actuators_N
        say(f"actuators: {y + 0.0:.4g} N in y, {z + 0.0:.4g} N in z")


def say_remedy(remedy: "TwistRemedy") -> None:
    """What would keep twist small."""
    say(f"to keep twist at {1e3 * remedy.allowed_m:g} mm: G J / L of {remedy.needed_N_m_per_rad:.6g} N m/rad")
    if remedy.width_m is not None:
        say(f"  outer tube {1e3 * remedy.width_m:.4g} mm wide, wall as it is: {remedy.width_added_kg:.3g} kg more")
    if remedy.wall_m is not None:
        fits = "" if remedy.wall_fits is not False else ", in which the inner tube does not fit"
        say(f"  or wall {1e3 * remedy.wall_m:.4g} mm, width as it is: {remedy.wall_added_kg:.3g} kg more{fits}")
    elif remedy.width_m is not None:
        say("  no wall up to a tenth of the width does it")
    if remedy.counterweight_kg_m > 0:
        say(f"  or, against weight alone, {remedy.counterweight_kg_m:.4g} kg m on the other side of the axis")


def say_travel(travel: "InnerTravel") -> None:
    """How far the inner tip gives way."""
    gap = "" if travel.gap_m is None else f", of a gap of {1e3 * travel.gap_m:.4g} mm"
    touches = ": the tubes TOUCH" if travel.touches else ""
    y, z = (1e3 * value + 0.0 for value in travel.travel_m)
    say(f"the inner tip gives way by {y:.4g} mm in y, {z:.4g} mm in z{gap}{touches}")
