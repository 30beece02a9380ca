"""Transport delay between sensor and controller, as the [2/2] Pade approximant.

Its gain is one at every frequency; its phase differs from that of the delay T by about (w T)^5 / 720.
"""

from typing import Any

from flint import fmpq

from beamdesign.plant.effects import Effect, Elements, Exact, Linear, Parameter, Site


def _law(signal: Any, site: Site) -> Any:
    delay, rate = site.parameter["delay_s"], site.state["slope_V_per_s"]
    site.rate["smooth_V"] = rate
    site.rate["slope_V_per_s"] = 12 / delay**2 * (signal - site.state["smooth_V"]) - 6 / delay * rate
    return signal - delay * rate


def _elements(own: Exact, figure: Exact) -> Elements:
    delay = own["delay_s"]
    return Elements(volts=(((fmpq(12), -6 * delay, delay**2), (fmpq(12), 6 * delay, delay**2)),))


EFFECT = Effect(
    name="transport_delay",
    subsystem="controller",
    laws={"measured_V": _law},
    parameters=(Parameter("delay_s", 0.5e-3, 0.1e-3, 5e-3, 0.8, "of sampling, computing and transmission together"),),
    states=("smooth_V", "slope_V_per_s"),
    source="Pade approximant of exp(-sT); Franklin, Powell, Emami-Naeini, Feedback Control of Dynamic Systems",
    linear=Linear("its approximant, as it is simulated", elements=_elements),
)
