"""Tasks on prototypes: what is found and proved of one. Each loads the engine that it needs."""

from typing import TYPE_CHECKING, Any

from beamdesign.json_text import picked
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.sweep.tasks import (
    ERRORS,
    Answer,
    ArmOptions,
    AtMassOptions,
    CertifyOptions,
    RangeOptions,
    TuneOptions,
    of_all,
    payload_range,
    proved_outputs,
)

if TYPE_CHECKING:
    from beamdesign.proofs.arm.result import ArmResult
    from beamdesign.proofs.certificate import Certificate
    from beamdesign.synthesis.tuning import Tuning


def tune(prototype: Prototype, options: TuneOptions) -> Answer:
    """Controller and inner end mass with the largest guaranteed bandwidth over the payload range.

    Of several laws the one of the least bandwidth, with those of each in the details.
    """
    from beamdesign.synthesis import tuning

    kind, rig = options.controller, prototype.but(goal=tuning.limited(prototype.goal, options.controller))
    found = tuning.tune(rig, payload_range(prototype), kind, **options.sought)
    if found.reason:
        return Answer({}, _effort(found), found.reason)
    answers = {}
    for stage, law in zip(found.stages, found.each, strict=True):
        assert law.best is not None
        details = _effort(law) | {"controller": law.best.controller.model_dump(mode="json")}
        answers[stage.prototype.name] = Answer(proved_outputs(law.best), details)
    return of_all(answers)


def _effort(found: "Tuning") -> dict[str, Any]:
    return {"starts_Hz": list(found.starts), "certificates": found.certificates}


def certify(prototype: Prototype, options: CertifyOptions) -> Answer:
    """What is proved of one prototype over its own payload range."""
    from beamdesign.proofs.certificate import Asked, describe
    from beamdesign.proofs.certifying import certify as prove

    asked = []
    if options.bandwidth_Hz is not None:
        asked.append(Asked("compliance", prototype.goal.compliance_m_per_N, options.bandwidth_Hz))
    if options.peak_sensitivity is not None:
        asked.append(Asked("peak_sensitivity", options.peak_sensitivity))
    found = prove(prototype, *payload_range(prototype), asked)
    below, above = found.stability.below, found.stability.above
    outputs = {
        **_guaranteed(found, None),
        "stable_ranges_kg": [f"{low:.7g} to {high:.7g}" for low, high in found.stable_ranges_kg],
        "stable_share": _share(found),
        "unstable_below_kg": below.value if below is not None and below.value >= 0 else None,
        "unstable_above_kg": above.value if above is not None else None,
        **_crossings(found),
    }
    claims = [
        {"claim": describe(claim), **picked(claim, "holds reason mass_kg=witness_outer_end_mass_kg")}
        for claim in found.claims
    ]
    details = {"method": found.method, "scope": list(found.scope), "claims": claims}
    return Answer(outputs, details, found.reason)


def _guaranteed(found: "Certificate", no_bandwidth: float | None) -> dict[str, Any]:
    sure = found.guaranteed
    return {
        "stable": found.stable,
        "bandwidth_Hz": sure.bandwidth_Hz if sure else no_bandwidth,
        "peak_sensitivity": sure.peak_sensitivity if sure else None,
    }


def _crossings(found: "Certificate") -> dict[str, Any]:
    return {
        "crossings_kg": [crossing.value for crossing in found.crossings],
        "crossing_frequencies_Hz": [crossing.frequency_Hz for crossing in found.crossings],
    }


def _share(found: "Certificate") -> float:
    """Share of the payload range that is stable; of a single mass, 1 or 0."""
    low, high = found.outer_end_mass_kg
    if low == high:
        return float(found.stable)
    return sum(most - least for least, most in found.stable_ranges_kg) / (high - low)


def stable_masses(prototype: Prototype, options: RangeOptions) -> Answer:
    """Exact stable ranges of mass on the outer tip, with the frequencies at the crossings; none at all is a no."""
    from beamdesign.proofs.certifying import certify as prove

    found = prove(prototype, options.from_kg, options.to_kg)
    ranges = found.stable_ranges_kg
    ends = {"stable_from_kg": [low for low, _ in ranges], "stable_to_kg": [high for _, high in ranges]}
    return Answer(ends | _crossings(found), {"method": found.method}, "" if ranges else found.stability.reason)


def robust(prototype: Prototype, options: RangeOptions) -> Answer:
    """Prove one rig over its payload range, and find its longest stable range between the masses of the options.

    Everything is exact for this one set of figures. A loop that is not stable over its payload has no bandwidth: 0.
    """
    from beamdesign.proofs.certifying import certify as prove

    found = prove(prototype, *payload_range(prototype))
    around = prove(prototype, options.from_kg, options.to_kg)
    low, high = max(around.stable_ranges_kg, key=lambda ends: ends[1] - ends[0], default=(0.0, 0.0))
    longest = {"stable_from_kg": low, "stable_to_kg": high, "stable_width_kg": high - low}
    return Answer(_guaranteed(found, 0.0) | longest, {"method": found.method}, found.reason)


