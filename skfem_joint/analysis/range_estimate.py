"""Stand-in."""
from dataclasses import replace
from skfem_joint.analysis.estimate import Estimate, verification_run
from skfem_joint.analysis.history import difference, results
def of_range(run, plan, progress=None):
    serves = run.system.serves
    larger = verification_run(serves.larger, plan, progress=progress)
    d = difference(results(larger), results(run))
    f = serves.factors
    basis = {k: None if v is None else v * f["energy" if "energy" in k else "history"] for k, v in d.items()}
    return Estimate({"basis": basis, "total": basis})
