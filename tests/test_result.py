"""What a public function gives shows itself: a short text, a table for a notebook, plain values for a file."""

import json
from dataclasses import dataclass

from beamdesign.result import Result


@dataclass(frozen=True, repr=False)
class Weighed(Result):
    mass_kg: float
    parts: dict[str, float]
    reason: str = ""


def test_a_yes_is_short_and_a_no_tells_why():
    found = Weighed(2.0, {"tube_kg": 1.23456, "rest_kg": float("inf")})
    assert (found.yes, found.status) == (True, "yes")
    assert repr(found) == "<Weighed: yes; mass_kg=2, parts.tube_kg=1.235>"
    refused = Weighed(2.0, {}, "too <heavy>")
    assert not refused.yes
    assert "too <heavy>" in repr(refused)
    assert "too &lt;heavy&gt;" in refused._repr_html_()


def test_rows_and_page_and_file_hold_the_same_figures():
    found = Weighed(2.0, {"tube_kg": 1.23456, "rest_kg": float("inf")})
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["parts"] == {"tube_kg": 1.23456, "rest_kg": None}
    assert found.rows() == [("mass_kg", 2.0), ("parts.tube_kg", 1.23456)]
    assert "<td>parts.tube_kg</td><td>1.235</td>" in found._repr_html_()
