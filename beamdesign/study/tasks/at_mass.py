"""Task `at_mass`: the loop at one mass on the outer tip, from exact polynomials."""

from beamdesign.loop import critical_gain, loop
from beamdesign.prototype import Prototype
from beamdesign.study.answer import Answer
from beamdesign.study.tasks import AtMassOptions


def compute(prototype: Prototype, options: AtMassOptions) -> Answer:
    """Stability, margins and bandwidth at one mass; an unstable loop is a no."""
    there = loop(prototype).at(options.outer_end_mass_kg)
    outputs: dict[str, object] = {"stable": there.stable}
    try:
        critical = critical_gain(prototype, options.outer_end_mass_kg)
        outputs |= {"critical_gain_A_per_V": critical.gain_A_per_V, "critical_frequency_Hz": critical.frequency_Hz}
    except ValueError:  # it oscillates at no gain, or at every low one: there is no such figure
        outputs |= {"critical_gain_A_per_V": None, "critical_frequency_Hz": None}
    if not there.stable:
        return Answer(outputs, reason=f"unstable with {options.outer_end_mass_kg:g} kg on the outer tip")
    margins = there.margins()
    outputs |= {
        "bandwidth_Hz": there.bandwidth_Hz(prototype.goal.compliance_m_per_N),
        "peak_sensitivity": there.peak_sensitivity(),
        "gain_margin": margins.gain_up,
        "phase_margin_deg": margins.phase_deg,
        "static_compliance_m_per_N": there.static_compliance(),
    }
    return Answer(outputs)
