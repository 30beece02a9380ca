"""Re-prove a certificate over changes between stages from its own figures, with python-flint.

A(m) of every stage is written down anew from equations (7) to (16) of Zalucky and Hardt (1984), as in
`replay_lyapunov`, whose plant, definiteness and claims about one loop are used here; nothing is shared with the
programme that wrote the certificate. The states are those of the rig, then output and rate of each second-order
section, then the current, which all stages share: none of them jumps when the stage changes.

What a claim says, V = x' P(m) x:

- any_stage: A_i' P + P A_i < 0 for every stage i and payload m. Then the loop is stable whichever stage acts when.
- any_change, payload_rate, payload_jumps: the claims any_change, bounded_rate and sudden_change of `replay_lyapunov`,
  for every stage with one and the same P(m), so with any change of stage at any time.
- stage_dwell: A_i' P_i + P_i A_i + 2 decay P_i < 0, P_j < factor P_i, and log(factor) < 2 decay dwell.
- counterexample stage_cycle: a product M of two matrix exponentials with |trace M^k| above the order of M for one k;
  cycle: as in `replay_lyapunov`, with one stage that stays.

Run as `python -m beamdesign.proof.replay_stages CERTIFICATE`; exit status 0 if it holds, 1 if not, 2 if unreadable.
"""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from flint import arb, arb_mat, fmpq, fmpq_mat

from beamdesign.proof.replay_lyapunov import (
    CLAIMS,
    COUNTEREXAMPLES,
    FLOAT_ROUNDING,
    MOST_CYCLES,
    Function,
    Loop,
    Malformed,
    Replay,
    Result,
    pivots_positive,
    positive_between,
    proved_again,
    rational,
    told,
)

KIND = "beamdesign.stages"
VERSION = 1

__all__ = ["Malformed", "replay"]


class StageLoop(Loop):
    """The closed loop of one stage.

    Attributes:
        stage: its table.
    """

    def __init__(self, rig: dict[str, Any], stage: dict[str, Any]):
        if rig["kind"] != "twin_beam":
            raise Malformed(f"rig.kind {rig['kind']!r} is not known here")
        self.stage, self.sections = stage, stage.get("section", [])
        self.figure = {name: rational(value) for name, value in rig.items() if name != "kind"}
        self.filtered = "filter_frequency_rad_per_s" in self.figure
        if self.sections and not self.filtered:
            raise Malformed("sections without a filter before them")
        self.bare_mass = self.figure["outer_mass_kg"]
        self.order = 7 + int(self.filtered) + 2 * len(self.sections) + 1

    def _close(self, rows: list[list[fmpq]], into: int, drive: fmpq, sensed: int, gain: fmpq) -> None:
        """Sections, then w_p (K u - i) + K (w_p / w_z) u' = i', the current driving row `into`."""
        n, current = self.order, self.order - 1
        rows[into][current] += drive
        signal = [fmpq(0)] * n
        signal[sensed] = -gain
        slope = _through(rows, signal)
        bend = _through(rows, slope) if self.sections else slope
        first = 7 + int(self.filtered)
        for k, section in enumerate(self.sections):
            pole, zero = rational(section["pole_rad_per_s"]), rational(section["zero_rad_per_s"])
            here, rate = first + 2 * k, first + 2 * k + 1
            rows[here][rate] = fmpq(1)
            own, above = rational(section["pole_damping_ratio"]), rational(section["zero_damping_ratio"])
            for j in range(n):
                rows[rate][j] = pole * pole * (signal[j] + 2 * above / zero * slope[j] + bend[j] / (zero * zero))
            rows[rate][here] -= pole * pole
            rows[rate][rate] -= 2 * own * pole
            bend = list(rows[rate])
            signal, slope = [fmpq(0)] * n, [fmpq(0)] * n
            signal[here] = slope[rate] = fmpq(1)
        pole, zero = rational(self.stage["pole_rad_per_s"]), rational(self.stage["zero_rad_per_s"])
        size = rational(self.stage["gain_A_per_V"])
        for j in range(n):
            rows[current][j] = pole * size * (signal[j] + slope[j] / zero)
        rows[current][current] -= pole

    def figures_agree(self) -> Iterator[Result]:
        """Figures of the rig are not negative, and those that stand in two units agree."""
        may_be_zero = ("outer_damping", "inner_damping", "leakage", "inner_end_mass")
        for name, value in self.figure.items():
            if value < 0 or (value == 0 and not name.startswith(may_be_zero)):
                yield False, f"rig.{name} is not positive"
        pairs = [
            (self.figure[f"{name}_Hz"], self.figure[f"{name}_rad_per_s"])
            for name in ("valve_frequency", "filter_frequency")
            if f"{name}_rad_per_s" in self.figure
        ]
        for table in (self.stage, *self.sections):
            pairs += [
                (rational(table[f"{name}_Hz"]), rational(table[f"{name}_rad_per_s"])) for name in ("pole", "zero")
            ]
        agree = all(
            radians > 0 and abs(2 * arb.pi() * arb(hertz) / arb(radians) - 1) < arb(FLOAT_ROUNDING)
            for hertz, radians in pairs
        )
        yield bool(agree), "figures given twice agree" if agree else "the stage's or the rig's figures contradict"


def _through(rows: Sequence[Sequence[fmpq]], signal: Sequence[fmpq]) -> list[fmpq]:
    """The rate of a linear function of the states, which must not depend on the velocity of the tip."""
    if signal[1] != 0:
        raise Malformed("a law feels the acceleration of the tip")
    n = len(signal)
    return [sum((signal[i] * rows[i][j] for i in range(n) if signal[i] != 0), fmpq(0)) for j in range(n)]


