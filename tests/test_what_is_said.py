"""What is said goes no further than what is proved: of which rigs, with which effects, of which laws and payloads."""

from pathlib import Path

import numpy as np
import pytest

from beamdesign import InputError, Prototype, code, read_prototype
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