def lag_breaks(prototype: Prototype, options: Any) -> Answer:
    """Exact zero frequencies with which a lag is stable for every payload, at its pole and gain.

    The prototype's own zero only tells whether it is inside.
    """
    from beamdesign.proofs.rectangle import stable_zeros

    law = prototype.controller
    if law is None or law.lacks("lag") or (lag := law.lag) is None:
        raise InputError(prototype.name, [("controller", "must be a lag")])
    low, high = payload_range(prototype)
    found = stable_zeros(prototype, lag.pole_Hz, law.gain_A_per_V, (low, high))
    outputs = {
        "stable_zero_from_Hz": [part.low_Hz for part in found],
        "stable_zero_to_Hz": [part.high_Hz for part in found],
        "own_zero_stable": any(part.low_Hz <= lag.zero_Hz <= part.high_Hz for part in found),
    }
    return Answer(outputs, reason="" if found else f"no zero is stable for every mass from {low:g} to {high:g} kg")


def at_mass(prototype: Prototype, options: AtMassOptions) -> Answer:
    """Stability, margins and bandwidth at one mass on the outer tip; an unstable loop is a no."""
    from beamdesign.loop import critical_gain, loop

    there = loop(prototype).at(options.outer_end_mass_kg)
    outputs: dict[str, Any] = {"stable": there.stable}
    try:
        critical = critical_gain(prototype, options.outer_end_mass_kg)
        outputs |= picked(critical, "critical_gain_A_per_V=gain_A_per_V critical_frequency_Hz=frequency_Hz")
    except ValueError:  # it oscillates at no gain, or at every low one: there is no such figure
        outputs |= {"critical_gain_A_per_V": None, "critical_frequency_Hz": None}
    if not there.stable:
        return Answer(outputs, reason=f"unstable with {options.outer_end_mass_kg:g} kg on the outer tip")
    outputs |= {
        "bandwidth_Hz": there.bandwidth_Hz(prototype.goal.compliance_m_per_N),
        "peak_sensitivity": there.peak_sensitivity(),
        **picked(there.margins(), "gain_margin=gain_up phase_margin_deg=phase_deg"),
        "static_compliance_m_per_N": there.static_compliance(),
    }
    return Answer(outputs)


def arm(prototype: Prototype, options: ArmOptions) -> Answer:
    """Both planes with torsion over the payload range, and the error that a load leaves; "no" where not stable."""
    from beamdesign.plant.members import STANDARD_GRAVITY
    from beamdesign.proofs.arm.result import work_out

    masses = payload_range(prototype)
    weight = masses[1] * STANDARD_GRAVITY + (prototype.payload.largest_force_N or 0.0)
    force = weight if options.force_N is None else options.force_N
    found = work_out(prototype, masses, (0.0, 0.0, -force))
    outputs: dict[str, Any] = {"stable": found.stable, "force_N": force, "error_alone_m": found.without.size_m}
    if found.with_servo is not None:
        outputs["error_m"] = found.with_servo.size_m
        outputs |= {f"error_by_{cause}_m": size for cause, size in found.with_servo.shares_m.items()}
        outputs |= dict(zip(ERRORS.split(), found.with_servo.rotation_rad, strict=True))
    outputs["torsion_tip_held_Hz"] = found.frequencies[-1].torsion_held_Hz
    return Answer(outputs | _of_planes(found), {"notes": list(found.figures.notes)}, found.reason)


def _of_planes(found: "ArmResult") -> dict[str, Any]:
    """The worse of both planes; nothing where the payload couples them."""
    sure = [plane.guaranteed for plane in found.planes if plane.guaranteed is not None]
    if not sure or len(sure) < len(found.planes):
        return {}
    worse = {"peak_sensitivity": max, "tip_bandwidth_Hz": min, "load_bandwidth_Hz": min}
    return {name: of(getattr(plane, name) for plane in sure) for name, of in worse.items()}


def limits(prototype: Prototype, options: AtMassOptions) -> Answer:
    """Largest force on the tip at 1, 10 and 100 Hz with one mass there, what governs it, and the static error."""
    import numpy as np

    from beamdesign.synthesis.operating_limits import envelope, sensor_reach

    shown_Hz = np.array([1.0, 10.0, 100.0])
    found = envelope(prototype, options.outer_end_mass_kg, frequency_Hz=shown_Hz)
    outputs: dict[str, Any] = {}
    for k, frequency in enumerate(shown_Hz if not found.reason else ()):
        outputs[f"load_at_{frequency:g}_Hz_N"] = float(found.load_N[k])
        outputs[f"governing_at_{frequency:g}_Hz"] = found.governing[k]
        outputs[f"displacement_at_{frequency:g}_Hz_m"] = float(found.displacement_m[k])
    if not found.reason:
        outputs["static_error_m_per_N"] = sensor_reach(prototype, options.outer_end_mass_kg).static_error_m_per_N
    return Answer(outputs, {"missing": found.missing}, found.reason)
