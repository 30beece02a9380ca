"""Whether a prototype is the rig that a certificate states: parsed tables, number by number.

What a prototype's geometry gives where no lumped figure stands is worked out anew, for a tube of an alloy whose
modulus and density the certificate states. What a prototype leaves out has the value that its format gives it.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import inf
from typing import Any

from flint import arb, fmpq

from beamdesign.checker.law import FLOAT_ROUNDING, SCHEDULED, decimal, same
from beamdesign.checker.reading import Table, Unreadable, rational, short
from beamdesign.checker.rig import OF_ACTUATOR, Rig
from beamdesign.checker.roots import Pair

# Tubes in balls: area, second moment, torsion constant. For bending Zalucky and Hardt (1984), equations (3) and (5);
# for torsion of tubes with corners Bredt's formula with what a thin wall has by itself, as EN 10219-2:2006, Annex B.


ROUNDING = 1000 * FLOAT_ROUNDING
"""Of a figure that floats have worked out of a section's geometry."""


def agree(stated: fmpq, value: arb) -> bool:
    """Whether a figure is one that floats have worked out."""
    return bool(abs(arb(stated) - value) <= abs(value) * arb(ROUNDING))


class Section:
    """A tube: m2, m4 and m4.

    Attributes:
        area: of the cross-section.
        second_moment: about the axis across the load.
        polar: the sum of that and the one about the axis along it.
        torsion_constant: J.
    """

    def __init__(self, shape: str, width: fmpq, wall: fmpq, radius: fmpq, depth: fmpq | None = None) -> None:
        if shape not in SHAPES or (depth is None) is (shape == "rectangle") or (shape == "round" and radius != 0):
            raise Unreadable(f"shape {shape[:60]!r} with these sizes is of no tube")
        high = width if depth is None else depth
        narrow = min(width, high)
        if not 0 < 2 * wall < narrow or not 0 <= 2 * radius <= narrow:
            raise Unreadable("a wall or a corner does not fit into the sides of a tube")
        across, along, thick = arb(width), arb(high), arb(wall)
        if shape == "round":  # a disc less a disc
            outside, inside = across / 2, across / 2 - thick
            self.area = arb.pi() * (outside**2 - inside**2)
            self.second_moment = arb.pi() * (outside**4 - inside**4) / 4
            self.polar = self.torsion_constant = 2 * self.second_moment
            return
        corner, inner = arb(radius), arb(max(radius - wall, fmpq(0)))
        lost = (4 - arb.pi()) * (corner**2 - inner**2)
        self.area = across * along - (across - 2 * thick) * (along - 2 * thick) - lost

        def about(side: arb, other: arb) -> arb:
            """Second moment about the axis that `side` lies across."""
            return _rounded(side, other, corner) - _rounded(side - 2 * thick, other - 2 * thick, inner)

        self.second_moment = about(along, across)
        self.polar = self.second_moment + about(across, along)
        turn = arb(max(radius - wall / 2, fmpq(0)))
        straight, arc = (across - thick - 2 * turn, along - thick - 2 * turn), arb.pi() * turn / 2
        around = 2 * sum(straight, arb(0)) + 4 * arc
        within = straight[0] * straight[1] + 2 * turn * sum(straight, arb(0)) + arb.pi() * turn**2
        self.torsion_constant = 4 * within**2 * thick / around + around * thick**3 / 3


def _rounded(side: arb, other: arb, radius: arb) -> arb:
    """Second moment of a rectangle with rounded corners: one as wide as these leave, two beside, four quarter discs."""
    straight, to_centre = side - 2 * radius, side / 2 - radius
    quarter = arb.pi() * radius**4 / 16 + 2 * to_centre * radius**3 / 3 + to_centre**2 * arb.pi() * radius**2 / 4
    return (other - 2 * radius) * side**3 / 12 + radius * straight**3 / 6 + 4 * quarter


# The prototype's tables.


