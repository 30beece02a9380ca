"""One blind case, said and true, in the terms that scores are made of."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from beamdesign.diagnosis.fitting.hypothesis import subsystem
from beamdesign.validation.blind.blindcheck import Opened

NO_GAP, UNKNOWN, FAILED = "no_gap", "unknown", "failed"
_BROKE_OFF = ("failed", "failed_at")
_ALIKE = {
    "sensor_lag": "break_Hz",
    "transport_delay": "delay_s",
    "unequal_piston_areas": "asymmetry",
    "pressure_dependent_flow": "supply_pressure_Pa",
    "seal_friction": "coulomb_N",
    "valve_deadband": "half_width_A",
    "valve_hysteresis": "half_width_A",
    "current_saturation": "limit_A",
    "second_beam_mode": "frequency_Hz",
    "mount_compliance": "stiffness_N_per_m",
    "joint_backlash": "play_m",
}
"""The parameter of an effect that means the same in both models. None of entrained air: its law has other exponents."""


@dataclass(frozen=True)
class Outcome:
    """One case.

    Attributes:
        key: of the case.
        kind: null, single, pair, outside or parameter.
        effects: that were in it, the dominant one first; none for a null.
        subsystem: of the dominant one.
        gap_over_floor: how far the effects stand out of the noise.
        each_over_floor: the least of the effects alone.
        verdict: what was said; `failed` where the diagnosis broke off.
        chosen: causes held responsible.
        named: the first of them, or `no_gap`, `unknown`, `failed`.
        where: subsystem that was said.
        probability: of each stated cause, by name.
        exactly: of exactly what was in it (an effect outside the library: that it is unknown).
        no_gap: probability that was given to no gap at all.
        unknown: to something outside the library.
        alternatives: names in the classes of what cannot be told apart.
        closed: share of the gap that was said to close, with its interval; None without one.
        interval: of it.
        closed_truly: against the noise-free rig.
        parameter_error: relative, of the effect named first where that is right; None where not comparable.
        seconds: of its diagnosis, and of processor time; None where parts were done before.
        baselines: causes chosen by each.
        failure: why the diagnosis broke off, and where; empty where it did not.
    """

    key: str
    kind: str
    effects: tuple[str, ...]
    subsystem: str
    gap_over_floor: float
    each_over_floor: float
    verdict: str
    chosen: tuple[str, ...] = ()
    named: str = FAILED
    where: str = ""
    probability: Mapping[str, float] = field(default_factory=dict)
    exactly: float = 0.0
    no_gap: float = 0.0
    unknown: float = 0.0
    alternatives: tuple[str, ...] = ()
    closed: float | None = None
    interval: tuple[float, float] | None = None
    closed_truly: float | None = None
    parameter_error: float | None = None
    seconds: tuple[float, float] | None = None
    baselines: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    failure: str = ""

    @property
    def label(self) -> str:
        """Its row in a table of confusion; two effects go by the dominant one."""
        if self.kind == "null":
            return NO_GAP
        return {"pair": f"{self.effects[0]} +", "outside": f"outside: {self.effects[0]}"}.get(
            self.kind, self.effects[0]
        )


def outcome(case: Opened) -> Outcome:
    """Put what was said beside what is true."""
    answer, found = case.answer, case.found
    effects = tuple(name for name in answer["effects"] if name != NO_GAP)
    gaps = answer["gaps_over_floor"]
    base = {
        "key": case.key,
        "kind": answer["kind"],
        "effects": effects,
        "subsystem": answer["subsystem"],
        "gap_over_floor": answer["gap_over_floor"],
        "each_over_floor": min((gaps[name] for name in effects), default=0.0),
    }
    if "diagnosis" not in found:
        return Outcome(**base, verdict=FAILED, failure=" at ".join(str(found[k]) for k in _BROKE_OFF if k in found))
    said = found["diagnosis"]
    verdict, gap = said["verdict"], said["gap"]
    causes = {cause["name"]: cause for cause in said["effects"]}
    probability = {name: cause["probability"] for name, cause in causes.items()}
    stated = {frozenset(row["names"]): row["probability"] for row in said["hypotheses"]}
    unknown = said["probability_unknown"]
    named = _named(verdict, said["chosen"], list(causes))
    comparable = verdict != UNKNOWN and gap["closed"] is not None
    time = found.get("time")
    return Outcome(
        **base,
        verdict=verdict,
        chosen=tuple(said["chosen"]),
        named=named,
        where=said["where"]["subsystem"],
        probability=probability,
        exactly=unknown if answer["kind"] == "outside" else stated.get(frozenset(effects), 0.0),
        no_gap=stated.get(frozenset(), 0.0),
        unknown=unknown,
        alternatives=tuple(
            sorted({name for rivals in said["classes"] for text in rivals for name in text.split(" + ")})
        ),
        closed=gap["closed"] if comparable else None,
        interval=tuple(gap["closed_interval"]) if comparable else None,
        closed_truly=case.closed,
        parameter_error=_parameter_error(named, answer, causes),
        seconds=(time["seconds"], time["cpu_seconds"]) if time else None,
        baselines={name: tuple(way["chosen"]) for name, way in found["baselines"].items()},
    )


def _named(verdict: str, chosen: list[str], ranked: list[str]) -> str:
    if verdict in (NO_GAP, UNKNOWN):
        return verdict
    return next(iter((*chosen, *ranked)), UNKNOWN)


def _parameter_error(named: str, answer: dict[str, Any], causes: dict[str, Any]) -> float | None:
    true, said = answer["parameters"].get(named), causes.get(named, {}).get("parameters", {})
    if true is None:
        return None
    if "figure" in true:
        key, value = true["figure"], true["value"]
    else:
        key = _ALIKE.get(named, "")
        value = true.get(key)
        if named == "sensor_lag" and true.get("order") != 1:
            return None
    if not value or key not in said:
        return None
    return abs(said[key]["value"] / value - 1)


def subsystem_of(chosen: tuple[str, ...]) -> str:
    """Of the first of some causes; empty without any."""
    return subsystem(chosen[0]) if chosen else ""
