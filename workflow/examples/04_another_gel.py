"""The same press into gels of another stiffness, thickness and compressibility."""

import gelforge

sphere = {"kind": "sphere", "diameter": 10, "height": 10}
usual = gelforge.solve(sphere, depth=0.6, quality="demo").total[2]
print(f"as the project's gel: {usual:.3f} N")

# C10 in MPa is the stiffness of the neo-Hookean gel: force is exactly proportional to it.
stiffer = gelforge.solve(sphere, depth=0.6, c10=2 * 0.0725, quality="demo").total[2]
print(f"twice as stiff: {stiffer:.3f} N, {stiffer / usual:.3f} times as much")

# A gel that is 3.6 mm thick at its highest point; its rigid base is nearer.
thinner = gelforge.solve(sphere, depth=0.6, gel="gelsight_mini-3.6mm", quality="demo").total[2]
print(f"3.6 mm thick: {thinner:.3f} N, {thinner / usual:.3f} times as much")

# Poisson's ratio: 0.5 would be incompressible.
softer = gelforge.solve(sphere, depth=0.6, nu=0.45, quality="demo").total[2]
print(f"more compressible: {softer:.3f} N, {softer / usual:.3f} times as much")
