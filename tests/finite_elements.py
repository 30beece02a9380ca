"""Hollow sections by the finite elements of sectionproperties, another library."""

from typing import Any

import numba
import pytest

with pytest.MonkeyPatch.context() as patch:  # to compile its loops takes ten times as long as these few sections
    patch.setattr(numba.config, "DISABLE_JIT", True)
    from sectionproperties.analysis import Section
from sectionproperties.pre.library import rectangular_hollow_section


def meshed(width: float, depth: float, wall: float, radius: float, arcs: int, largest: float) -> Any:
    """A section with its geometric properties, each quarter of a circle drawn as so many points.

    Args:
        width: outside, in any unit of length.
        depth: likewise.
        wall: thickness.
        radius: of the corners outside.
        arcs: points of a quarter of a circle.
        largest: area of an element.
    """
    outline = rectangular_hollow_section(d=depth, b=width, t=wall, r_out=radius, n_r=arcs)
    outline.create_mesh(mesh_sizes=[largest])
    analysed = Section(outline)
    analysed.calculate_geometric_properties()
    return analysed
