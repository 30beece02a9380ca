"""Which stage acts: hysteresis through the overlaps of the stages, and time between changes."""

from math import inf

from beamdesign.controllers import Scheduled
from beamdesign.scheduling.estimator import Estimate


def next_stage(schedule: Scheduled, stage: int, estimate: Estimate, since_s: float) -> int:
    """The stage to go on with.

    A stage keeps acting while the estimate lies within its range, less the estimator's band towards its neighbours:
    then the payload itself is in the range as long as the estimate errs by no more than the band. Ranges overlap by
    more than two bands; the rest is hysteresis.

    Args:
        schedule: stages and figures.
        stage: number of the one that acts, from 0.
        estimate: of the payload.
        since_s: time since the last change.
    """
    if since_s < schedule.dwell_s or estimate.std_kg > schedule.estimator.largest_std_kg:
        return stage
    spare = [_spare(schedule, k, estimate.outer_end_mass_kg) for k in range(len(schedule.stage))]
    if spare[stage] >= 0:
        return stage
    return max(range(len(spare)), key=lambda k: spare[k])


def _spare(schedule: Scheduled, stage: int, mass: float) -> float:
    """How far inside a stage's range less the band a payload is, kg; the ends of the whole range are open."""
    low, high = schedule.stage[stage].outer_end_mass_kg
    band = schedule.estimator.band_kg
    below = inf if stage == 0 else mass - low - band
    above = inf if stage == len(schedule.stage) - 1 else high - band - mass
    return min(below, above)
