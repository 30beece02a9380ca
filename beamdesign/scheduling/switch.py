"""Which stage acts: hysteresis through the overlaps of the stages, and time between changes."""

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
    mass = estimate.outer_end_mass_kg
    spare = [min(mass - least, most - mass) for least, most in schedule.kept_kg]
    if spare[stage] >= 0:
        return stage
    return max(range(len(spare)), key=lambda k: spare[k])
