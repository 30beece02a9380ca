"""The folder of a realised controller: its C files, and what is said at the head of them."""

from pathlib import Path

from beamdesign.files import write_set
from beamdesign.realisation.c_code import c_files
from beamdesign.realisation.realise import Realisation
from beamdesign.realisation.verdict import Judgement


def notes(found: Judgement, masses_kg: tuple[float, float]) -> tuple[str, ...]:
    """Lines on the loop for the head of the header."""
    if found.reason:
        return (f"Its loop is not proved: {found.reason}.",)
    where = f"{masses_kg[0]:g} to {masses_kg[1]:g} kg" if masses_kg[0] < masses_kg[1] else f"{masses_kg[0]:g} kg"
    if not found.proved:
        return (f"Its loop is not proved for {where} on the outer tip.",)
    when = "at its sample or one whole period later" if found.any_time is None else "at any time within a period"
    return (
        f"Proved stable for {where} on the outer tip, with these coefficients, the current held, put out",
        f"{when}. Roundings and limits are no part of that proof.",
    )


def write_code(
    realisation: Realisation, name: str, found: Judgement, masses_kg: tuple[float, float], folder: Path
) -> list[Path]:
    """Write the C files of a realised controller, all of them or none.

    Raises:
        OSError: where one cannot be written.
    """
    texts = c_files(realisation, name, notes(found, masses_kg))
    return list(write_set(folder, {file: (file, text) for file, text in texts.items()}).values())
