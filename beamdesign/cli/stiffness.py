"""`beamdesign stiffness`: a controller that gives the end of the link a commanded stiffness, proved for contact."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.command import CommandResult, Figure, by_stage, command, figures_of, in_time, mass_range
from beamdesign.cli.output import echo, echo_table, progress, refuse
from beamdesign.files import write_set
from beamdesign.result import picked

if TYPE_CHECKING:
    from beamdesign.controllers import Cascade
    from beamdesign.proofs.contact import Wall
    from beamdesign.prototype import InStage, Prototype
    from beamdesign.synthesis.end_stiffness import EndStiffness, Need

CONTACTS: dict[str, "Need"] = {"passive": "passive", "wall": "wall", "none": "stable"}
"""Of the option, and what the design calls it."""
RIGS = 40
"""Drawn for a law to suit, and others to count what it does on them."""

_LowToHigh = Annotated[str, typer.Option(metavar="LO:HI")]


def _wrong_wishes(
    contact: str, end_stiffness_N_per_m: float | None, keep_controller: bool, **others: Any
) -> Iterator[tuple[str, str]]:
    if contact not in CONTACTS:
        yield "--contact", f"must be one of {', '.join(CONTACTS)}, is {contact!r}"
    if end_stiffness_N_per_m is None and keep_controller:
        yield "--keep-controller", "is for --end-stiffness-N-per-m; without it no other controller is made"


@partial(command, problems=_wrong_wishes)
def stiffness(
    prototype: Path,
    end_stiffness_N_per_m: Annotated[float | None, Figure("Stiffness")] = None,
    outer_end_mass: str | None = None,
    wall_N_per_m: _LowToHigh = "0:1e9",
    wall_damping_N_s_per_m: _LowToHigh = "0:0",
    contact: str = "wall",
    keep_controller: bool = False,
    rigs: Annotated[int, typer.Option(min=0, max=1000)] = RIGS,
    minutes: float | None = None,
    out: Path | None = None,
) -> CommandResult:
    """Give the end of the link a stiffness.

    From nearly none to that of the servo. The command moves by the force on the tip over the stiffness; the force is
    that of the outer beam's bending less the actuator's, from the sensors of displacement and of load pressure, or of
    the force of a screw, behind a low-pass filter. Lag and filter are searched for the widest band in which the end
    feels as commanded, within 10 %. Stability over the payload, passivity at the tip and contact with walls are proved
    or refuted in exact arithmetic, for the linear loop with its nominal figures; on rigs drawn from the tolerances they
    are counted. Without a stiffness the controller is judged as it is. Exit status 1 if contact is not what it has to
    be.

    Args:
        prototype: the prototype.toml of the rig.
        end_stiffness_N_per_m: static stiffness that the end is to have; without it the controller is judged as it is.
        wall_N_per_m: stiffness of the walls that it may touch.
        wall_damping_N_s_per_m: damping of these walls.
        contact: least that contact has to be: passive (with any passive surroundings), wall (stable against every
            wall of the range) or none (stable in the air). The most that can be had is looked for first.
        keep_controller: keep the prototype's controller; choose the force filter alone.
        rigs: rigs drawn from the prototype's tolerances that the law has to suit; 0: nominal alone.
        out: folder for prototype.toml and its certificates; else none is written.
    """
    from beamdesign.polynomial import exact
    from beamdesign.proofs.contact import Wall
    from beamdesign.prototype import read_prototype
    from beamdesign.quantities import mass_range_text

    record = read_prototype(prototype)
    stiffest = figures_of("--wall-N-per-m", wall_N_per_m, "WallStiffness", "two figures as LO:HI", ":", 2)
    damping = figures_of("--wall-damping-N-s-per-m", wall_damping_N_s_per_m, "Damping", "two figures as LO:HI", ":", 2)
    wall = Wall((exact(stiffest[0]), exact(stiffest[1])), (exact(damping[0]), exact(damping[1])))
    servo = _servo(record, prototype) if keep_controller else None
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    if end_stiffness_N_per_m is not None:
        return give_stiffness(record, end_stiffness_N_per_m, masses, wall, CONTACTS[contact], servo, rigs, out, minutes)

    from beamdesign.synthesis.end_stiffness import CONTACT_NAME, contact_text, in_words, judge

    def judged(stage: "InStage") -> tuple[dict[str, Any], bool]:
        rig, own, _ = stage
        try:
            found = judge(rig, None, own, wall)
        except ValueError as error:
            refuse(prototype, ("controller", str(error)))
        rows = [*_kept(found), ("for every outer end mass", mass_range_text(own))]
        echo_table(f"{rig.name}: its end, with the controller as it is", ("figure", "value"), rows)
        for line in in_words(found, wall):
            echo(line)
        paths: dict[str, Path] = {}
        if out is not None:
            text = contact_text(rig, found, own, wall)
            paths = write_set(out / stage.suffix[1:], {"certificate_contact": (CONTACT_NAME, text)})
            echo(f"certificate_contact: {paths['certificate_contact']}")
        met = next((one for one in CONTACTS.values() if found.meets(one)), None)
        return _fields(found, wall) | {"met": met, "reason": "", **paths}, found.meets(CONTACTS[contact])

    return by_stage(record, masses, judged)


def give_stiffness(
    record: "Prototype",
    end_stiffness: float,
    masses: tuple[float, float],
    wall: "Wall | None" = None,
    need: "Need" = "wall",
    servo: "Cascade | None" = None,
    rigs: int = RIGS,
    out: Path | None = None,
    minutes: float | None = None,
) -> CommandResult:
    """Design, prove, say and write, against every wall where none is given.

    The rigs that the law has to suit are drawn from the tolerances.

    Raises:
        InputError: for a stiffness that is none, or effects.
    """
    from beamdesign.proofs.contact import EVERY_WALL
    from beamdesign.quantities import mass_range_text, quantity
    from beamdesign.records import to_toml
    from beamdesign.synthesis.design_run import CERTIFICATE_NAME
    from beamdesign.synthesis.end_stiffness import CONTACT_NAME, in_words, softest_N_per_m
    from beamdesign.synthesis.stiffness_search import carried_out, design, drawn_in_words, drawn_rigs

    wall = wall or EVERY_WALL
    with in_time(minutes, "2 to 5 min") as limit, progress("end stiffness") as update:
        found = design(record, end_stiffness, masses, wall, need, servo, rigs, update)
    if found.best is None:
        echo(found.reason)
        return CommandResult({"controller": None, "met": None, "reason": found.reason, **limit}, yes=False)
    best = found.best
    assert best.law is not None  # it was searched
    done = carried_out(record, best, masses, wall)
    softest = softest_N_per_m(record, best.law.servo, best.law.force_filter_Hz, masses)
    rows = [
        *best.law.servo.summary(),
        ("force filter", quantity(best.law.force_filter_Hz, "Hz")),
        *_kept(best),
        ("softest with this lag and filter, at either end of the payload", quantity(softest, "N/m")),
        ("stiffest, the servo alone", quantity(best.servo_N_per_m, "N/m")),
        ("for every outer end mass", mass_range_text(masses)),
    ]
    echo_table(f"{record.name}: end stiffness {quantity(end_stiffness, 'N/m')}", ("figure", "value"), rows)
    if found.reason:
        echo(f"{found.reason}; the next best is given")
    for line in in_words(best, wall):
        echo(line)
    others = drawn_rigs(done.prototype, masses, wall, RIGS)
    if others:
        echo(drawn_in_words(others))
    texts = {
        "prototype": ("prototype.toml", to_toml(done.prototype)),
        "certificate": (CERTIFICATE_NAME, done.certificate.text),
        "certificate_contact": (CONTACT_NAME, done.contact),
    }
    paths = {} if out is None else write_set(out, texts)
    fields = _fields(best, wall) | picked(found, "met reason") | limit
    return CommandResult(fields | {"drawn": others, **paths}, files=paths.values())


def _kept(found: "EndStiffness") -> list[tuple[str, Any]]:
    """Rows of what is proved of stiffness, command and sensitivity."""
    from beamdesign.quantities import at_least, quantity, stated_peak
    from beamdesign.synthesis.end_stiffness import SHARE

    return [
        ("static stiffness of the end", quantity(found.static_N_per_m, "N/m")),
        (f"apparent stiffness within {SHARE:.0%} of it", f"up to {at_least(found.band_Hz, 'Hz')}"),
        ("free end follows its command, 0.707 or more", f"up to {at_least(found.command_Hz, 'Hz')}"),
        ("command followed at rest, share of it", found.command_at_rest),
        ("guaranteed peak sensitivity", stated_peak(found.peak_sensitivity)),
    ]


def _servo(record: "Prototype", source: Path) -> "Cascade":
    """The prototype's own law, or the one that its compliant controller was made from.

    Raises:
        InputError: where there is none.
    """
    from beamdesign.controllers import Cascade

    if record.compliance is not None:
        return record.compliance.servo
    if record.controller is None:
        refuse(source, ("controller", "missing; write it there, or leave out --keep-controller"))
    if not isinstance(record.controller, Cascade):
        reason = f"{record.controller.kind!r} cannot be kept without a [compliance] that says what it stands for"
        refuse(source, ("controller.kind", f"{reason}; give a lag"))
    return record.controller


_STATED = """end_stiffness_N_per_m static_stiffness_N_per_m=static_N_per_m servo_stiffness_N_per_m=servo_N_per_m
    stiffness_band_Hz=band_Hz command_bandwidth_Hz=command_Hz command_at_rest peak_sensitivity stable
    passive=passivity.holds wall_stable=contact.holds stiffest_wall_N_per_m
    one_sided_wall_N_per_m=unilateral_contact.stiffness_N_per_m"""


def _fields(best: "EndStiffness", wall: "Wall") -> dict[str, Any]:
    def environment(found: Any) -> dict[str, float] | None:
        names = "mass_kg=mass stiffness_N_per_m=stiffness damping_N_s_per_m=damping"
        return None if found is None else {name: float(value) for name, value in picked(found, names).items()}

    return {
        "servo": None if best.law is None else best.law.servo.model_dump(),
        "force_filter_Hz": None if best.law is None else best.law.force_filter_Hz,
        **picked(best, _STATED),
        "active_bands": [picked(band, "low_Hz high_Hz sample_Hz") for band in best.passivity.bands],
        "destabilised_by": environment(best.destabilising_environment),
        "wall_N_per_m": [float(value) for value in wall.stiffness],
        "wall_witness": environment(best.contact.witness),
    }
