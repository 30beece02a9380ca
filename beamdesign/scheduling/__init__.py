"""Laws chosen by the payload: their record, the estimate of the payload, the choice of a stage, and their loop in time."""
