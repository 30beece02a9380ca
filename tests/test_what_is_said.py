"""What is said goes no further than what is proved: of which rigs, with which effects, of which laws and payloads."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from finished_run import finished_run

from beamdesign import InputError, Prototype, code, read_prototype
from beamdesign.build.ratings import SensorNeed
from beamdesign.build.result_folder import FILES, report_html
from beamdesign.build.specification import specification_of
from beamdesign.synthesis.law_design import Proved

STUDIES = Path(__file__).parents[1] / "studies"
TAME = read_prototype(STUDIES / "prototypes" / "tame_lag.toml")
MASSES = (0.0, 6.8)


def with_effects(*names: str) -> Prototype:
    return TAME.but(effects={name: {} for name in names})


def of_tame(*effects: str) -> dict[str, object]:
    """What JSON says is guaranteed of the tame lag with some effects."""
    assert TAME.controller is not None
    return Proved(TAME.controller, 2.5, 3.0, 2.0, np.zeros(0)).guaranteed(with_effects(*effects), MASSES)


def test_any_computing_time_is_refused_where_no_sampled_loop_is_worked_out() -> None:
    with pytest.raises(InputError, match=r"any_computing_time.*not worked out for a prototype with effects"):
        code(with_effects("sensor_lag"), 10_000.0, any_computing_time=True)
    assert code(with_effects("sensor_lag"), 10_000.0).proved is None


def test_a_report_says_where_each_proof_stands_and_by_what_method_it_is_proved_again() -> None:
    """Of a box it is the same method in other code; figures of the nominal rig stand in a certificate of their own."""
    page = report_html(finished_run(), {**FILES, "certificate_box": "certificate.box.toml"})
    said = " ".join(re.sub("<[^>]*>", " ", page).split())
    for name, method in (("certificate", "another method"), ("certificate.box", "the same method in code of its own")):
        assert f"beamdesign certify --replay {name}.toml" in said
        assert f"by {method}" in said
    assert "With exactly the figures stated it carries" in said


def test_a_specification_says_of_which_rigs_it_is_proved() -> None:
    found = specification_of(finished_run())
    need = SensorNeed(30.0, 2000.0, 300.0, 4.6, 2.1, 1e-4, 0.1, 1e-5, 100.0, 1e-6, 1e-5, None, None)
    assert found.to_dict()["guaranteed"]["rigs"] == "nominal"
    assert ("proved", "for exactly these figures", "") in replace(found, laws=(), sensor=need).rows()
