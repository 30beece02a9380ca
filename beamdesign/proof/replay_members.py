"""Re-prove a certificate over the linear members of a prototype with effects; see `replay.py`, which it builds on.

Nothing here is shared with the programme that wrote the certificate: each member's polynomials are rebuilt from the
listed figures by the impedances of its parts, and what is claimed of a rectangle of masses and gains is decided on the
rectangle's sides with the methods of `replay.py`.

Run as `python -m beamdesign.proof.replay_members CERTIFICATE`; exit status 0 if it holds, 1 if it does not, 2 if it
cannot be read.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flint import arb, fmpq, fmpq_mat, fmpq_poly

from beamdesign.proof import replay as single
from beamdesign.proof.replay import FLOAT_ROUNDING, Malformed, Pair, Replay, S, rational

KIND = "beamdesign.members"
VERSION = 1
KNOWN = {
    "carrier_ripple", "current_saturation", "current_saturation_soft", "entrained_air", "entrained_air_with_stroke",
    "joint_backlash", "mount_compliance", "pressure_dependent_flow", "seal_friction", "second_beam_mode", "sensor_lag",
    "sensor_lag_second_order", "transport_delay", "unequal_piston_areas", "uneven_leakage", "valve_deadband",
    "valve_hysteresis", "valve_hysteresis_magnetic",
}  # fmt: skip
"""Effects whose linear members are rebuilt here; of some, nothing is left in them but factors on the gain."""

ONE, ZERO = fmpq_poly([1]), fmpq_poly([0])
Figures = Mapping[str, fmpq]


def replay(source: str | Path) -> Replay:
    """Prove a certificate again.

    Args:
        source: path of the certificate, or its text.

    Raises:
        Malformed: where it cannot be read as a certificate.
    """
    return single.proved_again(source, KIND, VERSION, _statements)


def _statements(table: dict[str, Any]) -> single.Statements:
    """Every statement of the certificate: whether it was proved, and it or its failure in words."""
    low, high = rational(table["low"]), rational(table["high"])
    if low > high:
        raise Malformed("the range of masses is empty")
    if unknown := sorted(set(table["effects"]) - KNOWN - {"two_pi"}):
        raise Malformed(f"effects that are not known here: {', '.join(unknown)}")
    if not any("performance_gain" in entry for entry in table["member"]):
        raise Malformed("there is no member, or none that is to perform")
    yield from single._figures(table)
    turn = abs(arb(rational(table["effects"]["two_pi"])) / (2 * arb.pi()) - 1) < arb(FLOAT_ROUNDING)
    yield bool(turn), "two_pi is 2 pi" if turn else "two_pi is not 2 pi"
    members = []
    for number, entry in enumerate(table["member"], start=1):
        member = Member(table, entry)
        members.append(member)
        same = member.follows
        words = "follow from the figures" if same else "do not follow from the figures"
        yield same, f"the polynomials of member {number} {words}"
    if not all(member.follows for member in members):
        return  # what follows would be about some other loops
    whole = all(member.is_stable_over(low, high) for member in members)
    yield from _stability(table["stability"], members, whole, low, high)
    for claim in table.get("claim", []):
        yield _claim(claim, members, whole, low, high)


def _stability(
    table: dict[str, Any], members: "Sequence[Member]", whole: bool, low: fmpq, high: fmpq
) -> Iterator[tuple[bool, str]]:
    for part in table["range"]:
        start, end = rational(part["low"]), rational(part["high"])
        words = f"every member stable from {single._short(start)} to {single._short(end)} kg"
        proved = low <= start <= end <= high and all(member.is_stable_over(start, end) for member in members)
        yield proved, words if proved else f"not proved: {words}"
    right = table["stable"] is whole
    yield right, f"stable = {whole}" if right else "`stable` contradicts what is found"


def _claim(claim: dict[str, Any], members: "Sequence[Member]", whole: bool, low: fmpq, high: fmpq) -> tuple[bool, str]:
    """One claim about all members: it holds if it says so, and fails for one of them if it says so."""
    kind, limit, holds = claim["kind"], rational(claim["limit"]), claim["holds"]
    if not isinstance(holds, bool) or limit <= 0:
        raise Malformed("a claim needs holds = true or false, and a positive limit")
    words = f"{kind} {claim['limit']}"
    truth: Callable[[Member], bool]
    if kind in single.INEQUALITIES:
        more, start, until = single.band(claim)
        words += more

        def truth(member: Member) -> bool:
            return member.performs(kind, limit, low, high, start, until)
    elif kind == "decay_rate":

        def truth(member: Member) -> bool:
            return member.is_stable_over(low, high, S - limit)
    elif kind == "gain_margin":
        ends = sorted((fmpq(1), limit))

        def truth(member: Member) -> bool:
            return member.is_stable_over(low, high, S, (member.gain[0] * ends[0], member.gain[1] * ends[1]))
    else:
        raise Malformed(f"claim.kind {kind!r} is not known here")
    found = whole and all(truth(member) for member in members)
    if found is not holds:
        return False, f"{'not proved' if holds else 'holds after all'}: {words}"
    return True, words if holds else f"refuted: {words}"


class Member:
    """One linear loop over the mass m and a factor g on its gain: opened + m p1 + g returned."""

    def __init__(self, table: dict[str, Any], entry: dict[str, Any]):
        self.gain = _factors(entry["gain"])
        self.performance = _factors(entry["performance_gain"]) if "performance_gain" in entry else None
        if self.performance and not self.gain[0] <= self.performance[0] <= self.performance[1] <= self.gain[1]:
            raise Malformed("the factors for performance are not among those for stability")
        stated = single.stated_polynomials(entry["polynomials"])
        self.returned, self.returned_slope = stated["returned"], stated["returned_slope"]
        self.opened, self.opened_slope = stated["p0"] - self.returned, stated["p1"] - self.returned_slope
        self.disturbance = stated["disturbance"]
        if self.returned_slope != 0 and self.performance and self.performance[0] < self.performance[1]:
            raise Malformed("mass and gain multiply each other, so that sides do not decide what is to be performed")
        self.law = tuple(single._polynomial(table["controller"][name]) for name in ("numerator", "denominator"))
        self.follows = single._proportional(_rebuilt(table, entry.get("frozen", {})), stated)

    def is_stable_over(self, low: fmpq, high: fmpq, s: fmpq_poly = S, gain: Pair | None = None) -> bool:
        """Whether it is stable on the rectangle, with s replaced."""
        opened, returned = (self.opened(s), self.opened_slope(s)), (self.returned(s), self.returned_slope(s))
        return single.stable_on_rectangle(opened, returned, (low, high), gain or self.gain)

    def performs(self, kind: str, limit: fmpq, low: fmpq, high: fmpq, start: fmpq, until: fmpq | None) -> bool:
        """Whether an inequality holds on the rectangle: on its sides, on which both magnitudes are least.

        A member without factors for performance is not asked.
        """
        if self.performance is None:
            return True
        for factor in set(self.performance):
            over_mass = (self.opened, self.opened_slope)
            returned = (factor * self.returned, factor * self.returned_slope)
            bottom, top = single.magnitudes(kind, over_mass, returned, self.disturbance, self.law)
            if not single.Slack(limit, bottom, top).nonnegative(low, high, until, start):
                return False
        if kind == "loop_gain" or self.performance[0] == self.performance[1]:  # it grows with the factor
            return True
        for mass in {low, high}:
            opened = (self.opened + mass * self.opened_slope, ZERO)
            (_, _), top = single.magnitudes(kind, opened, (ZERO, ZERO), self.disturbance, self.law)
            slack = single.Slack(limit, (opened[0], self.returned), top)
            if not slack.nonnegative(*self.performance, until, start):
                return False
        return True


def _factors(pair: Sequence[str]) -> Pair:
    least, most = (rational(value) for value in pair)
    if not 0 <= least <= most:
        raise Malformed(f"no range of factors: {pair}")
    return least, most


# The loop of a member, from the figures.


def _rebuilt(table: dict[str, Any], frozen: Mapping[str, Mapping[str, str]]) -> dict[str, fmpq_poly]:
    """The polynomials of a member: impedances of its parts, solved for tip and mount by Cramer's rule."""
    figure = {name: rational(value) for name, value in table["rig"].items() if name != "kind"}
    turn = rational(table["effects"]["two_pi"])
    effects = {
        name: {key: rational(value) for key, value in (own | dict(frozen.get(name, {}))).items()}
        for name, own in table["effects"].items()
        if name != "two_pi"
    }
    numerators, denominator = single.law_of(table["controller"])
    bare, loaded = (_mechanics(figure, effects, turn, fmpq(mass), list(numerators)) for mass in (0, 1))
    valve = figure["valve_frequency_rad_per_s"]
    spring = 1 + effects["valve_hysteresis"]["spring"] if "valve_hysteresis" in effects else 1
    around = fmpq_poly([valve**2 * spring, 2 * figure["valve_damping_ratio"] * valve, 1]) * denominator
    drive = figure["flow_gain_m3_per_s_per_A"] * valve**2
    forward, lags = drive * figure["sensor_gain_V_per_m"] * numerators[single.SENSED[0]], ONE
    if "filter_frequency_rad_per_s" in figure:
        forward *= figure["filter_frequency_rad_per_s"]
        lags *= S + figure["filter_frequency_rad_per_s"]
    if "sensor_lag" in effects:
        rate = turn * effects["sensor_lag"]["break_Hz"]
        forward, lags = forward * rate, lags * (S + rate)
    if "sensor_lag_second_order" in effects:
        own = effects["sensor_lag_second_order"]
        natural = 2 * turn * own["damping_ratio"] * own["break_Hz"]
        forward, lags = forward * natural**2, lags * fmpq_poly([natural**2, 2 * own["damping_ratio"] * natural, 1])
    if "transport_delay" in effects:
        delay = effects["transport_delay"]["delay_s"]
        forward *= fmpq_poly([12, -6 * delay, delay**2])
        lags *= fmpq_poly([12, 6 * delay, delay**2])
    # What added sensors read passes none of the lags of the displacement's volts.
    back = {single.SENSED[0]: forward} | {
        name: drive * numerators[name] * lags for name in single.SENSED[1:] if name in numerators
    }
    around *= lags
    returned, heavier = (sum((law * at.sensed[name] for name, law in back.items()), ZERO) for at in (bare, loaded))
    inside = sum((law * bare.crossed[name] for name, law in back.items()), ZERO)
    p0 = bare.opened * around + returned
    return {
        "p0": p0,
        "p1": loaded.opened * around + heavier - p0,
        "returned": returned,
        "disturbance": bare.moved * around + inside,
        "returned_slope": heavier - returned,
    }


