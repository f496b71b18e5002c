from warpcrete import Simulation, scenes
from warpcrete.mps.mixes import concrete_of
def go(**k):
    r = Simulation(scenes.pipe(**k), device="cuda").run().result
    return {n: round(r[n]["value"]/1e3,2) for n in ("peak_pressure","end_pressure","plateau_pressure")}
for u in "ABD": print("spheres zhan", u, go(unit=u), flush=True)
for n in ("no1","no3"):
    c = concrete_of(n); tau = c.slip_yield + .3*c.slip_viscosity
    for shapes in ("reference",):
        for cov in (0.8,):
            for u in "BA":
                print(n, shapes, u, go(unit=u, shapes=shapes, concrete=n, wall_friction=0.0, layer_yield=c.slip_yield/cov, layer_viscosity=c.slip_viscosity/cov),
                  "theory", round(1+4*tau/.15/1e3+(c.density*9.81e-3 if u=="A" else 0),2), flush=True)
