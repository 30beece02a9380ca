"""Cost of a diagnosis beside differences of scipy's integrator, on a short piece: both agree; no time is asserted."""

from contextlib import redirect_stdout
from io import StringIO

import diagnosis_cost


def test_both_ways_integrate_the_same_record():
    with redirect_stdout(StringIO()) as printed:
        _, errors = diagnosis_cost.main(["--samples", "120", "--no-diagnosis"])
    assert max(errors) < 2e-3
    assert "14 unknowns" in printed.getvalue()
