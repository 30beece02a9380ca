"""Laws chosen by the payload: their record, the payload's estimate, the choice of a stage, and their loop in time."""
