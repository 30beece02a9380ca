"""Alloys: stiffness, density and strength, as data with their source in `materials.toml`."""

from functools import cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from beamdesign.records import InputError, Positive, Record, parse, read_table

_DATA = Path(__file__).with_name("materials.toml")

STRENGTH_SOURCE = "EN 1999-1-1:2007 + A1:2009, Table 3.2b"
"""Where proof strengths and buckling classes come from."""


class Material(Record):
    """An alloy and temper, as extruded and without welds."""

    name: str
    youngs_modulus_Pa: Annotated[Positive, Field(description="E")]
    shear_modulus_Pa: Annotated[Positive, Field(description="G")]
    density_kg_per_m3: Annotated[Positive, Field(description="rho")]
    proof_strength_Pa: Annotated[Positive, Field(description="characteristic 0.2 % proof strength, f_o")]
    largest_wall_m: Annotated[Positive, Field(description="thickness up to which the proof strength holds")]
    buckling_class: Annotated[Literal["A", "B"], Field(description="row of Tables 6.2 and 6.3 of EN 1999-1-1")]


@cache
def _alloys() -> dict[str, Material]:
    return {name: parse(Material, {"name": name} | figures, _DATA) for name, figures in read_table(_DATA).items()}


def material_names() -> tuple[str, ...]:
    """Names that `material` knows, in alphabetical order."""
    return tuple(sorted(_alloys()))


def unknown_material(name: str) -> str | None:
    """Why `name` is no material here, in words, or None if it is one."""
    return None if name in _alloys() else f"unknown alloy {name!r}; known are {', '.join(material_names())}"


def material(name: str, source: str | Path = "material", key: str = "material") -> Material:
    """Look an alloy up by its name, such as "6061-T6".

    Args:
        name: alloy and temper.
        source: file to name if there is no such alloy.
        key: key to name if there is no such alloy.

    Raises:
        InputError: listing the known alloys.
    """
    if reason := unknown_material(name):
        raise InputError(source, [(key, reason)])
    return _alloys()[name]
