"""Materials of tubes: stiffness, density and strength, as data with their source in `materials.toml` or of one's own.

A beam's record holds its material. In a file it stands by its name: of one that is known here, or of a table
`[material.NAME]` of that file.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PlainSerializer, ValidationError
from pydantic_core import PydanticCustomError

from beamdesign import quantities as q
from beamdesign.records import ByName, InputError, Problem, Record, numbers, parse, read_table
from beamdesign.structure.section import LOCAL_BUCKLING_CONSTANTS, elastic_buckling_constants

_DATA = Path(__file__).with_name("materials.toml")

STRENGTH_SOURCE = "EN 1999-1-1:2007 + A1:2009, Table 3.2b"
"""Where proof strengths and buckling classes of aluminium come from."""

BEAMS = ("outer_beam", "inner_beam")
MATERIAL = "what the tube is of: a name that `beamdesign explain material` lists, or that of a [material.NAME]"
"""Of the key of a beam."""

_POISSON = 0.3


class Material(Record):
    """What a tube is of: an alloy and temper as extruded and without welds, a steel, a laminate along the tube."""

    name: str = Field(exclude=True, description="its name, that of the table where it stands in one")
    youngs_modulus_Pa: q.YoungsModulus = Field(description="E, along the tube")
    shear_modulus_Pa: q.ShearModulus = Field(
        default_factory=lambda figures: figures.get("youngs_modulus_Pa", 0.0) / (2 * (1 + _POISSON)),
        description=f"G, in the plane of the wall; E / (2 (1 + {_POISSON})) where it is left out",
    )
    density_kg_per_m3: q.SolidDensity = Field(description="rho")
    proof_strength_Pa: q.Strength = Field(
        description="0.2 % proof strength, yield strength, or what else the stress is to stay below"
    )
    largest_wall_m: q.Wall = Field(1.0, description="thickness up to which the proof strength holds")
    buckling_class: Literal["A", "B"] | None = Field(
        None, description="row of Tables 6.2 and 6.3 of EN 1999-1-1, of aluminium alloys"
    )
    local_buckling: tuple[q.Slenderness, q.Slenderness] | None = Field(
        None,
        description="C1 and C2 of the factor C1 / x - C2 / x^2 of thin walls, x being b / t over sqrt(250 MPa / f_o);"
        " where neither these nor a class is given, those of a plate of one modulus, E or what G is to that if it is"
        " less",
    )
    source: str | None = Field(None, description="where its figures come from")

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The local buckling factor reaches 1: its largest value is C1^2 / (4 C2)."""
        pair = numbers(table, "local_buckling", each=2)
        if pair and pair[1] > pair[0] ** 2 / 4 > 0:
            words = f"C2 is at most C1^2 / 4, {pair[0] ** 2 / 4:.4g}, or no wall however thick would count whole"
            yield Problem("local_buckling", words)

    @property
    def buckling_constants(self) -> tuple[float, float]:
        """C1 and C2 of the local buckling factor, see `beamdesign.structure.section.buckling_curve`."""
        if self.local_buckling is not None:
            return self.local_buckling
        if self.buckling_class is not None:
            return LOCAL_BUCKLING_CONSTANTS[self.buckling_class]
        # What shears more than a plate of one modulus is softer across as well.
        as_it_shears = 2 * (1 + _POISSON) * self.shear_modulus_Pa
        return elastic_buckling_constants(min(self.youngs_modulus_Pa, as_it_shears), _POISSON)

    @property
    def largest_diameter_to_wall(self) -> float:
        """Largest outside diameter over wall of a round tube that counts whole in bending: the limit of class 3.

        Of aluminium alloys EN 1999-1-1, 6.1.4: beta = 3 sqrt(D / t) with D at mid-thickness, held to the limit of
        internal parts, where their factor C1 / x - C2 / x^2 leaves 1 (beta / epsilon of 22 in class A, 18 in class B).
        The formula for round tubes was entered from memory and could not be compared with the standard's text: look it
        up before a tube is built to this limit. In class A the elastic critical stress is there six times the strength,
        1.21 E t / D of a perfect cylinder. Of all else EN 1993-1-1:2005, Table 5.2:
        90 (235 MPa / f_y), in proportion to the modulus of a plate that buckles as C1 says; the elastic critical
        stress 1.21 E t / D is then twelve times the strength. Less stressed, such tubes may be as much more slender
        (EN 1993-1-1, 5.5.2(9)), which `beamdesign.synthesis.checks` sees to.
        """
        first, second = self.buckling_constants
        if self.buckling_class is not None:
            beta = (first + (first**2 - 4 * second) ** 0.5) / 2
            return 1 + (beta / 3) ** 2 * 250e6 / self.proof_strength_Pa
        modulus = (first / elastic_buckling_constants(1.0, _POISSON)[0]) ** 2
        return 90 * 235e6 / 210e9 * modulus / self.proof_strength_Pa

    @property
    def strength_source(self) -> str:
        """Where its strength comes from, in words; of a material of one's own what that states."""
        tabled = STRENGTH_SOURCE if self.buckling_class and self.name in _known() else "as given"
        return self.source or tabled

    def __str__(self) -> str:
        return self.name


