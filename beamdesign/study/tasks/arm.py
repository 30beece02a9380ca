"""Task `arm`: both planes of a link with torsion, proved over the payload range, and the error that a load leaves."""

from beamdesign.arm.result import ArmResult, work_out
from beamdesign.members import STANDARD_GRAVITY
from beamdesign.prototype import Prototype
from beamdesign.study.answer import Answer
from beamdesign.study.tasks import ArmOptions
from beamdesign.study.tasks.certify import payload_range


def compute(prototype: Prototype, options: ArmOptions) -> Answer:
    """Prove and work out one arm over its own payload range; "no" where it is not proved stable."""
    masses = payload_range(prototype)
    weight = masses[1] * STANDARD_GRAVITY + (prototype.payload.largest_force_N or 0.0)
    force = weight if options.force_N is None else options.force_N
    found = work_out(prototype, masses, (0.0, 0.0, -force))
    outputs: dict[str, object] = {"stable": found.stable, "force_N": force, "error_alone_m": found.without.size_m}
    if found.with_servo is not None:
        outputs["error_m"] = found.with_servo.size_m
        outputs |= {f"error_by_{cause}_m": size for cause, size in found.with_servo.shares_m.items()}
        outputs |= dict(zip(("twist_rad", "about_y_rad", "about_z_rad"), found.with_servo.rotation_rad, strict=True))
    outputs["torsion_tip_held_Hz"] = found.frequencies[-1].torsion_held_Hz
    outputs |= _proved(found)
    return Answer(outputs, {"notes": list(found.figures.notes)}, found.reason)


def _proved(found: ArmResult) -> dict[str, object]:
    """The worse of both planes; nothing where the payload couples them."""
    sure = [plane.guaranteed for plane in found.planes if plane.guaranteed is not None]
    if not sure or len(sure) < len(found.planes):
        return {}
    return {
        "peak_sensitivity": max(plane.peak_sensitivity for plane in sure),
        "tip_bandwidth_Hz": min(plane.tip_bandwidth_Hz for plane in sure),
        "load_bandwidth_Hz": min(plane.load_bandwidth_Hz for plane in sure),
    }