def replay(source: str | Path) -> Replay:
    """Prove a certificate again.

    Args:
        source: path of the certificate, or its text.

    Raises:
        Malformed: where it cannot be read as a certificate.
    """
    return proved_again(source, KIND, VERSION, _statements)


def _statements(table: dict[str, Any]) -> Iterator[Result]:
    low, high = rational(table["low"]), rational(table["high"])
    if not 0 <= low < high:
        raise Malformed("the range of masses is empty or negative")
    loops = [StageLoop(table["rig"], stage) for stage in table["stage"]]
    if len({loop.order for loop in loops}) != 1:
        raise Malformed("the stages do not have the same states")
    for loop in loops:
        yield from loop.figures_agree()
    claims, against = table.get("claim", []), table.get("counterexample", [])
    yield bool(claims or against), "something is claimed" if claims or against else "nothing is claimed"
    for claim in claims:
        least, most = rational(claim["low"]), rational(claim["high"])
        if not low <= least < most <= high:
            raise Malformed("the range of a claim is not within that of the certificate")
        yield _claim(loops, claim, least, most)
    for example in against:
        if example["kind"] == "cycle":
            yield COUNTEREXAMPLES["cycle"](loops[int(example["stage"])], example, low, high)
        elif example["kind"] == "stage_cycle":
            yield _cycle(loops, example, low, high)
        else:
            raise Malformed(f"counterexample.kind {example['kind']!r} is not known here")


def _claim(loops: list[StageLoop], claim: dict[str, Any], low: fmpq, high: fmpq) -> Result:
    words = f"{_short(low)} to {_short(high)} kg"
    within = {"any_change": "any_change", "payload_rate": "bounded_rate", "payload_jumps": "sudden_change"}
    kind = claim["kind"]
    if kind in within:
        each = [CLAIMS[within[kind]](loop, claim, low, high, words) for loop in loops]
        failed = [f"stage {k}: {told}" for k, (proved, told) in enumerate(each, start=1) if not proved]
        return not failed, failed[0] if failed else f"any stage at any time: {each[0][1]}"
    if kind == "any_stage":
        function = Function(loops[0], claim["P"])
        proved = positive_between(function.at, function.degree, low, high) and all(
            _falls(loop, function, fmpq(0), low, high) for loop in loops
        )
        return proved, f"{'stable' if proved else 'not proved stable'} whichever stage acts when, {words}"
    if kind == "stage_dwell":
        return _dwell(loops, claim, low, high, words)
    raise Malformed(f"claim.kind {kind!r} is not known here")


def _falls(loop: StageLoop, function: Function, decay: fmpq, low: fmpq, high: fmpq) -> bool:
    """Whether V falls as exp(-2 decay t) along a stage at every payload."""

    def fall(m: fmpq) -> fmpq_mat:
        a, p = loop.matrix(m), function.at(m)
        return -(a.transpose() * p + p * a + p * (2 * decay)) * (loop.bare_mass + m)

    return positive_between(fall, function.degree + 1, low, high)


def _dwell(loops: list[StageLoop], claim: dict[str, Any], low: fmpq, high: fmpq, words: str) -> Result:
    dwell, factor, decay = (rational(claim[name]) for name in ("dwell_s", "factor", "decay_per_s"))
    size = int(claim["degree"]) + 1
    if not 1 <= size <= 2 or len(claim["P"]) != size * len(loops):
        raise Malformed("P must list as many matrices for each stage, at most two")
    functions = [Function(loop, claim["P"][k * size : (k + 1) * size]) for k, loop in enumerate(loops)]
    proved = (
        decay > 0
        and all(positive_between(f.at, f.degree, low, high) for f in functions)
        and all(_falls(loop, f, decay, low, high) for loop, f in zip(loops, functions, strict=True))
        and all(  # affine in m: both ends suffice
            pivots_positive(one.at(m) * factor - two.at(m))
            for m in (low, high)
            for one in functions
            for two in functions
            if one is not two
        )
        and bool(arb(factor).log() < arb(2 * decay * dwell))
    )
    how = f"changes of stage every {_short(dwell)} s on average"
    return proved, f"{'stable' if proved else 'not proved stable'} for {how}, {words}"


def _cycle(loops: list[StageLoop], example: dict[str, Any], low: fmpq, high: fmpq) -> Result:
    mass, times = rational(example["outer_end_mass_kg"]), [rational(value) for value in example["time_s"]]
    first, second = (loops[int(k)] for k in example["stages"])
    cycles = int(example["cycles"])
    if len(times) != 2 or not 1 <= cycles <= MOST_CYCLES:
        raise Malformed("a cycle has two stages, two times and a number of repetitions")
    proved = low <= mass <= high and min(times) > 0
    if proved:
        one, two = (arb_mat(loop.matrix(mass) * t).exp() for loop, t in zip((first, second), times, strict=True))
        turn = two * one
        total = turn
        for bit in bin(cycles)[3:]:
            total = total * total * turn if bit == "1" else total * total
        proved = bool(abs(total.trace()) > first.order)
    return proved, f"{'the motion grows' if proved else 'growth is not proved'} with two stages in turn"


def _short(value: fmpq) -> str:
    return f"{int(value.p) / int(value.q):.7g}"


def main(arguments: Sequence[str]) -> int:
    """Replay the certificate named on the command line; the exit status."""
    return told(replay, "python -m beamdesign.proof.replay_stages", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
