"""What each cause would change if there were a little of it: columns for a linear look at a residual."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from beamdesign.gap.fitting.evidence import RecordEvidence
from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.hypothesis import NOTHING, WRONG, Hypothesis
from beamdesign.gap.fitting.unknowns import Placement, Unknown
from beamdesign.parameters import RIG_TOLERANCES
from beamdesign.prototype import Prototype
from beamdesign.rig.effects import library

_STRENGTH = {
    "carrier_ripple": ("depth", 1),
    "current_saturation": ("limit_A", -1),
    "entrained_air": ("air_fraction", 1),
    "joint_backlash": ("play_m", 1),
    "mount_compliance": ("stiffness_N_per_m", -1),
    "pressure_dependent_flow": ("supply_pressure_Pa", -1),
    "seal_friction": ("coulomb_N", 1),
    "second_beam_mode": ("compliance_share", 1),
    "sensor_lag": ("break_Hz", -1),
    "transport_delay": ("delay_s", 1),
    "unequal_piston_areas": ("asymmetry", 1),
    "uneven_leakage": ("imbalance", 1),
    "valve_deadband": ("half_width_A", 1),
    "valve_hysteresis": ("half_width_A", 1),
}
"""The parameter by which an effect grows, and whether it grows with it or against it. Others take their first one."""
_LADDER = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0)  # prior standard deviations from the default, weak first
_WEAK = 0.1  # of the default, for a parameter that may be none
_SEEN = 0.1  # unit of misfit: what changes less is not there


@dataclass(frozen=True)
class Dictionary:
    """Terms, each of one severity, with the tolerances free to make up for what they can.

    The misfit falls by slope^2 / gram of one term, and by b'G^-1 b of several.

    Attributes:
        names: (K,) cause that each term belongs to.
        gram: (K, K) G.
        slope: (K,) b.
    """

    names: tuple[str, ...]
    gram: np.ndarray = field(repr=False)
    slope: np.ndarray = field(repr=False)


def dictionary(prototype: Prototype, evidence: Sequence[RecordEvidence], null: Fit) -> Dictionary:
    """Linearise about the null fit.

    An effect's term is the change of the residual at the weakest of some severities at which it can be seen; its
    other parameters have their defaults. A wrong figure's term is the derivative by it.

    Args:
        prototype: that was believed.
        evidence: time records.
        null: fit of the tolerances alone.
    """
    placement = NOTHING.placement(prototype)
    if null.reason or (base := _linearised(evidence, placement, null.z)) is None:
        return Dictionary((), np.zeros((0, 0)), np.zeros(0))
    residual, tolerances = base
    names: list[str] = []
    columns: list[np.ndarray] = []
    for name in (name for name, effect in library().items() if not effect.realises):
        change = _change(name, prototype, evidence, null, residual)
        if change is not None:
            names.append(name)
            columns.append(change)
    for k, unknown in enumerate(null.unknowns):
        names.append(WRONG + RIG_TOLERANCES[unknown.name])
        columns.append(tolerances[:, k])
    d = np.column_stack(columns)
    # Tolerances follow a term as far as their priors let them; at the null fit itself they have nothing to gain.
    across = tolerances.T @ d
    curvature = np.eye(tolerances.shape[1]) + tolerances.T @ tolerances
    gram = d.T @ d - across.T @ np.linalg.solve(curvature, across)
    slope = -(d.T @ residual) + across.T @ np.linalg.solve(curvature, tolerances.T @ residual + null.z)
    good = np.diag(gram) > 1e-9 * np.diag(d.T @ d)
    return Dictionary(tuple(n for n, g in zip(names, good, strict=True) if g), gram[np.ix_(good, good)], slope[good])


def _linearised(
    evidence: Sequence[RecordEvidence], placement: Placement, z: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    parts = [piece.linearised(placement, z) for piece in evidence]
    if any(part is None for part in parts):
        return None
    return np.concatenate([p[0] for p in parts if p]), np.concatenate([p[1] for p in parts if p])


def _change(
    name: str, prototype: Prototype, evidence: Sequence[RecordEvidence], null: Fit, residual: np.ndarray
) -> np.ndarray | None:
    """Of the residual, by a little of an effect; None where no severity of the ladder can be seen and is stable."""
    placement = Hypothesis((name,)).placement(prototype)
    known = null.values
    base = np.array([u.z(known[u.name]) if u.name in known else 0.0 for u in placement.unknowns])
    key, sign = _STRENGTH.get(name, (library()[name].parameters[0].name, 1))
    position = [u.name for u in placement.unknowns].index(f"{name}.{key}")
    last = None
    for step in _rungs(placement.unknowns[position], sign):
        z = base.copy()
        z[position] = step
        parts = [piece.residual(placement, z) for piece in evidence]
        if any(part is None for part in parts):
            return last
        change = np.concatenate([p for p in parts if p is not None]) - residual
        if not np.all(np.isfinite(change)):
            return last
        size = float(np.sqrt(change @ change))
        if size > _SEEN:
            return change / size
        last = change / size if size > 1e-6 else last
    return last


def _rungs(unknown: Unknown, sign: int) -> list[float]:
    """Severities as z, from weak to strong."""
    if unknown.linear:
        return [unknown.z(share * unknown.nominal) for share in (_WEAK, 0.3, 1.0, 3.0)]
    low, high = unknown.bounds
    return list(dict.fromkeys(float(np.clip(sign * step, low, high)) for step in _LADDER))