@cache
def _known() -> dict[str, Material]:
    return {name: parse(Material, {"name": name} | figures, _DATA) for name, figures in read_table(_DATA).items()}


def material_names() -> tuple[str, ...]:
    """Names that `material` knows, in alphabetical order."""
    return tuple(sorted(_known()))


def material(name: str) -> Material:
    """Look a material up by its name, such as "6061-T6".

    Raises:
        InputError: listing the known ones.
    """
    if name not in _known():
        known = ", ".join(material_names())
        reason = f"unknown material {name!r}; known are {known}; or give your own, [material.{name}]"
        raise InputError("material", [("material", reason)])
    return _known()[name]


def _looked_up(given: Any) -> Any:
    """The material of a name; anything else as it is."""
    if isinstance(given, bool | int | float):
        said = {"reason": f"must be the name of a material in quotes, is {given!r}"}
        raise PydanticCustomError("said", "{reason}", said)
    if not isinstance(given, str):
        return given
    try:
        return material(given)
    except InputError as error:
        raise PydanticCustomError("said", "{reason}", {"reason": error.problems[0].reason}) from None


MaterialByName = Annotated[Material, BeforeValidator(_looked_up), PlainSerializer(str, return_type=str), ByName()]
"""A material in a record, which stands in files by its name."""


class WithMaterials(Record):
    """A file about a rig, which may bring materials of its own along."""

    material: dict[str, Material] | None = Field(None, description="materials of your own, [material.NAME] each")

    @classmethod
    def prepared(cls, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """The table with own materials in the beams that name them, and those of beams in it."""
        given = table.get("material") or {}
        if not isinstance(given, Mapping):
            return table
        own = {name: {"name": name, **one} if isinstance(one, Mapping) else one for name, one in given.items()}
        found: dict[str, Any] = dict(table)
        for key in BEAMS:
            beam = table.get(key)
            if isinstance(beam, Mapping) and isinstance(name := beam.get("material"), str) and name in own:
                found[key] = {**beam, "material": _sound(own[name])}
            elif isinstance(one := getattr(beam, "material", None), Material) and one.name not in _known():
                own.setdefault(one.name, one)
        return found | ({"material": own} if own else {})

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """Own materials have names of their own, those of their tables."""
        yield from super().relations(table)
        own = table.get("material") or {}
        for name, one in own.items() if isinstance(own, Mapping) else ():
            if name in _known():
                yield Problem(f"material.{name}", "is a material that is known here; give yours another name")
            if isinstance(one, Mapping) and one.get("name", name) != name:
                yield Problem(f"material.{name}.name", "is another than that of its table; leave it out")


def _sound(given: Any) -> Any:
    """A material; in the place of one with a mistake, which is told where it stands, any that is known."""
    with suppress(ValidationError):
        return Material.model_validate(given)
    return next(iter(_known().values()))


def material_lines(names: Iterable[str]) -> Iterator[str]:
    """A line for each of some materials that are known, with its figures."""
    for one in map(material, names):
        figures = (one.youngs_modulus_Pa / 1e9, one.shear_modulus_Pa / 1e9, one.proof_strength_Pa / 1e6)
        moduli = "E {:.4g} GPa, G {:.4g} GPa, strength {:.4g} MPa".format(*figures)
        yield f"  {one.name:<21} {moduli}, {one.density_kg_per_m3:g} kg/m3; {one.strength_source}"
