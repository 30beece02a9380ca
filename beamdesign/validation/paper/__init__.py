"""Zalucky and Hardt (1984): the published rig as a prototype, and every published number beside the model's."""

from beamdesign.validation.paper.comparison import Comparison, compare
from beamdesign.validation.paper.rig import CASES, lag, paper_prototype, proportional

__all__ = ["CASES", "Comparison", "compare", "lag", "paper_prototype", "proportional"]
