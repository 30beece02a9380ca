"""Drawing one case of a blind check: its data set in one folder, its answer in another."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from beamdesign.files import write_whole
from beamdesign.gap.blind.case_plan import Planned
from beamdesign.gap.blind.seal import canonical
from beamdesign.gap.truth import answer, draw_case, noise_free, write_case

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
            case = draw_case(planned.seed + attempt * _NEXT_SEED, planned.kind, short=short, names=planned.names)
        except ValueError as error:
            reason = str(error)
            continue
        write_case(case, sets / planned.key)
        answers.mkdir(parents=True, exist_ok=True)
        truth = {name: motion.displacement.astype(np.float32) for name, motion in noise_free(case).items()}
        np.savez_compressed(answers / f"{planned.key}.npz", **truth)  # type: ignore[arg-type]
        fields: dict[str, Any] = json.loads(json.dumps(answer(case)))
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