SHAPES = ("square", "rectangle", "round")
MODE_MASS_FRACTION = fmpq(236, 1000)
"""Equation (2): the share of a uniform beam's mass that moves with its tip."""
DEFAULTS: dict[str, dict[str, Any]] = {
    "beam": {"damping_ratio": 0.05, "shape": "square", "corner_radius_m": 0.0, "end_mass_kg": 0.0},
    "servovalve": {"damping_ratio": 0.5},
    "actuator": {"rotor_friction_N_m_s_per_rad": 0.0, "screw_damping_N_s_per_m": 0.0},
    "payload": {"inner_end_mass_kg": 0.0},
    "goal": {
        "compliance_m_per_N": 5.71e-8,
        "peak_sensitivity": 2.0,
        "peak_over_passive": 1.0,
        "lower_gains": True,
        "comes_to_rest": False,
        "loop_gain_from_Hz": 250.0,
    },
    "arm": {"offset_m": [0.0] * 3, "end_polar_inertia_kg_m2": 0.0, "payload_polar_inertia_kg_m2": 0.0},
}  # fmt: skip
"""What a prototype's tables say where they say nothing."""
ACTUATORS = {
    "servo_cylinder": {
        "oil_stiffness_N_per_m": ("actuator", "oil_stiffness_N_per_m"),
        "piston_area_m2": ("actuator", "piston_area_m2"),
        "flow_gain_m3_per_s_per_A": ("servovalve", "flow_gain_m3_per_s_per_A"),
        "leakage_m3_per_s_per_Pa": ("servovalve", "leakage_m3_per_s_per_Pa"),
        "valve_damping_ratio": ("servovalve", "damping_ratio"),
        "valve_frequency_rad_per_s": ("servovalve", "natural_frequency_Hz"),
    },
    "ball_screw": {
        **{name: ("actuator", name) for name in OF_ACTUATOR["ball_screw"]},
        "lead_m_per_rad": ("actuator", "lead_m"),
        "current_loop_rad_per_s": ("actuator", "current_loop_Hz"),
    },
}
"""Where a prototype states each figure of its actuator, by the kind of that."""
MAY_BE_EMPTY = ("a", "b", "c", "b_command", "section")
"""Lists of a controller that say as much as nothing where they are empty."""
ALLOY = ("youngs_modulus_Pa", "shear_modulus_Pa", "density_kg_per_m3")
"""What a certificate states of a material."""
KNOWN = (
    "name", "kind", "outer_beam", "inner_beam", "actuator", "servovalve", "sensor", "supply", "controller",
    "compliance", "payload", "arm", "goal", "sized_for", "tolerance", "guarantee", "effects", "effect", "material",
)  # fmt: skip
"""What a prototype has."""
GUARANTEED = ("bandwidth_Hz", "peak_sensitivity", "outer_end_mass_kg", "sigmas", "certificate", "certificate_sha256")
"""What it states under [guarantee]."""
TABLES = ("payload", "goal", "arm", "compliance", "tolerance")
"""Tables that a certificate states as the prototype has them, tolerances where it is about them."""


