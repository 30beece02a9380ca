"""Controllers as machines carry them out: rate, words, C code, and what these cost in margin."""

from beamdesign.build.realisation.c_code import c_files
from beamdesign.build.realisation.realise import Realisation, realise
from beamdesign.build.realisation.sections import DiscreteLaw, Section, discretised
from beamdesign.build.realisation.verdict import Judgement, judge

__all__ = [
    "DiscreteLaw",
    "Judgement",
    "Realisation",
    "Section",
    "c_files",
    "discretised",
    "judge",
    "realise",
]
