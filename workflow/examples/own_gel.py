"""The same press into gels of your own: a table of workflow/gels.toml each, by measures or from a closed STL."""

from pathlib import Path

import gelforge

GELS = Path(__file__).parents[1] / "gels.toml"

usual = gelforge.solve("sphere_10", depth=0.4).total[2]
print(f"GelSight Mini, 4 mm thick: {usual:.3f} N")

# flat_2mm and dome stand in that file as examples; add yours beside them. NAME-3.6mm is any of them 3.6 mm thick.
for gel in ("flat_2mm", "dome", "gelsight_mini-3.6mm"):
    force = gelforge.solve("sphere_10", depth=0.4, gel=gel, gels=GELS).total[2]
    print(f"{gel}: {force:.3f} N, {force / usual:.3f} times as much")

# C10 in MPa is the stiffness of the neo-Hookean gel: force is exactly proportional to it. nu: Poisson's ratio.
stiffer = gelforge.solve("sphere_10", depth=0.4, c10=2 * 0.0725).total[2]
print(f"twice as stiff: {stiffer:.3f} N, {stiffer / usual:.3f} times as much")
