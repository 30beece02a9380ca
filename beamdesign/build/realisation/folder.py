"""The folder of a realised controller: its C files, what is said at their head, and how to compile and run them."""

import os
import shutil
import subprocess
from pathlib import Path

from beamdesign.build.realisation.c_code import HEADER, LAW, SELF_TEST, c_files
from beamdesign.build.realisation.realise import Realisation
from beamdesign.build.realisation.verdict import Judgement
from beamdesign.files import write_set


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


FLAGS = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O2", "-ffp-contract=off")


def compiler() -> str | None:
    """The C compiler: that of the environment variable CC, or the first of cc, gcc and clang on the path."""
    names = [name for name in (os.environ.get("CC", ""), "cc", "gcc", "clang") if name]
    return next((found for name in names if (found := shutil.which(name))), None)


def compile_self_test(folder: Path) -> Path:
    """Compile the program whose exit status is 0 where the self-test of the files of a folder passes.

    Raises:
        ValueError: without a compiler, or where it finds fault with the files, in its own words.
    """
    return compiled(folder, folder / "controller_self_test", "-DCONTROLLER_SELF_TEST_MAIN")


def compiled(folder: Path, target: Path, *more: str) -> Path:
    """Compile the files of a folder to a target with further flags; errors as of `compile_self_test`."""
    program = compiler()
    if program is None:
        raise ValueError("no C compiler found: neither cc, gcc nor clang is on the path")
    done = subprocess.run(
        [program, *FLAGS, *more, "-o", str(target), *(str(folder / name) for name in (LAW, SELF_TEST))],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise ValueError(f"{program} finds fault with {folder / HEADER} or what belongs to it:\n{done.stderr.strip()}")
    return target
