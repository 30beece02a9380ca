"""Re-prove a certificate of one plane of an arm; see `replay.py`, which it builds on.

Nothing here is shared with the programme that wrote the certificate: the loop is rebuilt from the listed figures as the
equilibrium of tip and twist under the payload's inertia, solved by Cramer's rule at single payloads, and what is
claimed is decided with the methods of `replay.py`.

Run as `python -m beamdesign.proof.replay_arm CERTIFICATE`; exit status 0 if it holds, 1 if it does not, 2 if it cannot
be read.
"""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from flint import arb, fmpq, fmpq_poly

from beamdesign.proof import replay as single
from beamdesign.proof.replay import Malformed, Polynomials, Replay, S, rational

KIND = "beamdesign.arm_plane"
VERSION = 1


def replay(source: str | Path) -> Replay:
    """Prove a certificate again.

    Args:
        source: path of the certificate, or its text.

    Raises:
        Malformed: where it cannot be read as a certificate.
    """
    return single.proved_again(source, KIND, VERSION, _statements)


def _statements(table: dict[str, Any]) -> single.Statements:
    low, high = rational(table["low"]), rational(table["high"])
    if low > high or low < 0:
        raise Malformed("the range of payloads is empty, or negative")
    yield from single._figures(table)
    plane = Plane(table)
    yield from single._stability(table["stability"], *plane.characteristic, low, high)
    stable = single.Family(*plane.characteristic).is_stable_over(low, high)
    for claim in table.get("claim", []):
        yield _claim(claim, plane, stable, low, high)


