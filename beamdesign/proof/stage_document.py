"""The text of a certificate for a loop whose law is changed while it runs, which `replay_stages` proves again."""

from collections.abc import Iterator
from math import pi

from beamdesign.polynomial import exact
from beamdesign.proof.document import quoted, remarks, rig_lines, sealed
from beamdesign.proof.rational import text
from beamdesign.proof.stage_switching import StageSwitching
from beamdesign.proof.switching_document import matrix_lines
from beamdesign.scheduling.record import ScheduledRig, Stage

KIND = "beamdesign.stages"
VERSION = 1


def stage_document(rig: ScheduledRig, found: StageSwitching, summary: str) -> str:
    """Write the certificate: figures, laws, Lyapunov matrices and counterexample, all in exact decimals.

    Args:
        rig: whose figures it states.
        found: what was proved of it.
        summary: the result in words, put on top as a comment.
    """
    low, high = (text(exact(value)) for value in found.outer_end_mass_kg)
    head = [
        *remarks(summary),
        "#",
        "# To prove it again with python-flint alone: python -m beamdesign.proof.replay_stages THIS-FILE. All numbers",
        "# are exact: decimals or quotients, as text. P lists the matrix coefficients of m^0, m^1, ... by the rows of",
        f"# their lower triangles, for the state ({', '.join(found.states)}),",
        "# which all stages share and none resets. The checksum is of the text without its own line.",
        "",
        f'kind = "{KIND}"',
        f"version = {VERSION}",
        "",
    ]
    body = [
        f"name = {quoted(rig.prototype.name)}",
        f'low = "{low}"',
        f'high = "{high}"',
        "",
        *rig_lines(rig.prototype),
        *(line for stage in rig.schedule.stage for line in _stage_lines(stage)),
        *_claims(found, low, high),
    ]
    return sealed(head, body)


def _stage_lines(stage: Stage) -> Iterator[str]:
    yield "# A law, from error voltage (V) to current (A)."
    yield "[[stage]]"
    yield f'gain_A_per_V = "{text(exact(stage.gain_A_per_V))}"'
    for name in ("pole", "zero"):
        yield from _frequency(name, getattr(stage, f"{name}_Hz"))
    for section in stage.section:
        yield "[[stage.section]]"
        for name in ("pole", "zero"):
            yield from _frequency(name, getattr(section, f"{name}_Hz"))
            yield f'{name}_damping_ratio = "{text(exact(getattr(section, f"{name}_damping_ratio")))}"'
    yield ""


def _frequency(name: str, frequency_Hz: float) -> Iterator[str]:
    yield f'{name}_Hz = "{text(exact(frequency_Hz))}"'
    yield f'{name}_rad_per_s = "{text(exact(2 * pi * frequency_Hz))}"'


def _claims(found: StageSwitching, low: str, high: str) -> Iterator[str]:
    if found.kind == "any_time":
        yield "# Any stage may act at any time while the payload stays: V = x' P(m) x falls along every stage."
        yield from _head("any_stage", low, high)
        yield from matrix_lines(found.functions[0])
    if found.kind == "dwell":
        yield "# The stage may change this often on average: V_i = x' P_i(m) x falls as exp(-2 decay t) along stage i"
        yield "# and is at most factor times any other; P lists the functions of the stages, one after another."
        yield from _head("stage_dwell", low, high)
        yield f'dwell_s = "{text(found.dwell_s)}"'
        yield f'factor = "{text(found.factor)}"'
        yield f'decay_per_s = "{text(found.decay_per_s)}"'
        yield f"degree = {len(found.functions[0]) - 1}"
        yield from matrix_lines([p for function in found.functions for p in function])
    for rate in found.rates:
        yield "# Any stage at any time, and a payload that changes at up to this rate."
        yield from _head("payload_rate", low, high)
        yield f'joining = "{rate.joining}"'
        yield f'rate_kg_per_s = "{text(exact(rate.rate_kg_per_s))}"'
        yield from matrix_lines(rate.coefficients)
    for jumps in found.jumps:
        yield "# Any stage at any time, and a payload that jumps this often on average."
        yield from _head("payload_jumps", low, high)
        yield f'joining = "{jumps.joining}"'
        yield f'dwell_s = "{text(jumps.dwell_s)}"'
        yield f'factor = "{text(jumps.factor)}"'
        yield f'decay_per_s = "{text(jumps.decay_per_s)}"'
        yield from matrix_lines(jumps.coefficients)
    cycle = found.counterexample
    if cycle is not None and cycle.cycles:
        yield "# Two stages (numbered from 0) in turn at one payload, under which the motion grows."
        yield "[[counterexample]]"
        yield 'kind = "stage_cycle"'
        yield f"stages = {list(cycle.stages)}"
        yield f'outer_end_mass_kg = "{text(exact(cycle.outer_end_mass_kg))}"'
        yield "time_s = [" + ", ".join(f'"{text(exact(value))}"' for value in cycle.time_s) + "]"
        yield f"cycles = {cycle.cycles}"
        yield ""


def _head(kind: str, low: str, high: str) -> Iterator[str]:
    yield "[[claim]]"
    yield f'kind = "{kind}"'
    yield f'low = "{low}"'
    yield f'high = "{high}"'


def in_words(found: StageSwitching, dwell_s: float) -> list[str]:
    """What is proved of changes between stages, a line each.

    Args:
        found: what was proved.
        dwell_s: least time between changes that the schedule keeps.
    """
    if found.kind == "any_time":
        lines = [
            "proved: stable whichever stage acts when, at every payload that stays (one Lyapunov function for all)"
        ]
    elif found.status == "proved":
        least = f"{float(found.dwell_s.p) / float(found.dwell_s.q):.4g} s"
        kept = "kept by the schedule" if found.suffices(dwell_s) else f"NOT kept by its dwell_s of {dwell_s:g}"
        lines = [f"proved: stable for changes of stage at least {least} apart on average, which is {kept}"]
    else:
        lines = [f"{found.status.upper()}: changes of stage: {found.reason}"]
    if found.kind == "dwell" and found.reason:
        lines.append(f"not at any time: {found.reason}")
    joining = {"matched": "joining with the tip's velocity", "from_rest": "joining at rest or with any part of it"}
    for rate in found.rates:
        lines.append(
            f"proved: the same while the payload changes at up to {rate.rate_kg_per_s:g} kg/s, {joining[rate.joining]}"
        )
    for jumps in found.jumps:
        apart = float(jumps.dwell_s.p) / float(jumps.dwell_s.q)
        lines.append(
            f"proved: the same while the payload jumps, at least {apart:.4g} s apart on average,"
            f" {joining[jumps.joining]}"
        )
    return [*lines, "all of it about the linear loop, each law in continuous time"]
