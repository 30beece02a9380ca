"""The folder a design run leaves behind: prototype, certificate, report, specification."""

import os
from pathlib import Path

from beamdesign.records import InputError, to_toml
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
    """Write what a run gave; all texts are complete before the first file is touched.

    Args:
        result: a run with a certified prototype.
        out: the folder, made if need be; files of an earlier run are replaced, and a front.csv there is shown in the
            report.

    Returns:
        Paths of the four files, by the keys of `FILES`.

    Raises:
        InputError: where the folder cannot be made or written to.
        ValueError: where the run has no result; nothing is written then.
    """
    if result.prototype is None or result.certificate is None:
        raise ValueError(f"no result to write: {result.reason}")
    texts = {
        "prototype": to_toml(result.prototype),
        "certificate": result.certificate.text,
        "report": report_html(result, FILES, read_trade(out)),
        "specification": specification_markdown(result, FILES),
    }
    paths = {kind: out / name for kind, name in FILES.items()}
    try:
        out.mkdir(parents=True, exist_ok=True)
        for kind, path in paths.items():
            partial = path.with_name(path.name + ".part")
            # As bytes: the certificate's digest in the prototype must fit on every platform.
            partial.write_bytes(texts[kind].encode())
            os.replace(partial, path)
    except OSError as error:
        raise InputError(out, [("(folder)", error.strerror or str(error))]) from error
    return paths
