"""Valve hysteresis: friction on the spool, so that the current has to go back before the spool does.

Its law is that of Bouc and Wen, of which Dahl's is the case with a sharpness of 1 that unloads as steeply as it can. As
in `seal_friction` the friction settles no faster than a bound.
"""

from typing import Any

import casadi as ca
import numpy as np

from beamdesign.plant.effects import Effect, Elements, Linear, Parameter, Site, Span, bounded, play

_LEAST = 1e-4  # of the friction: below it its size has no kink; a size of one is one, so that no slope is beyond 2


def _law(signal: Any, site: Site) -> Any:
    width, state = site.parameter["half_width_A"], site.state["friction"]
    rate = bounded(site.port["flow_m3_per_s2"] / (site.figure["flow_gain"] * width * site.parameter["travel"]))
    size, steepness = ca.sqrt((state**2 + _LEAST**2) / (1 + _LEAST**2)), site.parameter["steepness"]
    turned = steepness * ca.fabs(rate) * state / size + (1 - steepness) * rate
    site.rate["friction"] = rate - size ** site.parameter["sharpness"] * turned
    return signal - width * state


EFFECT = Effect(
    name="valve_hysteresis",
    subsystem="servovalve",
    laws={"spool_A": _law},
    parameters=(
        Parameter(
            "half_width_A", 0.1e-3, 1e-6, 5e-3, 0.8,
            "half the width of the loop of flow over current", "current",
        ),
        Parameter(
            "travel", 1.0, 0.15, 5.0, 0.7,
            "of the spool until its friction has turned about, over the half width; the quicker, the more like play",
        ),
        Parameter("sharpness", 1.0, 1.0, 3.0, 0.3, "the larger, the straighter the flanks and the sharper their ends"),
        Parameter(
            "steepness", 1.0, 0.5, 1.0, 0.3,
            "of the return: at 1 up to twice that from rest, as by Dahl, at 0.5 no steeper",
        ),
    ),
    states=("friction",),
    memory=("friction",),
    source="Y.-K. Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249; P. R. Dahl, AIAA J. 14 (1976) 1675, here on the spool",
    linear=Linear(
        "the friction as a spring on the spool, from none while it slides to its stiffest just after a reversal;"
        " performance while it slides",
        "limit cycles",
        laws={
            "spool_A": lambda signal, site: (
                signal - site.parameter["spring"] * site.port["flow_m3_per_s"] / site.figure["flow_gain"]
            )
        },
        near_rest="compliance",
        figures={"spring": lambda own, at: Span(0.0, 2 / own["travel"], 1 / own["travel"], (0.0, 0.0))},
        elements=lambda own, figure: Elements(spool=own["spring"]),
    ),
)  # fmt: skip


_PLAYS = ("play_1", "play_2", "play_3", "play_4")  # in half widths
_NODES, _WEIGHTS = ((side / 2).tolist() for side in np.polynomial.legendre.leggauss(len(_PLAYS)))


def _magnetic(signal: Any, site: Site) -> Any:
    width, share = site.parameter["half_width_A"], site.parameter["held_share"]
    largest = 2 / share  # threshold in half widths: the mean of all, times the share, is one
    plays = zip(_PLAYS, _NODES, _WEIGHTS, strict=True)
    passed = sum(weight * play(signal / width, (node + 0.5) * largest, site, name) for name, node, weight in plays)
    return (1 - share) * signal + share * width * passed


MAGNETIC = Effect(
    name="valve_hysteresis_magnetic",
    meaning="""Magnetic valve hysteresis: the torque motor's iron holds back a part of the current before the spool
        sees it.

        Rayleigh's law: small currents meet the reversible share alone; with the amplitude grow the slope of the curve,
        in proportion, and the remanence, with the square, up to the largest threshold. Beyond it the loop keeps its
        width. That is what plays do whose thresholds lie evenly between none and the largest; here they are the nodes
        of Gauss and Legendre's quadrature over them. So loops close, and what happened within one is forgotten once it
        is left (Madelung's rules), neither of which Dahl's law does. See `beamdesign.plant.effects.play`.""",
    subsystem="servovalve",
    laws={"spool_A": _magnetic},
    parameters=(
        Parameter(
            "half_width_A", 0.1e-3, 1e-6, 5e-3, 0.8,
            "half the width of a large loop of flow over current", "current",
        ),
        Parameter(
            "held_share", 0.5, 0.05, 0.98, 0.5,
            "of small currents: one less the initial over the largest slope; catalogues do not give it",
        ),
    ),
    states=("followed", *_PLAYS),
    memory=_PLAYS,
    source="Lord Rayleigh, Phil. Mag. 23 (1887) 225; plays: K. Kuhnen, Eur. J. Control 9 (2003) 407",
    linear=Linear(
        "gain from the reversible share to the whole, between which lie all slopes of its loops; performance at"
        " amplitudes well beyond their width",
        "limit cycles, and the phase that its loops cost",
        laws={},
        gain=lambda own, at: Span(1 - own["held_share"], 1.0, 1 - own["held_share"], (1.0, 1.0)),
        near_rest="compliance",
    ),
    realises="valve_hysteresis",
)  # fmt: skip
