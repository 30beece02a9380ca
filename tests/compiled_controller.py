"""A realised controller that runs: its C files compiled, or its emulation over series of readings."""

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from beamdesign.build.realisation.c_code import Machine, compiled, to_word
from beamdesign.build.realisation.realise import Realisation


def in_volts_and_amperes(realisation: Realisation, *readings: Sequence[float]) -> list[float]:
    """Currents (A) of series of readings (V, m, Pa), the errors first, from rest."""
    machine, unit = Machine(realisation), 2.0**-realisation.current_places
    return [
        float(machine.step(*(to_word(realisation, value, k) for k, value in enumerate(sample)))) * unit
        for sample in zip(*readings, strict=True)
    ]


class CompiledController:
    """The compiled controller of a folder with the interface of the emulation: words in fixed point, else floats."""

    def __init__(self, folder: Path, realisation: Realisation):
        self.realisation = realisation
        bits = realisation.word_length
        word: Any = ctypes.c_float if bits is None else ctypes.c_int16 if bits <= 16 else ctypes.c_int32
        wide: Any = ctypes.c_float if bits is None else ctypes.c_int32 if bits <= 16 else ctypes.c_int64
        fields = [(name, wide) for name in realisation.states] + [("limited", ctypes.c_int)]
        self._state = type("State", (ctypes.Structure,), {"_fields_": fields})()
        loaded = ctypes.CDLL(str(compiled(folder, folder / "controller.so", "-shared", "-fPIC")))
        self._reset, self._step, self.self_test = (
            loaded.controller_reset, loaded.controller_step, loaded.controller_self_test,
        )  # fmt: skip
        pointer = ctypes.POINTER(type(self._state))
        given = [word] * len(realisation.channels)
        self._reset.argtypes, self._reset.restype = [pointer, *given], None
        self._step.argtypes, self._step.restype = [pointer, *given], word
        self.reset(*(0 for _ in given))

    @property
    def states(self) -> dict[str, float]:
        """By name, as the machine holds them."""
        return {name: getattr(self._state, name) for name in self.realisation.states}

    @property
    def limited(self) -> int:
        """Whether the last current was at its limit: -1, 0 or 1."""
        return int(self._state.limited)

    def reset(self, *readings: float) -> None:
        """At rest under constant readings."""
        self._reset(ctypes.byref(self._state), *readings)

    def step(self, *readings: float) -> float:
        """The current of one sample."""
        current = self._step(ctypes.byref(self._state), *readings)
        return float(current) if self.realisation.word_length is None else int(current)