def differences(table: Table, rig: Rig, prototype: Mapping[str, Any]) -> Iterator[str]:
    """Where a prototype is another rig than that of a certificate, in words; nothing where it is the same.

    Args:
        table: the certificate.
        rig: that it states.
        prototype: the table of a prototype.toml.
    """
    yield from (f"{repr(key)[:60]} is not known here" for key in prototype if key not in KNOWN)
    if (kind := prototype.get("kind", "twin_beam")) != "twin_beam":
        yield f"it is of a rig of another kind, {str(kind)[:60]!r}"
    materials = table.optional("material")
    alloys = {name: Table(entries, f"material.{name}") for name, entries in materials.whole_of_it().items()}
    for name, value in _figures(prototype, alloys).items():
        stated = rig.figures.get(name)
        if not (stated is value if stated is None or value is None else agree(stated, value)):
            there = "none" if value is None else f"{float(value.mid()):.8g}"
            yield f"{name} is {'none' if stated is None else short(stated)}, that of the prototype {there}"
    yield from _laws(table, rig, prototype)
    yield from _plane(table, prototype)
    given = table_of(prototype, "effects")
    stated_effects = {effect.name: effect.parameters for effect in rig.effects}
    if stated_effects.keys() != given.keys():
        yield f"its effects are {', '.join(stated_effects) or 'none'}, the prototype's {', '.join(given) or 'none'}"
    for name in stated_effects.keys() & given.keys():
        for key, value in table_of(given, name).items():
            if stated_effects[name].get(key) != _number(value, f"effects.{name}.{key}"):
                yield f"effects.{name}.{key} is not that of the prototype, {value}"
    yield from _alloys(materials.whole_of_it(), prototype)
    if "effect" in prototype and prototype["effect"] != (table.entries("effect") if "effect" in table else []):
        yield "the elements stated are not those that stand for its effects"
    for name in TABLES:
        stated_table, given_table = _full(table.optional(name).whole_of_it()), _full(table_of(prototype, name))
        if name in prototype or name in ("payload", "goal"):
            given_table = DEFAULTS.get(name, {}) | given_table
        if name == "goal":  # of which some certificates say nothing
            stated_table = {"lower_gains": True, "comes_to_rest": False} | stated_table
            given_table = {
                k: v for k, v in given_table.items() if k != "peak_over_passive" or (k in stated_table and v != inf)
            }
        if name == "payload" and (stages := _own_stages(rig, prototype)):
            given_table = {**given_table, "outer_end_mass_kg": _within(stages, stated_table)}
        if name == "tolerance":  # none is as much as zero, and nothing stated is nothing that was proved of it
            given_table = {key: value for key, value in given_table.items() if value and stated_table}
        if not same(stated_table, given_table):
            yield f"[{name}] is not that of the prototype"
    if rig.inner_end_mass != number_of(prototype, "payload", "inner_end_mass_kg"):
        yield "inner_end_mass_kg is not that of the prototype"


def _alloys(stated: Mapping[str, Any], prototype: Mapping[str, Any]) -> Iterator[str]:
    """Where a certificate's materials are others than a prototype's, which has all or, in its file, its own alone."""
    given = table_of(prototype, "material")
    for name, figures in stated.items():
        own = {key: value for key, value in table_of(given, name).items() if key in figures}
        if not figures.keys() <= {*ALLOY} or not same({key: figures[key] for key in own}, own):
            yield f"[material.{name}] is another than that of the prototype"
    if "effect" in prototype and not same(dict(stated), given):  # worked out by whoever asks: complete
        yield "[material] states other materials than those of its beams"


def left_open(table: Table, rig: Rig, prototype: Mapping[str, Any]) -> Iterator[str]:
    """What cannot be told from the prototype's table alone, and what it asks for beyond what is proved, in words."""
    payload, stages = table_of(prototype, "payload"), table_of(prototype, "controller").get("stage", [])
    box = table.optional("range").whole_of_it()
    at, key = (Table(box), "outer_end_mass") if box else (table, "outer_end_mass_kg")
    stated = [payload] if "outer_end_mass_kg" in payload else stages  # where it states none, those of all its laws
    if stated and key in at:
        (low, high), (lows, highs) = at.range(key), zip(*map(masses_of, stated), strict=True)
        least, most = min(lows), max(highs)
        if not low <= least <= most <= high:
            yield f"the prototype's payloads, {short(least)} to {short(most)} kg, are not all within those proved"
    if stages and rig.schedule is None:
        yield f"the other laws of the prototype, which has {len(stages)}"
    if any(table_of(prototype, "tolerance").values()) and not table.optional("tolerance").whole_of_it():
        yield "the prototype's [tolerance]: what is proved is of exactly the figures stated"
    own, every = table_of(prototype, "material"), table.optional("material").whole_of_it()
    if names := [name for name, figures in every.items() if not figures.keys() <= table_of(own, name).keys()]:
        yield f"that {', '.join(names)} is as [material] states"
    given = table_of(prototype, "effects")
    for effect in rig.effects:
        if unstated := sorted(effect.parameters.keys() - table_of(given, effect.name).keys()):
            yield f"the prototype does not state {', '.join(unstated)} of {effect.name}, which has a usual value"


