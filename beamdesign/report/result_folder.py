"""The folder a design run leaves behind: prototype, certificate, report, specification."""

from pathlib import Path

from beamdesign.files import write_set
from beamdesign.proof.lyapunov import CHANGES_NAME
from beamdesign.records import to_toml
from beamdesign.report.html import report_html
from beamdesign.report.specification import specification_markdown
from beamdesign.report.trade_rows import read_trade
from beamdesign.study.design_run import CERTIFICATE_NAME, DesignRun

FILES = {
    "prototype": "prototype.toml",
    "certificate": CERTIFICATE_NAME,
    "report": "report.html",
    "specification": "specification.md",
}
"""Names of the files, by kind."""


def write_result_folder(result: DesignRun, out: Path) -> dict[str, Path]:
    """Write what a run gave, all of it or nothing.

    Args:
        result: a run with a certified prototype.
        out: the folder, made if need be; files of an earlier run are replaced, and a front.csv there is shown in the
            report.

    Returns:
        Paths of the four files, by the keys of `FILES`; of several laws those of each but for the prototype,
        with the suffix of its stage in key and name, and the proof of changes between them.

    Raises:
        OSError: where the folder cannot be made or written to; it is then as it was.
        ValueError: where the run has no result; nothing is written then.
    """
    if result.prototype is None or result.certificate is None:
        raise ValueError(f"no result to write: {result.reason}")
    texts = {"prototype": (FILES["prototype"], to_toml(result.prototype))}
    for law in result.laws or (result,):
        assert law.certificate is not None
        names = {kind: name.replace(".", f"{law.suffix}.") for kind, name in FILES.items()}
        names["prototype"] = FILES["prototype"]
        own = {
            "certificate": law.certificate.text,
            "report": report_html(law, names, read_trade(out)),
            "specification": specification_markdown(law, names),
        }
        texts |= {kind + law.suffix.replace(".", "_"): (names[kind], text) for kind, text in own.items()}
    if result.changes:
        texts["certificate_switching"] = (CHANGES_NAME, result.changes)
    return write_set(out, texts, ("*.stage_*.*", CHANGES_NAME))