@dataclass(frozen=True)
class Mechanics:
    """Beams, mount, rod and oil: the determinant, and numerators over it.

    Attributes:
        opened: the determinant.
        moved: what a force on the tip does to the tip, m/N.
        sensed: what a flow does to what is sensed, by its name; of the displacement per volt of the sensor, in m.
        crossed: of each of them, what a force and a flow together do: determinants with both columns replaced.
    """

    opened: fmpq_poly
    moved: fmpq_poly
    sensed: dict[str, fmpq_poly]
    crossed: dict[str, fmpq_poly]


def _mechanics(
    figure: Figures, effects: Mapping[str, Figures], turn: fmpq, mass: fmpq, sensed: Sequence[str]
) -> Mechanics:
    """Beams, mount, rod and oil with a mass on the outer tip.

    The unknowns are the outer beam's first mode, its second, the inner tip, the rod, the mount and the force of the
    oil, or of each chamber, as far as there are such; each has one equation.
    """
    leak, area = figure["leakage_m3_per_s_per_Pa"], figure["piston_area_m2"]
    # Both chambers show only where their sides differ and leak; else they act as one.
    uneven = effects.get("unequal_piston_areas", {}).get("asymmetry", fmpq(0)) if leak != 0 else fmpq(0)
    chambers = {"oil_a": 1 + uneven, "oil_b": 1 - uneven} if uneven != 0 else {"oil": fmpq(1)}
    names = ["first", "inner", *chambers]
    names += ["second"] if "second_beam_mode" in effects else []
    names += ["rod"] if "joint_backlash" in effects else []
    names += ["mount"] if "mount_compliance" in effects else []
    rod = "rod" if "joint_backlash" in effects else "inner"
    rows: dict[str, dict[str, fmpq_poly]] = {name: {} for name in names}

    def add(row: str, column: str, value: fmpq_poly) -> None:
        if row in rows and column in rows:
            rows[row][column] = rows[row].get(column, ZERO) + value

    def join(one: str, two: str, impedance: fmpq_poly) -> None:
        """A spring and dashpot between two coordinates; one that does not exist stands still."""
        for row, sign in ((one, 1), (two, -1)):
            add(row, one, sign * impedance)
            add(row, two, -sign * impedance)

    def inertia(name: str, value: fmpq) -> None:
        add(name, name, fmpq_poly([0, 0, value]))

    join("first", "mount", fmpq_poly([figure["outer_stiffness_N_per_m"], figure["outer_damping_N_s_per_m"]]))
    join("inner", "mount", fmpq_poly([figure["inner_stiffness_N_per_m"], figure["inner_damping_N_s_per_m"]]))
    inertia("first", figure["outer_mass_kg"])
    inner = figure["inner_mass_kg"] + figure["inner_end_mass_kg"]
    if "joint_backlash" in effects:  # what was weighed with the inner beam, though it is the rod's
        own = effects["joint_backlash"]
        inner -= own["counted_share"] * own["rod_mass_kg"]
    inertia("inner", inner)
    if "second_beam_mode" in effects:
        own = effects["second_beam_mode"]
        frequency, stiffness = turn * own["frequency_Hz"], figure["outer_stiffness_N_per_m"] / own["compliance_share"]
        join("second", "ground", stiffness * fmpq_poly([1, 2 * own["damping_ratio"] / frequency]))
        inertia("second", stiffness / frequency**2)
    if "mount_compliance" in effects:
        own = effects["mount_compliance"]
        frequency, stiffness = turn * own["frequency_Hz"], own["stiffness_N_per_m"]
        join("mount", "ground", stiffness * fmpq_poly([1, 2 * own["damping_ratio"] / frequency]))
        inertia("mount", stiffness / frequency**2)
    if "joint_backlash" in effects:
        own = effects["joint_backlash"]
        join("rod", "inner", own["share"] * fmpq_poly([own["stiffness_N_per_m"], own["damping_N_s_per_m"]]))
        inertia("rod", own["rod_mass_kg"])
    tip: list[str] = [name for name in ("first", "second") if name in rows]
    seal = ZERO
    if "seal_friction" in effects:
        own = effects["seal_friction"]
        seal = fmpq_poly([own["spring_N_per_m"], own["dashpot_N_s_per_m"]])
    for row in tip:  # forces at the tip act on both modes, and it moves by their sum
        for column in tip:
            add(row, column, fmpq_poly([0, 0, mass]) + seal)
        add(row, rod, -seal)
        add(rod, row, -seal)
    add(rod, rod, seal)
    softer = fmpq(1)
    for name in ("entrained_air", "entrained_air_with_stroke"):
        if name in effects:
            softer *= effects[name]["stiffness_factor"]
    count = len(chambers)
    for name, side in chambers.items():  # each adds a force to the cylinder, towards its own end
        for row in tip:
            add(row, name, -ONE)
            add(name, row, S)
        add(rod, name, ONE)
        add(name, rod, -S)
        spring = softer * figure["oil_stiffness_N_per_m"] * side / count
        add(name, name, fmpq_poly([count * leak / (area * side) ** 2, 1 / spring]))
    matrix = [[rows[row].get(column, ZERO) for column in names] for row in names]

    def replaced(columns: Mapping[str, Sequence[fmpq]]) -> fmpq_poly:
        """The determinant with the columns of some unknowns replaced by what drives each equation."""
        return _determinant(
            [
                [fmpq_poly([columns[name][k]]) if name in columns else row[j] for j, name in enumerate(names)]
                for k, row in enumerate(matrix)
            ]
        )

    def moved(by: Sequence[fmpq], seen: Mapping[str, fmpq]) -> fmpq_poly:
        """Numerator of a sum of coordinates over the forces that drive each equation."""
        return sum((weight * replaced({name: by}) for name, weight in seen.items() if name in names), ZERO)

    def crossed(seen: Mapping[str, fmpq]) -> fmpq_poly:
        """The tip by a force and a sum of coordinates by a flow, in one determinant."""
        total = ZERO
        for one in tip:
            for name, weight in seen.items():
                if name in names and name != one:
                    total += weight * replaced({one: force, name: flow})
        return total

    at_tip: dict[str, fmpq] = dict.fromkeys(tip, fmpq(1))
    share = effects["mount_compliance"]["sensor_share"] if "mount_compliance" in effects else fmpq(0)
    flow = [1 / area if name in chambers else fmpq(0) for name in names]
    force = [fmpq(1) if name in tip else fmpq(0) for name in names]
    # A chamber's unknown is its force; its pressure acts on its own side, and the two against each other.
    pressure = {name: (1 / (area * side)) for name, side in chambers.items()}
    read = {
        "displacement_m": {**at_tip, "mount": -share} if share != 0 else at_tip,
        "inner_displacement_m": {"inner": fmpq(1)},
        "load_pressure_Pa": pressure,
    }
    seen = {name: read[name] for name in sensed}
    return Mechanics(
        _determinant(matrix),
        moved(force, at_tip),
        {name: moved(flow, where) for name, where in seen.items()},
        {name: crossed(where) for name, where in seen.items()},
    )


def _determinant(matrix: Sequence[Sequence[fmpq_poly]]) -> fmpq_poly:
    """Determinant of a matrix of polynomials, interpolated from its values."""
    degree = sum(max(max(entry.degree() for entry in row), 0) for row in matrix)
    n, total, basis = len(matrix), ZERO, ONE
    for point in (fmpq(k) for k in range(degree + 1)):
        value = fmpq_mat(n, n, [entry(point) for row in matrix for entry in row]).det()
        total += basis * ((value - total(point)) / basis(point))
        basis *= S - point
    return total


def main(arguments: Sequence[str]) -> int:
    """Replay the certificate named on the command line; the exit status."""
    return single.told(replay, "python -m beamdesign.proof.replay_members", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
