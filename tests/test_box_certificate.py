"""Certificates over a box of parameters: replayed on their own, and refused once altered."""

import hashlib
import re
import shutil
import subprocess
import sys

import pytest
from beamdesign.proof.replay_box import Malformed, replay
from flint import fmpq

from beamdesign.polynomial import exact
from beamdesign.proof import replay_box
from beamdesign.proof.box import box_of, certify_box
from beamdesign.proof.branch import Search
from beamdesign.proof.rig_family import Family

CUBIC = Family("cubic", "s**3 + 2*s**2 + s + q", {"q": fmpq(1, 2)})


@pytest.fixture(scope="module")
def certificate() -> str:
    """Of a family with every kind of part: reciprocals, packs, groups and a delay."""
    values = {"m": 1.0, "n": 0.0, "b": 0.6, "k": 4.0, "g": 2.0, "f": 1.0, "area": 2.0, "T": 0.0}
    parts = Family(
        "parts",
        "(spring*per_area_2 + inertia)*lag + gain*per_area*late",
        {name: exact(value) for name, value in values.items()},
        {
            "spring": "k",
            "inertia": "mass*s**2 + b*s",
            "lag": "1 + s/20",
            "gain": "loop_gain",
            "per_area": "1/area",
            "per_area_2": "1/area**2",
        },
        (("per_area", "per_area_2"),),
        {"late": "T"},
        (("mass", "sum", ("m", "n")), ("loop_gain", "product", ("g", "f"))),
    )
    box = box_of(
        {"n": (0, 1), "b": (1.5, 1.7), "k": (3.5, 4.5), "f": (0.2, 0.3), "area": (1.9, 2.1), "T": (0, 0.1)},
        {"n": 0, "T": 0},
    )
    verdict = certify_box(parts, box)
    assert verdict.stable is True
    return verdict.certificate


def resealed(text: str) -> str:
    """The text with the checksum that belongs to it, as one who alters it on purpose would leave it."""
    bare = re.sub(r'sha256 = "[0-9a-f]+"\n', "", text)
    seal = f'sha256 = "{hashlib.sha256(bare.encode()).hexdigest()}"\n'
    before, version, after = bare.partition("version = 1\n")
    return before + version + seal + after


def altered(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


def refused(text: str) -> bool:
    """Whether a text is not accepted: not valid, or not even a certificate."""
    try:
        return not replay(text).valid
    except Malformed:
        return True


def test_replay_stands_alone(certificate, tmp_path):
    shutil.copy(replay_box.__file__, tmp_path / "replay_box.py")
    path = tmp_path / "box.toml"
    path.write_text(certificate, encoding="utf-8")
    blocked = "import sys; sys.modules['beamdesign'] = sys.modules['numpy'] = None; "
    code = blocked + "import replay_box; sys.exit(replay_box.main(['box.toml']))"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("valid\n")


def test_altered_text_is_refused(certificate):
    assert replay(resealed(certificate)).valid
    outcome = replay(altered(certificate, 'k = ["3.5"', 'k = ["3.4"'))
    assert not outcome.valid
    assert "altered" in outcome.reasons[0]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('k = ["3.5", "4.5"]', 'k = ["3.5", "400"]'),
        ('T = ["0", "0.1"]', 'T = ["0", "20"]'),
        ('b = "1.6"', 'b = "9"'),
        ('b = ["1.5", "1.7"]', 'b = ["-0.1", "1.7"]'),
        ('inertia = "mass*s**2 + b*s"', 'inertia = "mass*s**2 - b*s"'),
        ('lag = "1 + s/20"', 'lag = "1 + s"'),
        ("gain*per_area*late", "spring*spring*spring*gain*per_area*late"),
        ('kind = "sum"', 'kind = "product"'),
    ],
)
def test_altered_statements_are_refused(certificate, old, new):
    assert not replay(resealed(altered(certificate, old, new))).valid


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('inf",', '?",'),
        ('inf",', '",'),
        ('inf",', 'inf inf",'),
        ('inf",', '1000,0",'),
        ('tree = [\n  "', 'tree = [\n  "k '),
        ('tree = [\n  "', 'tree = [\n  "w=-1 '),
        ('bound = [["per_area", "per_area_2"]]', 'bound = [["per_area", "per_area_2", "spring"]]'),
        ('inertia = "', 'inertia = "__import__(0) + '),
        ('inertia = "', 'inertia = "u + '),
        ("version = 1", "version = 2"),
        ('area = ["1.9"', 'area = ["0"'),
    ],
)
def test_altered_trees_and_expressions_are_refused(certificate, old, new):
    text = resealed(altered(certificate, old, new))
    assert refused(text)


def test_every_line_of_the_tree_counts(certificate):
    """A line turned by a right angle no longer separates, wherever it stands."""
    lines = re.findall(r"(?<=[ \"])-?\d+,-?\d+(?=[ \"])", certificate)
    assert len(lines) > 3
    for line in dict.fromkeys(lines):
        x, y = line.split(",")
        turned = re.sub(rf"(?<=[ \"]){re.escape(line)}(?=[ \"])", f"{-int(x)},{-int(y)}", certificate, count=1)
        assert not replay(resealed(turned)).valid


def test_refutation_is_replayed_too():
    verdict = certify_box(CUBIC, box_of({"q": (1, 3)}, {"q": 1}))
    assert verdict.stable is False
    assert replay(verdict.certificate).valid
    member_line = re.search(r"\[member\]\nq = .*\n", verdict.certificate).group(0)
    stable = altered(verdict.certificate, member_line, '[member]\nq = "1"\n')
    assert not replay(resealed(stable)).valid
    outside = altered(verdict.certificate, member_line, '[member]\nq = "4"\n')
    assert not replay(resealed(outside)).valid


def test_search_marks_what_is_open():
    statement = CUBIC.over({"q": (fmpq(1), fmpq(3))})
    search = Search(statement)
    search.run(60)
    assert not search.settled
    undecided = [piece for piece in replay_box.pieces(statement, search.tree) if piece.direction == "?"]
    assert undecided
    assert not any(replay_box.holds(piece) for piece in undecided)
    crossing = fmpq(1, 2)  # q = 2 is in the middle of the range, its root pair at w = 1
    assert any(
        piece.cell.shares["q"][0] <= crossing <= piece.cell.shares["q"][1] and piece.w1 <= 1 <= piece.w2
        for piece in undecided
        if piece.w2 is not None
    )