class Plane:
    """The loop of one plane, each polynomial as (constant, slope) in the payload."""

    def __init__(self, table: dict[str, Any]):
        arm = table["arm"]
        x, y, z = (rational(value) for value in arm["offset_m"])
        length = rational(arm["free_length_m"])
        if length <= 0 or arm["plane"] not in ("y", "z"):
            raise Malformed("the arm needs a length, and the plane y or z")
        turning = fmpq(3, 2) / length  # of the tip, per deflection under a force on it
        self.travel = 1 + turning * x
        self.along, self.lever = (turning * y, -z) if arm["plane"] == "y" else (turning * z, y)
        if self.along != 0 and self.lever != 0:
            raise Malformed("a payload that stands off to both sides couples both planes")
        sensed = [rational(value) for value in arm["sensor_m"]]
        self.seen = 1 + turning * sensed[0]
        self.seen_roll = -sensed[2] if arm["plane"] == "y" else sensed[1]
        names = ("torsional_stiffness_N_m_per_rad", "torsional_damping_N_m_s_per_rad", "polar_inertia_kg_m2")
        self.twist = fmpq_poly([rational(arm[name]) for name in names])
        if self.lever == 0:
            self.twist = fmpq_poly([1])  # it has no part in the loop
        elif not (self.twist[0] > 0 and self.twist[1] >= 0 and self.twist[2] > 0):
            raise Malformed("torsion needs stiffness and inertia, and no negative damping")
        above, below = single.law_of(table["controller"])
        if len(above) != 1:
            raise Malformed("an arm's controller senses displacement alone")
        self.law = above["displacement_m"], below
        self.base = single._rebuilt(table)
        stiffness = rational(table["rig"]["outer_stiffness_N_per_m"])
        # The end is held and turns under the moment F x: x^2 L / 4 E I, with E I = K L^3 / 3.
        self.rest = 3 * x * x / (4 * stiffness * length * length)
        self.seen_rest = 3 * x * sensed[0] / (4 * stiffness * length * length)

        self.beam, fed = self.base["p0"] - self.base["returned"], self.base["returned"]
        self.characteristic = self._over(lambda m: self._determinant(fed, m))
        self.opened = self._over(lambda m: self._determinant(0 * fed, m))
        self.returned = self._over(lambda m: fed * (self.seen * self._twisted(m) - self.seen_roll * self._both(m)))
        self.tip = self._over(lambda m: self.base["disturbance"] * self._twisted(m))
        self.load = self._over(self._load)

    def _over(self, value: Callable[[fmpq], fmpq_poly]) -> Polynomials:
        """Constant and slope of what is affine in the payload, which is checked."""
        at = [value(fmpq(m)) for m in range(4)]
        if any(at[k] - at[k - 1] != at[1] - at[0] for k in (2, 3)):
            raise Malformed("the loop is not affine in the payload")
        return at[0], at[1] - at[0]

    def _twisted(self, m: fmpq) -> fmpq_poly:
        return self.twist + m * self.lever**2 * S * S

    def _both(self, m: fmpq) -> fmpq_poly:
        return m * self.travel * self.lever * S * S

    def _first(self, fed: fmpq_poly, m: fmpq) -> Polynomials:
        """The row of the tip, times its own denominator: what tip and twist do in it, the servo's feeding back."""
        compliance = self.base["disturbance"]
        tip = self.beam + self.seen * fed + m * (self.travel**2 + self.along**2) * S * S * compliance
        return tip, self._both(m) * compliance + self.seen_roll * fed

    def _determinant(self, fed: fmpq_poly, m: fmpq) -> fmpq_poly:
        tip, twist = self._first(fed, m)
        return tip * self._twisted(m) - twist * self._both(m)

    def _load(self, m: fmpq) -> fmpq_poly:
        """Motion of the payload in the plane under a force there: Cramer's rule for tip and twist."""
        fed = self.base["returned"]
        tip, twist = self._first(fed, m)
        pushed = self.travel * self.base["disturbance"] - self.seen_rest * fed
        moved = pushed * self._twisted(m) - self.lever * twist
        turned = self.lever * tip - pushed * self._both(m)
        return self.travel * moved + self.lever * turned + self.rest * self._determinant(fed, m)

    def ratio(self, kind: str) -> tuple[Polynomials, Polynomials]:
        """Denominator and numerator of what a claim bounds."""
        match kind:
            case "tip_compliance":
                return self.characteristic, self.tip
            case "load_compliance":
                return self.characteristic, self.load
            case "peak_sensitivity":
                return self.characteristic, self.opened
            case "loop_gain":
                return self.opened, self.returned
            case "controller_effort":
                above, below = self.law
                if any(divmod(part, below)[1] != 0 for part in self.opened):
                    raise Malformed("the controller's poles are not those of the open loop")
                return self.characteristic, (self.opened[0] / below * above, self.opened[1] / below * above)
        raise Malformed(f"claim.kind {kind!r} is not known here")


def _claim(claim: dict[str, Any], plane: Plane, stable: bool, low: fmpq, high: fmpq) -> tuple[bool, str]:
    kind, limit = claim["kind"], rational(claim["limit"])
    if limit <= 0:
        raise Malformed("a claim needs a positive limit")
    start, until = fmpq(0), None
    words = f"{kind} {claim['limit']}"
    if kind.endswith("compliance"):
        words += f" m/N up to {claim['up_to_Hz']} Hz"
        if claim["up_to_Hz"] != "infinite":
            until = _square(claim["up_to_Hz"])[1]
    if kind == "loop_gain":
        words += f" from {claim['from_Hz']} Hz up"
        start = max(_square(claim["from_Hz"])[0], fmpq(0))
    proved = stable and single.Slack(limit, *plane.ratio(kind)).nonnegative(low, high, until, start)
    return proved, words if proved else f"not proved: {words}"


def _square(hertz: str) -> single.Pair:
    """Bounds of w^2 for a frequency."""
    return single._ends((2 * arb.pi() * arb(rational(hertz))) ** 2)


def main(arguments: Sequence[str]) -> int:
    """Replay the certificate named on the command line; the exit status."""
    return single.told(replay, "python -m beamdesign.proof.replay_arm", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
