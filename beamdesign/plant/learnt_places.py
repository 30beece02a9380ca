"""Places of a rig at which laws are learnt: what a law there adds to, of which variable it is, and what it is like."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from flint import fmpq

from beamdesign.plant.effects import Site

Signal = Callable[[Any, Site], Any]
"""From the signal of the port itself and the site to a local variable."""


def _at(name: str) -> Signal:
    return lambda signal, site: site.port[name]


def _bending(of: str, unit: str) -> Signal:
    return lambda signal, site: site.port[f"{of}_{unit}"] - site.port[f"mount_{unit}"]


@dataclass(frozen=True)
class Place:
    """Where laws are learnt.

    Attributes:
        name: of the port, without its unit.
        subsystem: that it is in.
        ports: where a law adds, with its sign there.
        size: unit suffix of what is added, and the signal of a linear rig that tells its size.
        argument: of a curve, its unit suffix, and the signal that tells its reach.
        laws: kinds that it takes.
        travel: of a loop and its rate, with unit suffix and signal; None where it takes none.
        stiffness: figure of the rig that a lag takes a share of; empty where it takes one of the port's own signal.
        motion: what a linear spring or dashpot resists there; None where a slope is a factor on the loop's gain.
        dashpot: whether a curve's argument is the rate of that motion.
        like: what a curve there is like, in words: one that falls, that grows, that is uneven.
    """

    name: str
    subsystem: str
    ports: Mapping[str, int]
    size: tuple[str, str]
    argument: tuple[Signal, str, str]
    laws: tuple[str, ...]
    travel: tuple[Signal, Signal, str, str] | None = None
    stiffness: str = ""
    motion: Mapping[str, fmpq] | None = None
    dashpot: bool = False
    like: tuple[str, str, str] = (
        "a gain that falls with size", "a gain that grows with size", "a curve that differs by sign",
    )  # fmt: skip


def _beam(name: str, coordinate: str, uneven: str) -> Place:
    bent = f"{name}_m"
    return Place(
        f"{name}_reaction", "structure", {f"{name}_reaction_N": 1}, ("N", f"{name}_reaction_N"),
        (_bending(name, "m"), "m", bent), ("curve", "loop", "lag"),
        (_bending(name, "m"), _bending(name, "m_per_s"), "m", bent), f"{name}_stiffness",
        {coordinate: fmpq(1), "base": fmpq(-1)}, like=("a spring that softens", "a spring that hardens", uneven),
    )  # fmt: skip


def _tip(name: str, at: str, moves: str) -> Place:
    """What pushes a beam's tip from outside, so that the mount does not feel it but by the beam."""
    position, rate, read = _at(f"{at}_m"), _at(f"{at}_m_per_s"), f"{name}_m"
    return Place(
        f"{name}_force", "structure", {f"{name}_force_N": -1}, ("N", f"{name}_reaction_N"), (position, "m", read),
        ("appendage",), (position, rate, "m", read), motion={moves: fmpq(1)},
    )  # fmt: skip


def _series(subsystem: str, name: str, unit: str, *laws: str, **more: Any) -> Place:
    """A port whose signal goes on to the next: a law there is of that signal alone."""
    port = f"{name}_{unit}"
    return Place(name, subsystem, {port: 1}, (unit, port), (lambda signal, site: signal, unit, port), laws, **more)


PLACES = (
    _beam("outer", "first", "a spring that pulls on one side, as a cable does"),
    _beam("inner", "inner", "a spring that pulls on one side"),
    _tip("outer", "outer_tip", "tip"),
    _tip("inner", "inner", "inner"),
    Place(
        "friction", "actuator", {"friction_N": 1}, ("N", "actuator_force_N"),
        (_at("sliding_m_per_s"), "m_per_s", "stroke_m_per_s"), ("curve", "loop"),
        (_at("sliding_m"), _at("sliding_m_per_s"), "m", "stroke_m"), motion={"slide": fmpq(1)}, dashpot=True,
        like=("a push that grows with speed", "drag that grows faster than speed", "drag that differs by direction"),
    ),
    Place(
        "leakage", "actuator", {"leakage_a_m3_per_s": 1, "leakage_b_m3_per_s": -1}, ("m3_per_s", "metered_m3_per_s"),
        (lambda signal, site: site.port["pressure_a_Pa"] - site.port["pressure_b_Pa"], "Pa", "load_pressure_Pa"),
        ("curve",), like=("leakage that falls with pressure", "leakage that grows with pressure", "a leak to one side"),
    ),
    _series("servovalve", "metered", "m3_per_s", "curve", "droop", "drift"),
    _series("servovalve", "spool", "A", "curve", "lag"),
    _series("amplifier", "current", "A", "curve", "lag"),
    _series("amplifier", "motor_demand", "A", "curve", "lag", "drift"),
    _series(
        "sensor", "sensor", "V", "curve", "play", "lag", "resonance", "drift",
        like=("a sensor that flattens at its ends", "a sensor that steepens at its ends", "a sensor that is curved"),
    ),
)  # fmt: skip
