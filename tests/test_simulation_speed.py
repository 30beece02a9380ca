"""The speed table of simulated records, on a short run: every row is there, its errors small. No time is asserted."""

from contextlib import redirect_stdout
from io import StringIO

import pytest
import simulation_speed


def test_all_ways_stand_in_the_table_and_agree():
    with redirect_stdout(StringIO()) as printed:
        rows = simulation_speed.main(["--duration-s", "0.06"])
    by_table = {
        (row.case, row.table): [other for other in rows if other.table == row.table and other.case == row.case]
        for row in rows
    }
    assert {case for case, _ in by_table} == {"no effects", "all effects"}
    assert len(by_table) == 4
    for (_, name), found in by_table.items():
        assert len(found) == (4 if name == "record" else 3)
        for row in found:
            assert row.way in printed.getvalue()
            assert row.ratio == pytest.approx(row.seconds / found[0].seconds)
        if name == "record":
            assert max(row.error for row in found) < 5e-3  # RK45 at its loose tolerance, on the build-up
        else:
            assert found[0].error == pytest.approx(found[1].error, rel=0.1)  # both differentiate the same steps
            assert found[0].error < 0.05
