"""Task `sim_to_real`: design, build a virtual rig, take records, diagnose, redesign, and look at the rig again."""

from pathlib import Path
from tempfile import TemporaryDirectory

from beamdesign.diagnosis.data.dataset import read_dataset
from beamdesign.diagnosis.diagnose import diagnose
from beamdesign.diagnosis.redesign import redesign
from beamdesign.prototype import Prototype
from beamdesign.sweep.tasks import Answer, SimToRealOptions, payload_range
from beamdesign.synthesis.tuning import tune
from beamdesign.validation.truth.writing import write_case
from beamdesign.validation.virtual_rig import LINEAR, RunawayError, gain_margin, runs, virtual_rig


def sim_to_real(prototype: Prototype, options: SimToRealOptions) -> Answer:
    """Once round the loop.

    Bandwidths are proved of the model that they name. Whether a design runs is simulated on the virtual rig; gain
    margins are those of the linearised one, told only where that has the effect in it.
    """
    masses = payload_range(prototype)
    designed = tune(prototype, masses)
    if designed.best is None:
        return Answer({}, reason=designed.reason)
    built = (options.effect, options.severity, options.seed, options.duration_s)
    try:
        case = virtual_rig(designed.prototype, masses, *built)
    except RunawayError as error:
        return Answer({"believed_bandwidth_Hz": designed.best.bandwidth_Hz}, reason=str(error))
    with TemporaryDirectory() as folder:
        write_case(case, Path(folder))
        data = read_dataset(folder)
    found = diagnose(data, workers=1)
    renewed = redesign(found.prototype, masses)
    linear, new = options.effect in LINEAR, renewed.prototype
    outputs = {
        "believed_bandwidth_Hz": designed.best.bandwidth_Hz,
        "believed_design_runs": runs(case, designed.prototype, masses),
        "believed_design_gain_margin": gain_margin(case, designed.prototype, masses) if linear else None,
        "verdict": found.verdict,
        "named": list(found.chosen),
        "named_rightly": list(found.chosen) == list(case.names if case.departures else ()),
        "gap_before": found.gap.before,
        "gap_after": found.gap.after,
        "gap_closed": found.gap.closed,
        "redesigned_bandwidth_Hz": None if new is None else _bandwidth(new),
        "redesign_runs": None if new is None else runs(case, new, masses),
        "redesign_gain_margin": gain_margin(case, new, masses) if new is not None and linear else None,
    }
    details = {
        "sentences": found.sentences,
        "diagnosed": found.prototype.model_dump(mode="json", exclude_none=True),
        "redesign": renewed.reason,
    }
    return Answer(outputs, details)


def _bandwidth(prototype: Prototype) -> float | None:
    return None if prototype.guarantee is None else prototype.guarantee.bandwidth_Hz
