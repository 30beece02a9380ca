"""What the tubes of a link are asked to keep beside its load: sizes, gaps, and factors against each failure."""

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.records import Problem, Record, numbers

_SIZES = {"least_wall_m": 0.002, "largest_width_m": 0.2}


class Sizes(Record):
    """What limits the sizes of the tubes."""

    least_wall_m: q.Wall = Field(_SIZES["least_wall_m"], description="thinnest wall that may be used")
    largest_width_m: q.Width = Field(_SIZES["largest_width_m"], description="widest tube that may be used")
    width_to_wall_at_most: q.Slenderness | None = Field(
        None, description="limit of b / t, beside the check of local buckling"
    )

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The thinnest wall fits into the widest tube."""
        if (pair := numbers({**_SIZES, **table}, *_SIZES)) and pair[0] >= pair[1] / 2 > 0:
            yield Problem("least_wall_m", f"{pair[0]} is not less than half of largest_width_m, {pair[1] / 2}")


class Clearance(Record):
    """Gap between the inner beam and the outer one's inside, per side."""

    assembly_m: q.Gap = Field(0.005, description="least gap before any load")
    under_load_m: q.Gap = Field(0.003, description="least gap left when the inner beam carries the load")


class Safety(Record):
    """Factors on the load against each failure."""

    strength: q.SafetyFactor = Field(2.0, description="factor against yield in bending")
    local_buckling: q.SafetyFactor = Field(1.5, description="factor against bending resistance of thin walls")


class SizedFor(Sizes, Clearance, Safety):
    """What the sections were chosen to keep, beside their load: sizes, gaps and factors of the study."""
