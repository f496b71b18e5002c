"""Area on which a wall's lubrication layer acts, over that of the wall, of concrete in the level pipe.

    python tests/bench/bench_layer.py --device cuda --shapes reference spheres --layers 300 700 1200

Without gravity and friction the piston pushes against the plug's pressure and the layer alone, so what it needs besides
is the layer's stress times the area on which it acts. Prints device, sizes, repeats (seeds) and a table; of its last
column is the coverage that `warpcrete/dem/concretes.py` takes for concretes whose layer was measured in a tribometer.
"""

import argparse

import numpy as np

from warpcrete import Simulation, scenes


def coverage(device: str, shapes: str, layer: float, seed: int) -> tuple[float, float, int]:
    """Pressure at the end [Pa], area of the layer over that of the wall along the concrete, spheres."""
    scene = scenes.pipe(unit="B", shapes=shapes, concrete="zhan-table1", friction=0.0, layer_viscosity=layer,
                        gravity=0.0, seed=seed)  # fmt: skip
    run = Simulation(scene, device=device).run()
    pressure = run.result["end_pressure"]["value"]
    plug = np.array([group == "plug" for group in run.bodies.group])
    front = float(scene.pipe.axis.along(run.bodies.position[plug]).min())
    length = front - float(run.series["travel"][-1])
    wall = np.pi * 2 * scene.pipe.radius * length
    force = (pressure - scene.parameters["plug_pressure"]) * scene.pressure.area
    return pressure, force / (layer * scene.pipe.velocity * wall), run.result["spheres"]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--shapes", nargs="*", default=["spheres"])
    parser.add_argument("--layers", type=float, nargs="*", default=[700.0])
    parser.add_argument("--seeds", type=int, default=1)
    arguments = parser.parse_args()
    print(f"device: {arguments.device}; repeats: {arguments.seeds} seed(s)")
    print("| shapes | spheres | layer [Pa s/m] | pressure [kPa] | coverage |\n|---|---|---|---|---|")
    for shapes in arguments.shapes:
        for layer in arguments.layers:
            rows = [coverage(arguments.device, shapes, layer, seed) for seed in range(arguments.seeds)]
            pressure, area, _ = np.mean(rows, axis=0)
            print(f"| {shapes} | {rows[0][2]} | {layer:g} | {pressure / 1e3:.2f} | {area:.3f} |", flush=True)


if __name__ == "__main__":
    main()
