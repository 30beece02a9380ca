"""What a release says of itself: the same everywhere."""

import re
import tomllib
from importlib.metadata import metadata
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_one_version_is_stated_everywhere() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    told = re.search(r"^## (\S+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert cited is not None
    assert told is not None
    assert {cited[1], told[1], metadata("beamdesign")["Version"]} == {version}


def test_an_installed_package_says_what_it_is() -> None:
    said = metadata("beamdesign")
    assert said["License-Expression"] == "BSD-3-Clause"
    assert said["Requires-Python"]
    assert {"Topic :: Scientific/Engineering", "Typing :: Typed"} <= set(said.get_all("Classifier", []))
