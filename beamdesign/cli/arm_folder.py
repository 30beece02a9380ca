"""What `beamdesign arm --out` writes: certificates, tables, picture and the prototype as it was looked at."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamdesign.arm.both_planes import both_planes
from beamdesign.cli.output import write_csv
from beamdesign.files import fresh_folder, settled, write_whole
from beamdesign.prototype import Prototype, write_prototype
from beamdesign.report.arm_plot import compliance_curves, draw_arm
from beamdesign.report.canvas import save

if TYPE_CHECKING:
    from beamdesign.arm.remaining import Vector
    from beamdesign.arm.result import ArmResult
    from beamdesign.proof.box import BoxVerdict


def write_folder(
    record: Prototype, found: "ArmResult", force: "Vector", places: Mapping[str, "BoxVerdict"], folder: Path
) -> dict[str, Any]:
    """Write them as one set, and say which file is which; `places` are the verdicts on any place of the payload."""
    with fresh_folder(folder, ("certificate_*.toml",)) as fresh:
        files = _written(record, found, force, places, fresh)
    return {name: settled(paths, fresh, folder) for name, paths in files.items()}


def _written(
    record: Prototype, found: "ArmResult", force: "Vector", places: Mapping[str, "BoxVerdict"], out: Path
) -> dict[str, Any]:
    texts = {f"certificate_{plane.name}": plane.text for plane in found.planes}
    if found.both is not None and found.both.certificate:
        texts["certificate_both"] = found.both.certificate
    texts |= {f"certificate_anywhere_{name}": one.certificate for name, one in places.items() if one.certificate}
    files: dict[str, Any] = {}
    for name, text in texts.items():
        files[name] = out / f"{name}.toml"
        write_whole(files[name], text)
    files |= {name: out / f"{name}.csv" for name in ("compliance", "remaining", "response")}
    motions = ("x_m", "y_m", "z_m", "about_x_rad", "about_y_rad", "about_z_rad")
    loads = ("force_x_N", "force_y_N", "force_z_N", "moment_x_N_m", "moment_y_N_m", "moment_z_N_m")
    matrices = {
        ("tip", "no"): found.tip_passive, ("tip", "yes"): found.tip_active,
        ("payload", "no"): found.passive, ("payload", "yes"): found.active,
    }  # fmt: skip
    write_csv(
        files["compliance"],
        [
            {"at": at, "servo": servo, "motion": motion} | dict(zip(loads, map(float, row), strict=True))
            for (at, servo), matrix in matrices.items()
            if matrix is not None
            for motion, row in zip(motions, matrix, strict=True)
        ],
    )
    cases = {"no": found.without} | ({"yes": found.with_servo} if found.with_servo is not None else {})
    write_csv(
        files["remaining"],
        [
            {"servo": servo, "cause": cause} | dict(zip(("x_m", "y_m", "z_m"), vector, strict=True))
            for servo, case in cases.items()
            for cause, vector in (
                ("tip", case.tip_m),
                ("turning", case.from_turning_m),
                ("twist", case.from_twist_m),
                ("all", case.error_m),
            )
        ],
    )
    curves = compliance_curves(both_planes(record), found)
    write_csv(files["response"], curves.rows())
    files["figures"] = save(draw_arm(record, found, force, curves), out / "arm")
    files["prototype"] = out / "prototype.toml"
    write_prototype(record, files["prototype"])
    return files
