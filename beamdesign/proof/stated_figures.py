"""Whether a certificate is of a prototype: the figures that its text states."""

from beamdesign.proof.document import controller_lines, rig_lines
from beamdesign.proof.family_document import effect_lines
from beamdesign.prototype import Prototype


def states_figures_of(certificate: str, prototype: Prototype) -> bool:
    """Whether the text of a certificate states rig, controller and effects of a prototype, and no others.

    That of a controller with several laws states either all of them or one.
    """
    laws = () if prototype.schedule is None else prototype.schedule.laws
    each = [prototype, *(prototype.but(controller=law) for law, _ in laws)]
    stated = any(
        "\n".join([*rig_lines(one), *controller_lines(one), *effect_lines(one)]) in certificate for one in each
    )
    return stated and ("\n[effects]\n" in certificate) == bool(prototype.effects)
