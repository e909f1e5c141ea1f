"""Damping and frequency of a mode against its amplitude: the structure of Fig. 18.

There are three ways to the same curves. Quasi-static modal analysis gives a mode's frequency and
damping against its amplitude (the backbone) in hundredths of a second. Released from its highest
level, the structure rings down through the same amplitudes. The response to a harmonic force, at
several levels of the force, has its peaks there too. The frequencies of a uniform bar are as
1 : 3 : 5, so that the odd harmonics of friction excite the higher modes: the true damping, of
ring-down and response, is up to twice that of the backbone, as its warning states. A heavy tip
moves the higher modes away.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import skfem_joint as sj

# The structure, its Coulomb friction, and 0.2 % of viscous damping.
scene = sj.load_scene(Path(__file__).resolve().parent / "structure_harmonic.toml")
scene = scene.changed(joint={"law": "coulomb"}, damping={"stiffness": 0.0, "ratio": 0.002})
system = scene.system()

# Frequency and damping of the first mode against its amplitude, and as it rings down.
(curve,) = sj.backbone(system, modes=[1], levels=30, up_to=0.5)
down = sj.ring_down(system, curve, cycles=60)
end = abs(curve.displacement[-1, 0] / curve.amplitude[-1])  # of the free end, m, over modal
reach = curve.displacement[:, 0]

# Steady vibration at three levels of the load, in shares of 87.5 kN.
levels = (0.003, 0.01, 0.03)
swept = sj.response(system, np.linspace(2300.0, 2550.0, 26), levels)

figure = Figure(figsize=(9.0, 4.0), layout="constrained")
left, right = figure.subplots(1, 2)
for response in swept:
    label = f"response, {100 * response.level:g} % of 87.5 kN"
    left.semilogy(
        response.column("frequency"), 1e3 * response.column("amplitude")[:, 0], "-", label=label
    )
left.semilogy(curve.frequency, 1e3 * reach, "k--", label="backbone")
left.semilogy(down.frequency, 1e3 * end * down.amplitude, "k.", label="ring-down")
left.set(xlabel="frequency, Hz", ylabel="amplitude of the free end, mm", xlim=(2300.0, 2550.0))
left.set_ylim(bottom=1e-3)
right.plot(1e3 * reach, 100.0 * curve.damping_ratio, "k--", label="backbone")
right.plot(1e3 * end * down.amplitude, 100.0 * down.damping_ratio, "k.", label="ring-down")
right.set(xlabel="amplitude of the free end, mm", ylabel="damping ratio, %")
for panel in (left, right):
    panel.legend(fontsize="small", loc="lower right")
    panel.grid(alpha=0.3)

if __name__ == "__main__":
    figure.savefig("damping.png", dpi=150)
    print(f"stuck frequency {curve.stuck_frequency:.1f} Hz, {curve.warnings[-1]}")
    for response in swept:
        peak, amplitude = response.peak
        print(f"level {response.level}: peak {1e3 * amplitude:.4f} mm at {peak:.1f} Hz")
    print(
        f"ring-down lost {down.friction_work[-1].sum():.1f} of {down.energy[0]:.1f} J in the joint"
    )
