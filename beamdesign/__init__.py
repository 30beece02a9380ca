"""Design of actively straightened robot links: sections, controller and end mass, with proofs that they hold.

The verbs of the command line as functions on one record, the `Prototype`. Importing this package loads none of their
engines; each comes with the first use of its name.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from beamdesign.checker import check
    from beamdesign.control_models import state_space
    from beamdesign.design.codesign import codesign
    from beamdesign.design.sizing import size
    from beamdesign.design.tuning import tune
    from beamdesign.loop import critical_gain
    from beamdesign.problem import DesignProblem, read_problem
    from beamdesign.proof.certifying import certify
    from beamdesign.prototype import Prototype, read_prototype, write_prototype
    from beamdesign.records import InputError
    from beamdesign.study.design_run import run_design

_ROOMS = {
    "DesignProblem": "beamdesign.problem",
    "InputError": "beamdesign.records",
    "Prototype": "beamdesign.prototype",
    "certify": "beamdesign.proof.certifying",
    "codesign": "beamdesign.design.codesign",
    "critical_gain": "beamdesign.loop",
    "read_problem": "beamdesign.problem",
    "read_prototype": "beamdesign.prototype",
    "check": "beamdesign.checker",
    "run_design": "beamdesign.study.design_run",
    "size": "beamdesign.design.sizing",
    "state_space": "beamdesign.control_models",
    "tune": "beamdesign.design.tuning",
    "write_prototype": "beamdesign.prototype",
}

__all__ = [
    "DesignProblem",
    "InputError",
    "Prototype",
    "certify",
    "check",
    "codesign",
    "critical_gain",
    "read_problem",
    "read_prototype",
    "run_design",
    "size",
    "state_space",
    "tune",
    "write_prototype",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    if name not in _ROOMS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_ROOMS[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