def _within(stages: Sequence[Mapping[str, Any]], stated: Mapping[str, Any]) -> Any:
    """Payloads of a single law, as stated, where they are some of those of a stage with that law; else the stage's."""
    own = stated.get("outer_end_mass_kg")
    for least, most in map(masses_of, stages):
        if isinstance(own, list) and len(own) == 2 and least <= rational(own[0]) <= rational(own[1]) <= most:
            return [float(int(v.p) / int(v.q)) for v in map(rational, own)]
    return stages[0]["outer_end_mass_kg"]


def masses_of(table: Mapping[str, Any]) -> Pair:
    """The payloads of a prototype or of a stage of its controller."""
    found = table.get("outer_end_mass_kg")
    if not isinstance(found, list) or len(found) != 2:
        raise Unreadable("outer_end_mass_kg of the prototype must be [least, most]")
    return _number(found[0], "outer_end_mass_kg"), _number(found[1], "outer_end_mass_kg")


def _own_stages(rig: Rig, prototype: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The stages of a prototype whose law is the one of the certificate, each as it would stand by itself."""
    stages = _full(table_of(prototype, "controller")).get("stage", [])
    if not isinstance(stages, list) or not all(isinstance(stage, dict) for stage in stages):
        raise Unreadable("controller.stage of the prototype must be a list of tables")

    def alone(stage: Mapping[str, Any]) -> dict[str, Any]:
        kind = "structured" if "section" in stage else "lag" if "pole_Hz" in stage else "proportional"
        return {"kind": kind} | {key: value for key, value in stage.items() if key != "outer_end_mass_kg"}

    return [stage for stage in stages if rig.law is not None and same(_full(rig.law.figures), alone(stage))]


def _plane(table: Table, prototype: Mapping[str, Any]) -> Iterator[str]:
    """That a plane of an arm is that of the prototype's outer beam; torsion is proved to follow from its section."""
    if "plane" not in table:
        return
    plane, keys = table.table("plane"), ("shape", "width_m", "wall_m", "material", "corner_radius_m")
    own, stated = plane.optional("section").whole_of_it(), plane.whole_of_it()
    shapes = [_of(prototype, beam, "shape") for beam in ("outer_beam", "inner_beam")]
    if stated["name"] == "y" and "rectangle" in shapes:
        yield "a rectangular tube of the prototype's is of other figures in this plane"
    if not same(stated["free_length_m"], _of(prototype, "outer_beam", "free_length_m")):
        yield "the length of its outer beam is not that of the prototype's"
    given = {key: _of(prototype, "outer_beam", key) for key in keys}
    whole = {} if None in given.values() else given
    section = {"shape": "square", **own} if own else {}
    if "torsion" in stated and not same(section, whole):
        yield "the section of its outer beam is not that of the prototype's"


def _laws(table: Table, rig: Rig, prototype: Mapping[str, Any]) -> Iterator[str]:
    """That the controller is the prototype's, or one of several that take turns or act in one plane."""
    given = _full(table_of(prototype, "controller"))
    if "plane" in table and table.table("plane").whole_of_it()["name"] == "y":
        given = _full(table_of(table_of(prototype, "arm"), "second_controller")) or given
    if rig.law is not None and not same(_full(rig.law.figures), given) and not _own_stages(rig, prototype):
        yield "[controller] is not that of the prototype"
    if rig.schedule is not None:
        whole = SCHEDULED | given
        whole["estimator"] = {**SCHEDULED["estimator"], **table_of(whole, "estimator")}
        if not same(_full(rig.schedule.figures), whole):
            yield "[controller] with its stages is not that of the prototype"


def _full(table: Mapping[str, Any]) -> dict[str, Any]:
    """A table, and those within it, without lists that say nothing."""

    def whole(value: Any) -> Any:
        if isinstance(value, list):
            return [whole(item) for item in value]
        return _full(value) if isinstance(value, dict) else value

    return {key: whole(value) for key, value in table.items() if value != [] or key not in MAY_BE_EMPTY}


def _figures(prototype: Mapping[str, Any], alloys: Mapping[str, Table]) -> dict[str, arb | None]:
    """Figures of the rig by name, as balls; None for a filter that there is not."""
    found: dict[str, arb | None] = {}
    for which in ("outer", "inner"):
        stiffness, mass = _lumped(prototype, f"{which}_beam", alloys)
        ratio = _ball(prototype, f"{which}_beam", "damping_ratio")
        found |= {
            f"{which}_stiffness_N_per_m": stiffness,
            f"{which}_mass_kg": mass,
            f"{which}_damping_N_s_per_m": 2 * ratio * (stiffness * mass).sqrt(),
        }
    kind, turn = table_of(prototype, "actuator").get("kind", "servo_cylinder"), 2 * arb.pi()
    if not isinstance(kind, str) or kind not in ACTUATORS:
        raise Unreadable(f"actuator.kind of the prototype is not known here: {str(kind)[:60]!r}")
    for name, (part, key) in ACTUATORS[kind].items():
        value = _ball(prototype, part, key)
        found[name] = turn * value if key.endswith("_Hz") else value / turn if key == "lead_m" else value
    found["sensor_gain_V_per_m"] = _ball(prototype, "sensor", "gain_V_per_m")
    filtered = _of(prototype, "sensor", "filter_Hz") is not None
    found["filter_frequency_rad_per_s"] = turn * _ball(prototype, "sensor", "filter_Hz") if filtered else None
    return found


def _lumped(prototype: Mapping[str, Any], name: str, alloys: Mapping[str, Table]) -> tuple[arb, arb]:
    """Stiffness and effective mass of a beam: measured where they stand, from the geometry otherwise."""
    stiffness, mass = (_of(prototype, name, key) for key in ("stiffness_N_per_m", "effective_mass_kg"))
    if stiffness is not None and mass is not None:
        return _ball(prototype, name, "stiffness_N_per_m"), _ball(prototype, name, "effective_mass_kg")
    material = _of(prototype, name, "material")
    if not isinstance(material, str):
        raise Unreadable(f"the prototype states neither figures nor a material of its {name}")
    if material not in alloys:
        raise Unreadable(f"the certificate states no [material.{material}], of which the prototype's {name} is")
    length, end = (_ball(prototype, name, key) for key in ("free_length_m", "end_mass_kg"))
    keys = ("width_m", "wall_m", "corner_radius_m", *(["depth_m"] if "depth_m" in table_of(prototype, name) else []))
    sizes = (number_of(prototype, name, key) for key in keys)
    alloy, tube = alloys[material], Section(str(_of(prototype, name, "shape")), *sizes)
    from_section = 3 * arb(alloy.number("youngs_modulus_Pa")) * tube.second_moment / length**3
    moving = end + arb(MODE_MASS_FRACTION * alloy.number("density_kg_per_m3")) * tube.area * length
    return (
        from_section if stiffness is None else _ball(prototype, name, "stiffness_N_per_m"),
        moving if mass is None else _ball(prototype, name, "effective_mass_kg"),
    )


def table_of(entries: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """A table of a prototype, empty where it is left out."""
    value = entries.get(name, {})
    if not isinstance(value, dict):
        raise Unreadable(f"{name} of the prototype must be a table")
    return value


def _of(prototype: Mapping[str, Any], name: str, key: str) -> Any:
    """An entry of a prototype, or what it has where it is left out."""
    return table_of(prototype, name).get(key, DEFAULTS.get("beam" if name.endswith("_beam") else name, {}).get(key))


def number_of(prototype: Mapping[str, Any], name: str, key: str) -> fmpq:
    """A figure of a prototype, or what it has where it is left out."""
    return _number(_of(prototype, name, key), f"{name}.{key}")


def _ball(prototype: Mapping[str, Any], name: str, key: str) -> arb:
    return arb(number_of(prototype, name, key))


def _number(value: Any, place: str) -> fmpq:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
        raise Unreadable(f"{place} of the prototype must be a number")
    return decimal(value)
