"""What a sweep is about to compute: its cases that are known beforehand, on a grid or as samples of ranges."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import ceil, log2
from pathlib import Path
from typing import Any

import numpy as np

from beamdesign.sweep.case import Case, case
from beamdesign.sweep.sweep_file import SAMPLED, Sweep, Vary, with_value

_OPTIONS = "options"


@dataclass(frozen=True)
class Plan:
    """A sweep read from its file, with its base document.

    Attributes:
        path: of the sweep file.
        sweep: what it says.
        base: tables of the base document.
        cases: the cases that are known beforehand; of an adaptive method none.
        budget: how many there are at most.
        limit: as asked, None for all.
    """

    path: Path
    sweep: Sweep
    base: dict[str, Any]
    cases: tuple[Case, ...]
    budget: int
    limit: int | None = None


def points(sweep: Sweep, cases: int | None = None) -> list[dict[str, Any]]:
    """Varied values by key, one table per case, in a stable order.

    Args:
        sweep: with method grid, latin_hypercube or sobol.
        cases: take no more than so many: spread evenly over a grid, or as many samples.
    """
    if sweep.study.method in SAMPLED:
        return list(_sampled(sweep, cases or sweep.study.cases))
    found = [merged(parts) for parts in product(*(_axis(vary) for vary in sweep.vary))]
    if cases is None or cases >= len(found):
        return found
    chosen = np.unique(np.round(np.linspace(0, len(found) - 1, cases)).astype(int))
    return [found[k] for k in chosen]


def merged(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Several tables of varied values as one."""
    return {key: value for part in parts for key, value in part.items()}


def at(vary: Vary, value: Any, number: int | None = None) -> dict[str, Any]:
    """Values of a varied key and of those that go along; `number` is that of a listed value."""
    found = {vary.key: value}
    for key, other in vary.along.items():
        found[key] = other.values[number or 0] if other.values is not None else _times(value, other.times)
    return found


def _times(value: Any, factor: float | None) -> Any:
    """A factor on a value; digits beyond those that any tape measures are noise of binary arithmetic."""
    return float(f"{float(value) * float(factor or 1.0):.12g}")


def scaled(vary: Vary, share: float) -> dict[str, Any]:
    """Values at a share, 0 to 1, of an axis: between its ends, or one of its listed values."""
    if vary.values is not None:
        number = min(int(share * len(vary.values)), len(vary.values) - 1)
        return at(vary, vary.values[number], number)
    assert vary.low is not None
    assert vary.high is not None
    if vary.spacing == "logarithmic":
        value = vary.low * (vary.high / vary.low) ** share
    else:
        value = vary.low + share * (vary.high - vary.low)
    return at(vary, float(f"{value:.12g}"))


def _axis(vary: Vary) -> list[dict[str, Any]]:
    if vary.values is not None:
        return [at(vary, value, number) for number, value in enumerate(vary.values)]
    return [scaled(vary, k / (vary.count - 1)) for k in range(vary.count)]


def _sampled(sweep: Sweep, cases: int) -> Iterator[dict[str, Any]]:
    from scipy.stats import qmc

    dimensions, seed = len(sweep.vary), sweep.study.seed
    if sweep.study.method == "sobol":  # balanced only as a power of two: the rest of the last one is left out
        unit = qmc.Sobol(dimensions, scramble=True, rng=seed).random_base2(max(0, ceil(log2(cases))))[:cases]
    else:
        unit = qmc.LatinHypercube(dimensions, rng=seed).random(cases)
    for row in unit:
        yield merged([scaled(vary, float(share)) for vary, share in zip(sweep.vary, row, strict=True)])


def case_at(sweep: Sweep, base: Mapping[str, Any], varied: Mapping[str, Any]) -> Case:
    """The case of a sweep with the given varied values put into its base document and options.

    Raises:
        ValueError: where a value cannot be put in.
    """
    document: dict[str, Any] = dict(base) | {_OPTIONS: dict(sweep.options)}
    for key, value in varied.items():
        document = with_value(document, key, value)
    options = document.pop(_OPTIONS)
    return case(sweep.study.task, document, options, varied)
