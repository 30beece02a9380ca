"""What a proof found, printed: stability, what is guaranteed beside the goal, a box of tolerances."""

from math import isfinite
from typing import TYPE_CHECKING, Any

from beamdesign.cli.output import echo, echo_table
from beamdesign.result import picked

if TYPE_CHECKING:
    from beamdesign.polynomial import Crossing
    from beamdesign.proofs.arm.result import PlaneGuaranteed
    from beamdesign.proofs.box import Box, BoxVerdict
    from beamdesign.proofs.certificate import Decided, Guaranteed
    from beamdesign.proofs.tolerance_box import Scaling
    from beamdesign.prototype import Goal, Prototype


def echo_stability(name: str, found: "Decided", holds_for: str) -> None:
    """Whether a loop is stable over a range of payloads, where else it is, and where that changes."""
    low, high = found.outer_end_mass_kg
    if found.stable:
        echo(f"{name}: stable for every outer end mass from {low:g} to {high:g} kg, {holds_for}")
    else:
        echo(f"{name}: NOT stable from {low:g} to {high:g} kg: {found.stability.reason}")
        for least, most in found.stability.stable_ranges:
            echo(f"  stable from {least:.7g} to {most:.7g} kg")
    if found.crossings:
        rows = [(f"{crossing.value:.7g}", hertz(crossing)) for crossing in found.crossings]
        echo_table("a root pair lies on the imaginary axis at", ("outer_end_mass_kg", "frequency_Hz"), rows)


def echo_against_goal(found: "Guaranteed | PlaneGuaranteed", goal: "Goal") -> None:
    """What is guaranteed beside the goal's limits, as far as it sets any."""
    from beamdesign.quantities import stated_peak

    for name, words, more in (
        ("peak_sensitivity", "peak sensitivity", ""),
        ("loop_gain", "loop gain |L|", f" from {goal.loop_gain_from_Hz:g} Hz up"),
        ("controller_effort_A_per_V", "controller effort |C/(1+L)|", " A/V"),
    ):
        value, limit = getattr(found, name), getattr(goal, name)
        if value is not None and limit is not None:
            met = "within" if value <= limit else "beyond"
            echo(f"  guaranteed: {words} at most {stated_peak(value)}{more}, {met} the goal of {limit:g}")


def echo_over_passive(peak_m_per_N: float, servo_off_m_per_N: float, ratio: float, goal: "Goal", of: str = "") -> None:
    """The largest compliance at any frequency beside that with the servo off, and the goal."""
    met = "within" if ratio <= goal.peak_over_passive else "beyond"
    limit = f", {met} the goal of {goal.peak_over_passive:g}" if isfinite(goal.peak_over_passive) else ""
    echo(
        f"  guaranteed{of}: |x/F_d| at most {peak_m_per_N:.5g} m/N at every frequency, {ratio:.4g} times the"
        f" {servo_off_m_per_N:.5g} m/N with the servo off{limit}"
    )


def hertz(crossing: "Crossing") -> str:
    """The frequency of a crossing, Hz."""
    return f"{crossing.frequency_Hz:.6g}" if crossing.finite else "infinite"


def echo_box(record: "Prototype", box: "Box", verdict: "BoxVerdict", sigmas: float) -> None:
    """Whether a loop is stable over a box, and where it is not; what the box is."""
    from beamdesign.polynomial import nearest
    from beamdesign.proofs.near_rest import holds_for
    from beamdesign.proofs.tolerance_box import figure_key

    words = {True: "stable", False: "NOT stable", None: "undecided whether stable"}
    echo(f"{record.name}: {words[verdict.stable]} {holds_for(record, sigmas)}")
    rows = []
    for name, (low, high) in box.ranges.items():
        key, factor = figure_key(name)
        row = [key, nearest(low) / factor, nearest(high) / factor]
        rows.append(row if verdict.unstable_point is None else [*row, nearest(verdict.unstable_point[name]) / factor])
    last = () if verdict.unstable_point is None else ("not stable at",)
    echo_table(f"{len(box.names)} figures, all at once", ("figure", "from", "to", *last), rows)
    if verdict.stable is not True:
        echo(f"  {verdict.reason.rpartition(': ')[2] if verdict.stable is False else verdict.reason}")
        if verdict.volumes is not None:
            shares = [nearest(share) for share in verdict.volumes]
            echo("  share of the box proved stable {:.6g}, proved not stable {:.3g}, undecided {:.3g}".format(*shares))
    if record.effects:
        echo("  effects are covered as linear loops at frozen values, not as the nonlinear loop")
    echo(f"method: zero exclusion, {verdict.pieces} pieces proved in ball arithmetic, one member by an exact test")


def echo_each(found: "dict[str, Scaling]", sigmas: float) -> None:
    """How far each figure alone may be off."""
    from beamdesign.proofs.tolerance_box import figure_key

    rows = [
        (figure_key(name)[0], one.proved * sigmas, "none found" if one.refuted is None else one.refuted * sigmas)
        for name, one in found.items()
    ]
    columns = "figure", "proved stable up to", "not stable from"
    echo_table(f"standard deviations that one figure may be off, the others up to {sigmas:g} as before", columns, rows)


def box_fields(
    box: "Box", verdict: "BoxVerdict", scaling: "Scaling | None", each: "dict[str, Scaling]"
) -> dict[str, Any]:
    """What a JSON file holds of it."""
    from beamdesign.polynomial import nearest
    from beamdesign.proofs.tolerance_box import figure_key, in_units

    def point(of: Any) -> dict[str, float] | None:
        return None if of is None else in_units(of, list(of))

    shares = [None] * 3 if verdict.volumes is None else [nearest(share) for share in verdict.volumes]
    return {
        **picked(verdict, "stable reason pieces looked_at"),
        "box": {
            key: [nearest(low) / factor, nearest(high) / factor]
            for name, (low, high) in box.ranges.items()
            for key, factor in [figure_key(name)]
        },
        "stable_fraction": shares[0],
        "unstable_fraction": shares[1],
        "undecided_fraction": shares[2],
        "unstable_point": point(verdict.unstable_point),
        "largest_scaling": None
        if scaling is None
        else picked(scaling, "proved refuted limit reason") | {"unstable_point": point(scaling.unstable_point)},
        "scaling_of_each": [
            {"figure": figure_key(name)[0]} | picked(one, "proved refuted limit") for name, one in each.items()
        ],
    }
