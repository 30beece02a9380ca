"""Controllers as machines carry them out: rate, words, C code, and what these cost in margin."""

from beamdesign.realisation.c_code import c_files
from beamdesign.realisation.realise import Realisation, realise
from beamdesign.realisation.sections import DiscreteLaw, Section, discretised
from beamdesign.realisation.verdict import Judgement, judge

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
