"""Design of actively straightened robot links: sections, controller and end mass, with proofs that they hold.

Functions on two records do what the commands do: a `DesignProblem` is a study file, a `Prototype` is one rig. Figures
are in SI, payloads are a range of mass on the outer tip in kg, and what a function gives is a record that says why
where the answer is no. In the order in which one needs them:

1. `read_prototype` and `read_problem` read the files; `InputError` names everything that is wrong with one at once.

   >>> import beamdesign
   >>> rig = beamdesign.read_prototype("studies/prototypes/paper_remedy.toml")
   >>> rig.payload.outer_end_mass_kg
   (0.0, 6.8)

2. `size` finds the lightest tubes of a problem, `tune` controller and inner end mass for the largest guaranteed
   bandwidth of a rig, `codesign` all of them together, and `run_design` goes from a problem to a certified prototype.
   `front` draws co-designs over bandwidths and payloads, `remedies` compares the paper's four for payload, and
   `stiffness` gives the end of a link a commanded stiffness and says what contact it bears.

   >>> found = beamdesign.size(beamdesign.read_problem("studies/prototype.toml"))
   >>> f"{found.beam_mass_kg:.4g} kg, governed by {found.governing}"
   '9.518 kg, governed by inner strength, servo on'

   `run` is `run_design` by the name of the command, and its record has what each step gave.

3. `certify` proves stability and performance for every payload of a range, `check` proves a certificate again from its
   text alone, and `critical_gain` is where a loop begins to oscillate. `certify_box` does so of every rig within
   tolerances at once, `certify_switching` while the payload changes in motion, and `arm` of both planes with torsion.

   >>> beamdesign.certify(rig, (2.0, 6.8)).stable
   True
   >>> [f"{low:.4g} to {high:.4g} kg" for low, high in beamdesign.certify(rig).stable_ranges_kg]
   ['1.968 to 6.8 kg']
   >>> f"{1e3 * beamdesign.critical_gain(rig, 6.8).gain_A_per_V:.4g} mA/V"
   '199.1 mA/V'

4. `state_space` hands a closed loop to python-control, `simulate` gives records of a scenario, which `read_scenario`
   reads, and `limits` what actuator, sensor and linear model bear. `pictures` draws a loop: Bode with margins, Nyquist,
   root locus, compliance beside that without servo, and what masses and gains are stable.
5. `spec` (also by the name `specify`) works out what to build and how to accept it; `code` is the
   controller as C code for a rate, proved as it is rounded.
6. `read_dataset` reads what came back from the rig, and `predict` gives what a model would have recorded there;
   `diagnose` tells where the rig differs from its prototype, why, and how far the difference closes. Files of other
   programs become a data set by `import_measured`, and `blindcheck` says how often a diagnosis is right. An actuator
   on a bench has readers of its own, `read_bench_prototype` and `read_bench_set`; `simulate`, `predict`, `diagnose`
   and `write_prototype` take what they give.
7. `write_prototype` writes a rig to its file, which every command takes.
8. `study` carries out a sweep over any key of a file, and nothing is computed twice; `paper` recomputes what Zalucky
   and Hardt (1984) state.
9. `prove` proves any other loop of one input and one output, given as a system of python-control or over parameters.

   >>> import control
   >>> proved = beamdesign.prove(control.tf([10], [1, 6, 5, 0]))
   >>> proved.gain_increase, f"{proved.phase_margin_deg[0]:.4f} deg"
   ((3.0, 3.0), '25.3898 deg')

What the engines give is a `beamdesign.result.Result` (of `remedies` one each; the verdict of `check` stands alone, as
its checker does): `status` is the answer in a word, `rows()` its table, `to_dict()` its plain values, of most functions
the fields that the command of that name writes with `--json`, but for its files; a notebook shows it as a table.

Importing this package loads none of their engines; each comes with the first use of its name.
"""

import re
from importlib import import_module
from pathlib import Path
from typing import Any

_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
_PLACES = {name: module for module, name in re.findall(r"^from (\S+) import (\w+)", _STUB, re.MULTILINE)}
"""Public names, each with the module that has it, as the stub beside this file states them for type checkers."""

__all__ = sorted(_PLACES)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
