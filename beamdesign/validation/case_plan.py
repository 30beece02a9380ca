"""Which cases a blind check is made of; their drawing, data sets in one folder, answers in another; and the seal.

Kinds come in fixed shares, and of each kind so do the rigs, every effect about as often as any other. The seal holds
digests of answers and data, taken before anybody looks for them and checked when answers are opened.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from beamdesign.files import write_whole
from beamdesign.validation.truth.case import answer, noise_free, write_case
from beamdesign.validation.truth.drawing import Hiss, Kind, draw_case
from beamdesign.validation.truth.effects import LISTED, OUTSIDE
from beamdesign.validation.truth.loop_figures import gap_over_errors, loop_figures
from beamdesign.validation.truth.rig_kinds import PARAMETERS, Rig, on

SHARES: dict[Kind, float] = {
    "null": 0.20, "single": 0.39, "parameter": 0.08, "pair": 0.12, "outside": 0.12, "triple": 0.05, "alone": 0.04,
}  # fmt: skip
"""Of all cases."""
RIGS: tuple[Rig, ...] = ("lag", "lag", "arm", "structured", "ball_screw", "observer")
HISSES: tuple[Hiss, ...] = ("white", "white", "white", "coloured", "outliers")
"""Dealt to the cases of each kind: a fifth of them each."""
FIGURES = (False, False, False, False, True)
"""Likewise, whether frequency responses and critical gains are measured beside the records."""
_SEEDS_PER_PLAN = 100_000
T = TypeVar("T")


@dataclass(frozen=True)
class Planned:
    """One case to be drawn.

    Attributes:
        number: in the order in which they are diagnosed, which mixes the kinds.
        kind: of case.
        names: of the effects in it; none for a null.
        seed: of its drawing.
        rig: which rigs it is drawn from.
        noise: of its sensor and recorder.
        figures: whether frequency responses and critical gains are measured as well; of the kind `alone` always.
    """

    number: int
    kind: Kind
    names: tuple[str, ...]
    seed: int
    rig: Rig = "lag"
    noise: Hiss = "white"
    figures: bool = False

    @property
    def key(self) -> str:
        """Under which its files are kept."""
        return f"{self.number:04d}"


def plan(count: int, seed: int) -> tuple[Planned, ...]:
    """Plan a check.

    Args:
        count: of cases.
        seed: another one gives other cases throughout.

    Raises:
        ValueError: for no cases or a negative seed.
    """
    if count < 1 or seed < 0:
        raise ValueError("a check needs at least one case and a seed that is not negative")
    random = np.random.default_rng([seed, count])
    rows: list[tuple[Kind, tuple[str, ...], Rig, Hiss, bool]] = []
    for kind, number in counts(count).items():
        rigs, hisses = _dealt(RIGS, number, random), _dealt(HISSES, number, random)
        more = _dealt(FIGURES, number, random)
        able = Counter(names for rig in RIGS for names in _pools(rig)[kind])
        often: Counter[tuple[str, ...]] = Counter()
        for rig, hiss, figures in zip(rigs, hisses, more, strict=True):
            pool = _pools(rig)[kind]
            mixed = [pool[k] for k in random.permutation(len(pool))]
            names = min(mixed, key=lambda names: (often[names], able[names]))  # first what few rigs can have
            often[names] += 1
            rows.append((kind, names, rig, hiss, figures or kind == "alone"))
    ordered = (rows[index] for index in random.permutation(len(rows)))
    return tuple(
        Planned(k, kind, names, seed * _SEEDS_PER_PLAN + k, rig, hiss, figures)
        for k, (kind, names, rig, hiss, figures) in enumerate(ordered)
    )


def _pools(rig: Rig) -> dict[Kind, Sequence[tuple[str, ...]]]:
    listed = on(rig, LISTED)
    return {
        "null": [()],
        "single": [(name,) for name in listed],
        "parameter": [(f"parameter:{name}",) for name in on(rig, PARAMETERS)],
        "pair": list(combinations(listed, 2)),
        "outside": [(name,) for name in on(rig, OUTSIDE)],
        "triple": list(combinations(listed, 3)),
        "alone": [(name,) for name in listed],
    }


def counts(total: int) -> dict[Kind, int]:
    """How many of each kind: the shares, rounded so that they add up (largest remainders)."""
    exact = {kind: share * total for kind, share in SHARES.items()}
    found = {kind: int(value + 1e-9) for kind, value in exact.items()}
    late = sorted(SHARES, key=lambda kind: found[kind] - exact[kind])
    for kind in late[: total - sum(found.values())]:
        found[kind] += 1
    return found


def _dealt(pool: Sequence[T], count: int, random: np.random.Generator) -> list[T]:
    """Deal out a shuffled pool, shuffled anew whenever it is used up."""
    found: list[T] = []
    while len(found) < count:
        found += [pool[k] for k in random.permutation(len(pool))]
    return found[:count]


_TRIES = 4
_NEXT_SEED = 20_000  # further on, where a seed has no stable case


def draw(planned: Planned, short: bool, sets: Path, answers: Path) -> str:
    """Draw a case and write it, unless it is there.

    Args:
        planned: what to draw.
        short: five records of 1.75 s instead of eight of 4 s.
        sets: folder in which the data set gets a folder of its own.
        answers: folder for the answer and the noise-free displacements.

    Returns:
        the reason why there is no such case; empty where there is one.
    """
    target = answers / f"{planned.key}.json"
    if target.is_file():
        return ""
    for attempt in range(_TRIES):
        try:
            seed = planned.seed + attempt * _NEXT_SEED
            case = draw_case(seed, planned.kind, short=short, names=planned.names, rig=planned.rig, noise=planned.noise)
        except ValueError as error:
            reason = str(error)
            continue
        folder = sets / planned.key
        write_case(case, folder, loop_figures(case, folder) if planned.figures else {})
        answers.mkdir(parents=True, exist_ok=True)
        truth = {name: motion.displacement.astype(np.float32) for name, motion in noise_free(case).items()}
        np.savez_compressed(answers / f"{planned.key}.npz", **truth)  # type: ignore[arg-type]
        fields: dict[str, Any] = json.loads(json.dumps(answer(case))) | {"figures": planned.figures}
        if planned.kind == "alone":
            fields["figures_over_errors"] = gap_over_errors(case)
        fields["displacements_sha256"] = displacements_digest(truth)
        write_whole(target, canonical(fields).decode() + "\n")
        return ""
    return reason


def displacements_digest(records: dict[str, np.ndarray]) -> str:
    """SHA-256 of the noise-free displacements of a case."""
    sha = hashlib.sha256()
    for name in sorted(records):
        sha.update(name.encode() + b"\0" + np.ascontiguousarray(records[name], dtype="<f4").tobytes())
    return sha.hexdigest()


@dataclass(frozen=True)
class Seal:
    """Digests.

    Attributes:
        answers: SHA-256 of each answer in its canonical form, by case.
        sets: SHA-256 of the files of each data set, by case.
        truth: digest of the program that drew the cases.
    """

    answers: Mapping[str, str]
    sets: Mapping[str, str]
    truth: str

    @property
    def whole(self) -> str:
        """SHA-256 of all of these."""
        return hashlib.sha256(canonical(vars(self))).hexdigest()


def canonical(answer: Mapping[str, Any]) -> bytes:
    """An answer as bytes that do not depend on how it is laid out: sorted keys, no spaces, shortest figures.

    Raises:
        ValueError: for figures that are not finite.
    """
    return json.dumps(answer, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode()


def sealed(answers: Mapping[str, Mapping[str, Any]], sets: Mapping[str, str], truth: str = "") -> Seal:
    """Seal answers.

    Args:
        answers: by case.
        sets: digest of each case's data, by case.
        truth: digest of the program that drew them.
    """
    return Seal(_digests(answers), dict(sorted(sets.items())), truth)


def write_seal(seal: Seal, path: Path) -> None:
    """Write it down.

    Raises:
        OSError: where it cannot be written.
    """
    fields = {"whole": seal.whole, "truth": seal.truth, "answers": dict(seal.answers), "sets": dict(seal.sets)}
    write_whole(path, json.dumps(fields, indent=1) + "\n")


def read_seal(path: Path) -> Seal:
    """Read it back.

    Raises:
        OSError: where it cannot be read.
        ValueError: where it is no seal, or where its parts are not those that its whole was made of.
    """
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
        found = Seal(fields["answers"], fields["sets"], fields["truth"])
        sound = found.whole == fields["whole"]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: no seal: {error}") from error
    if not sound:
        raise ValueError(f"{path}: the digest of the whole is not that of its parts")
    return found


def broken(seal: Seal, answers: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Cases whose answer is not the one that was sealed: changed, taken away or put in."""
    found = _digests(answers)
    return sorted(case for case in {*seal.answers, *found} if seal.answers.get(case) != found.get(case))


def _digests(answers: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    return {case: hashlib.sha256(canonical(given)).hexdigest() for case, given in sorted(answers.items())}
