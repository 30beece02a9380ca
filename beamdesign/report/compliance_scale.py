"""Compliance in the two scales of the drawings: m/N, and the paper's decibels of inch per pound-force."""

from typing import Any

import numpy as np

INCH_M = 0.0254
POUND_FORCE_N = 4.4482216152605  # 0.45359237 kg at 9.80665 m/s2, both exact by definition
INCH_PER_POUND_FORCE = INCH_M / POUND_FORCE_N
"""1 in/lbf in m/N."""


def decibels(compliance_m_per_N: Any) -> Any:
    """Level in dB re 1 in/lbf of a compliance magnitude in m/N; -inf for zero."""
    with np.errstate(divide="ignore"):
        return 20 * np.log10(np.abs(compliance_m_per_N) / INCH_PER_POUND_FORCE)


def from_decibels(level_dB: Any) -> Any:
    """Compliance magnitude in m/N of a level in dB re 1 in/lbf."""
    return INCH_PER_POUND_FORCE * 10.0 ** (np.asarray(level_dB) / 20)
