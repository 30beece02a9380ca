"""Of what kind a gap is: linear, static, hysteretic or drifting."""

from collections.abc import Sequence

import casadi as ca

from beamdesign.gap.fitting.hypothesis import WRONG
from beamdesign.gap.where.conditions import Setting
from beamdesign.gap.where.missing import Explanation
from beamdesign.rig.assembly import Structure, assemble
from beamdesign.rig.effects import library
from beamdesign.rig.electronics import LAG

_DRIFT = 0.5  # of the residual's power
_BENT = 0.3  # of the residual's power away from the lines of the input
_TOLD = 0.3  # share that a subsystem's laws must explain for their kind to count


def kind_of_effect(name: str) -> str:
    """Kind of a cause of the library: by its memory, and by whether its equations are linear in the states."""
    if name.startswith(WRONG):
        return "linear"
    effect = library().get(name)
    if effect is None:
        return ""
    if effect.memory:
        return "hysteretic"
    assembly = assemble(Structure(LAG, False, (name,)))
    t, x, u, p = (ca.SX.sym(n, *assembly.function.size_in(k)) for k, n in enumerate("txup"))
    rate, y = assembly.function(t, x, u, p)
    slopes = ca.jacobian(ca.vertcat(rate, y), ca.vertcat(x, u))
    bent = any(ca.which_depends(ca.vec(slopes), ca.vertcat(x, u), 1, True))
    return "static" if bent else "linear"


def kind_of_residual(seen: Setting, laws: Sequence[Explanation]) -> str:
    """Kind of a gap whose cause is not known: by its slowness, by the laws that explain most, by its distortion."""
    if seen.slow > _DRIFT:
        return "drifting"
    if laws and laws[0].share > _TOLD and laws[0].kinds:
        return laws[0].kinds[0]
    if seen.distortion == seen.distortion:
        return "static" if seen.distortion > _BENT else "linear"
    return ""
