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

from flint import fmpq, fmpq_mat, fmpq_poly

from beamdesign.proof import replay as single
from beamdesign.proof.replay import Malformed, Pair, Replay, S, rational

KIND = "beamdesign.members"
VERSION = 1
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
    if not any("performance_gain" in entry for entry in table["member"]):
        raise Malformed("there is no member, or none that is to perform")
    yield from single._figures(table)
    members = []
    for number, entry in enumerate(table["member"], start=1):
        member = Member(table, entry)
        members.append(member)
        same = member.follows
        words = f"{'follow' if same else 'do not follow'} from the figures and the elements of effects"
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
        self.follows = single._proportional(_rebuilt(table, entry["elements"]), stated)

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


def _rebuilt(table: dict[str, Any], elements: dict[str, Any]) -> dict[str, fmpq_poly]:
    """The polynomials of a member: impedances of its parts, solved for tip and mount by Cramer's rule."""
    figure = {name: rational(value) for name, value in table["rig"].items() if name != "kind"}
    numerators, denominator = single.law_of(table["controller"])
    bare, loaded = (_mechanics(figure, elements, fmpq(mass), list(numerators)) for mass in (0, 1))
    valve = figure["valve_frequency_rad_per_s"]
    spring = 1 + rational(elements["spool"])
    around = fmpq_poly([valve**2 * spring, 2 * figure["valve_damping_ratio"] * valve, 1]) * denominator
    drive = figure["flow_gain_m3_per_s_per_A"] * valve**2
    forward, lags = drive * figure["sensor_gain_V_per_m"] * numerators[single.SENSED[0]], ONE
    if "filter_frequency_rad_per_s" in figure:
        forward *= figure["filter_frequency_rad_per_s"]
        lags *= S + figure["filter_frequency_rad_per_s"]
    for volts in elements.get("volts", []):
        forward, lags = (
            forward * single._polynomial(volts["numerator"]),
            lags * single._polynomial(volts["denominator"]),
        )
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


def _mechanics(figure: Figures, elements: dict[str, Any], mass: fmpq, sensed: Sequence[str]) -> Mechanics:
    """Beams and oil, and what effects are made of, with a mass on the outer tip.

    The unknowns are the outer beam's first mode, the inner tip, the force of the oil, or of each chamber, and what the
    elements name beside; each has one equation.
    """
    leak, area = figure["leakage_m3_per_s_per_Pa"], figure["piston_area_m2"]
    # Both chambers show only where their sides differ and leak; else they act as one.
    uneven = rational(elements["asymmetry"]) if leak != 0 else fmpq(0)
    chambers = {"oil_a": 1 + uneven, "oil_b": 1 - uneven} if uneven != 0 else {"oil": fmpq(1)}
    added = {point: _weights(table) for point, table in elements.get("points", {}).items()}
    points: dict[str, dict[str, fmpq]] = {"tip": {"first": fmpq(1)}, "rod": {"inner": fmpq(1)}, "base": {}}
    for point, weights in points.items():
        for name, weight in added.get(point, {}).items():
            weights[name] = weights.get(name, fmpq(0)) + weight
    points["sensed"] = points["tip"] | added.get("sensed", {})

    def motion(weights: Mapping[str, fmpq]) -> dict[str, fmpq]:
        """In coordinates alone."""
        total: dict[str, fmpq] = {}
        for name, weight in weights.items():
            for coordinate, share in points.get(name, {name: fmpq(1)}).items():
                total[coordinate] = total.get(coordinate, fmpq(0)) + weight * share
        return total

    def parts() -> Iterator[tuple[dict[str, fmpq], fmpq_poly]]:
        """What moves, and the impedance against it."""
        one = fmpq(1)
        for side in ("outer", "inner"):
            own = {"outer": "first", "inner": "inner"}[side]
            bending = [figure[f"{side}_stiffness_N_per_m"], figure[f"{side}_damping_N_s_per_m"]]
            yield motion({own: one, "base": -one}), fmpq_poly(bending)
        yield {"first": one}, fmpq_poly([0, 0, figure["outer_mass_kg"]])
        yield {"inner": one}, fmpq_poly([0, 0, figure["inner_mass_kg"] + figure["inner_end_mass_kg"]])
        yield points["tip"], fmpq_poly([0, 0, mass])
        for entry in elements.get("impedance", []):
            yield motion(_weights(entry["motion"])), single._polynomial(entry["resists"])

    network = list(parts())
    names = list(dict.fromkeys(["first", "inner", *chambers, *(name for moved, _ in network for name in moved)]))
    rows: dict[str, dict[str, fmpq_poly]] = {name: {} for name in names}

    def add(row: str, column: str, value: fmpq_poly) -> None:
        rows[row][column] = rows[row].get(column, ZERO) + value

    for moved_by, impedance in network:
        for row, share in moved_by.items():
            for column, weight in moved_by.items():
                add(row, column, share * weight * impedance)
    stroke, tip = motion({"tip": fmpq(1), "rod": fmpq(-1)}), points["tip"]
    count = len(chambers)
    for name, side in chambers.items():  # each adds a force to the cylinder, towards its own end
        for row, weight in stroke.items():
            add(row, name, -weight * ONE)
            add(name, row, weight * S)
        spring = rational(elements["oil"]) * figure["oil_stiffness_N_per_m"] * side / count
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
        for one, share in tip.items():
            for name, weight in seen.items():
                if name in names and name != one:
                    total += share * weight * replaced({one: force, name: flow})
        return total

    flow = [1 / area if name in chambers else fmpq(0) for name in names]
    force = [tip.get(name, fmpq(0)) for name in names]
    # A chamber's unknown is its force; its pressure acts on its own side, and the two against each other.
    pressure = {name: (1 / (area * side)) for name, side in chambers.items()}
    read = {
        "displacement_m": points["sensed"],
        "inner_displacement_m": {"inner": fmpq(1)},
        "load_pressure_Pa": pressure,
    }
    seen = {name: read[name] for name in sensed}
    return Mechanics(
        _determinant(matrix),
        moved(force, tip),
        {name: moved(flow, where) for name, where in seen.items()},
        {name: crossed(where) for name, where in seen.items()},
    )


def _weights(table: Mapping[str, str]) -> dict[str, fmpq]:
    return {name: rational(value) for name, value in table.items()}


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
