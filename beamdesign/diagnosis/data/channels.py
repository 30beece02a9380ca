"""Which column of a measured file is which channel of a record: told by names and units, for each kind of rig."""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from beamdesign.bench_prototype import AnyPrototype, BenchPrototype
from beamdesign.diagnosis.data.dataset import INPUTS
from beamdesign.diagnosis.data.measured_files import UNITS, Column, in_SI, unit_of
from beamdesign.plant.actuators import FELT
from beamdesign.records import InputError

_RECORD = {
    "t_s": ("s", r"^t$|time|^zeit|^t[_ ]?s|^x[_ ]?values?$"),
    "disturbance_N": ("N", r"disturb|force|load(?!.*pres)|kraft|forza|fuerza|hammer|^f(_?d)?$"),
    "command_V": ("V", r"command|(?<![a-z])cmd|reference|^ref|setpoint|set point|demand|soll|consign|comando|^u$"),
    "current_A": ("A", r"current|strom|courant|corr(i)?ente|^i(_?sv)?$|valve"),
    "inner_displacement_m": ("m", r"inner"),
    "displacement_m": ("m", r"displ|d[eé]plac|desplaz|spostam|tip|deflection|position|^x(_?m)?$|weg|lvdt|outer"),
    "load_pressure_Pa": ("Pa", r"pressure|druck|^p(_?l)?$"),
    "screw_force_N": ("N", r"screw|spindle|spindel"),
}
_FELT = {name: name.rsplit("_", 1) for name in FELT}
_RECORD |= {n: (unit, words.replace("_", "[_ ]?")) for n, (words, unit) in _FELT.items() if n not in _RECORD}
_RUN = {name: _RECORD[name] for name in ("t_s", "command_V", "displacement_m")} | {
    f"pressure_{side}_Pa": ("Pa", rf"(pressure|druck|^p)[_ .-]?{side}(?![a-z])|{words}")
    for side, words in (
        ("a", "(?<![a-z])(cap|head|bore)(?![a-z])|kolben"),
        ("b", "(?<![a-z])rod(?![a-z])|annul|ring|stange"),
    )
}
_ANOTHERS = {
    "disturbance_N": "|".join(_RECORD[name][1] for name, (_, unit) in _FELT.items() if unit == "N"),
    "displacement_m": _RECORD["inner_displacement_m"][1],
}
"""By channel what is in the name of another one whose name looks alike."""
NOTHING = "0"
"""Instead of a column: an input that there was none of, or a channel that was not recorded."""


@dataclass(frozen=True)
class Channels:
    """Columns of the records of a kind of rig.

    Attributes:
        known: by column its unit, and what its name looks like elsewhere.
        needed: that no record is without.
        asked: that none is without unless that is said.
        inputs: that are zero where there is no column of them.
        either: of which a record has one at least.
        sensor_V_per_m: by which a displacement may be in volts; 0: it may not.
    """

    known: Mapping[str, tuple[str, str]]
    needed: tuple[str, ...]
    asked: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    either: tuple[str, ...] = ()
    sensor_V_per_m: float = 0.0

    def units(self, channel: str) -> tuple[str, ...]:
        """SI units in which it may be measured: the displacement in volts of its sensor too."""
        own = self.known[channel][0]
        return (own, "V") if channel == "displacement_m" and self.sensor_V_per_m else (own,)

    def alike(self, channel: str, columns: Sequence[Column]) -> list[Column]:
        """Columns that may be a channel: by name and unit; else, where no name tells, by a unit that only one has."""
        known = ("", *self.units(channel))
        others = self.known.keys() - {channel}  # a column of such a name is of that channel
        fits = [one for one in columns if one.name not in others and (unit_of(one.unit) if one.unit else "") in known]
        by_name = [one for one in fits if one.name == channel] or self.by_name(channel, fits)
        if by_name or channel not in (*self.needed, *self.asked):
            return by_name
        return self.by_unit(channel, fits)

    def by_name(self, channel: str, columns: Sequence[Column]) -> list[Column]:
        """Columns whose names look like that of a channel, and like no other's, in whatever unit they are."""
        stems = ((one, self._stem(channel, one.name.rpartition(".")[2])) for one in columns)
        found = [one for one, stem in stems if re.search(self.known[channel][1], stem, re.IGNORECASE)]
        anothers = _ANOTHERS.get(channel)
        return [one for one in found if not (anothers and re.search(anothers, one.name, re.IGNORECASE))]

    def by_unit(self, channel: str, columns: Sequence[Column]) -> list[Column]:
        """Columns in the unit of a channel, stated or at the end of their names."""
        said = ((one, one.unit or self.ending(channel, one.name)) for one in columns)
        return [one for one, unit in said if unit and unit_of(unit) == self.known[channel][0]]

    def ending(self, channel: str, name: str) -> str:
        """The unit of a channel that a name ends in, as in `force_kN` or `t_ms`; empty where it ends in none."""
        _, underscore, end = name.rpartition("_")
        return end if underscore and unit_of(end) in self.units(channel) else ""

    def _stem(self, channel: str, name: str) -> str:
        return name.removesuffix(f"_{self.ending(channel, name)}")

    def factor(self, channel: str, unit: str) -> tuple[float | None, str]:
        """What a column is multiplied by to be in SI, and what was assumed, or why not."""
        own, per_m = self.known[channel][0], self.sensor_V_per_m
        if not unit:
            return 1.0, f"no unit stated: taken as {own}"
        measures, factor = in_SI(unit)
        if measures == own:
            return factor, ""
        if measures in self.units(channel):
            return factor / per_m, f"volts over the believed {per_m:g} V/m"
        words = f"{channel} is measured in {', '.join(UNITS[own])}"
        return None, f"{words}; state the unit, --column '{channel} = NAME [UNIT]'"


def channels_of(prototype: AnyPrototype) -> Channels:
    """Those of records of a rig of this kind."""
    if isinstance(prototype, BenchPrototype):
        return Channels(_RUN, ("t_s", "command_V", "displacement_m"), either=("pressure_a_Pa", "pressure_b_Pa"))
    needed = ("t_s", "displacement_m")
    return Channels(_RECORD, needed, ("current_A",), INPUTS, sensor_V_per_m=prototype.sensor.gain_V_per_m)


def asked(texts: Sequence[str], channels: Channels) -> dict[str, list[tuple[str, str, float]]]:
    """Columns that are named, `CHANNEL = NAME [UNIT]` with a minus sign before NAME to turn it round.

    Returns:
        By channel the name, the unit (empty where none is stated) and the sign of each column that is named for it.

    Raises:
        InputError: with all that cannot be read.
    """
    found, wrong = defaultdict[str, list[tuple[str, str, float]]](list), list[str]()
    for text in texts:
        channel, equals, rest = (part.strip() for part in text.partition("="))
        match = re.match(r"^(-?)\s*(.*?)\s*(?:\[([^\]]*)\])?$", rest)
        if not equals or match is None or not match[2]:
            wrong.append(f"{text!r} is not CHANNEL = NAME [UNIT], such as 'current_A = -i_valve [mA]'")
        elif channel not in channels.known:
            wrong.append(f"{channel!r} is no channel; there are {', '.join(channels.known)}")
        elif match[2] in (name for name, unit, _ in found.get(channel, ()) if unit == (match[3] or "").strip()):
            wrong.append(f"{channel!r} is named twice as {match[2]!r}; name each column of it once")
        else:
            found[channel].append((match[2], (match[3] or "").strip(), -1.0 if match[1] else 1.0))
    if wrong:
        raise InputError("gap import", [("--column", reason) for reason in wrong])
    return found
