"""The picture of the README: stable gains over payload of the paper's remedy, beside those of a tuned loop.

python studies/remedy_picture.py REMEDY.toml TUNED.toml PICTURE.svg
"""

import sys
from pathlib import Path

import numpy as np

from beamdesign import Prototype, read_prototype
from beamdesign.loop import loop
from beamdesign.report.canvas import new_figure, save
from beamdesign.report.pictures import plot_stable_gains


def draw(remedy: Prototype, tuned: Prototype, picture: Path, largest_mass_kg: float = 20.0) -> Path:
    """Draw both prototypes side by side and give the path of the SVG file."""
    figure = new_figure(190, 80)
    masses = [float(mass) for mass in np.linspace(0.0, largest_mass_kg, 161)]
    words = ("The paper's remedy", "Tuned and proved")
    for axes, prototype, title in zip(figure.subplots(1, 2, sharey=True), (remedy, tuned), words, strict=True):
        if prototype.controller is None:
            raise ValueError(f"{prototype.name} has no controller")
        gain, inner = prototype.controller.gain_A_per_V, prototype.payload.inner_end_mass_kg
        plot_stable_gains(axes, loop(prototype), gain, masses, prototype.payload.outer_end_mass_kg)
        axes.set_title(f"{title}: {inner:.3g} kg inside", fontsize=10)
    figure.axes[1].set_ylabel("")
    return save(figure, picture.with_suffix(""), ("svg",))[0]


if __name__ == "__main__":
    given, found, target = sys.argv[1:]
    print(draw(read_prototype(given), read_prototype(found), Path(target)))
