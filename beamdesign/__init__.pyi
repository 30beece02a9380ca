# The public names with their types; `__init__.py` takes from here where each stands.

from beamdesign.bench_prototype import read_bench_prototype as read_bench_prototype
from beamdesign.build.realisation.code import code as code
from beamdesign.build.specification import spec as spec
from beamdesign.build.specification import specify as specify
from beamdesign.checker import check as check
from beamdesign.diagnosis.data.bench_set import read_bench_set as read_bench_set
from beamdesign.diagnosis.data.dataset import read_dataset as read_dataset
from beamdesign.diagnosis.data.importing import import_measured as import_measured
from beamdesign.diagnosis.diagnose import diagnose as diagnose
from beamdesign.diagnosis.predict import predict as predict
from beamdesign.loop import critical_gain as critical_gain
from beamdesign.problem import DesignProblem as DesignProblem
from beamdesign.problem import read_problem as read_problem
from beamdesign.proofs.arm.result import arm as arm
from beamdesign.proofs.certifying import certify as certify
from beamdesign.proofs.loop_family import prove as prove
from beamdesign.proofs.over_box import certify_box as certify_box
from beamdesign.prototype import Prototype as Prototype
from beamdesign.prototype import read_prototype as read_prototype
from beamdesign.prototype import write_prototype as write_prototype
from beamdesign.public import certify_switching as certify_switching
from beamdesign.public import pictures as pictures
from beamdesign.public import state_space as state_space
from beamdesign.public import study as study
from beamdesign.records import InputError as InputError
from beamdesign.scenario import read_scenario as read_scenario
from beamdesign.simulation import simulate as simulate
from beamdesign.synthesis.codesign import codesign as codesign
from beamdesign.synthesis.codesign import front as front
from beamdesign.synthesis.design_run import run as run
from beamdesign.synthesis.design_run import run_design as run_design
from beamdesign.synthesis.operating_limits import limits as limits
from beamdesign.synthesis.remedies import remedies as remedies
from beamdesign.synthesis.sizing import size as size
from beamdesign.synthesis.stiffness_search import stiffness as stiffness
from beamdesign.synthesis.tuning import tune as tune
from beamdesign.validation.blindcheck import blindcheck as blindcheck
from beamdesign.validation.paper_comparison import paper as paper

__all__: list[str]
__version__: str
