"""Motor current limit: drive and motor give no more current than their peak, whatever law and speed feedback ask for.

What the law asks for and what the drive takes off it for the rotor's speed meet the limit as one demand: a motor at its
limit has lost the drive's damping together with the law. `current_saturation` bounds what the law asks for alone.
"""

from beamdesign.plant.effects import Effect, Linear, Parameter, limited

EFFECT = Effect(
    name="motor_current_limit",
    subsystem="amplifier",
    laws={"motor_demand_A": lambda signal, site: limited(signal, site.parameter["limit_A"])},
    parameters=(
        Parameter(
            "limit_A", 30.0, 0.1, 1e3, 0.7, "largest current of drive and motor; where nothing is said their peak"
        ),
    ),
    source="W. Leonhard, Control of Electrical Drives, 3rd ed. (2001): a limit before the current loop",
    linear=Linear(
        "the loop below the limit, which is as it is without one",
        "a motor at its limit, which has lost the law and the drive's speed feedback together: a loop that is stable"
        " here may oscillate for good there",
        laws={},
        swings=True,
    ),
)
