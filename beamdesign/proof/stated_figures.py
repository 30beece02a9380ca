"""Whether a certificate is of a prototype: the figures that its text states."""

from beamdesign.proof.document import controller_lines, rig_lines
from beamdesign.proof.family_document import effect_lines
from beamdesign.prototype import Prototype


def states_figures_of(certificate: str, prototype: Prototype) -> bool:
    """Whether the text of a certificate states rig, controller and effects of a prototype, and no others."""
    stated = "\n".join([*rig_lines(prototype), *controller_lines(prototype), *effect_lines(prototype)])
    return stated in certificate and ("\n[effects]\n" in certificate) == bool(prototype.effects)
